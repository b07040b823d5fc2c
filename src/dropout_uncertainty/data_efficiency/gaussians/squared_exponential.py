"""Sums of squared-exponential functions, as in Gaussian processes and RBF networks, and their moments under a Gaussian.

Formulas: Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010), section 2.3 and appendix A.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian, Moments, identity

LOG2_E = 1 / math.log(2)  # exp(x) = 2^(x log2 e), and powers of 2 take half the time
# Numbers of a block of large arrays worked on at once: 1 MiB of float64, the second-level cache of a current core; on a
# GPU few large blocks are faster than many small ones.
BLOCK = {"cpu": 2**17, "cuda": 2**26}


@dataclass(frozen=True)
class SquaredExponential:
    """E functions of D inputs, each a weighted sum of N squared-exponential functions around shared centres.

    Function e is ``s_e^2 sum_n weights[e, n] exp(-|(x - centre_n) / l_e|^2 / 2)``. With ``precision`` it is the
    posterior of a Gaussian process: ``k(x, x) - k(x, centres) precision_e k(centres, x)`` is its own uncertainty
    at x. What is worked out once keeps its autograd graph, so every gradient needs functions of its own.
    """

    centres: Tensor  # [R, N, D]
    log_length_scales: Tensor  # [R, E, D]
    log_signal_std: Tensor  # [R, E]
    weights: Tensor  # [R, E, N]
    precision: Tensor | None = None  # [R, E, N, N]
    fixed: bool = False  # the functions' own parameters need no gradients, which makes their moments cheaper

    def __post_init__(self) -> None:
        replicas, count, dim = self.centres.shape
        outputs = self.weights.shape[1]
        expected = (replicas, outputs, dim), (replicas, outputs), (replicas, outputs, count)
        got = tuple(tuple(a.shape) for a in (self.log_length_scales, self.log_signal_std, self.weights))
        if got != expected:
            raise ValueError(f"expected length-scales, signal and weights of shapes {expected}, got {got}")

    @cached_property
    def inverse_squares(self) -> Tensor:
        """The inverse squared length-scales of the functions and of their products f_i f_j, i <= j [R, E + P, D]."""
        own, (first, second) = torch.exp(-2 * self.log_length_scales), self._pairs
        return torch.cat((own, own[:, first] + own[:, second]), 1)

    @cached_property
    def roots(self) -> Tensor:
        """The square roots of ``inverse_squares``."""
        return self.inverse_squares.sqrt()

    @cached_property
    def terms(self) -> tuple[Tensor, Tensor]:
        """The functions and their products f_i f_j, i <= j, as sums of terms ``weight exp(-|root x - centre|^2 / 2)``.

        The product of two terms is another, so that a second moment is an expectation like the first. Returns centres
        [R, E + P, N^2, D] and weights [R, E + P, N^2]; the functions themselves have N terms, then zeros.
        """
        outputs, (first, second) = self.weights.shape[1], self._pairs
        own, total = self.inverse_squares.split((outputs, len(first)), 1)
        left, right = own[:, first, None, None], own[:, second, None, None]
        x, y = self.centres[:, None, :, None], self.centres[:, None, None]
        between = (left * x + right * y) / total.sqrt()[:, :, None, None]
        overlap = torch.exp(-((x - y) ** 2 * left * right / total[:, :, None, None]).sum(-1) / 2)
        weights = torch.exp(2 * self.log_signal_std)[..., None] * self.weights
        products = weights[:, first, :, None] * weights[:, second, None] * overlap
        padding = (0, overlap.shape[-1] ** 2 - overlap.shape[-1])
        alone = self.centres[:, None] * self.roots[:, :outputs, None]
        centres = torch.cat((pad(alone, (0, 0, *padding)), between.flatten(2, 3)), 1)
        return centres, torch.cat((pad(weights, padding), products.flatten(2)), 1)

    @cached_property
    def pair_scales(self) -> tuple[Tensor, Tensor]:
        """The inverse squared length-scales of the two functions of each pair [R, P, D]."""
        own, (first, second) = self.inverse_squares[:, : self.weights.shape[1]], self._pairs
        return own[:, first], own[:, second]

    @cached_property
    def pair_weights(self) -> tuple[Tensor, Tensor]:
        """The weights of the two functions of each pair [R, P, N]; 1 for f_i f_i where ``curvature`` holds them."""
        outputs, (first, second) = self.weights.shape[1], self._pairs
        both = self.weights[:, first], self.weights[:, second]
        if self.precision is None:
            return both
        ones = torch.ones_like(self.weights)
        return torch.cat((ones, both[0][:, outputs:]), 1), torch.cat((ones, both[1][:, outputs:]), 1)

    @cached_property
    def curvature(self) -> Tensor | None:
        """Per output the outer product of its weights less its ``precision`` [R, E, N, N], if there is one."""
        return None if self.precision is None else self.weights[..., None] * self.weights[..., None, :] - self.precision

    @property
    def _plain(self) -> bool:
        return self.precision is None and not self.fixed

    @property
    def _pairs(self) -> tuple[Tensor, Tensor]:
        return _pairs(self.weights.shape[1], self.weights.device)

    def __call__(self, x: Float[Tensor, "R *K D"]) -> Float[Tensor, "R *K E"]:
        """Return the functions' (mean) values at points."""
        values = (self.kernel(x.reshape(len(x), -1, x.shape[-1])) @ self.weights[..., None])[..., 0]
        return values.mT.reshape(*x.shape[:-1], -1)

    def select(self, replicas: list[int]) -> "SquaredExponential":
        """Return the functions of some of the replicas."""
        if replicas == list(range(len(self.centres))):
            return self
        return SquaredExponential(
            self.centres[replicas],
            self.log_length_scales[replicas],
            self.log_signal_std[replicas],
            self.weights[replicas],
            None if self.precision is None else self.precision[replicas],
            self.fixed,
        )

    def mean_function(self) -> "SquaredExponential":
        """Return the posterior's mean alone: fixed functions without uncertainty of their own."""
        return replace(self, precision=None, fixed=True)

    def kernel(self, x: Float[Tensor, "R K D"]) -> Float[Tensor, "R E K N"]:
        """Return the covariance function between points and centres."""
        return squared_exponential(x, self.centres, self.log_length_scales, self.log_signal_std)

    def moments(self, x: Gaussian) -> Moments:
        """Return the moments for a Gaussian input, with function uncertainty if there is a ``precision``.

        Gradients with respect to the functions' own parameters exist only without ``precision``, unless ``fixed``.
        """
        values, sums = self.values(x)
        asked = torch.is_grad_enabled() and any(part.requires_grad for part in x)
        return Linearised(values, self.jacobian(x, sums) if asked else None).moments(x)

    def values(self, x: Gaussian) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return the values of ``Linearised`` for a Gaussian input, and the sums over centres that ``jacobian`` needs.

        The values have gradients with respect to the functions' own parameters where ``moments`` has them.
        """
        x = Gaussian(x.mean.detach(), x.cov.detach())
        return _mixture_values(self, x) if self._plain else _posterior_values(self, x)

    def jacobian(self, x: Gaussian, sums: tuple[Tensor, ...]) -> Tensor:
        """Return the derivatives of ``Linearised``, for one input or for those of several times [R, T, ...] at once.

        What grows with N alone is worked out again, which costs less than to keep it for each time.
        """
        with torch.no_grad():
            return _mixture_jacobian(self, x) if self._plain else _posterior_jacobian(self, x, *sums)


class Linearised(NamedTuple):
    """Values of E functions of a Gaussian's mean and covariance, and their derivatives.

    ``values`` [..., E + E D + E^2] are the means of the functions, their slopes in D inputs and the second moments
    ``E f f'``; ``jacobian`` [..., E + E D + E^2, D + D^2] is None if nobody asked for it.
    """

    values: Tensor
    jacobian: Tensor | None

    def moments(self, x: Gaussian) -> Moments:
        """Return the moments for the Gaussian input that this was worked out for, with its gradients in x."""
        dim, count, values = x.mean.shape[-1], self.values.shape[-1], self.values
        outputs = next(e for e in range(1, count) if e * (1 + dim + e) == count)
        if self.jacobian is not None:
            values = _Known.apply(*x, values, self.jacobian)
        mean, slope, square = values.split((outputs, outputs * dim, outputs**2), -1)
        cov = square.unflatten(-1, (outputs, outputs)) - mean[..., :, None] * mean[..., None, :]
        return Moments(mean, cov, slope.unflatten(-1, (outputs, dim)).mT)


class _Known(torch.autograd.Function):
    """Values that are known already, as a function of mean and covariance of which the derivatives are, too."""

    @staticmethod
    def forward(ctx: Any, mean: Tensor, cov: Tensor, values: Tensor, jacobian: Tensor) -> Tensor:
        ctx.save_for_backward(jacobian)
        return values.view_as(values)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        (jacobian,) = ctx.saved_tensors
        dim = int(jacobian.shape[-1] ** 0.5)  # D + D^2 columns
        in_mean, in_cov = (gradient[..., None, :] @ jacobian)[..., 0, :].split((dim, dim * dim), -1)
        return in_mean, in_cov.reshape(*in_mean.shape, dim), gradient, None


def squared_exponential(x: Tensor, y: Tensor, log_length_scales: Tensor, log_signal_std: Tensor) -> Tensor:
    """Return ``k_e(x_k, y_n)`` [R, E, K, N] for points x [R, K, D] and y [R, N, D]."""
    inverse = torch.exp(-log_length_scales)[..., None, :]
    scaled_x, scaled_y = x[:, None] * inverse, y[:, None] * inverse
    square = (scaled_x**2).sum(-1)[..., :, None] + (scaled_y**2).sum(-1)[..., None, :]
    distance = (square - 2 * scaled_x @ scaled_y.mT).clamp_min(0)
    return torch.exp(2 * log_signal_std[..., None, None] - distance / 2)


def _over(x: Gaussian, *parts: Tensor) -> tuple[Tensor, ...]:
    """Return what belongs to replicas, with a time axis if x has one."""
    return parts if x.mean.ndim == 2 else tuple(part[:, None] for part in parts)


def _mixture(f: SquaredExponential, x: Gaussian) -> tuple[Tensor, ...]:
    """Return height [..., E + P, K], pull [..., E + P, K, D] and metric of ``f.terms``, and the root of each."""
    centres, weights, root = _over(x, *f.terms, f.roots)
    inverse, log_det = spd_inverse(_system(x.cov[..., None, :, :], root))
    z = centres - (x.mean[..., None, :] * root)[..., None, :]  # in length-scales
    pull = z @ inverse
    return torch.exp((log_det[..., None] + (z * pull).sum(-1)) / -2) * weights, pull, inverse, root


def _mixture_values(f: SquaredExponential, x: Gaussian) -> tuple[Tensor, tuple[()]]:
    height, pull, _, root = _mixture(f, x)
    outputs = f.weights.shape[1]
    own, value = slice(outputs), height.sum(-1)
    slope = (height[..., own, None, :] @ pull[..., own, :, :])[..., 0, :] * root[..., own, :]
    square = value[..., outputs + _pair_numbers(outputs, value.device).flatten()]
    return torch.cat((value[..., own], slope.flatten(-2), square), -1), ()


def _mixture_jacobian(f: SquaredExponential, x: Gaussian) -> Tensor:
    height, pull, inverse, root = _mixture(f, x)
    pull, metric = pull * root[..., None, :], inverse * root[..., :, None] * root[..., None, :]
    first, second = _derivatives(height, pull, metric)
    outputs, count = f.weights.shape[1], f.centres.shape[1]  # behind these the functions have terms of weight 0
    own, some = slice(outputs), slice(count)
    third = _third_derivatives(height[..., own, some], pull[..., own, some, :], metric[..., own, :, :])
    pairs = outputs + _pair_numbers(outputs, height.device).flatten()
    return _jacobian(
        first[..., own, :], second[..., own, :, :], third, first[..., pairs, :], second[..., pairs, :, :] / 2
    )


def _posterior(f: SquaredExponential, x: Gaussian) -> tuple[Tensor, ...]:
    """Return height [..., E, N], pull [..., E, N, D], metric, and (I + cov total)^-1 with log determinant."""
    total, root, centres, signal, weights = _over(
        x, f.inverse_squares, f.roots, f.centres, 2 * f.log_signal_std, f.weights
    )
    own = slice(f.weights.shape[1])
    inverse, log_det = _spd_inverse(_system(x.cov[..., None, :, :], root))
    shrink = inverse / root[..., :, None] * root[..., None, :]
    metric = shrink[..., own, :, :].mT * total[..., own, None, :]  # (cov + squared length-scales)^-1
    z = (centres - x.mean[..., None, :])[..., None, :, :]
    pull = z @ metric
    height = torch.exp((signal - log_det[..., own] / 2)[..., None] - (pull * z).sum(-1) / 2) * weights
    return height, pull, metric, shrink, log_det


def _posterior_values(f: SquaredExponential, x: Gaussian) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Return the values under a Gaussian input and the posterior over f, and sums over pairs of centres.

    The second moments are the part of PILCO that grows with N^2. For outputs i <= j one sums
    ``W_nm = curvature_nm exp(e_nm)``, e a quadratic form in the differences ``z_n, z_m`` of the centres to the mean.
    All that its derivatives need are sums of ``W``, ``W z`` and ``z W z'``, taken while a block of W is in the cache,
    so that no N x N array is kept. Where the curvature is a product of weights alone, these are left out of W.
    """
    outputs = f.weights.shape[1]
    height, pull, _, shrink, log_det = _posterior(f, x)
    sums = _pair_sums(f, x, shrink[:, outputs:], log_det[:, outputs:])
    square = sums[0][:, _pair_numbers(outputs, height.device).flatten(), 0, 0]
    if f.precision is not None:
        square[:, :: outputs + 1] += torch.exp(2 * f.log_signal_std)
    slope = (height[..., None, :] @ pull)[..., 0, :]
    return torch.cat((height.sum(-1), slope.flatten(1), square), -1), sums


