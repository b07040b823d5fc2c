"""Gaussian-process regression with a squared-exponential kernel: one length-scale per input, learned noise.

Hyper-parameters are one vector per output, in logs: D length-scales, signal standard deviation, noise
standard deviation. With inducing inputs, shared by the outputs, the posterior is the FITC approximation
(Snelson and Ghahramani, 2006). Replicas R first; float64. The settings are those of pilco-matlab (gp/train.m,
gp/hypCurb.m, gp/gp1.m).
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2
from torch import Tensor

from dropout_uncertainty.data_efficiency.gaussians.moments import identity
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import (
    SquaredExponential,
    blocks,
    nan_cholesky,
    squared_exponential,
)
from dropout_uncertainty.data_efficiency.minimise.batched import Minimum, minimise

MAX_SIGNAL_TO_NOISE = 1000.0
MAX_LENGTH_SCALE = 100.0  # in standard deviations of the input
PENALTY_POWER = 30
RIDGE = 1e-6  # added to the covariance of the inducing points, as in the original
LEAST_SPREAD = 1e-6  # standard deviation up to which a column of inputs or targets counts as constant
# Multiples of the mean variance tried in turn on the diagonal of a covariance that cannot be factorised.
JITTERS = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4)


@dataclass(frozen=True)
class GaussianProcess:
    """E independent processes over the same D inputs, with their data."""

    inputs: Tensor  # [R, N, D]
    targets: Tensor  # [R, E, N]
    log_hyper: Tensor  # [R, E, D + 2]
    inducing: Tensor | None = None  # [R, M, D]

    def __post_init__(self) -> None:
        replicas, count, dim = self.inputs.shape
        if count == 0:
            raise ValueError("expected at least one transition to condition the Gaussian process on, got none")
        if self.targets.shape[::2] != (replicas, count) or self.log_hyper.shape != (*self.targets.shape[:2], dim + 2):
            raise ValueError(
                "expected inputs [R, N, D], targets [R, E, N] and log hyper-parameters [R, E, D + 2], got shapes "
                f"{tuple(self.inputs.shape)}, {tuple(self.targets.shape)} and {tuple(self.log_hyper.shape)}"
            )
        if {self.inputs.dtype, self.targets.dtype, self.log_hyper.dtype} != {torch.float64}:
            dtypes = self.inputs.dtype, self.targets.dtype, self.log_hyper.dtype
            raise ValueError(
                f"expected inputs, targets and log hyper-parameters in float64, got {dtypes}: use .double()"
            )

    @property
    def noise_std(self) -> Float[Tensor, "R E"]:
        """Learned noise standard deviations, in units of the targets."""
        return self.log_hyper[..., -1].exp()

    def posterior(self) -> tuple[SquaredExponential, Int[Tensor, " R"]]:
        """Return the posterior over the functions, and how many covariances of each replica needed jitter."""
        if self.inducing is not None:
            return self._inducing_posterior(self.inducing)
        factor, repaired = robust_cholesky(_gram(self.inputs, self.log_hyper))
        weights = torch.cholesky_solve(self.targets[..., None], factor)[..., 0]
        return self._functions(self.inputs, weights, torch.cholesky_inverse(factor)), repaired.sum(-1)

    def _inducing_posterior(self, inducing: Tensor) -> tuple[SquaredExponential, Tensor]:
        noise = torch.exp(2 * self.log_hyper[..., -1])[..., None]
        own, cross, residual = _inducing_covariances(self.inputs, inducing, self.log_hyper)
        factor, repaired = robust_cholesky(own)
        whitened = torch.linalg.solve_triangular(factor, cross, upper=False)
        diagonal = noise + (residual - (whitened**2).sum(-2))  # of the conditional covariance of the targets
        scaled = whitened / diagonal[..., None, :]
        one = identity(own.shape[-1], own.dtype, own.device)
        inner, also = robust_cholesky(one + scaled @ whitened.mT)
        root = torch.linalg.solve_triangular(factor @ inner, one, upper=False)
        weights = (root.mT @ (torch.linalg.solve_triangular(inner, scaled, upper=False) @ self.targets[..., None]))[
            ..., 0
        ]
        precision = torch.cholesky_inverse(factor) - root.mT @ root
        return self._functions(inducing, weights, precision), (repaired | also).sum(-1)

    def _functions(self, centres: Tensor, weights: Tensor, precision: Tensor) -> SquaredExponential:
        return SquaredExponential(centres, self.log_hyper[..., :-2], self.log_hyper[..., -2], weights, precision)


def initial_hyper(inputs: Float[Tensor, "R N D"], targets: Float[Tensor, "R E N"]) -> Float[Tensor, "R E H"]:
    """Return the start of a fit: length-scales and signal as spread as the data, noise a tenth of the signal.

    Where a column does not vary, or there is one row only, the spread counts as 1, as for the network of Deep PILCO.

    Raises:
        ValueError: if the data hold NaN or infinity, or are not of one number of transitions.
    """
    if targets.shape[::2] != inputs.shape[:2]:
        shapes = tuple(inputs.shape), tuple(targets.shape)
        raise ValueError(f"expected inputs [R, N, D] and targets [R, E, N], got shapes {shapes}")
    for name, columns in (("input", inputs.mT), ("target", targets)):
        if not columns.isfinite().all():
            bad = (~columns.isfinite()).any(-1).any(0).nonzero().flatten().tolist()
            raise ValueError(f"expected finite transitions, got NaN or infinity in the {name} columns {bad}")
    scales = _spread(inputs, 1)[0].log()[:, None].expand(-1, targets.shape[1], -1)
    signal = _spread(targets, -1)[0].log()
    return torch.cat((scales, signal[..., None], signal[..., None] - math.log(10)), -1)


def _spread(data: Tensor, dim: int) -> tuple[Tensor, Tensor]:
    """Return the standard deviation along an axis, 1 where the data do not vary, and where that is."""
    std = data.std(dim, correction=min(1, data.shape[dim] - 1))
    constant = std <= LEAST_SPREAD
    return std.masked_fill(constant, 1.0), constant


def negative_log_likelihood(
    log_hyper: Float[Tensor, "B H"], inputs: Float[Tensor, "B N D"], targets: Float[Tensor, "B N"]
) -> tuple[Float[Tensor, " B"], Float[Tensor, "B H"]]:
    """Return the negative log marginal likelihood [nat] of B single-output processes and its gradient.

    NaN where the covariance cannot be factorised.
    """
    size, device = inputs.shape[1] ** 2, inputs.device
    parts = [_nll(*(x[block] for x in (log_hyper, inputs, targets))) for block in blocks(len(inputs), size, device)]
    values, gradients = zip(*parts, strict=True)
    return torch.cat(values), torch.cat(gradients)


def _nll(log_hyper: Tensor, inputs: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Return the same for a block whose arrays stay in the cache.

    No array of D x N x N numbers is made: the sum over n, m of ``W_nm (x_n - x_m)^2`` is
    ``2 sum_n r_n x_n^2 - 2 x' W x`` with r the row sums of the symmetric W.
    """
    gram = _gram(inputs, log_hyper[:, None])[:, 0]
    noise = torch.exp(2 * log_hyper[:, -1])
    factor = nan_cholesky(gram)
    weights = torch.cholesky_solve(targets[..., None], factor)[..., 0]
    half_log_det = factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    value = (targets * weights).sum(-1) / 2 + half_log_det + targets.shape[-1] / 2 * math.log(2 * math.pi)
    slack = torch.cholesky_inverse(factor).addcmul_(weights[:, :, None], weights[:, None], value=-1)
    trace = slack.diagonal(dim1=-2, dim2=-1).sum(-1)
    gram.diagonal(dim1=-2, dim2=-1).sub_(noise[:, None])
    slack.mul_(gram)
    scaled = inputs * torch.exp(-log_hyper[:, None, :-2])
    rows = slack.sum(-1)
    scale_gradient = (rows[..., None] * scaled**2).sum(1) - (scaled * (slack @ scaled)).sum(1)
    return value, torch.cat((scale_gradient, rows.sum(-1)[:, None], (noise * trace)[:, None]), -1)


