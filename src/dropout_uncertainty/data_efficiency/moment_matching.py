"""Exact moments of nonlinear functions of a Gaussian: sines, features, squared-exponential functions.

Every function takes a `Gaussian` and returns `Moments` of its output: mean, covariance and *slope*, the
expected Jacobian E[d output / d input]. For a Gaussian input of covariance S the covariance of input and
output is S @ slope (Stein's lemma), which holds for S = 0 too, and slopes of a chain of functions multiply.
Leading axes are batch axes, replicas R first.
Formulas: Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010), section 2.3 and
    appendix A.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

# Numbers of a block of N x N arrays worked on at once: 1 MiB of float64, the second-level cache of a current
# core.
BLOCK = 2**17


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
    """Return the moments of (x, v, w, sin theta, cos theta) of a Gaussian state (x, v, w, theta)."""
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

    Function e is s_e^2 sum_n weights[e, n] exp(-|(x - centre_n) / l_e|^2 / 2). With `precision` it is the
    posterior of a Gaussian process: k(x, x) - k(x, centres) precision_e k(centres, x) is its own uncertainty
    at x.
    """

    centres: Tensor  # [R, N, D]
    log_length_scales: Tensor  # [R, E, D]
    log_signal_std: Tensor  # [R, E]
    weights: Tensor  # [R, E, N]
    precision: Tensor | None = None  # [R, E, N, N]

    def __post_init__(self) -> None:
        replicas, count, dim = self.centres.shape
        outputs = self.weights.shape[1]
        expected = (replicas, outputs, dim), (replicas, outputs), (replicas, outputs, count)
        got = tuple(tuple(a.shape) for a in (self.log_length_scales, self.log_signal_std, self.weights))
        if got != expected:
            raise ValueError(f"expected length-scales, signal and weights of shapes {expected}, got {got}")

    @cached_property
    def inverse_square(self) -> Tensor:
        """The inverse squared length-scales [R, E, D]."""
        return torch.exp(-2 * self.log_length_scales)

    @cached_property
    def curvature(self) -> Tensor:
        """The outer product of the weights less the precision [R, E, N, N]."""
        return self.weights[..., :, None] * self.weights[..., None, :] - self.precision

    def __call__(self, x: Float[Tensor, "R *K D"]) -> Float[Tensor, "R *K E"]:
        """Return the functions' (mean) values at points."""
        values = (self.kernel(x.reshape(len(x), -1, x.shape[-1])) @ self.weights[..., None])[..., 0]
        return values.mT.reshape(*x.shape[:-1], -1)

    def select(self, replicas: list[int]) -> "SquaredExponential":
        """Return the functions of some of the replicas."""
        if replicas == list(range(len(self.centres))):
            return self
        own = (self.centres, self.log_length_scales, self.log_signal_std, self.weights, self.precision)
        return SquaredExponential(*(None if a is None else a[replicas] for a in own))

    def kernel(self, x: Float[Tensor, "R K D"]) -> Float[Tensor, "R E K N"]:
        """Return the covariance function between points and centres."""
        return squared_exponential(x, self.centres, self.log_length_scales, self.log_signal_std)

    def moments(self, x: Gaussian) -> Moments:
        """Return the moments for a Gaussian input, with function uncertainty if there is a `precision`.

        Gradients with respect to the functions' own parameters exist only without `precision`.
        """
        difference = self.centres - x.mean[..., None, :]
        mean, slope = _expectation(self, difference, x.cov)
        if self.precision is None:
            second = _second_moment(self, difference, x.cov)
        else:
            second = PosteriorSecondMoment.apply(x.mean, x.cov, self)
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
    height = torch.exp((2 * f.log_signal_std - log_det)[..., None] - (scaled * solved).sum(-1) / 2) * f.weights
    slope = (height[..., None, :] @ solved)[..., 0, :] * inverse
    return height.sum(-1), slope.mT


def _second_moment(f: SquaredExponential, difference: Tensor, cov: Tensor) -> Tensor:
    """Return E f_i f_j [R, E, E]: the plain formula, with gradients with respect to everything."""
    precision = torch.exp(-2 * f.log_length_scales)
    scaled = difference[:, None] * precision[..., None, :]  # [R, E, N, D]
    log_height = 2 * f.log_signal_std[..., None] - (scaled * difference[:, None]).sum(-1) / 2
    total = precision[:, :, None] + precision[:, None]  # [R, E, E, D]
    system = torch.eye(cov.shape[-1], dtype=cov.dtype, device=cov.device) + cov[:, None, None] * total[..., None, :]
    gain = torch.linalg.solve(system, cov[:, None, None].expand_as(system))
    left = scaled[:, :, None] @ gain  # [R, E, E, N, D]
    own = (left * scaled[:, :, None]).sum(-1) / 2
    other = ((scaled[:, None] @ gain) * scaled[:, None]).sum(-1) / 2
    exponent = (log_height[:, :, None] + own)[..., :, None] + (log_height[:, None] + other)[..., None, :]
    product = torch.exp(exponent + left @ scaled[:, None].mT)
    sums = (f.weights[:, :, None, None] @ product @ f.weights[:, None, ..., None])[..., 0, 0]
    return sums / torch.linalg.det(system).sqrt()


