"""Sums of squared-exponential functions, as in Gaussian processes and RBF networks, and their moments under a Gaussian.

Formulas: Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010), section 2.3 and appendix A.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian, Moments, identity

# Numbers of a block of N x N arrays worked on at once: 1 MiB of float64, the second-level cache of a current core; on a
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
    def curvature(self) -> Tensor:
        """Per pair of outputs i <= j, the outer product of weights, less the precision where i = j [R, P, N, N]."""
        first, second = self._pairs
        product = self.weights[:, first, :, None] * self.weights[:, second, None]
        if self.precision is not None:
            product[:, _pair_numbers(self.weights.shape[1], product.device).diagonal()] -= self.precision
        return product

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
        if self.precision is None and not self.fixed:
            mean, slope, square = _mixture_moments(self, *x)
        else:
            mean, slope, square = PosteriorMoments.apply(*x, self)
        return Moments(mean, square - mean[..., :, None] * mean[..., None, :], slope)


def squared_exponential(x: Tensor, y: Tensor, log_length_scales: Tensor, log_signal_std: Tensor) -> Tensor:
    """Return ``k_e(x_k, y_n)`` [R, E, K, N] for points x [R, K, D] and y [R, N, D]."""
    inverse = torch.exp(-log_length_scales)[..., None, :]
    scaled_x, scaled_y = x[:, None] * inverse, y[:, None] * inverse
    square = (scaled_x**2).sum(-1)[..., :, None] + (scaled_y**2).sum(-1)[..., None, :]
    distance = (square - 2 * scaled_x @ scaled_y.mT).clamp_min(0)
    return torch.exp(2 * log_signal_std[..., None, None] - distance / 2)


def _mixture_moments(f: SquaredExponential, mean: Tensor, cov: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return mean [R, E], slope [R, D, E] and E f f' [R, E, E], with gradients with respect to everything."""
    (centres, weights), root, outputs = f.terms, f.roots, f.weights.shape[1]
    inverse, log_det = spd_inverse(_system(cov, root))
    z = centres - (mean[:, None] * root)[..., None, :]  # [R, E + P, K, D], in length-scales
    pull = z @ inverse
    height = torch.exp((log_det[..., None] + (z * pull).sum(-1)) / -2) * weights
    value = height.sum(-1)
    slope = (height[:, :outputs, None] @ pull[:, :outputs])[..., 0, :] * root[:, :outputs]
    return value[:, :outputs], slope.mT, value[:, outputs + _pair_numbers(outputs, mean.device)]


class PosteriorMoments(torch.autograd.Function):
    """Mean, slope and second moment ``E f f'`` under a Gaussian input and the posterior over f.

    This is the part of PILCO that grows with N^2, so value and gradient are worked out by hand in one pass. A
    mean value ``g(m, S)`` over a Gaussian has ``dg/dm = slope`` and ``dg/dS`` half its second derivative in m;
    those of g are sums over centres. For outputs i <= j the second moment sums
    ``W_nm = curvature_nm exp(e_nm)``, e a quadratic form in the differences ``z_n, z_m`` of the centres to m.
    All that its gradient needs are sums of ``W``, ``W z`` and ``z W z'``, taken while a block of W is in the
    cache, so that no N x N array is kept. Only mean and covariance of the input get gradients.
    """

    @staticmethod
    def forward(ctx: Any, mean: Tensor, cov: Tensor, f: SquaredExponential) -> tuple[Tensor, Tensor, Tensor]:
        """Return mean [R, E], slope [R, D, E], second moment [R, E, E]; keep what their gradients need."""
        total, root, outputs = f.inverse_squares, f.roots, f.weights.shape[1]
        inverse, log_det = _spd_inverse(_system(cov, root))
        shrink = inverse / root[..., :, None] * root[..., None, :]  # (I + cov total)^-1
        z = f.centres - mean[:, None]

        metric = shrink[:, :outputs].mT * total[:, :outputs, None]  # (cov + squared length-scales)^-1
        pull = z[:, None] @ metric  # [R, E, N, D]
        exponent = 2 * f.log_signal_std - log_det[:, :outputs] / 2
        height = torch.exp(exponent[..., None] - (pull * z[:, None]).sum(-1) / 2) * f.weights
        slope = (height[..., None, :] @ pull)[..., 0, :]
        bend = pull.mT @ (height[..., None] * pull) - height.sum(-1)[..., None, None] * metric

        value, d_mean, d_cov = _pair_sums(f, z, cov, total[:, outputs:], shrink[:, outputs:], log_det[:, outputs:])
        ctx.save_for_backward(d_mean, d_cov, slope, bend, pull, height, metric)
        square = value[:, _pair_numbers(outputs, mean.device)]
        if f.precision is not None:
            square.diagonal(dim1=-2, dim2=-1).add_(torch.exp(2 * f.log_signal_std))
        return height.sum(-1), slope.mT, square

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, g_mean: Tensor, g_slope: Tensor, g_square: Tensor) -> tuple[Tensor, Tensor, None]:
        """Contract the kept derivatives; the third derivative of g only along the slope's gradient."""
        d_mean, d_cov, slope, bend, pull, height, metric = ctx.saved_tensors
        first, second = _pairs(g_mean.shape[-1], g_mean.device)
        share = (g_square + g_square.mT)[:, first, second] * torch.where(first == second, 0.5, 1.0)
        along = g_slope.mT[..., None]  # [R, E, D, 1]
        weight = height[..., None] * (pull @ along)  # [R, E, N, 1]
        side = (metric @ along) * slope[..., None, :]
        third = pull.mT @ (weight * pull) - weight.sum(-2, keepdim=True) * metric - side - side.mT
        curved = (g_mean[..., None, None] * bend + third).sum(1) / 2
        in_mean = (g_mean[..., None] * slope + (bend @ along)[..., 0]).sum(1) + (share[..., None] * d_mean).sum(1)
        return in_mean, curved + (share[..., None, None] * d_cov).sum(1), None