def penalty(
    log_hyper: Float[Tensor, "B H"],
    input_std: Float[Tensor, "B D"],
    max_ratio: float = MAX_SIGNAL_TO_NOISE,
    max_scale: float = MAX_LENGTH_SCALE,
) -> tuple[Float[Tensor, " B"], Float[Tensor, "B H"]]:
    """Return the penalty that keeps length-scales and signal-to-noise ratios sane, and its gradient.

    A 30th power: next to nothing inside the limits, a wall at them.
    """
    scales = (log_hyper[:, :-2] - input_std.log()) / math.log(max_scale)
    ratio = (log_hyper[:, -2] - log_hyper[:, -1]) / math.log(max_ratio)
    steep = PENALTY_POWER * scales ** (PENALTY_POWER - 1) / math.log(max_scale)
    ratio_slope = PENALTY_POWER * ratio ** (PENALTY_POWER - 1) / math.log(max_ratio)
    value = (scales**PENALTY_POWER).sum(-1) + ratio**PENALTY_POWER
    return value, torch.cat((steep, ratio_slope[:, None], -ratio_slope[:, None]), -1)


def fit_hyper(
    inputs: Float[Tensor, "R N D"], targets: Float[Tensor, "R E N"], start: Float[Tensor, "R E H"], iterations: int
) -> tuple[Float[Tensor, "R E H"], Minimum]:
    """Return the hyper-parameters of smallest penalised negative log likelihood found from ``start``.

    An output that does not vary has nothing to tell of them and keeps its start.
    """
    outputs = targets.shape[1]
    (input_std, _), (_, constant) = _spread(inputs, 1), _spread(targets, -1)

    def objective(x: Tensor, numbers: list[int]) -> tuple[Tensor, Tensor]:
        x, index = x.to(inputs), torch.tensor(numbers, device=inputs.device)
        replica, output = index // outputs, index % outputs
        value, gradient = negative_log_likelihood(x, inputs[replica], targets[replica, output])
        extra, slope = penalty(x, input_std[replica])
        still = constant[replica, output]
        return (value + extra).masked_fill(still, 0.0), (gradient + slope).masked_fill(still[:, None], 0.0)

    found = minimise(objective, start.flatten(0, 1), iterations)
    return found.x.reshape(start.shape), found


