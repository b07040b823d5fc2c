"""Policies: features of the observed state in, a squashed force out; for points and Gaussians.

A policy is a value, a frozen dataclass of tensors with the replica axis R first, so that an optimiser can
build one from any vector of parameters. Calling it gives the preliminary output, before the squash; ``force``
applies both.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian, Moments, identity, sines
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import (
    SquaredExponential,
    nan_cholesky,
    squared_exponential,
)
from dropout_uncertainty.data_efficiency.plant.cartpole import FEATURE_NAMES, CartPole, features

# The original policy is the posterior mean of a Gaussian process whose signal and noise standard
# deviations are fixed to 1 and this (pilco-matlab, control/congp.m); only their ratio matters for the
# weights.
NOISE_STD = 0.01
# Added to the variance of the preliminary output, as in the original (gp/gp2.m); keeps it positive for a
# certain state.
VARIANCE_JITTER = 1e-6


@dataclass(frozen=True)
class RBFPolicy:
    """A weighted sum of N squared-exponential basis functions of height 1, with length-scales per output."""

    centres: Float[Tensor, "R N D"]
    log_length_scales: Float[Tensor, "R F D"]
    weights: Float[Tensor, "R F N"]

    @classmethod
    def from_targets(
        cls, centres: Float[Tensor, "R N D"], log_length_scales: Float[Tensor, "R F D"], targets: Float[Tensor, "R F N"]
    ) -> "RBFPolicy":
        """Return the posterior mean of a process that saw ``targets`` at ``centres``, as PILCO does."""
        noise = NOISE_STD**2 * torch.eye(centres.shape[-2], dtype=centres.dtype, device=centres.device)
        gram = squared_exponential(centres, centres, log_length_scales, torch.zeros_like(targets[..., 0])) + noise
        weights = torch.cholesky_solve(targets[..., None], nan_cholesky(gram))[..., 0]
        return cls(centres, log_length_scales, weights)

    @cached_property
    def functions(self) -> SquaredExponential:
        """The preliminary output as functions whose moments are known, made once."""
        log_height = torch.zeros_like(self.weights[..., 0])
        return SquaredExponential(self.centres, self.log_length_scales, log_height, self.weights)

    def __call__(self, x: Float[Tensor, "R *K D"]) -> Float[Tensor, "R *K F"]:
        """Return the preliminary output at points."""
        return self.functions(x)

    def moments(self, x: Gaussian) -> Moments:
        """Return the moments of the preliminary output for a Gaussian input."""
        u = self.functions.moments(x)
        jitter = VARIANCE_JITTER * identity(u.mean.shape[-1], u.mean.dtype, u.mean.device)
        return Moments(u.mean, u.cov + jitter, u.slope)


@dataclass(frozen=True)
class Layout:
    """How the parameters of N basis functions over D features stand in one vector: scales, centres, one number each."""

    basis: int
    dim: int = len(FEATURE_NAMES)

    @property
    def size(self) -> int:
        """The length of the vector."""
        return self.dim + self.basis * (self.dim + 1)

    def split(self, parameters: Float[Tensor, "R P"]) -> tuple[Tensor, Tensor, Tensor]:
        """Return length-scales [R, 1, D], centres [R, N, D] and the last numbers [R, 1, N]."""
        scales, centres, numbers = parameters.split((self.dim, self.basis * self.dim, self.basis), -1)
        return scales[:, None], centres.reshape(-1, self.basis, self.dim), numbers[:, None]


def squash(u: Float[Tensor, "*batch"], limit: float) -> Float[Tensor, "*batch"]:
    """Return ``limit (9 sin u + sin 3u) / 8``, which is within [-limit, limit] and flat at its extremes."""
    return limit / 8 * (9 * u.sin() + (3 * u).sin())


def squash_moments(u: Gaussian, limit: float | Tensor) -> Moments:
    """Return the moments of ``squash``, element by element, for a Gaussian u and one limit or one per element."""
    spread, mix = _squash_constants(u.mean.shape[-1], u.mean.dtype, u.mean.device)
    mean, cov, derivative = sines(u.mean @ spread, spread.mT @ u.cov @ spread)
    mix = limit * mix
    return Moments(mean @ mix, mix.mT @ cov @ mix, torch.diag_embed(derivative @ (spread.mT * mix)))


@cache
def _squash_constants(width: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the map from u to (u, 3u), and that from their sines to the squash."""
    one = identity(width, dtype, device)
    return torch.cat((one, 3 * one), 1), torch.cat((9 * one, one)) / 8


def force(policy: RBFPolicy, plant: CartPole, state: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch"]:
    """Return the squashed force [N] for (observed) states, within the plant's limit."""
    return squash(policy(features(state))[..., 0], plant.force_limit)


def force_moments(policy: RBFPolicy, limit: float | Tensor, x: Gaussian) -> Moments:
    """Return the moments of the squashed output, the preliminary one matched by a Gaussian."""
    preliminary = policy.moments(x)
    squashed = squash_moments(preliminary.out, limit)
    return Moments(squashed.mean, squashed.cov, preliminary.slope @ squashed.slope)
