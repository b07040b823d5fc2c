"""Exact moments of nonlinear functions of a Gaussian input: sines, features of the state, squared-exponential functions.

Every function takes a `Gaussian` and returns `Moments` of its output: mean, covariance and *slope*, the expected Jacobian
E[d output / d input]. For a Gaussian input of covariance S the covariance of input and output is S @ slope (Stein's lemma),
which holds for S = 0 too, and slopes of a chain of functions multiply. Leading axes are batch axes, replicas R first.
Formulas: Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010), section 2.3 and appendix A.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Gaussian(NamedTuple):
    """A normal distribution: mean [..., D] and covariance [..., D, D]."""

    mean: Tensor
    cov: Tensor


class Moments(NamedTuple):
    """What a function makes of a Gaussian of D dimensions: mean [..., E], cov [..., E, E] and slope [..., D, E]."""

    mean: Tensor
    cov: Tensor
    slope: Tensor

    @property
    def out(self) -> Gaussian:
        """The Gaussian of equal moments."""
        return Gaussian(self.mean, self.cov)


def linear_moments(x: Gaussian, matrix: Float[Tensor, "... D E"], offset: Tensor | float = 0.0) -> Moments:
    """Return the moments of x @ matrix + offset."""
    mean = (x.mean[..., None, :] @ matrix)[..., 0, :] + offset
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


def feature_moments(state: Gaussian) -> Moments:
    """Return the moments of the features (x, v, w, sin theta, cos theta) of a Gaussian state (x, v, w, theta)."""
    theta = Gaussian(state.mean[..., 3:], state.cov[..., 3:, 3:])
    twice = torch.ones_like(theta.mean[..., None]).expand(*theta.mean.shape, 2)
    quarter = theta.mean.new_tensor([0.0, torch.pi / 2])
    shifted = linear_moments(theta, twice, quarter)  # cos theta = sin(theta + pi / 2)
    trig = sine_moments(shifted.out)
    slope = state.cov.new_zeros(*state.cov.shape[:-2], 4, 5)
    slope[..., [0, 1, 2], [0, 1, 2]] = 1.0
    slope[..., 3:, 3:] = shifted.slope @ trig.slope
    cross = state.cov @ slope  # of state and features
    top = torch.cat((state.cov[..., :3, :3], cross[..., :3, 3:]), -1)
    bottom = torch.cat((cross[..., :3, 3:].mT, trig.cov), -1)
    return Moments(torch.cat((state.mean[..., :3], trig.mean), -1), torch.cat((top, bottom), -2), slope)


@dataclass(frozen=True)
class SquaredExponential:
    """E functions of D inputs, each a weighted sum of N squared-exponential functions around shared centres.

    Function e is s_e^2 sum_n weights[e, n] exp(-|(x - centre_n) / l_e|^2 / 2). With `precision` it is the posterior of a
    Gaussian process: k(x, x) - k(x, centres) precision_e k(centres, x) is its own uncertainty at x.
    """

    centres: Float[Tensor, "R N D"]
    log_length_scales: Float[Tensor, "R E D"]
    log_signal_std: Float[Tensor, "R E"]
    weights: Float[Tensor, "R E N"]
    precision: Float[Tensor, "R E N N"] | None = None

    def __post_init__(self) -> None:
        replicas, count, dim = self.centres.shape
        outputs = self.weights.shape[1]
        expected = (replicas, outputs, dim), (replicas, outputs), (replicas, outputs, count)
        got = tuple(tuple(a.shape) for a in (self.log_length_scales, self.log_signal_std, self.weights))
        if got != expected:
            raise ValueError(f"expected length-scales, signal and weights of shapes {expected}, got {got}")

    def __call__(self, x: Float[Tensor, "R *K D"]) -> Float[Tensor, "R *K E"]:
        """Return the functions' (mean) values at points."""
        values = (self.kernel(x.reshape(len(x), -1, x.shape[-1])) @ self.weights[..., None])[..., 0]
        return values.mT.reshape(*x.shape[:-1], -1)

    def kernel(self, x: Float[Tensor, "R K D"]) -> Float[Tensor, "R E K N"]:
        """Return the covariance function between points and centres."""
        return squared_exponential(x, self.centres, self.log_length_scales, self.log_signal_std)

    def moments(self, x: Gaussian) -> Moments:
        """Return the moments for a Gaussian input, function uncertainty included where there is a `precision`.

        Gradients with respect to the functions' own parameters exist only without `precision`.
        """
        difference = self.centres - x.mean[..., None, :]  # [R, N, D]
        mean, slope = _expectation(self, difference, x.cov)
        second = (
            _second_moments(self, difference, x.cov) if self.precision is None else _posterior_second(self, x)
        )
        return Moments(mean, second - mean[..., :, None] * mean[..., None, :], slope)