def _pair_sums(
    f: SquaredExponential, z: Tensor, cov: Tensor, total: Tensor, shrink: Tensor, log_det: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return sum W [R, P] per pair of outputs and its gradients in mean [R, P, D] and covariance [R, P, D, D]."""
    inverse_square, (first, second) = f.inverse_squares[:, : f.weights.shape[1]], f._pairs
    li, lj = inverse_square[:, first], inverse_square[:, second]
    scaled = z[:, None] * inverse_square[..., None, :]  # [R, E, N, D]
    log_height = 2 * f.log_signal_std[..., None] - (scaled * z[:, None]).sum(-1) / 2
    left, right, gain = scaled[:, first], scaled[:, second], shrink @ cov[:, None]
    bent = left @ gain
    own = log_height[:, first] + ((bent * left).sum(-1) - log_det[..., None]) / 2
    other = log_height[:, second] + ((right @ gain) * right).sum(-1) / 2
    ones = torch.ones_like(own[..., None])
    row = torch.cat((bent, own[..., None], ones), -1).flatten(0, 1)
    column = torch.cat((right, ones, other[..., None]), -1).flatten(0, 1).mT
    basis = torch.cat((torch.ones_like(z[..., :1]), z), -1)  # [R, N, 1 + D]
    basis = basis[:, None].expand(-1, len(first), -1, -1).flatten(0, 1)

    product, over_n = torch.empty_like(basis), torch.empty_like(basis[..., 0])
    curvature = f.curvature.flatten(0, 1)
    count, size = over_n.shape
    for block in _blocks(count, size, z.device):
        w = torch.bmm(row[block], column[block]).exp_().mul_(curvature[block])
        torch.bmm(w, basis[block], out=product[block])
        torch.sum(w, -2, out=over_n[block])
    sums = (basis.mT @ product).unflatten(0, own.shape[:2])  # sums of W basis_n basis_m'
    spread_n = (z.mT[:, None] * product[..., 0].unflatten(0, own.shape[:2])[..., None, :]) @ z[:, None]
    spread_m = (z.mT[:, None] * over_n.unflatten(0, own.shape[:2])[..., None, :]) @ z[:, None]

    value = sums[..., 0, 0]
    linear = li * sums[..., 1:, 0] + lj * sums[..., 0, 1:]
    mixed = li[..., :, None] * sums[..., 1:, 1:] * lj[..., None, :]
    square = li[..., :, None] * spread_n * li[..., None, :] + lj[..., :, None] * spread_m * lj[..., None, :]
    d_cov = shrink.mT @ (square + mixed + mixed.mT) @ shrink - value[..., None, None] * total[..., :, None] * shrink
    return value, (linear[..., None, :] @ shrink)[..., 0, :], d_cov / 2


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
    """Return I + diag(root) cov diag(root) [R, ..., D, D] for cov [R, D, D] and root [R, ..., D]."""
    cov = cov.reshape(len(cov), *(1,) * (root.ndim - 2), *cov.shape[1:])
    return identity(cov.shape[-1], cov.dtype, cov.device) + root[..., :, None] * cov * root[..., None, :]


@cache
def _pairs(outputs: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the output pairs i <= j."""
    first, second = torch.triu_indices(outputs, outputs, device=device)
    return first, second


@cache
def _pair_numbers(outputs: int, device: torch.device) -> Tensor:
    """Return the number of each pair of outputs in the list of those i <= j, in either order [E, E]."""
    first, second = _pairs(outputs, device)
    numbers = first.new_empty(outputs, outputs)
    numbers[first, second] = numbers[second, first] = torch.arange(len(first), device=device)
    return numbers


def _blocks(count: int, size: int, device: torch.device) -> list[slice]:
    """Cut ``count`` square arrays of edge ``size`` into slices of at most ``BLOCK`` numbers."""
    width = max(1, BLOCK[device.type] // size**2)
    return [slice(i, min(i + width, count)) for i in range(0, count, width)]
