"""PILCO learning the cart-pole swing-up: one unit is a batch of repetitions, one step of its process is a trial."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Generator, Tensor

from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import SquaredExponential
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP, Learner
from dropout_uncertainty.data_efficiency.pilco import gaussian_process as gp
from dropout_uncertainty.data_efficiency.pilco import planning
from dropout_uncertainty.data_efficiency.plant.cartpole import MATLAB, PAPER, CartPole
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.settings import at_least, of_type, positive, tidy

__all__ = ["CONFIGS", "LONGER", "PILCO_MATLAB", "PILCO_PAPER", "PilcoConfig", "PilcoLearning", "start"]


@dataclass(frozen=True)
class PilcoConfig:
    """The learner, after pilco-matlab, scenarios/cartPole/settings_cp.m, unless said otherwise."""

    plant: CartPole = field(default_factory=lambda: MATLAB)  #: The cart-pole, its start distribution and trial length.
    trials: int = 10  #: Controlled trials after the random one; 15 in the original.
    basis: int = 10  #: Basis functions of the policy.
    policy_iterations: int = 150  #: Line searches per trial for the policy.
    model_iterations: int = 300  #: Line searches per trial for the hyper-parameters of each output's Gaussian process.
    inducing: int = 300  #: Inducing inputs, used once there are more transitions than this; 0: never.
    #: Line searches per trial for the inducing inputs, thrice as many at first; the original has 500 evaluations.
    inducing_iterations: int = 100
    target_std: float = 0.1  #: Standard deviation of the first targets of the policy's basis functions.
    #: Logs of the policy's first length-scales: 1, 1, 1, 0.7, 0.7.
    log_length_scales: tuple[float, ...] = (0.0, 0.0, 0.0, -0.35667494393873245, -0.35667494393873245)
    #: The policy is improved on the model with its variance. Otherwise on its mean, taken for the truth; only the start
    #: state is uncertain then.
    doubt: bool = field(default=True, metadata={"before": True})

    def __post_init__(self) -> None:
        tidy(self)
        at_least(
            1, trials=self.trials, basis=self.basis, policy_iterations=self.policy_iterations,
            model_iterations=self.model_iterations, inducing_iterations=self.inducing_iterations,
        )  # fmt: skip
        at_least(0, inducing=self.inducing)
        positive(target_std=self.target_std)
        if len(self.log_length_scales) != planning.DIM:
            raise ValueError(f"expected {planning.DIM} length-scales, one per feature, got {self.log_length_scales}")


#: The plant of the original code.
PILCO_MATLAB = PilcoConfig(plant=MATLAB)
#: The plant of the Deep PILCO paper, on which both methods of figure 5.7 are compared.
PILCO_PAPER = replace(PILCO_MATLAB, plant=PAPER)
#: Longer runs of the same learner, which go on from the records of shorter ones: more of the curve of figure 5.7, and
#: (one repetition) the 40 trials whose hours the thesis gives.
LONGER: dict[str, PilcoConfig] = {f"pilco-paper-{trials}": replace(PILCO_PAPER, trials=trials) for trials in (15, 40)}
CONFIGS: dict[str, PilcoConfig] = {"pilco-paper": PILCO_PAPER, "pilco-matlab": PILCO_MATLAB, **LONGER}


class PilcoLearning(Learner):
    """R repetitions of PILCO (thesis algorithm 3) in one batch; step 0 is the random trial."""

    #: 2: the moments of the policy and the features are worked out in fewer operations. 3: the derivatives of all steps
    #: are worked out at once, and sums over pairs of centres are of powers of two. 4: the gradient in the inducing
    #: inputs is written out, and likelihoods are worked out block by block. 5: sums over pairs are products with few
    #: rows.
    ROUNDING = 5
    #: Kept in full precision: with these a longer config continues from the record as if it had never stopped.
    CONTINUED = ("observed", "forces", "hyper", "policy")
    #: "gradients" are for the record only.
    PARTS = ("model", "gradients", "policy", "trial")
    COUNTS = (
        "model_line_searches",  # summed over outputs
        "policy_line_searches",
        "policy_evaluations",
        "model_repairs",  # values that were not finite, failed line searches, covariances that needed jitter
        "policy_repairs",  # values that were not finite, failed line searches
        "policy_redrawn",  # the policy could not be evaluated and began anew from a random one
    )
    STATE = (*Learner.STATE, "inputs", "targets", "hyper", "inducing")
    PRECISION = dict.fromkeys(CONTINUED, np.float64)
    config: PilcoConfig

    def __init__(
        self, config: PilcoConfig, seeds: Sequence[int], device: str = "cpu", kept: Sequence[str] | None = None
    ) -> None:
        super().__init__(config, seeds, planning.PolicyShape(config.basis), kept)
        self.device = device
        self.policy = self._draw_policy(0)
        plant, runs = config.plant, len(self.seeds)
        self.inputs = torch.zeros(runs, 0, planning.DIM + 1, dtype=torch.float64)
        self.targets = torch.zeros(runs, 4, 0, dtype=torch.float64)
        self.hyper: Tensor | None = None
        self.inducing: Tensor | None = None
        times, steps = plant.steps + 1, plant.steps
        sizes = {
            "predicted_mean": (times, 4),
            "predicted_variance": (times, 4),
            "predicted_cost": (steps,),
            # where the search for the policy begins, norms of the gradient of each step's expected cost; with
            # doubt about the model, and taking its mean for the truth; and what is predicted there
            "search_gradient": (steps,),
            "search_gradient_sure": (steps,),
            "search_variance": (times, 4),
            "hyper": (4, planning.DIM + 3),  # logs: length-scales, signal and noise standard deviation per output
            "policy": (self.shape.size,),
        }
        self.log |= self._blank(sizes, self.total)

    def _learn(self) -> None:
        with self._timed("model"):
            model = self._train()
        with self._timed("gradients"):
            self._record_gradients(model)
        with self._timed("policy"):
            planned = self._planned(model)
            self._improve(planned)
            self._predict(planned)

    def _planned(self, model: SquaredExponential) -> SquaredExponential:
        """Return the model that the policy is improved on."""
        return model if self.config.doubt else model.mean_function()

    def _train(self) -> SquaredExponential:
        """Step 5: fit hyper-parameters, then inducing inputs if there are many data; return the posterior."""
        config, outputs = self.config, self.targets.shape[1]
        inputs, targets = self.inputs.to(self.device), self.targets.to(self.device)
        self.hyper, found = planning.train_model(inputs, targets, self.hyper, config.model_iterations)
        self.log["hyper"][:, self.done] = self.hyper
        per_run = found.iterations.reshape(-1, outputs).sum(1)
        self.counts["model_line_searches"][:, self.done] = per_run
        repairs = (found.repairs + found.failures).reshape(-1, outputs).sum(1)
        model = gp.GaussianProcess(inputs, targets, self.hyper.to(self.device))
        if 0 < config.inducing < inputs.shape[1]:
            iterations = config.inducing_iterations
            if self.inducing is None:
                iterations *= 3
                self.inducing = gp.initial_inducing(self.inputs, config.inducing, list(self.seeds))
            self.inducing, found = gp.fit_inducing(model, self.inducing, iterations)
            repairs = repairs + found.repairs + found.failures
            model = replace(model, inducing=self.inducing.to(self.device))
        posterior, jittered = model.posterior()
        self.counts["model_repairs"][:, self.done] = repairs + jittered.cpu()
        return posterior

    def _record_gradients(self, model: SquaredExponential) -> None:
        """Note how much each step of the predicted trial has to say when the search for the policy begins."""
        doubting, sure, states = planning.step_gradients(model, self.config.plant, self.shape, self.policy)
        self.log["search_gradient"][:, self.done] = doubting.norm(dim=-1)
        self.log["search_gradient_sure"][:, self.done] = sure.norm(dim=-1)
        self.log["search_variance"][:, self.done] = states.cov.diagonal(dim1=-2, dim2=-1)

    def _improve(self, model: SquaredExponential) -> None:
        """Steps 6 to 8; a policy that cannot be evaluated is redrawn once, then kept as it was."""
        config, trial = self.config, self.done
        found = planning.improve(model, config.plant, self.shape, self.policy, config.policy_iterations)
        best, lost = found.x, found.value.isnan()
        if lost.any():
            numbers = lost.nonzero()[:, 0].tolist()
            fresh = self._draw_policy(trial)[lost]
            again = planning.improve(model.select(numbers), config.plant, self.shape, fresh, config.policy_iterations)
            best[lost] = torch.where(again.value.isnan()[:, None], self.policy[lost], again.x)
        self.policy = best
        self.log["policy"][:, trial] = best
        self.counts["policy_line_searches"][:, trial] = found.iterations
        self.counts["policy_evaluations"][:, trial] = found.evaluations
        self.counts["policy_repairs"][:, trial] = found.repairs + found.failures
        self.counts["policy_redrawn"][:, trial] = lost.long()

    def _predict(self, model: SquaredExponential) -> None:
        plant = self.config.plant
        begin = planning.start_distribution(plant, len(self.seeds), self.device)
        states = planning.predict(model, self.shape.policy(self.policy.to(self.device)), plant, begin)
        self.log["predicted_mean"][:, self.done] = states.mean
        self.log["predicted_variance"][:, self.done] = states.cov.diagonal(dim1=-2, dim2=-1)
        self.log["predicted_cost"][:, self.done] = planning.expected_costs(plant, states)

    def _run_trial(self) -> None:
        super()._run_trial()
        self._append(self.log["observed"][:, self.done], self.log["forces"][:, self.done])

    def _append(self, observed: Tensor, forces: Tensor) -> None:
        inputs, targets = planning.transitions(observed, forces)
        self.inputs, self.targets = torch.cat((self.inputs, inputs), 1), torch.cat((self.targets, targets), 2)

    def _initial(self, generator: Generator) -> Tensor:
        config = self.config
        return self.shape.initial(config.plant, config.target_std, config.log_length_scales, generator)

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the record, see `Learner.result`."""
        inducing = {} if self.inducing is None else {"inducing": self.inducing.numpy()}
        arrays = super().result() | inducing
        return arrays if self.kept is None else {name: arrays[name] for name in (*self.kept, *self.COUNTS)}

    def take_over(self, arrays: Mapping[str, np.ndarray], seconds: Mapping[str, Sequence[float]]) -> None:
        """Stand where a shorter run of the same learner ended, given the arrays of its record and its timings."""
        self.done = done = arrays["costs"].shape[1]
        for kept in (self.log, self.counts):
            for name, values in kept.items():
                values[:, :done] = torch.tensor(arrays[name])
        for part, spent in self.seconds.items():
            spent[:done] = seconds[part]
        self.policy, self.hyper = self.log["policy"][:, done - 1].clone(), self.log["hyper"][:, done - 1].clone()
        self.inducing = torch.tensor(arrays["inducing"]) if "inducing" in arrays else None
        for trial in range(done):
            self._append(self.log["observed"][:, trial], self.log["forces"][:, trial])