def inducing_negative_log_likelihood(
    inducing: Float[Tensor, "R M D"], model: GaussianProcess
) -> tuple[Float[Tensor, " R"], Float[Tensor, "R M D"]]:
    """Return the FITC negative log likelihood [nat], summed over outputs, and its gradient in the inducing inputs.

    The targets have the covariance ``S = Q + diag(c - Q)``, where ``Q = cross' own^-1 cross``: the gradient in S,
    ``S^-1 - S^-1 y y' S^-1``, gives those in ``cross`` and ``own`` if its diagonal is left out. No N x N array is made.
    """
    own, cross, residual = _inducing_covariances(model.inputs, inducing, model.log_hyper)
    noise, y = torch.exp(2 * model.log_hyper[..., -1])[..., None], model.targets[..., None]
    factor = nan_cholesky(own)
    whitened = torch.linalg.solve_triangular(factor, cross, upper=False)
    diagonal = noise + (residual - (whitened**2).sum(-2))
    scaled = whitened / diagonal[..., None, :]
    inner = nan_cholesky(identity(own.shape[-1], own.dtype, own.device) + scaled @ whitened.mT)
    root = torch.linalg.solve_triangular(inner, scaled, upper=False)  # S^-1 = diag(1 / diagonal) - root' root
    weights = y / diagonal[..., None] - root.mT @ (root @ y)
    log_det = diagonal.log().sum(-1) + 2 * inner.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    value = ((y * weights).sum((-2, -1)) + log_det + model.inputs.shape[1] * math.log(2 * math.pi)) / 2

    solved = torch.linalg.solve_triangular(factor.mT, whitened, upper=True)  # own^-1 cross
    on_diagonal = 1 / diagonal - (root**2).sum(-2) - weights[..., 0] ** 2
    in_cross = solved * (1 / diagonal - on_diagonal)[..., None, :]
    in_cross = in_cross - (solved @ root.mT) @ root - (solved @ weights) @ weights.mT
    in_own = in_cross @ solved.mT  # times -1/2, and twice since both sides of a pair move
    pull = _pull(cross * in_cross, inducing, model.inputs) - _pull(own * in_own, inducing, inducing)
    gradient = (pull * torch.exp(-2 * model.log_hyper[..., None, :-2])).sum(1)
    return value.sum(-1), gradient