def _posterior_jacobian(f: SquaredExponential, x: Gaussian, sums: Tensor, spread_n: Tensor, spread_m: Tensor) -> Tensor:
    height, pull, metric, shrink, _ = _posterior(f, x)
    first, second = _derivatives(height, pull, metric)
    third, outputs = _third_derivatives(height, pull, metric), f.weights.shape[1]
    total, left, right = _over(x, f.inverse_squares[:, outputs:], *f.pair_scales)
    shrink, value = shrink[..., outputs:, :, :], sums[..., 0, 0]
    linear = left * sums[..., 1:, 0] + right * sums[..., 0, 1:]
    mixed = left[..., :, None] * sums[..., 1:, 1:] * right[..., None, :]
    square = left[..., :, None] * spread_n * left[..., None, :] + right[..., :, None] * spread_m * right[..., None, :]
    d_cov = shrink.mT @ (square + mixed + mixed.mT) @ shrink - value[..., None, None] * total[..., :, None] * shrink
    pairs = _pair_numbers(outputs, value.device).flatten()
    d_mean = (linear[..., None, :] @ shrink)[..., 0, :]
    return _jacobian(first, second, third, d_mean[..., pairs, :], d_cov[..., pairs, :, :] / 2)


# A mean value g(m, S) over a Gaussian has dg/dm, its slope, and dg/dS, half its second derivative in m. Those of g
# here are sums over centres: with heights h_n and p_n = metric (centre_n - m) the first is sum h p, the second
# sum h (p p' - metric), and so on.


