"""Gaussians through nonlinear functions: exact moments of sines and features, and how moments of a chain combine.

Functions take a ``Gaussian`` and return ``Moments`` of their output (``sines`` its parts): mean, covariance and
*slope*, the expected Jacobian ``E[d output / d input]``. For a Gaussian input of covariance S the covariance of input
and output is ``S @ slope`` (Stein's lemma), which holds for S = 0 too, and slopes of a chain of functions multiply.
Leading axes are batch axes, replicas R first. Formulas: Deisenroth, Efficient Reinforcement Learning using
Gaussian Processes (2010), section 2.3 and appendix A.
"""

from functools import cache
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad


class Gaussian(NamedTuple):
    """A normal distribution: mean [..., D] and covariance [..., D, D]."""

    mean: Tensor
    cov: Tensor


class Moments(NamedTuple):
    """What a function makes of a Gaussian: mean [..., E], cov [..., E, E] and slope [..., D, E]."""

    mean: Tensor
    cov: Tensor
    slope: Tensor

    @property
    def out(self) -> Gaussian:
        """The Gaussian of equal moments."""
        return Gaussian(self.mean, self.cov)


def sines(mean: Float[Tensor, "... D"], cov: Float[Tensor, "... D D"]) -> tuple[Tensor, Tensor, Tensor]:
    """Return mean [..., D] and covariance [..., D, D] of sin x for a Gaussian x, and the mean of cos x [..., D]."""
    row, column = mean[..., :, None], mean[..., None, :]
    decay = torch.exp(cov.diagonal(dim1=-2, dim2=-1) / -2)
    same = torch.expm1(cov) * (row - column).cos()
    opposite = torch.expm1(-cov) * (row + column).cos()
    covariance = (same - opposite) * (decay[..., :, None] * decay[..., None, :] / 2)
    return decay * mean.sin(), covariance, decay * mean.cos()


def appended(x: Gaussian, y: Moments, kept: int) -> Moments:
    """Return the joint moments of the first ``kept`` entries of x and, behind them, y, a function of x."""
    cross = x.cov[..., :kept, :] @ y.slope
    upper = torch.cat((x.cov[..., :kept, :kept], cross), -1)
    cov = torch.cat((upper, torch.cat((cross.mT, y.cov), -1)), -2)
    unchanged = identity(x.cov.shape[-1], x.cov.dtype, x.cov.device)[:, :kept]
    slope = torch.cat((unchanged.expand(*x.cov.shape[:-1], kept), y.slope), -1)
    return Moments(torch.cat((x.mean[..., :kept], y.mean), -1), cov, slope)


def feature_moments(state: Gaussian) -> Moments:
    """Return the moments of (x, v, w, sin theta, cos theta) of a Gaussian state (x, v, w, theta)."""
    angle, variance = state.mean[..., 3:], state.cov[..., 3:, 3:]
    quarter = _quarter_turn(state.mean.dtype, state.mean.device)  # cos theta = sin(theta + pi / 2)
    mean, cov, derivative = sines(angle + quarter, variance.expand(*angle.shape[:-1], 2, 2))
    return appended(state, Moments(mean, cov, pad(derivative[..., None, :], (0, 0, 3, 0))), 3)


@cache
def identity(dim: int, dtype: torch.dtype, device: torch.device) -> Float[Tensor, "D D"]:
    """Return the identity matrix, made once."""
    return torch.eye(dim, dtype=dtype, device=device)


@cache
def _quarter_turn(dtype: torch.dtype, device: torch.device) -> Tensor:
    return torch.tensor([0.0, torch.pi / 2], dtype=dtype, device=device)