def _pull(weights: Float[Tensor, "R E M N"], x: Float[Tensor, "R M D"], y: Float[Tensor, "R N D"]) -> Tensor:
    """Return the sums over n of ``weights[m, n] (y_n - x_m)`` [R, E, M, D]."""
    return weights @ y[:, None] - weights.sum(-1)[..., None] * x[:, None]


def initial_inducing(inputs: Float[Tensor, "R N D"], count: int, seeds: list[int]) -> Float[Tensor, "R M D"]:
    """Return k-means centres of each replica's inputs, scaled to unit spread, as first inducing inputs."""
    centres = []
    for x, seed in zip(inputs.cpu().numpy(), seeds, strict=True):
        scale = np.where(x.std(0) > LEAST_SPREAD, x.std(0), 1.0)
        found, _ = kmeans2(x / scale, count, minit="++", rng=np.random.default_rng(seed))
        centres.append(found * scale)
    return torch.from_numpy(np.stack(centres)).to(inputs)


def fit_inducing(
    model: GaussianProcess, start: Float[Tensor, "R M D"], iterations: int
) -> tuple[Float[Tensor, "R M D"], Minimum]:
    """Return the inducing inputs of smallest FITC negative log likelihood found from ``start``."""
    outputs, count = model.targets.shape[1:]

    def objective(x: Tensor, numbers: list[int]) -> tuple[Tensor, Tensor]:
        points, parts = x.to(model.inputs).reshape(-1, *start.shape[1:]), []
        for block in blocks(len(numbers), outputs * count * start.shape[1], points.device):
            chosen = numbers[block]
            part = GaussianProcess(model.inputs[chosen], model.targets[chosen], model.log_hyper[chosen])
            parts.append(inducing_negative_log_likelihood(points[block], part))
        values, gradients = zip(*parts, strict=True)
        return torch.cat(values), torch.cat(gradients).flatten(1)

    found = minimise(objective, start.flatten(1), iterations)
    return found.x.reshape(start.shape), found


def robust_cholesky(matrix: Float[Tensor, "*batch N N"]) -> tuple[Float[Tensor, "*batch N N"], Tensor]:
    """Return Cholesky factors, and which of the matrices needed jitter on their diagonal.

    Raises:
        ValueError: if a matrix is not positive definite even with the largest jitter.
    """
    scale = matrix.diagonal(dim1=-2, dim2=-1).mean(-1)
    factor, bad = _try_cholesky(matrix)
    repaired = bad
    for jitter in JITTERS[1:]:
        if not bad.any():
            return factor, repaired
        bumped = matrix + torch.diag_embed((jitter * scale)[..., None].expand(matrix.shape[:-1]))
        again, still = _try_cholesky(bumped)
        factor = torch.where((bad & ~still)[..., None, None], again, factor)
        bad = bad & still
    if bad.any():
        raise ValueError("expected positive definite covariances; one is not, even with jitter (NaN in the data?)")
    return factor, repaired


def _try_cholesky(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Return Cholesky factors, and which matrices have none; on a GPU, NaN is to be seen in the factor only."""
    factor, info = torch.linalg.cholesky_ex(matrix)
    return factor, (info > 0) | factor.diagonal(dim1=-2, dim2=-1).isnan().any(-1)


def _gram(inputs: Tensor, log_hyper: Tensor) -> Tensor:
    """Return the covariance of the targets [R, E, N, N]."""
    gram = squared_exponential(inputs, inputs, log_hyper[..., :-2], log_hyper[..., -2])
    variance = torch.exp(2 * log_hyper[..., -2:]).sum(-1)[
        ..., None
    ]  # set, not added: distances of 0 may come out as 1e-16
    gram.diagonal(dim1=-2, dim2=-1).copy_(variance.expand(gram.shape[:-1]))
    return gram


def _inducing_covariances(inputs: Tensor, inducing: Tensor, log_hyper: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return covariances of the inducing points, with the inputs, and the inputs' variance [R, E, 1]."""
    scales, signal = log_hyper[..., :-2], log_hyper[..., -2]
    own = squared_exponential(inducing, inducing, scales, signal)
    own = own + RIDGE * identity(own.shape[-1], own.dtype, own.device)
    return own, squared_exponential(inducing, inputs, scales, signal), torch.exp(2 * signal)[..., None]
