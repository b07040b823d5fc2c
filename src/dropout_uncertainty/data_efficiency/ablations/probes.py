"""Why Deep PILCO works, measured while it learns: the learner `OURS`, looked into after some of its trials.

The measurements have random streams of their own and leave network and policy as they are, so learning goes as it
would without them. What they serve: clouds of particles under masks held or redrawn, with moments matched or not
(DE4 and DE6), the scatter of the policy gradient (DE4), the objective against the number of particles, and the
three ways of lowering it (DE5).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty.data_efficiency.deep_pilco import planning
from dropout_uncertainty.data_efficiency.deep_pilco.learner import DeepPilcoConfig, DeepPilcoLearning
from dropout_uncertainty.data_efficiency.deep_pilco.particles import (
    MATCHING,
    Draws,
    Prediction,
    act,
    match,
    multiplied_out,
    predict,
)
from dropout_uncertainty.data_efficiency.deep_pilco.planning import Planning
from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.data_efficiency.policies import RBFPolicy

__all__ = ["CLOUDS", "DIAGONAL", "OPTIMISERS", "PARTED", "Mechanism", "MechanismConfig", "valley"]

#: The 2 x 2 of statement DE6: masks held over the trajectory or redrawn at each step, moments matched or not.
CLOUDS: dict[str, dict[str, Any]] = {
    "held-matched": {"hold_masks": True, "matching": "full"},
    "held-free": {"hold_masks": True, "matching": "off"},
    "redrawn-matched": {"hold_masks": False, "matching": "full"},
    "redrawn-free": {"hold_masks": False, "matching": "off"},
}
#: The same with moments matched dimension by dimension, as Algorithm 4 has it; records before these lack them.
DIAGONAL: dict[str, dict[str, Any]] = {
    "held-diagonal": {"hold_masks": True, "matching": "diagonal"},
    "redrawn-diagonal": {"hold_masks": False, "matching": "diagonal"},
}
#: Ways to lower the objective (statement DE5), by what they change in the plan.
OPTIMISERS: dict[str, dict[str, Any]] = {
    "fresh-adam": {},
    "fixed-adam": {"redraw_every": 0},
    "fixed-bfgs": {"redraw_every": 0, "optimiser": "bfgs"},
}
#: Particles have parted where the density between two groups is a quarter below the lower peak or more (`valley`).
PARTED = 0.25
#: A group with a smaller share of the particles counts as stragglers, not as a second mode.
LEAST_GROUP = 0.1


@dataclass(frozen=True)
class MechanismConfig(DeepPilcoConfig):
    """The learner, when it is looked into and how closely."""

    #: Trials after which the measurements are made, with the network that was fitted before them.
    measured: tuple[int, ...] = (1, 2, 5, 10, 20)
    cloud: int = 200  #: Particles of a predicted cloud.
    gradient_draws: int = 16  #: Draws of particles and masks over which the policy gradient's variance is taken.
    horizons: tuple[int, ...] = (5, 10, 15, 20, 25)  #: Lengths of the predicted trial at which it is taken, in steps.
    counts: tuple[int, ...] = (5, 10, 30, 100)  #: Numbers of particles K for which the objective is averaged.
    objective_draws: int = 32  #: Draws that are averaged.

    def __post_init__(self) -> None:
        super().__post_init__()
        if max(self.horizons) > self.plant.steps or min(self.horizons) < 1:
            raise ValueError(f"expected horizons of 1 to {self.plant.steps} steps, got {self.horizons}")


class Mechanism(DeepPilcoLearning):
    """R repetitions of Deep PILCO in one batch, looked into after the trials ``config.measured``."""

    STATE = (*DeepPilcoLearning.STATE, "found")
    config: MechanismConfig

    def __init__(
        self, config: MechanismConfig, seeds: Sequence[int], device: str, dtype: torch.dtype, kept: Sequence[str] | None
    ) -> None:
        super().__init__(config, seeds, device, dtype, kept)
        self.measured = tuple(trial for trial in config.measured if trial <= config.trials)
        steps, clouds, ways, horizons = config.plant.steps, len(CLOUDS), len(MATCHING), len(config.horizons)
        sizes = {
            "cloud_mean": (clouds, steps, 4),  # of times 1 ... T, before matching
            "cloud_std": (clouds, steps, 4),
            "cloud_valley": (clouds, steps),  # depth of the valley in the density of the angle, before matching
            "diagonal_std": (len(DIAGONAL), steps, 4),
            "penalty": (steps,),  # cost of the matched Gaussian less that of the free particles with held masks
            "penalty_diagonal": (steps,),  # the same of a Gaussian for each dimension by itself
            "gradient_variance": (ways, horizons),  # trace of the covariance over draws
            "gradient_norm": (ways, horizons),  # of the mean over draws
            "objective": (ways, len(config.counts)),  # mean over draws
            "reached": (len(OPTIMISERS),),  # the objective that a search ended with, by its own account
            "fresh": (len(OPTIMISERS),),  # the objective of the same policies on particles they have not seen
        }
        self.found = self._blank(sizes, len(self.measured))

    def advance(self) -> str:
        """Do a trial as the learner does, then measure if it is time to."""
        before = self.policy
        status = super().advance()
        if self.done - 1 in self.measured:
            self._measure(before)
        return status

    def _measure(self, before: Tensor) -> None:
        """Measure around the trial just done; ``before`` is the policy from which its search began."""
        self._measure_clouds()
        self._measure_gradient(before)
        self._measure_objective()
        self._measure_optimisers(before)

    def _measure_clouds(self) -> None:
        config, policy = self.config, self.shape.policy(self.policy)
        for index, change in enumerate(CLOUDS.values()):
            plan = replace(config, **change)
            (draws,) = self._draws(plan, config.cloud, 1, "cloud")
            with torch.no_grad():
                prediction = predict(policy, config.plant, draws, plan.matching)
                moved = before_matching(policy, config.plant, draws, prediction)
            self._note("cloud_mean", prediction.mean, index)
            self._note("cloud_std", prediction.variance.sqrt(), index)
            self._note("cloud_valley", valley(moved[..., 3]), index)
            if change == CLOUDS["held-free"]:
                self._note("penalty", penalty(config.plant, moved, draws.noise))
                self._note("penalty_diagonal", penalty(config.plant, moved, draws.noise, "diagonal"))
        for index, change in enumerate(DIAGONAL.values()):
            plan = replace(config, **change)
            (draws,) = self._draws(plan, config.cloud, 1, "cloud")
            with torch.no_grad():
                prediction = predict(policy, config.plant, draws, plan.matching)
            self._note("diagonal_std", prediction.variance.sqrt(), index)

    def _measure_gradient(self, before: Tensor) -> None:
        config = self.config
        for way, matching in enumerate(MATCHING):
            plan = replace(config, matching=matching)
            draws = list(self._draws(plan, config.particles, config.gradient_draws, "gradient"))
            for place, horizon in enumerate(config.horizons):
                plant = replace(config.plant, steps=horizon)
                gradients = torch.stack([planning.objective(plant, self.shape, plan, before, d)[1] for d in draws])
                self._note("gradient_variance", gradients.var(0).sum(-1), way, place)
                self._note("gradient_norm", gradients.mean(0).norm(dim=-1), way, place)

    def _measure_objective(self) -> None:
        config = self.config
        for way, matching in enumerate(MATCHING):
            plan = replace(config, matching=matching)
            for place, count in enumerate(config.counts):
                self._note("objective", self._objective(self.policy, plan, count, "objective"), way, place)

    def _measure_optimisers(self, before: Tensor) -> None:
        config = self.config
        for index, change in enumerate(OPTIMISERS.values()):
            plan = replace(config, **change)
            path = "mechanism", "optimiser", self.done - 1
            found = planning.improve(self.model, config.plant, self.shape, plan, before, *path)
            self._note("reached", found.value, index)
            self._note("fresh", self._objective(found.parameters, config, config.particles, "fresh"), index)

    def _objective(self, parameters: Tensor, plan: Planning, count: int, name: str) -> Float[Tensor, " R"]:
        """Return the objective, averaged over draws of ``count`` particles."""
        plant, policy = self.config.plant, self.shape.policy(parameters)
        with torch.no_grad():
            values = [
                predict(policy, plant, draws, plan.matching).costs(plant).mean(-1)
                for draws in self._draws(plan, count, self.config.objective_draws, name)
            ]
        return torch.stack(values).mean(0)

    def _draws(self, plan: Planning, count: int, blocks: int, name: str) -> Iterator[Draws]:
        """Return draws from streams that learning never uses."""
        path = "mechanism", name, self.done - 1
        return planning.draw(self.model, self.config.plant, plan, count, *path, blocks=blocks)

    def _note(self, name: str, value: Tensor, *place: int) -> None:
        where: tuple[slice | int, ...] = (slice(None), self.measured.index(self.done - 1), *place)
        self.found[name][where] = value.double().cpu()

    def result(self) -> dict[str, np.ndarray]:
        """Return the small record of learning, true states and measurements [R, measured trial, ...]."""
        states = self.log["states"][:, list(self.measured)].numpy().astype(np.float32)
        measured = {name: value.numpy().astype(np.float32) for name, value in self.found.items()}
        return super().result() | measured | {"true_states": states}


def before_matching(
    policy: RBFPolicy, plant: CartPole, draws: Draws, prediction: Prediction
) -> Float[Tensor, "R T K 4"]:
    """Return the particles of a predicted trial as the model left them at each step, before a Gaussian was fitted."""
    matrix, weights = multiplied_out(policy)
    state, moved = draws.start, []
    for t in range(plant.steps):
        function = draws.functions[t % len(draws.functions)]
        moved.append(state + function(act(state, matrix, weights, plant.force_limit, function.angle_features)))
        state = prediction.particles[:, t]
    return torch.stack(moved, 1)


def penalty(
    plant: CartPole, particles: Float[Tensor, "R T K 4"], noise: Float[Tensor, "R T K 4"], matching: str = "full"
) -> Tensor:
    """Return by how much the expected cost rises [R, T] if a Gaussian is put in the place of each step's particles."""
    fitted = torch.stack([match(particles[:, t], noise[:, t], matching)[0] for t in range(particles.shape[1])], 1)
    return (cost(plant, fitted) - cost(plant, particles)).mean(-1)


