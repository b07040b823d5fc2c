"""Deep PILCO learning the cart-pole swing-up: a unit is a batch of repetitions, a step of its process is a trial."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Generator, Tensor

from dropout_uncertainty.data_efficiency.deep_pilco import particles, planning
from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import DropoutDynamics
from dropout_uncertainty.data_efficiency.deep_pilco.ensemble import Ensemble
from dropout_uncertainty.data_efficiency.deep_pilco.planning import Dynamics, Planning
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP, LEAN, Learner
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER, CartPole, Rollout
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.runs.unit import precision_dtype
from dropout_uncertainty.settings import at_least, of_type, positive

__all__ = ["AS_TEXT", "AS_WRITTEN", "CONFIGS", "OURS", "SEARCH", "DeepPilcoConfig", "DeepPilcoLearning", "start"]

#: Trials whose policies are kept, for the animations and figure 5.8.
SHOWN = (1, 2, 3, 5, 10, 20, 26, 40)
#: True trials of each shown policy from fresh start states, beside the one it learns from (figure 5.8, green).
REPEATS = 5
#: Particles of the recorded prediction: more than are planned with, since it is drawn and not optimised.
PREDICTED = 100


@dataclass(frozen=True)
class DeepPilcoConfig(Planning):
    """The learner; the choices of planning are inherited. Defaults are `OURS`.

    "Paper" is the Deep PILCO workshop paper (Gal, McAllister and Rasmussen, 2016) at second hand: what two
    re-implementations written from it agree on or attribute to it (zuoxingdong/DeepPILCO, BrunoKM/deep-pilco-torch).
    """

    #: The cart-pole, its start distribution and trial length: the paper's.
    plant: CartPole = field(default_factory=lambda: PAPER)
    #: How the real plant moves: accurately ("runge-kutta"), or in one "euler" step per control interval, as the plants
    #: of two public re-implementations do.
    integration: str = "runge-kutta"
    trials: int = 40  #: Controlled trials after the random one (thesis section 5.4.3: run times of 40 trials).
    hidden: tuple[int, ...] = (200, 200)  #: Widths of the network's hidden layers (paper).
    activation: str = "relu"  #: Of the hidden layers: "relu", or "sigmoid" (paper).
    drop: float = 0.05  #: Drop probability of the hidden units (paper: 0.05 to 0.1).
    input_drop: float = 0.0  #: Drop probability of the network's inputs; the re-implementations differ.
    angle_features: bool = True  #: The network is given sin θ and cos θ instead of θ; not in thesis or paper.
    #: Inputs and targets of the network are scaled to mean 0 and standard deviation 1; not in thesis or paper.
    standardise: bool = True
    #: Length-scale l of the prior over the weights: with N and the drop probability it gives the weight decay (thesis
    #: equation 3.14). Thesis and paper give no value.
    length_scale: float = 0.1**0.5
    model_steps: int = 600  #: Adam steps per trial for the network; the paper has 5000.
    model_rate: float = 2e-3  #: Their size at first; thesis and paper give none.
    model_final_rate: float = 0.1  #: Their size at the end as a share of the first; it falls along a cosine.
    batch: int = 100  #: Transitions per step (paper), or all while there are fewer.
    memory: int = 0  #: The network learns from that many last trials (paper: 10); 0, as in the thesis: from all.
    basis: int = 50  #: Basis functions of the policy (paper).
    #: Standard deviations of the first centres in x, v, w, sin θ, cos θ, and first length-scales; our choice.
    spread: tuple[float, ...] = (1.0, 2.0, 4.0, 0.7, 0.7)
    #: Standard deviation of the first weights of the basis functions; our choice. The pole must be thrown about early,
    #: or the data teach nothing.
    weight_std: float = 0.5
    #: A policy whose predicted cost per step stays above this is drawn anew; 1, as in thesis and paper: never.
    guard: float = 0.98
    redraws: int = 2  #: How often at most, per trial.
    #: The policy is improved on draws of the weights. Otherwise on the mean network (weight scaling): a model that was
    #: trained with dropout and is sure of itself. With an ensemble, on its members or on the mean of their outputs.
    doubt: bool = field(default=True, metadata={"before": True})
    #: Networks without dropout, each with its own first weights and minibatches, that share the particles; 1, as in
    #: thesis and paper: one network.
    ensemble: int = field(default=1, metadata={"before": 1})

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.integration not in ("runge-kutta", "euler"):
            raise ValueError(f"expected the integration runge-kutta or euler, got {self.integration!r}")
        at_least(1, trials=self.trials, basis=self.basis, model_steps=self.model_steps, batch=self.batch)
        at_least(0, memory=self.memory, redraws=self.redraws, weight_std=self.weight_std)
        positive(model_rate=self.model_rate, length_scale=self.length_scale)
        if len(self.spread) != planning.DIM or min(self.spread) <= 0:
            raise ValueError(f"expected {planning.DIM} positive spreads, one per feature, got {self.spread}")
        shares = (self.drop, self.input_drop, self.model_final_rate, self.guard)
        if not all(0 <= share <= 1 for share in shares) or max(self.drop, self.input_drop) == 1:
            raise ValueError(f"expected drop probabilities in [0, 1), final rate and guard in [0, 1], got {shares}")
        if self.activation not in ("relu", "sigmoid") or not self.hidden or min(self.hidden) < 1:
            raise ValueError(f"expected layers of relu or sigmoid units, got {self.activation} and {self.hidden}")
        if self.ensemble < 1 or (self.ensemble > 1 and (self.drop or self.input_drop)):
            raise ValueError(f"expected one network, or several without dropout, got {self.ensemble} with {self.drop}")
        if self.particles % self.ensemble or PREDICTED % self.ensemble:
            raise ValueError(
                f"the {self.ensemble} networks of an ensemble share {self.particles} particles, {PREDICTED} in the "
                "recorded prediction: expected equally many for each"
            )


#: Robust choices: the best of the search on development seeds (`SEARCH`), frozen before the published seeds were run.
OURS = DeepPilcoConfig()
#: What thesis and paper say, where they say something. Adam's step size is its usual 1e-3, since neither gives one.
AS_WRITTEN = replace(
    OURS,
    activation="sigmoid",
    particles=10,
    matching="diagonal",
    standard_noise=False,
    policy_steps=1000,
    policy_rate=1e-3,
    clip=0.0,
    model_steps=5000,
    model_rate=1e-3,
    model_final_rate=1.0,
    memory=10,
    guard=1.0,
)
#: What the thesis says and nothing else: the network learns from all transitions, and is given the state as it is. The
#: paper's numbers stand where the thesis has none.
AS_TEXT = replace(AS_WRITTEN, memory=0, angle_features=False, standardise=False)
#: What was tried to find `OURS`, on development seeds.
TRIED = replace(OURS, trials=25)
SEARCH: dict[str, DeepPilcoConfig] = {"search/start": TRIED, "search/rate-decay": replace(TRIED, policy_final_rate=0.1)}
CONFIGS: dict[str, DeepPilcoConfig] = {
    "deep-pilco-ours": OURS,
    "deep-pilco-as-written": AS_WRITTEN,
    "deep-pilco-as-text": AS_TEXT,
    **SEARCH,
}


class DeepPilcoLearning(Learner):
    """R repetitions of Deep PILCO (thesis algorithms 3 and 4) in one batch; step 0 is the random trial."""

    #: 2: the gradients of policy and network are worked out by hand.
    ROUNDING = 2
    COUNTS = (
        "model_repairs",  # steps left out since the likelihood was not finite, networks that had to begin anew
        "policy_repairs",  # steps left out since predicted cost or gradient was not finite
        "policy_redrawn",  # times the guard tried another policy
    )
    STATE = (*Learner.STATE, "model")
    PRECISION = LEAN
    config: DeepPilcoConfig

    def __init__(
        self,
        config: DeepPilcoConfig,
        seeds: Sequence[int],
        device: str,
        dtype: torch.dtype,
        kept: Sequence[str] | None = None,
    ) -> None:
        super().__init__(config, seeds, planning.RBFShape(config.basis), kept)
        common: dict[str, Any] = {
            "hidden": config.hidden, "activation": config.activation, "angle_features": config.angle_features,
            "standardise": config.standardise, "dtype": dtype, "device": device,
        }  # fmt: skip
        self.model: DropoutDynamics | Ensemble = (
            Ensemble.of(self.seeds, config.ensemble, **common)
            if config.ensemble > 1
            else DropoutDynamics(self.seeds, drop=config.drop, input_drop=config.input_drop, **common)
        )
        self.policy = self._draw_policy(0)
        self.shown = tuple(trial for trial in SHOWN if trial <= config.trials)
        times, steps = config.plant.steps + 1, config.plant.steps
        sizes = {
            "predicted_mean": (times, 4),  # of the particles, before they are resampled
            "predicted_std": (times, 4),
            "predicted_cost": (steps,),
            "model_loss": (),  # [nats per transition]
            "noise_std": (4,),  # learned
        }
        shown = {
            "policy": (self.shape.size,),
            "repeats": (REPEATS, times, 4),  # true states of further trials of the same policy
        }
        self.log |= self._blank(sizes, self.total) | self._blank(shown, len(self.shown))

    def _learn(self) -> None:
        with self._timed("model"):
            self._train()
        with self._timed("policy"):
            planned = self._planned()
            self._improve(planned)
            self._predict(planned)

    def _train(self) -> None:
        """Algorithm 3, line 5: fit the network to the transitions of the trials that are remembered."""
        config, trial = self.config, self.done
        first = max(0, trial - config.memory) if config.memory else 0
        observed, forces = self.log["observed"][:, first:trial], self.log["forces"][:, first:trial]
        inputs = self.model.inputs(observed[:, :, :-1], forces).flatten(1, 2)
        targets = (observed[:, :, 1:] - observed[:, :, :-1]).flatten(1, 2)
        loss, repairs = self.model.fit(
            inputs, targets, trial, steps=config.model_steps, rate=config.model_rate,
            final_rate=config.model_final_rate, batch=config.batch, length_scale=config.length_scale,
        )  # fmt: skip
        self.log["model_loss"][:, trial] = loss
        self.log["noise_std"][:, trial] = self.model.noise_std()
        self.counts["model_repairs"][:, trial] = repairs

    def _planned(self) -> Dynamics:
        """Return the model that the policy is improved on."""
        return self.model if self.config.doubt else self.model.mean()

    def _improve(self, model: Dynamics) -> None:
        """Algorithm 3, lines 6 to 8: lower the predicted cost from the last policy on."""
        config, trial = self.config, self.done
        attempts = config.redraws if config.guard < 1 else 0
        fresh = [self._draw_policy(trial, attempt) for attempt in range(1, attempts + 1)]

        def search(rows: Sequence[int], start: Tensor, attempt: int) -> planning.Improved:
            return planning.improve(model.select(rows), config.plant, self.shape, config, start, trial, attempt)

        best, redraws = planning.guarded(search, self.policy, fresh, config.guard)
        self.policy = best.parameters
        self.counts["policy_repairs"][:, trial] = best.repairs
        self.counts["policy_redrawn"][:, trial] = redraws

    def _predict(self, model: Dynamics) -> None:
        """Record what the model expects of the policy that is about to be tried."""
        config, trial = self.config, self.done
        draws = next(planning.draw(model, config.plant, config, PREDICTED, "record", trial))
        with torch.no_grad():
            policy = self.shape.policy(self.policy)
            prediction = particles.predict(policy, config.plant, draws, config.matching)
        self.log["predicted_mean"][:, trial, 0] = draws.start.mean(1)
        self.log["predicted_std"][:, trial, 0] = draws.start.std(1)
        self.log["predicted_mean"][:, trial, 1:] = prediction.mean
        self.log["predicted_std"][:, trial, 1:] = prediction.variance.sqrt()
        self.log["predicted_cost"][:, trial] = prediction.costs(config.plant)

    def _run_trial(self) -> None:
        super()._run_trial()
        if self.done in self.shown:
            self._show(self.shown.index(self.done))

    def _show(self, place: int) -> None:
        """Keep the policy, and run it again from other start states; nothing is learned from it."""
        self.log["policy"][:, place] = self.policy
        self.log["repeats"][:, place] = self._execute(*self._begin("repeated ", (REPEATS,)), self._act()).states

    def _execute(self, begin: Tensor, noise: Tensor, act: Callable[[Tensor, int], Tensor]) -> Rollout:
        plant = self.config.plant
        if self.config.integration == "runge-kutta":
            return super()._execute(begin, noise, act)
        states, forces = [begin], []
        for t in range(plant.steps):
            forces.append(act(states[-1] + noise[..., t, :], t))
            states.append(states[-1] + plant.dt * cartpole.derivative(plant, states[-1], forces[-1]))
        visited = torch.stack(states, -2)
        return Rollout(visited, visited + noise, torch.stack(forces, -1))

    def _initial(self, generator: Generator) -> Tensor:
        return self.shape.initial(self.config.spread, self.config.weight_std, generator)

    def _draw_policy(self, *path: int) -> Tensor:
        return super()._draw_policy(*path).to(self.model.log_noise)

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from `state()` of a process made with the same arguments."""
        super().restore(state)
        self.policy = self.policy.to(self.model.log_noise)

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the record, see `Learner.result`; those of a small one in half precision."""
        arrays = super().result()
        if self.kept is None:
            return arrays | {"shown": np.array(self.shown, dtype=np.int32)}
        small = {name: arrays[name].astype(np.float16) for name in self.kept}
        return small | {name: arrays[name].astype(np.int16) for name in self.COUNTS}


def start(
    config: DeepPilcoConfig,
    seeds: Sequence[int],
    device: str = "cpu",
    precision: str = "float32",
    kept: Sequence[str] | None = None,
    kind: type[DeepPilcoLearning] = DeepPilcoLearning,
) -> DeepPilcoLearning:
    """Return the process of one unit, of that kind; `kept` names the arrays of a small record.

    Raises:
        ValueError: without seeds, or for bfloat16, which has no Cholesky factor.
    """
    return kind(of_type(DeepPilcoConfig, config, "config"), seeds, device, dtype_of(precision), kept)


def dtype_of(precision: str) -> torch.dtype:
    """Return the dtype of a precision; raises ValueError for bfloat16."""
    if precision == "bfloat16":
        raise ValueError("Deep PILCO runs in float32 or float64, got bfloat16")
    return precision_dtype(precision)


def memory(config: DeepPilcoConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: a predicted trial of the particles and its gradient."""
    wide = sum(config.hidden) + config.basis
    return 8.0 * config.plant.steps * max(config.particles, PREDICTED) * wide * 8


#: How each trial went.
start_search = partial(start, kept=("costs", "predicted_cost", "model_loss"))
SWEEPS = [
    Sweep(EXPERIMENT, configs, begin, ("float32", "float64"), GROUP, repetitions=40, memory=memory)
    for configs, begin in (
        ({name: config for name, config in CONFIGS.items() if name not in SEARCH}, start),
        (SEARCH, start_search),
    )
]
