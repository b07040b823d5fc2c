"""A trial predicted by particles (thesis algorithm 4): act, move, fit a Gaussian, draw new particles from it.

Everything that does not change during a trial is multiplied out before it. Gradients are autograd's;
`trial_gradient` has them by hand for the common settings. Replicas R first, then particles K.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import nan_cholesky
from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.data_efficiency.policies import RBFPolicy, squash

MATCHING = ("full", "diagonal", "off")
COST_OF = ("particles", "mean")
# Added to the particles' covariance, in SI units and as a share of each variance: keeps the Cholesky factor of nearly
# equal or strongly correlated particles in float32.
JITTER, RELATIVE_JITTER = 1e-6, 1e-5


@runtime_checkable
class Function(Protocol):
    """How each particle moves: the change of state for a state, or its features, and a force."""

    @property
    def angle_features(self) -> bool:
        """Whether it is given features of the state."""

    def __call__(self, inputs: Tensor) -> Tensor:
        """Return the change of state [R, K, 4] for inputs [R, K, D]."""


@dataclass(frozen=True)
class Draws:
    """The random numbers of one predicted trial: what makes its cost a function of the policy alone."""

    start: Float[Tensor, "R K 4"]  # particles at time 0
    functions: tuple[Function, ...]  # one, held for the whole trial, or one per step
    noise: Float[Tensor, "R T K 4"]  # standard normal, for the particles that are drawn anew


@dataclass(frozen=True)
class Prediction:
    """A predicted trial."""

    particles: Float[Tensor, "R T K 4"]  # of times 1 ... T, after matching
    mean: Float[Tensor, "R T 4"]  # of the particles as the model left them
    variance: Float[Tensor, "R T 4"]

    def costs(self, plant: CartPole, of: str = "particles") -> Float[Tensor, "R T"]:
        """Return the predicted cost of each step: mean cost of the particles, or cost of their mean."""
        return cost(plant, self.particles).mean(-1) if of == "particles" else cost(plant, self.particles.mean(-2))


def predict(policy: RBFPolicy, plant: CartPole, draws: Draws, matching: str = "full") -> Prediction:
    """Return the predicted trial of a policy under given draws, differentiable in the policy's parameters.

    The model's noise is not added to the states.
    """
    matrix, weights = multiplied_out(policy)
    state, visited, means, variances = draws.start, [], [], []
    for t in range(plant.steps):
        function = draws.functions[t % len(draws.functions)]
        moved = state + function(act(state, matrix, weights, plant.force_limit, function.angle_features))
        state, mean, variance = match(moved, draws.noise[:, t], matching)
        visited.append(state)
        means.append(mean)
        variances.append(variance)
    return Prediction(torch.stack(visited, 1), torch.stack(means, 1), torch.stack(variances, 1))


def multiplied_out(policy: RBFPolicy) -> tuple[Float[Tensor, "R Q N"], Float[Tensor, "R N 1"]]:
    """Return a policy of one output as (matrix, weights): exp((x, x², 1) @ matrix) @ weights for D features x."""
    precision = torch.exp(-2 * policy.log_length_scales)  # [R, 1, D]
    pull = policy.centres * precision  # [R, N, D]
    offset = -(policy.centres * pull).sum(-1, keepdim=True) / 2
    matrix = torch.cat((pull, (-precision / 2).expand_as(pull), offset), -1).mT
    return matrix, policy.weights.mT


def act(
    state: Float[Tensor, "R K 4"], matrix: Tensor, weights: Tensor, limit: float, angle_features: bool
) -> Float[Tensor, "R K D"]:
    """Return the features of a state (without ``angle_features``: the state) and the policy's force on it [N]."""
    theta = state[..., 3:]
    seen = torch.cat((state[..., :3], theta.sin(), theta.cos()), -1)
    return torch.cat((seen if angle_features else state, force(seen, matrix, weights, limit)), -1)


def force(
    seen: Float[Tensor, "R K D"], matrix: Float[Tensor, "R Q N"], weights: Float[Tensor, "R N 1"], limit: float
) -> Float[Tensor, "R K 1"]:
    """Return the force, within ``limit`` [N], of a policy (`multiplied_out`) on D features; Q = 2 D + 1."""
    squares = torch.cat((seen, seen * seen, torch.ones_like(seen[..., :1])), -1)
    return squash((squares @ matrix).exp() @ weights, limit)


def match(
    particles: Float[Tensor, "R K D"], noise: Float[Tensor, "R K D"], matching: str = "full"
) -> tuple[Float[Tensor, "R K D"], Float[Tensor, "R D"], Float[Tensor, "R D"]]:
    """Return new particles from the Gaussian fitted to the particles, with its mean and variances (lines 9 to 11).

    Gradients flow through the mean and the factor of the covariance to the new particles. ``matching`` "diagonal" fits
    each dimension by itself, "off" leaves the particles as they are. The covariance is that of the particles, divided
    by K; a replica whose covariance has no factor becomes NaN.

    Raises:
        ValueError: for another way of matching.
    """
    if matching not in MATCHING:
        raise ValueError(f"expected matching to be one of {', '.join(MATCHING)}, got {matching!r}")
    mean = particles.mean(1, keepdim=True)
    centred = particles - mean
    if matching == "full":
        cov = centred.mT @ centred / particles.shape[1]
        variance = cov.diagonal(dim1=-2, dim2=-1)
        factor = nan_cholesky(cov + torch.diag_embed(JITTER + RELATIVE_JITTER * variance))
        return torch.baddbmm(mean, noise, factor.mT), mean[:, 0], variance
    variance = centred.square().mean(1)
    if matching == "diagonal":
        particles = mean + noise * (variance + JITTER).sqrt()[:, None]
    return particles, mean[:, 0], variance