def valley(values: Float[Tensor, "*batch K"]) -> Float[Tensor, "*batch"]:
    """Return how deep the valley of the values' density is, from 0 (one mode) to 1 (two groups with nothing between).

    It is the bimodal amplitude of Zhang, Mapes and Soden (Bimodality in tropical water vapour, 2003): the lower of two
    peaks less the density between them, as a share of that peak; the deepest valley with at least a tenth of the
    values on each side counts. The density is a Gaussian kernel estimate with the robust bandwidth of Silverman
    (Density Estimation, 1986, equation 3.31), which smooths two groups more than needed, so that small bumps vanish.
    """
    x = values.sort(-1).values
    count = x.shape[-1]
    quartiles = x[..., (3 * count) // 4] - x[..., count // 4]
    spread = torch.minimum(x.std(-1), quartiles / 1.34)
    spread = torch.where(spread > 0, spread, x.std(-1).clamp_min(torch.finfo(x.dtype).tiny))
    width = 0.9 * spread[..., None] * count**-0.2
    places = torch.cat((x, (x[..., 1:] + x[..., :-1]) / 2), -1).sort(-1).values  # values and the middles between them
    density = torch.exp(-(((places[..., :, None] - x[..., None, :]) / width[..., None]) ** 2) / 2).sum(-1)
    left, right = density.cummax(-1).values, density.flip(-1).cummax(-1).values.flip(-1)
    depth = 1 - density / torch.minimum(left, right)
    least = 2 * math.ceil(LEAST_GROUP * count)
    return depth[..., least:-least].amax(-1)
