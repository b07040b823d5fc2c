"""Three estimates of a policy's gradient from the same particles: pathwise, by likelihood ratio, by total propagation.

Each particle moves by a Gaussian of its own, x' = mean + std · noise. The pathwise estimate follows this sum backwards;
the likelihood ratio weighs the score of each step by the cost that came after it; total propagation mixes the two at
every step, by their variances over the particles (Parmas, Rasmussen, Peters and Doya, PIPPS, 2018, algorithm 3).
Measured on free particles through PILCO's Gaussian process, where its searches begin. Replicas R first, K particles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.data_efficiency.ablations.mchutchon import moments_at
from dropout_uncertainty.data_efficiency.deep_pilco.particles import act, multiplied_out
from dropout_uncertainty.data_efficiency.deep_pilco.planning import RBFShape
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import SquaredExponential
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.data_efficiency.pilco.learner import LONGER, PilcoConfig, PilcoLearning
from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.runs.sweep import Sweep

__all__ = ["CONFIGS", "ESTIMATES", "FAMILY", "GradientConfig", "Gradients", "Step", "estimate", "start"]

FAMILY = "gradients"
#: Estimates, by the share of the likelihood ratio in each step; None: as the variances have it.
ESTIMATES: dict[str, float | None] = {"pathwise": 0.0, "likelihood-ratio": 1.0, "total-propagation": None}
#: Mean and standard deviation [R, K, D] of the next states, for states [R, K, D] and each particle's parameters.
Step = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


def estimate(
    step: Step,
    costs: Callable[[Tensor], Tensor],
    start: Float[Tensor, "R K D"],
    parameters: Float[Tensor, "R P"],
    noise: Float[Tensor, "R T K D"],
    share: float | None,
) -> Float[Tensor, "R P"]:
    """Return an estimate of the gradient of the expected cost, mean over times 1 ... T.

    Its two ends are unbiased. With ``share`` None the weights come from the particles that they weigh, which biases the
    estimate by an amount that vanishes with many particles. The cost of the other particles is the baseline of each.
    """
    each = parameters[:, None].expand(-1, start.shape[1], -1)
    states, steps = [start], noise.shape[1]
    with torch.no_grad():
        for t in range(steps):
            mean, std = step(states[t], each)
            states.append(mean + std * noise[:, t])
        to_come = torch.stack([costs(state) for state in states[1:]], 1).flip(1).cumsum(1).flip(1) / steps
        above = (to_come - to_come.mean(-1, keepdim=True)) * (start.shape[1] / (start.shape[1] - 1))
    gradient, ahead = torch.zeros_like(parameters), torch.zeros_like(start)
    for t in reversed(range(steps)):
        x, own, reached = (v.detach().clone().requires_grad_() for v in (states[t], each, states[t + 1]))
        (slope,) = torch.autograd.grad(costs(reached).sum() / steps, reached)
        z, moments = noise[:, t], step(x, own)
        std, weight = moments[1].detach(), above[:, t, :, None]
        along = ahead + slope, (ahead + slope) * z  # slopes of the cost to come in mean and standard deviation
        score = weight * z / std, weight * (z.square() - 1) / std
        back = partial(torch.autograd.grad, moments, (x, own), retain_graph=share is None)
        if share is None:
            path, ratio = back(along), back(score)
            k = _share(path[1], ratio[1])[..., None]
            ahead, terms = ((1 - k) * one + k * two for one, two in zip(path, ratio, strict=True))
        else:
            mixed = [(1 - share) * one + share * two for one, two in zip(along, score, strict=True)]
            ahead, terms = back(mixed)
        gradient += terms.mean(1)
    return gradient


def _share(path: Float[Tensor, "R K P"], ratio: Float[Tensor, "R K P"]) -> Float[Tensor, "R 1"]:
    """Return the share of the likelihood ratio with which the mixture varies least, were the two independent."""
    one, two = (values.var(1).sum(-1, keepdim=True) for values in (path, ratio))
    return one / (one + two).clamp_min(torch.finfo(one.dtype).tiny)


@dataclass(frozen=True)
class GradientConfig(PilcoConfig):
    """PILCO, looked at where the search after each trial begins."""

    #: Line searches per trial: few, since the policies are looked at and need not solve the task.
    policy_iterations: int = 30
    particles: int = 50  #: Particles of an estimate.
    draws: int = 16  #: Estimates, over which the variance is taken.
    horizons: tuple[int, ...] = (5, 10, 15, 20, 25)  #: Lengths of the predicted trial [steps].

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.particles, self.draws) < 2 or not 1 <= min(self.horizons) <= max(self.horizons) <= self.plant.steps:
            raise ValueError(
                f"expected 2 or more particles and draws, and horizons of 1 to {self.plant.steps} steps, got "
                f"{self.particles}, {self.draws} and {self.horizons}"
            )


class Gradients(PilcoLearning):
    """R repetitions of PILCO; nothing of what is measured goes into learning."""

    config: GradientConfig

    def __init__(
        self, config: GradientConfig, seeds: Sequence[int], device: str = "cpu", kept: Sequence[str] | None = None
    ) -> None:
        super().__init__(config, seeds, device, kept)
        size = len(ESTIMATES), len(config.horizons)
        self.log |= self._blank({name: size for name in MEASURED}, self.total)

    def _record_gradients(self, model: SquaredExponential) -> None:
        """Take the estimates at the policy from which the search begins."""
        plant, policy = self.config.plant, self.shape.policy(self.policy.to(self.device))
        parts = (policy.log_length_scales, policy.centres, policy.weights)
        parameters = torch.cat([part.flatten(1) for part in parts], 1)
        step = policy_step(model, plant, RBFShape(self.config.basis))
        draws = [self._numbers(draw) for draw in range(self.config.draws)]
        for row, share in enumerate(ESTIMATES.values()):
            for column, steps in enumerate(self.config.horizons):
                found = torch.stack([
                    estimate(step, partial(cost, plant), begin, parameters, noise[:, :steps], share)
                    for begin, noise in draws
                ])  # fmt: skip
                self.log["gradient_variance"][:, self.done, row, column] = found.var(0).sum(-1)
                self.log["gradient_norm"][:, self.done, row, column] = found.mean(0).norm(dim=-1)

    def _numbers(self, draw: int) -> tuple[Tensor, Tensor]:
        """Return start states [R, K, 4] and noise [R, T, K, 4] of an estimate."""
        plant, shape = self.config.plant, (self.config.plant.steps + 1, self.config.particles, 4)
        noise = rng.normal(self.seeds, shape, "estimates", self.done, draw).to(self.device)
        return noise.new_tensor(plant.start_mean) + plant.start_std * noise[:, 0], noise[:, 1:]


def policy_step(model: SquaredExponential, plant: CartPole, shape: RBFShape) -> Step:
    """Return how particles move through Gaussian processes, each under the policy of its own parameters."""

    def step(state: Float[Tensor, "R K 4"], parameters: Float[Tensor, "R K P"]) -> tuple[Tensor, Tensor]:
        matrix, weights = multiplied_out(shape.policy(parameters.flatten(0, 1)))
        inputs = act(state.flatten(0, 1)[:, None], matrix, weights, plant.force_limit, angle_features=True)
        mean, std = moments_at(model, inputs.reshape(*state.shape[:2], -1))
        return state + mean, std

    return step


#: Over draws: trace of the estimates' covariance, and norm of their mean; [R, trial, estimate, horizon].
MEASURED = ("gradient_variance", "gradient_norm")
#: Those at which the estimates are taken, with the model and the policy that the trials before have left.
TRIALS = 2
_PAPER = LONGER["pilco-paper-15"]
CONFIGS = {"gradients/pilco": GradientConfig(plant=_PAPER.plant, trials=TRIALS)}


def memory(config: GradientConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: a policy per particle, and PILCO's own."""
    return pilco.memory(config) + 8.0 * config.particles * config.basis * 12 * 20


start = partial(pilco.start, kind=Gradients, kept=("costs", *MEASURED))
SWEEPS = [Sweep(EXPERIMENT, CONFIGS, start, ("float64",), GROUP, 10, memory)]