def start(
    config: PilcoConfig,
    seeds: Sequence[int],
    device: str = "cpu",
    precision: str = "float64",
    kept: Sequence[str] | None = None,
    kind: type[PilcoLearning] = PilcoLearning,
) -> PilcoLearning:
    """Return the process of one unit, of that kind; `kept` names the arrays of a small record.

    Raises:
        ValueError: without seeds, or for another precision than float64.
    """
    if precision != "float64":
        raise ValueError(f"PILCO runs in float64, got {precision}; leave it out")
    return kind(of_type(PilcoConfig, config, "config"), seeds, device, kept)


class ContinuedPilco(PilcoLearning):
    """The same, going on from records of shorter runs."""

    def inherit(self, folder: Path) -> list[dict[str, Any]]:
        """Stand where records of the same learner with fewer trials end, and return them as parents.

        Without records of all its seeds from the same device type it stays at the beginning; the result is the same,
        but for rounding where they were made by an older version (`PilcoLearning.ROUNDING`).
        """
        names = [name for name in CONFIGS if _is_shorter(CONFIGS[name], self.config)]
        device = torch.device(self.device).type
        for name in sorted(names, key=lambda name: -CONFIGS[name].trials):
            found = records.find(EXPERIMENT, CONFIGS[name], name=name, folder=folder, device=device)
            place = {seed: (record, row) for record in found for row, seed in enumerate(record.seeds)}
            if all(seed in place for seed in self.seeds):
                rows = [place[seed] for seed in self.seeds]
                arrays = {key: np.stack([r.arrays[key][row] for r, row in rows]) for key in rows[0][0].arrays}
                self.take_over(arrays, {part: _seconds(part, [record for record, _ in rows]) for part in self.PARTS})
                return [records.parent(record, self.seeds) for record in found if set(record.seeds) & set(self.seeds)]
        return []


def _is_shorter(config: PilcoConfig, longer: PilcoConfig) -> bool:
    return config.trials < longer.trials and replace(config, trials=longer.trials) == longer


def _seconds(part: str, found: Sequence[Record]) -> list[float]:
    """Return the CPU seconds of some repetitions: of each the share that it has in its unit."""
    shares = [np.array(record.header["provenance"][f"{part}_cpu_s"]) / len(record.seeds) for record in found]
    return np.sum(shares, 0).tolist()


def memory(config: PilcoConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: matrices between all data, of all pairs of outputs."""
    data = config.trials * config.plant.steps
    data = min(data, config.inducing) if config.inducing else data
    return 8.0 * 10 * data**2 * 8


SWEEPS = [
    Sweep(EXPERIMENT, configs, begin, ("float64",), GROUP, repetitions=40, memory=memory)
    for configs, begin in (
        ({name: config for name, config in CONFIGS.items() if name not in LONGER}, start),
        (LONGER, partial(start, kind=ContinuedPilco)),
    )
]
