"""Deep PILCO where only x and θ are seen, with noise: a policy on the last observations, models with a memory.

The particles are observations: a model moves them as in `models.free_run`, each under a weight draw of its own and
with noise of the learned size, and each carries what its model remembers. So no moments are matched, for particles
drawn anew would not belong to these memories. On the plant the policy needs no model: it sees the last observations.
Replicas R first, then particles K.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.data_efficiency.deep_pilco import planning
from dropout_uncertainty.data_efficiency.deep_pilco.particles import force, multiplied_out
from dropout_uncertainty.data_efficiency.deep_pilco.planning import RBFShape
from dropout_uncertainty.data_efficiency.hidden_state.models import SEEN, Model, ModelConfig, inputs_of
from dropout_uncertainty.data_efficiency.hidden_state.prediction import FAMILY, MODELS
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP, LEAN, Learner, on_cpu
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER, CartPole
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.data_efficiency.policies import RBFPolicy, squash
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.settings import at_least, positive, tidy

__all__ = ["CONFIGS", "PAST", "ControlConfig", "HiddenLearning", "HiddenPolicy"]

#: Observations that the policy sees; each of its two speeds is a mixture of mean speeds over the last intervals.
PAST = 4
MIXED = 2 * (PAST - 1)
#: Optimisation steps whose noise is drawn at once.
BLOCK = 10
#: Particles of the recorded prediction.
PREDICTED = 100


@dataclass(frozen=True)
class ControlConfig:
    """A model of what is seen, and how a policy is improved on it: if not said otherwise, as in `DeepPilcoConfig`."""

    model: ModelConfig
    #: The cart-pole; of its states x and θ are seen, with the noise of its observations.
    plant: CartPole = field(default_factory=lambda: PAPER)
    trials: int = 25  #: Controlled trials after the random one.
    particles: int = 30
    policy_steps: int = 300
    policy_rate: float = 1e-2
    clip: float = 1.0
    basis: int = 50
    spread: tuple[float, ...] = (1.0, 2.0, 4.0, 0.7, 0.7)
    weight_std: float = 0.5
    guard: float = 0.98
    redraws: int = 2
    noise: bool = True  #: The particles get noise of the learned size at each step; Deep PILCO leaves it out.

    def __post_init__(self) -> None:
        tidy(self)
        at_least(1, trials=self.trials, policy_steps=self.policy_steps, basis=self.basis, particles=self.particles)
        at_least(0, redraws=self.redraws)
        positive(policy_rate=self.policy_rate, weight_std=self.weight_std)
        if len(self.spread) != planning.DIM or min(self.spread) <= 0:
            raise ValueError(f"expected {planning.DIM} positive spreads, one per feature, got {self.spread}")
        if self.clip < 0 or not 0 <= self.guard <= 1:
            raise ValueError(f"expected no negative clip and a guard in [0, 1], got {self.clip} and {self.guard}")


@dataclass(frozen=True)
class HiddenPolicy:
    """A policy of the chapter, on speeds that it estimates from the last observations."""

    on_states: RBFPolicy
    mixture: Float[Tensor, "R 1 2 I"]  # of the mean speeds over the last 1, 2, ... I intervals, for x and θ

    def inputs(self, past: Sequence[Float[Tensor, "R K 2"]], dt: float) -> Float[Tensor, "R K 5"]:
        """Return x [m], the speeds of x [m/s] and θ [rad/s], sin θ and cos θ, by observations ``dt`` [s] apart.

        The observations are x [m] and θ [rad], the latest last.
        """
        now = past[-1]
        means = torch.stack([(now - past[-1 - back]) / (back * dt) for back in range(1, len(past))], -1)
        speeds = (self.mixture * means).sum(-1)
        x, theta = now[..., :1], now[..., 1:]
        return torch.cat((x, speeds, theta.sin(), theta.cos()), -1)


@dataclass(frozen=True)
class HiddenShape:
    """How the parameters of such a policy stand in one vector: those of a policy on states, then the mixture."""

    basis: int

    @property
    def on_states(self) -> RBFShape:
        """The first part."""
        return RBFShape(self.basis)

    def policy(self, parameters: Float[Tensor, "R P"]) -> HiddenPolicy:
        """Return the policies of these parameters."""
        first, mixture = parameters.split((self.on_states.size, MIXED), -1)
        return HiddenPolicy(self.on_states.policy(first), mixture.reshape(-1, 1, 2, PAST - 1))


def predict(
    model: Model,
    plant: CartPole,
    policy: HiddenPolicy,
    draw: Any,
    start: Float[Tensor, "R K 2"],
    noise: Float[Tensor, "R T K 2"],
) -> Float[Tensor, "R T K 2"]:
    """Return the observations (x [m], θ [rad]) of times 1 ... T that a policy is expected to make.

    They are differentiable in the parameters of the policy. Particle k begins at ``start`` under its part of ``draw``,
    which is the model's; ``noise`` is standard normal, and scaled by what the model has learned.
    """
    matrix, weights = multiplied_out(policy.on_states)
    std, memory, past, visited = model.noise_std()[:, None], None, [start] * PAST, []
    for t in range(plant.steps):
        pushed = force(policy.inputs(past, plant.dt), matrix, weights, plant.force_limit)[..., 0]
        change, memory = model.step(inputs_of(past[-1], pushed), memory, draw, t)
        past = [*past[1:], past[-1] + change + std * noise[:, t]]
        visited.append(past[-1])
    return torch.stack(visited, 1)


def costs(plant: CartPole, observed: Float[Tensor, "R T K 2"]) -> Float[Tensor, "R T"]:
    """Return the mean cost [0, 1] of the particles at each time; it does not depend on the speeds."""
    x, theta = observed.unbind(-1)
    still = torch.zeros_like(x)
    return cost(plant, torch.stack((x, still, still, theta), -1)).mean(-1)


class HiddenLearning(Learner):
    """R repetitions in one batch; a step is a trial, step 0 the random one."""

    COUNTS = ("model_repairs", "policy_repairs", "policy_redrawn")
    STATE = (*Learner.STATE, "model")
    PRECISION = LEAN
    config: ControlConfig

    def __init__(self, config: ControlConfig, seeds: Sequence[int], dtype: torch.dtype) -> None:
        super().__init__(config, seeds, HiddenShape(config.basis))
        self.dtype = dtype
        self.model = config.model.model(self.seeds, dtype)
        self.policy = self._draw_policy(0).to(dtype)
        times, steps = config.plant.steps + 1, config.plant.steps
        sizes = {
            "predicted_mean": (times, 2),  # of the particles
            "predicted_std": (times, 2),
            "predicted_cost": (steps,),
            "model_loss": (),  # [nats per transition]
            "noise_std": (2,),  # learned
        }
        self.log |= self._blank(sizes, self.total)

    def _initial(self, generator: Generator) -> Tensor:
        drawn = self.shape.on_states.initial(self.config.spread, self.config.weight_std, generator)
        return torch.cat((drawn, torch.full((MIXED,), 1 / (PAST - 1), dtype=drawn.dtype)))

    def _learn(self) -> None:
        with self._timed("model"):
            self._train()
        with self._timed("policy"):
            self._improve()
            self._predict()

    def _train(self) -> None:
        trial = self.done
        observed = self.log["observed"][:, :trial][..., SEEN].to(self.dtype)
        forces = self.log["forces"][:, :trial].to(self.dtype)
        how = self.config.model.fit(self.config.plant.steps)
        seen, changes = inputs_of(observed[:, :, :-1], forces), observed.diff(dim=2)
        loss, repairs = self.model.fit(seen, changes, trial, how=how)
        self.log["model_loss"][:, trial] = loss.detach()
        self.log["noise_std"][:, trial] = self.model.noise_std()
        self.counts["model_repairs"][:, trial] = repairs

    def _improve(self) -> None:
        config, trial = self.config, self.done

        def search(rows: Sequence[int], start: Tensor, attempt: int) -> planning.Improved:
            seeds = [self.seeds[row] for row in rows]
            evaluate = self._objective(self.model.select(rows), seeds, "plan", trial, attempt)
            return planning.descend(
                evaluate, start, steps=config.policy_steps, rate=config.policy_rate, final_rate=1.0, clip=config.clip
            )

        fresh = [self._draw_policy(trial, attempt).to(self.dtype) for attempt in range(1, config.redraws + 1)]
        best, redraws = planning.guarded(search, self.policy, fresh, config.guard)
        self.policy = best.parameters
        self.counts["policy_repairs"][:, trial] = best.repairs
        self.counts["policy_redrawn"][:, trial] = redraws

    def _objective(
        self, model: Model, seeds: Sequence[int], *path: str | int
    ) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
        """Return the predicted cost of policies and its gradient, under other draws at each call."""
        config, calls = self.config, itertools.count()
        drawn: list[Tensor] = []

        def evaluate(parameters: Tensor) -> tuple[Tensor, Tensor]:
            block, place = divmod(call := next(calls), BLOCK)
            if place == 0:
                drawn[:] = self._noise(seeds, config.particles, BLOCK, *path, block).unbind(1)
            draw = model.draw(config.particles, config.plant.steps, *path, call)
            leaf = parameters.detach().requires_grad_()
            start, noise = self._started(drawn[place])
            observed = predict(model, config.plant, self.shape.policy(leaf), draw, start, noise)
            value = costs(config.plant, observed).mean(-1)
            (gradient,) = torch.autograd.grad(value.sum(), leaf)
            return value.detach(), gradient

        return evaluate

    @torch.no_grad()
    def _predict(self) -> None:
        """Record what the model expects of the policy that is about to be tried."""
        plant, trial = self.config.plant, self.done
        (drawn,) = self._noise(self.seeds, PREDICTED, 1, "record", trial).unbind(1)
        start, noise = self._started(drawn)
        draw = self.model.draw(PREDICTED, plant.steps, "record", trial)
        observed = predict(self.model, plant, self.shape.policy(self.policy), draw, start, noise)
        every = torch.cat((start[:, None], observed), 1)
        self.log["predicted_mean"][:, trial] = every.mean(2)
        self.log["predicted_std"][:, trial] = every.std(2)
        self.log["predicted_cost"][:, trial] = costs(plant, observed)

    def _noise(self, seeds: Sequence[int], count: int, blocks: int, *path: str | int) -> Float[Tensor, "R B times K 2"]:
        shape = blocks, self.config.plant.steps + 1, count, len(SEEN)
        return rng.normal(seeds, shape, "particles", *path).to(self.dtype)

    def _started(self, drawn: Float[Tensor, "R times K 2"]) -> tuple[Tensor, Tensor]:
        """Return observed starts and the noise of the steps."""
        plant = self.config.plant
        mean = drawn.new_tensor([plant.start_mean[place] for place in SEEN])
        begin = mean + np.hypot(plant.start_std, plant.observation_noise) * drawn[:, 0]
        return begin, self.config.noise * drawn[:, 1:]

    def _act(self) -> Callable[[Tensor, int], Tensor]:
        """Return what the policy does in an observed state, of which it looks at x and θ and remembers the last."""
        plant, policy = self.config.plant, self.shape.policy(self.policy.double())
        past: list[Tensor] = []

        def act(observed: Tensor, t: int) -> Tensor:
            now = observed[:, None, SEEN]
            past[:] = [*past[1:], now] if past else [now] * PAST
            return squash(policy.on_states(policy.inputs(past, plant.dt))[:, 0, 0], plant.force_limit)

        return act


CONFIGS = {f"{FAMILY}/control-{name}": ControlConfig(MODELS[name]) for name in ("last-one", "last-four", "lstm-held")}


def memory(config: ControlConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: a predicted trial of the particles and its gradient."""
    wide = sum(config.model.hidden) * (8 if config.model.kind == "recurrent" else 1) + config.basis
    return 8.0 * config.plant.steps * max(config.particles, PREDICTED) * wide * 4


start = partial(on_cpu, HiddenLearning, ControlConfig, "learners of hidden states")
SWEEPS = [Sweep(EXPERIMENT, CONFIGS, start, ("float32", "float64"), {"cpu": GROUP["cpu"]}, 10, memory)]