def _derivatives(height: Tensor, pull: Tensor, metric: Tensor) -> tuple[Tensor, Tensor]:
    """Return the first and second derivatives in the mean, [..., D] and [..., D, D]."""
    weighted = height[..., None] * pull
    return weighted.sum(-2), pull.mT @ weighted - height.sum(-1)[..., None, None] * metric


def _third_derivatives(height: Tensor, pull: Tensor, metric: Tensor) -> Tensor:
    """Return the third derivatives in the mean [..., D, D, D]."""
    weighted = height[..., None] * pull
    raw = torch.stack([(weighted[..., d : d + 1] * pull).mT @ pull for d in range(pull.shape[-1])], -3)
    side = weighted.sum(-2)[..., :, None, None] * metric[..., None, :, :]
    return raw - side - side.transpose(-3, -2) - side.transpose(-3, -1)


def _jacobian(first: Tensor, second: Tensor, third: Tensor, d_mean: Tensor, d_cov: Tensor) -> Tensor:
    """Return the derivatives of mean, slope and second moment in the input's mean and covariance, as one matrix."""
    in_mean = torch.cat((first, second.flatten(-3, -2), d_mean), -2)
    in_cov = torch.cat((second.flatten(-2) / 2, third.flatten(-4, -3).flatten(-2) / 2, d_cov.flatten(-2)), -2)
    return torch.cat((in_mean, in_cov), -1)


