"""Particles through PILCO's Gaussian process, the failed predecessor of Deep PILCO (thesis section 5.4.2; DE5c).

McHutchon (Nonlinear modelling and control using Gaussian processes, 2014) moved fixed particles and improved the
policy by BFGS. Here PILCO learns as ever, but its policy is improved by the code that moves Deep PILCO's
particles: fixed ones with BFGS or fresh ones with Adam, under each way to match moments. Replicas R first; float64.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import Masks
from dropout_uncertainty.data_efficiency.ablations.doubt import KEPT_PILCO
from dropout_uncertainty.data_efficiency.deep_pilco import particles, planning
from dropout_uncertainty.data_efficiency.deep_pilco.learner import PREDICTED
from dropout_uncertainty.data_efficiency.deep_pilco.particles import MATCHING
from dropout_uncertainty.data_efficiency.deep_pilco.planning import Planning
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import SquaredExponential
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.data_efficiency.pilco.learner import LONGER, PilcoConfig, PilcoLearning
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.settings import widened

__all__ = [
    "CONFIGS", "FAMILY", "GaussianDynamics", "GaussianFunction", "ParticlePilco", "ParticlePilcoConfig", "moments_at",
    "start",
]  # fmt: skip

FAMILY = "mchutchon"
#: Of the posterior, as a share of the prior's: next to the data the difference of the two is lost in rounding.
LEAST_VARIANCE = 1e-10


@dataclass(frozen=True)
class ParticlePilcoConfig(PilcoConfig):
    """PILCO whose policy is improved on particles."""

    #: Particles and optimiser: those of `OURS` where nothing else is said. A process has no weights to hold, so each
    #: step of each particle has a draw of its own, as PILCO supposes.
    planning: Planning = field(default_factory=lambda: Planning(hold_masks=False))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.planning.hold_masks:
            raise ValueError("a Gaussian process draws afresh at every step: set hold_masks to False")


_OPTIMISERS: dict[str, dict[str, Any]] = {
    "fixed-bfgs": {"redraw_every": 0, "optimiser": "bfgs", "policy_steps": PilcoConfig.policy_iterations},
    "fresh-adam": {},
}
CONFIGS: dict[str, ParticlePilcoConfig] = {
    f"mchutchon/{name}-{matching}": widened(
        ParticlePilcoConfig, LONGER["pilco-paper-15"], planning=Planning(hold_masks=False, matching=matching, **changes)
    )
    for name, changes in _OPTIMISERS.items()
    for matching in MATCHING
}


@dataclass(frozen=True)
class GaussianFunction:
    """The change of state of each particle, drawn from the posterior of a Gaussian process at its place."""

    posterior: SquaredExponential
    noise: Float[Tensor, "R K E"]  # standard normal
    angle_features: bool = True

    def __call__(self, inputs: Float[Tensor, "R K D"]) -> Float[Tensor, "R K E"]:
        """Return the change of state for features and force; the noise of the observations is not added."""
        mean, std = moments_at(self.posterior, inputs)
        return mean + std * self.noise


def moments_at(posterior: SquaredExponential, inputs: Float[Tensor, "R K D"]) -> tuple[Tensor, Tensor]:
    """Return mean and standard deviation [R, K, E] of Gaussian processes at points, without noise."""
    kernel, precision = posterior.kernel(inputs), posterior.precision  # [R, E, K, N] and [R, E, N, N]
    assert precision is not None  # of a posterior
    mean = (kernel @ posterior.weights[..., None])[..., 0]
    signal = torch.exp(2 * posterior.log_signal_std)[..., None]
    variance = signal - ((kernel @ precision) * kernel).sum(-1)
    return mean.mT, variance.clamp_min(LEAST_VARIANCE * signal).sqrt().mT


class GaussianDynamics:
    """R Gaussian processes by which particles are moved (`planning.Dynamics`)."""

    def __init__(self, posterior: SquaredExponential, seeds: Sequence[int]) -> None:
        self.posterior, self.seeds = posterior, tuple(seeds)

    @property
    def log_noise(self) -> Tensor:
        """A tensor of the dtype and on the device of the processes."""
        return self.posterior.log_signal_std

    def draw(self, count: int, *path: str | int) -> Masks:
        """Return standard normal numbers [R, count, E], which choose the functions' values."""
        shape, like = (count, self.log_noise.shape[1]), self.log_noise
        draw = lambda g: torch.randn(shape, generator=g, dtype=like.dtype, device=like.device)  # noqa: E731
        return (rng.stacked(draw, self.seeds, "outputs", *path, device=like.device),)

    def function(self, masks: Masks) -> GaussianFunction:
        """Return the functions of one step."""
        (noise,) = masks
        assert noise is not None  # of `draw`
        return GaussianFunction(self.posterior, noise)

    def select(self, replicas: Sequence[int]) -> "GaussianDynamics":
        """Return some of the replicas."""
        rows = list(replicas)
        return GaussianDynamics(self.posterior.select(rows), [self.seeds[row] for row in rows])


class ParticlePilco(PilcoLearning):
    """R repetitions of PILCO with particles in one batch."""

    config: ParticlePilcoConfig

    def _record_gradients(self, model: SquaredExponential) -> None:
        """Leave out what is asked of PILCO alone."""

    def _improve(self, model: SquaredExponential) -> None:
        config, dynamics = self.config, GaussianDynamics(model, self.seeds)
        found = planning.improve(dynamics, config.plant, self.shape, config.planning, self.policy, self.done)
        self.policy = found.parameters.cpu()
        self.log["policy"][:, self.done] = self.policy
        self.counts["policy_repairs"][:, self.done] = found.repairs.cpu()

    def _predict(self, model: SquaredExponential) -> None:
        plant, plan, trial = self.config.plant, self.config.planning, self.done
        dynamics = GaussianDynamics(model, self.seeds)
        draws = next(planning.draw(dynamics, plant, plan, PREDICTED, "record", trial))
        with torch.no_grad():
            policy = self.shape.policy(self.policy.to(self.device))
            prediction = particles.predict(policy, plant, draws, plan.matching)
        self.log["predicted_mean"][:, trial] = torch.cat((draws.start.mean(1)[:, None], prediction.mean), 1)
        start_variance = draws.start.var(1, correction=0)[:, None]
        self.log["predicted_variance"][:, trial] = torch.cat((start_variance, prediction.variance), 1)
        self.log["predicted_cost"][:, trial] = prediction.costs(plant)


def memory(config: ParticlePilcoConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: covariances with the data at every step of a trial."""
    data = min(config.trials * config.plant.steps, config.inducing or config.trials * config.plant.steps)
    return 8.0 * 6 * 4 * config.plant.steps * max(config.planning.particles, PREDICTED) * data


start = partial(pilco.start, kind=ParticlePilco, kept=KEPT_PILCO)
SWEEPS = [Sweep(EXPERIMENT, CONFIGS, start, ("float64",), GROUP, 10, memory)]
