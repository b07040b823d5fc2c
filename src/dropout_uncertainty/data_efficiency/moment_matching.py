"""Gaussians through nonlinear functions: exact moments of sines and features, and how moments of a chain combine.

Every function takes a ``Gaussian`` and returns ``Moments`` of its output: mean, covariance and *slope*, the
expected Jacobian ``E[d output / d input]``. For a Gaussian input of covariance S the covariance of input and
output is ``S @ slope`` (Stein's lemma), which holds for S = 0 too, and slopes of a chain of functions multiply.
Leading axes are batch axes, replicas R first. Formulas: Deisenroth, Efficient Reinforcement Learning using
Gaussian Processes (2010), section 2.3 and appendix A.
"""

from functools import cache
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


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


def linear_moments(x: Gaussian, matrix: Float[Tensor, "... D E"], offset: Tensor | float = 0.0) -> Moments:
    """Return the moments of ``x @ matrix + offset``."""
    mean = (x.mean @ matrix if matrix.ndim == 2 else (x.mean[..., None, :] @ matrix)[..., 0, :]) + offset
    return Moments(mean, matrix.mT @ x.cov @ matrix, matrix)


def sine_moments(x: Gaussian) -> Moments:
    """Return the moments of sin x, element by element."""
    variance = x.cov.diagonal(dim1=-2, dim2=-1)
    row, column = x.mean[..., :, None], x.mean[..., None, :]
    decay = torch.exp(-variance / 2)
    same = torch.expm1(x.cov) * (row - column).cos()
    opposite = torch.expm1(-x.cov) * (row + column).cos()
    cov = (same - opposite) * decay[..., :, None] * decay[..., None, :] / 2
    return Moments(decay * x.mean.sin(), cov, torch.diag_embed(decay * x.mean.cos()))


def appended(x: Gaussian, y: Moments, keep: Float[Tensor, "D J"], place: Float[Tensor, "E J"]) -> Moments:
    """Return the joint moments of ``x @ keep + y @ place``, where y is a function of x: usually x with y behind it."""
    slope = keep + y.slope @ place
    own = y.cov - y.slope.mT @ x.cov @ y.slope  # what y has beyond its linear part
    return Moments(x.mean @ keep + y.mean @ place, slope.mT @ x.cov @ slope + place.mT @ own @ place, slope)


@cache
def behind(kept: int, dim: int, added: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the maps of ``appended`` that keep the first of x's dim entries and put the added ones behind them."""
    identity = torch.eye(kept + added, dtype=dtype, device=device)
    nothing = identity.new_zeros(dim - kept, kept + added)
    return torch.cat((identity[:kept], nothing)), identity[kept:]


def feature_moments(state: Gaussian) -> Moments:
    """Return the moments of (x, v, w, sin theta, cos theta) of a Gaussian state (x, v, w, theta)."""
    keep, place = behind(3, 4, 2, state.mean.dtype, state.mean.device)
    twice, shift = _angle_constants(state.mean.dtype, state.mean.device)
    angles = linear_moments(state, twice, shift)  # theta and theta + pi / 2, since cos theta = sin(theta + pi / 2)
    trig = sine_moments(angles.out)
    return appended(state, Moments(trig.mean, trig.cov, twice @ trig.slope), keep, place)


@cache
def _angle_constants(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    twice = torch.tensor([[0.0, 0], [0, 0], [0, 0], [1, 1]], dtype=dtype, device=device)
    return twice, torch.tensor([0.0, torch.pi / 2], dtype=dtype, device=device)