def _pair_sums(f: SquaredExponential, x: Gaussian, shrink: Tensor, log_det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return per pair of outputs the sums of W basis_n basis_m', basis (1, z), and of W z_n z_n' and W z_m z_m'."""
    first, second = f._pairs
    left_scale, right_scale = f.pair_scales
    z = f.centres - x.mean[:, None]
    left, right = z[:, None] * left_scale[..., None, :], z[:, None] * right_scale[..., None, :]
    gain = shrink @ x.cov[:, None]
    bent = left @ gain
    height = 2 * f.log_signal_std
    own = (height[:, first] - log_det / 2)[..., None] + ((bent - z[:, None]) * left).sum(-1) / 2
    other = height[:, second, None] + ((right @ gain - z[:, None]) * right).sum(-1) / 2
    ones = torch.ones_like(own[..., None])
    row = torch.cat((bent, own[..., None], ones), -1) * LOG2_E
    column = torch.cat((right, ones, other[..., None]), -1).mT
    basis = torch.cat((ones[:, :1].mT, z.mT[:, None]), -2)  # [R, 1, 1 + D, N]
    outer, inner = f.pair_weights
    factors = row, column, outer, inner[..., None, :] * basis
    if f.curvature is None:
        product, over_n = _sums(factors)
    else:
        outputs = f.weights.shape[1]
        squares = _sums([part[:, :outputs] for part in factors], f.curvature)
        mixed = _sums([part[:, outputs:] for part in factors])
        product, over_n = (torch.cat(parts, 1) for parts in zip(squares, mixed, strict=True))
    product, over_n, z = outer[..., None, :] * product, inner * over_n, z[:, None]
    return basis @ product.mT, (z * product[..., 0, :, None]).mT @ z, (z * over_n[..., None]).mT @ z


def _sums(factors: Sequence[Tensor], curvature: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return ``inner W'`` [R, P, 1 + D, N] and ``outer' W`` [R, P, N] for ``W_nm = curvature_nm 2^(row_n column_m)``.

    The factors are row [R, P, N, 2 + D], column [R, P, 2 + D, N], outer [R, P, N] and inner [R, P, 1 + D, N]: on a CPU
    the product with few rows was measured faster than that with few columns.
    """
    shape = factors[0].shape[:2]
    row, column, outer, inner = (part.flatten(0, 1) for part in factors)
    over_m, over_n = torch.empty_like(inner), torch.empty_like(outer)
    size = outer.shape[1]
    parts = blocks(len(outer), size**2, outer.device)  # none of mixed pairs where there is one output
    kept = row.new_empty(parts[0].stop if parts else 0, size, size)  # new memory costs as much as filling it
    for block in parts:
        w = torch.bmm(row[block], column[block], out=kept[: block.stop - block.start]).exp2_()
        if curvature is not None:
            w *= curvature.flatten(0, 1)[block]
        torch.bmm(inner[block], w.mT, out=over_m[block])
        torch.bmm(outer[block, None], w, out=over_n[block, None])
    return over_m.unflatten(0, shape), over_n.unflatten(0, shape)


def spd_inverse(matrix: Float[Tensor, "*batch D D"]) -> tuple[Float[Tensor, "*batch D D"], Float[Tensor, "*batch"]]:
    """Return inverse and log determinant of symmetric positive definite matrices, NaN for others; differentiable.

    torch's own would solve the systems again in the backward pass, which costs most of the time for small ones, and is
    not defined for NaN on a GPU.
    """
    return _SPDInverse.apply(matrix)


class _SPDInverse(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, matrix: Tensor) -> tuple[Tensor, Tensor]:
        inverse, log_det = _spd_inverse(matrix)
        ctx.save_for_backward(inverse)
        return inverse, log_det

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, g_inverse: Tensor, g_log_det: Tensor) -> Tensor:
        (inverse,) = ctx.saved_tensors
        return g_log_det[..., None, None] * inverse - inverse @ g_inverse @ inverse


def nan_cholesky(matrix: Tensor) -> Tensor:
    """Return Cholesky factors, all NaN for a matrix that has none: one bad replica must not stop the others."""
    factor, info = torch.linalg.cholesky_ex(matrix)
    return torch.where((info > 0)[..., None, None], torch.nan, factor) if info.any() else factor


def _spd_inverse(matrix: Tensor) -> tuple[Tensor, Tensor]:
    factor = nan_cholesky(matrix)
    one = identity(matrix.shape[-1], matrix.dtype, matrix.device)
    root = torch.linalg.solve_triangular(factor, one, upper=False)
    return root.mT @ root, 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)


def _system(cov: Tensor, root: Tensor) -> Tensor:
    """Return I + diag(root) cov diag(root) [..., D, D] for cov [..., D, D] and root [..., D]."""
    return identity(cov.shape[-1], cov.dtype, cov.device) + root[..., :, None] * cov * root[..., None, :]


@cache
def _pairs(outputs: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the output pairs i <= j, those of i = j first."""
    same, (first, second) = torch.arange(outputs, device=device), torch.triu_indices(outputs, outputs, 1, device=device)
    return torch.cat((same, first)), torch.cat((same, second))


@cache
def _pair_numbers(outputs: int, device: torch.device) -> Tensor:
    """Return the number of each pair of outputs in the list of those i <= j, in either order [E, E]."""
    first, second = _pairs(outputs, device)
    numbers = first.new_empty(outputs, outputs)
    numbers[first, second] = numbers[second, first] = torch.arange(len(first), device=device)
    return numbers


def blocks(count: int, size: int, device: torch.device) -> list[slice]:
    """Cut ``count`` arrays of ``size`` numbers into slices of at most ``BLOCK`` numbers, or of one array."""
    width = max(1, BLOCK[device.type] // size)
    return [slice(i, min(i + width, count)) for i in range(0, count, width)]