class PosteriorSecondMoment(torch.autograd.Function):
    """E f_i f_j [R, E, E] under a Gaussian input and the posterior over f: the part of PILCO that grows with N^2.

    For outputs i <= j it sums W_nm = G_nm exp(e_nm), where G = weights_i weights_j' (less the precision where
    i = j) and e is a quadratic form in the differences z_n, z_m of the centres to the input's mean.
    Everything that the gradient needs are the sums of W, W z, z W z' over n and m, so these are taken while a
    block of W is in the cache and no N x N array is kept. Only mean and covariance of the input get
    gradients.
    """

    @staticmethod
    def forward(ctx, mean: Tensor, cov: Tensor, f: SquaredExponential) -> Tensor:
        """Return the second moments and keep their gradients for the backward pass."""
        replicas, outputs = f.log_signal_std.shape
        first, second = _pairs(outputs, mean.device)
        total = f.inverse_square[:, first] + f.inverse_square[:, second]  # [R, P, D]
        root = total.sqrt()
        system = root[..., :, None] * cov[:, None] * root[..., None, :]
        system.diagonal(dim1=-2, dim2=-1).add_(1)
        factor = torch.linalg.cholesky_ex(system).L
        shrink = torch.cholesky_inverse(factor) / root[..., :, None] * root[..., None, :]  # (I + cov total)^-1
        gain = shrink @ cov[:, None]

        z = f.centres - mean[:, None]
        scaled = z[:, None] * f.inverse_square[..., None, :]  # [R, E, N, D]
        log_height = 2 * f.log_signal_std[..., None] - (scaled * z[:, None]).sum(-1) / 2
        left, right = scaled[:, first], scaled[:, second]
        bent = left @ gain
        own = log_height[:, first] + (bent * left).sum(-1) / 2
        own = own - factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)[..., None]
        other = log_height[:, second] + ((right @ gain) * right).sum(-1) / 2
        ones = torch.ones_like(own[..., None])
        row = torch.cat((bent, own[..., None], ones), -1)
        column = torch.cat((right, ones, other[..., None]), -1)
        basis = torch.cat((torch.ones_like(z[..., :1]), z), -1)  # [R, N, 1 + D]

        sums, weight_n, weight_m = _weighted_sums(f, row, column, basis, first, second)
        spread_n, spread_m = ((z.mT[:, None] * w[..., None, :]) @ z[:, None] for w in (weight_n, weight_m))
        li, lj = f.inverse_square[:, first], f.inverse_square[:, second]
        linear = li * sums[..., 1:, 0] + lj * sums[..., 0, 1:]
        mixed = li[..., :, None] * sums[..., 1:, 1:] * lj[..., None, :]
        square = li[..., :, None] * spread_n * li[..., None, :] + lj[..., :, None] * spread_m * lj[..., None, :]
        square = square + mixed + mixed.mT
        value = sums[..., 0, 0]
        d_mean = (shrink.mT @ linear[..., None])[..., 0]
        d_cov = (shrink.mT @ square @ shrink - value[..., None, None] * total[..., :, None] * shrink) / 2
        ctx.save_for_backward(d_mean, d_cov)
        result = mean.new_zeros(replicas, outputs, outputs)
        result[:, first, second] = value
        result[:, second, first] = value
        result.diagonal(dim1=-2, dim2=-1).add_(torch.exp(2 * f.log_signal_std))
        return result

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, Tensor, None]:
        """Contract the kept gradients."""
        d_mean, d_cov = ctx.saved_tensors
        first, second = _pairs(grad.shape[-1], grad.device)
        share = (grad + grad.mT)[:, first, second] * torch.where(first == second, 0.5, 1.0)
        return (share[..., None] * d_mean).sum(1), (share[..., None, None] * d_cov).sum(1), None


def _pairs(outputs: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the output pairs i <= j, those with i = j first."""
    first, second = torch.triu_indices(outputs, outputs, 1, device=device)
    same = torch.arange(outputs, device=device)
    return torch.cat((same, first)), torch.cat((same, second))


def _weighted_sums(f: SquaredExponential, row, column, basis, first, second) -> tuple[Tensor, Tensor, Tensor]:
    """Return sums [R, P, 1 + D, 1 + D] of W_nm basis_n basis_m', and the sums of W over m and over n [R, P, N]."""
    replicas, pairs, count, _ = row.shape
    weighted_m = f.weights[:, second][..., None] * basis[:, None]
    weighted_n = f.weights[:, first][..., None] * basis[:, None]
    sums = row.new_empty(replicas, pairs, basis.shape[-1], basis.shape[-1])
    over_m, over_n = row.new_empty(replicas, pairs, count), row.new_empty(replicas, pairs, count)
    outputs = f.weights.shape[1]
    for r in _blocks(replicas, count * count):
        for p in _blocks(outputs, (r.stop - r.start) * count * count):
            w = torch.exp_(row[r, p] @ column[r, p].mT).mul_(f.curvature[r, p])
            product = w @ basis[r, None]
            sums[r, p] = basis[r, None].mT @ product
            over_m[r, p] = over_n[r, p] = product[..., 0]
        for p in _blocks(pairs - outputs, (r.stop - r.start) * count * count, outputs):
            w = torch.exp_(row[r, p] @ column[r, p].mT)
            product = w @ weighted_m[r, p]
            sums[r, p] = weighted_n[r, p].mT @ product
            over_m[r, p] = f.weights[r, first[p]] * product[..., 0]
            over_n[r, p] = f.weights[r, second[p]] * (weighted_n[r, p, :, :1].mT @ w)[..., 0, :]
    return sums, over_m, over_n


def _blocks(count: int, size: int, start: int = 0) -> list[slice]:
    """Cut count entries of `size` numbers into slices that stay in the processor's cache."""
    width = max(1, BLOCK // size)
    return [slice(start + i, start + min(i + width, count)) for i in range(0, count, width)]