def squared_exponential(x: Tensor, y: Tensor, log_length_scales: Tensor, log_signal_std: Tensor) -> Tensor:
    """Return k_e(x_k, y_n) [R, E, K, N] for points x [R, K, D] and y [R, N, D]."""
    inverse = torch.exp(-log_length_scales)[..., None, :]
    scaled_x, scaled_y = x[:, None] * inverse, y[:, None] * inverse
    square = (scaled_x**2).sum(-1)[..., :, None] + (scaled_y**2).sum(-1)[..., None, :]
    distance = (square - 2 * scaled_x @ scaled_y.mT).clamp_min(0)
    return torch.exp(2 * log_signal_std[..., None, None] - distance / 2)


def _expectation(f: SquaredExponential, difference: Tensor, cov: Tensor) -> tuple[Tensor, Tensor]:
    """Return E f [R, E] and E f' [R, D, E]."""
    inverse = torch.exp(-f.log_length_scales)  # [R, E, D]
    system = inverse[..., :, None] * cov[:, None] * inverse[..., None, :]
    system = system + torch.eye(cov.shape[-1], dtype=cov.dtype, device=cov.device)
    factor = torch.linalg.cholesky(system)
    scaled = difference[:, None] * inverse[..., None, :]  # [R, E, N, D]
    solved = torch.cholesky_solve(scaled.mT, factor).mT
    log_det = factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    height = (
        torch.exp((2 * f.log_signal_std - log_det)[..., None] - (scaled * solved).sum(-1) / 2) * f.weights
    )
    slope = (height[..., None, :] @ solved)[..., 0, :] * inverse
    return height.sum(-1), slope.mT


def _second_moments(f: SquaredExponential, difference: Tensor, cov: Tensor) -> Tensor:
    """Return E f_i f_j [R, E, E]: the plain formula, with gradients with respect to everything."""
    precision = torch.exp(-2 * f.log_length_scales)
    scaled = difference[:, None] * precision[..., None, :]  # [R, E, N, D]
    log_height = 2 * f.log_signal_std[..., None] - (scaled * difference[:, None]).sum(-1) / 2
    total = precision[:, :, None] + precision[:, None]  # [R, E, E, D]
    system = (
        torch.eye(cov.shape[-1], dtype=cov.dtype, device=cov.device)
        + cov[:, None, None] * total[..., None, :]
    )
    gain = torch.linalg.solve(system, cov[:, None, None].expand_as(system))
    left = scaled[:, :, None] @ gain  # [R, E, E, N, D]
    own = (left * scaled[:, :, None]).sum(-1) / 2
    other = ((scaled[:, None] @ gain) * scaled[:, None]).sum(-1) / 2
    exponent = (log_height[:, :, None] + own)[..., :, None] + (log_height[:, None] + other)[..., None, :]
    product = torch.exp(exponent + left @ scaled[:, None].mT)
    sums = (f.weights[:, :, None, None] @ product @ f.weights[:, None, ..., None])[..., 0, 0]
    return sums / torch.linalg.det(system).sqrt()
