"""The one idea of the book: a draw of the weights is a value.

With dropout, a draw from the approximate posterior over the weights, q(ω), is one set of masks. Here the masks are
plain tensors, made by ``draw`` and handed to the call: ``net(x, masks)``. How long a draw is held (a prediction, a
decision, a whole trajectory) is then visible in the code. ``masks=None`` is the deterministic pass (weight scaling).
"""

import itertools
import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Generator, Tensor, nn

from dropout_uncertainty import rng

__all__ = ["MLP", "Masks", "draw_masks", "dropout_mask", "weight_decay"]

#: One mask per weight layer, applied to that layer's input; None where the layer has no dropout.
Masks = tuple[Tensor | None, ...]

ACTIVATIONS = {"relu": torch.relu, "sigmoid": torch.sigmoid, "tanh": torch.tanh}


def check_probability(p: float) -> float:
    """Return the drop probability ``p``; raises ValueError outside [0, 1)."""
    if not 0.0 <= p < 1.0:
        raise ValueError(f"a drop probability lies in [0, 1), got {p}")
    return float(p)


def dropout_mask(
    shape: Sequence[int], p: float, generator: Generator, dtype: torch.dtype = torch.float32, out: Tensor | None = None
) -> Float[Tensor, "..."]:
    """Return a mask of the given shape: 0 with probability ``p``, else 1/(1 - p), so that its mean is 1.

    The scaling belongs to the mask (thesis section 3.2), hence the deterministic pass needs no scaling of its own.
    With ``out`` the mask is written there.

    Raises:
        ValueError: if ``p`` is outside [0, 1).
    """
    p, shape = check_probability(p), tuple(shape)
    keep = 1.0 - p
    mask = torch.empty(shape, dtype=dtype, device=generator.device) if out is None else out
    if (256 * p).is_integer():
        # One random byte decides exactly, at a twentieth of the cost of a Bernoulli variate on a CPU.
        count = math.prod(shape)
        words = _random_words((-(-count // 8),), generator)
        kept = words.view(torch.uint8)[:count].view(shape) >= int(256 * p)
    else:
        # The 53 bits of a double and the answer of `Tensor.bernoulli_` on a CPU, at less than half its cost.
        words = _random_words(shape, generator).bitwise_and_(2**53 - 1)
        kept = words < math.ceil(2**53 * keep)
    return mask.copy_(kept.view(torch.uint8)).div_(keep)  # bytes are copied faster than truth values


def _random_words(shape: tuple[int, ...], generator: Generator) -> Tensor:
    words = torch.empty(shape, dtype=torch.int64, device=generator.device)
    return words.random_(torch.iinfo(torch.int64).min, None, generator=generator)


def draw_masks(
    seeds: Sequence[int], widths: Sequence[int], drop: Sequence[float], count: int, *path: str | int, weight: Tensor
) -> Masks:
    """Return ``count`` weight draws per replica: for each dropout site a mask [R, count, width], None where p = 0.

    The draw is a function of each replica's seed and ``path``; dtype and device are those of ``weight``.
    """

    def site(index: int, width: int, p: float) -> Tensor | None:
        if p == 0.0:
            return None
        masks = weight.new_empty(len(seeds), count, width)
        for mask, seed in zip(masks, seeds, strict=True):
            generator = rng.generator(seed, "masks", index, *path, device=weight.device)
            dropout_mask((count, width), p, generator, weight.dtype, mask)
        return masks

    return tuple(site(index, width, p) for index, (width, p) in enumerate(zip(widths, drop, strict=True)))


def weight_decay(n: int, p: float, length_scale: float, precision: float) -> float:
    """Return λ = (1 - p) l² / (2 N τ), the decay of a weight matrix whose input is dropped with probability ``p``.

    It multiplies the sum of squared weights beside *half* the mean squared error (thesis equation 3.14): their sum is
    then 1 / (N τ) times the negative log posterior of weights with prior variance 1 / ((1 - p) l²), up to a constant.
    Without the factor ½ the prior counts half as much, as in the published code of the regression experiments, which
    has this decay beside the whole mean squared error (yaringal/DropoutUncertaintyExps, net/net.py). ``n`` is the
    number of data points N, ``length_scale`` the prior length-scale l, ``precision`` τ.

    Raises:
        ValueError: if ``n`` < 1, ``precision`` or ``length_scale`` is not positive, or ``p`` is outside [0, 1).
    """
    if not (n >= 1 and precision > 0 and length_scale > 0):
        raise ValueError(
            f"weight decay needs n >= 1 and a positive length-scale and precision, got {n}, {length_scale}, {precision}"
        )
    return (1.0 - check_probability(p)) * length_scale**2 / (2.0 * n * precision)


class MLP(nn.Module):
    """R independent multilayer perceptrons with dropout, evaluated together.

    Parameters carry the replica axis first: ``weights[l]`` is [R, in, out] and ``biases[l]`` [R, 1, out]. Replica r is
    initialised from the streams of ``seeds[r]`` alone, so it is the same network in any company.

    Args:
        sizes: widths from input to output, e.g. (59, 50, 50, 5).
        drop: the drop probability before each weight layer; ``drop[0]`` acts on the inputs.
        seeds: one seed per replica.
        activation: "relu", "sigmoid" or "tanh", after every layer but the last.
        dtype: of the parameters.

    Weights start from a normal distribution of variance 2 / (in + out) (Glorot and Bengio, 2010), biases at 0.

    Raises:
        ValueError: if ``drop`` has not one probability in [0, 1) per weight layer, the activation is unknown, or a seed
            is negative or comes twice.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        drop: Sequence[float],
        seeds: Sequence[int],
        *,
        activation: str = "relu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if len(drop) != len(sizes) - 1:
            raise ValueError(f"expected one drop probability per weight layer ({len(sizes) - 1}), got {len(drop)}")
        if activation not in ACTIVATIONS:
            raise ValueError(f"unknown activation {activation!r}, choose one of {', '.join(ACTIVATIONS)}")
        self.sizes, self.seeds = tuple(sizes), rng.check_seeds(seeds)
        self.drop = tuple(check_probability(p) for p in drop)
        self.activation = ACTIVATIONS[activation]
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for layer, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
            scale = (2.0 / (fan_in + fan_out)) ** 0.5

            def glorot(g: Generator, shape: tuple[int, int] = (fan_in, fan_out), scale: float = scale) -> Tensor:
                return scale * torch.randn(shape, generator=g, dtype=dtype)

            self.weights.append(nn.Parameter(rng.stacked(glorot, self.seeds, "init", layer)))
            self.biases.append(nn.Parameter(torch.zeros(len(self.seeds), 1, fan_out, dtype=dtype)))

    def draw(self, count: int, *path: str | int) -> Masks:
        """Return ``count`` weight draws per replica: for each layer a mask [R, count, in], or None without dropout.

        The draw is a function of each replica's seed and ``path``; give another path, e.g. a step counter, for a fresh
        draw. Row k of the masks belongs to row k of the inputs.
        """
        return draw_masks(self.seeds, self.sizes[:-1], self.drop, count, *path, weight=self.weights[0])

    def forward(self, x: Float[Tensor, "R B D"], masks: Masks | None = None) -> Float[Tensor, "R B E"]:
        """Return the outputs under one weight draw per row; ``masks=None`` is the deterministic pass."""
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            mask = masks[layer] if masks is not None else None
            x = torch.baddbmm(bias, x if mask is None else x * mask, weight)
            if layer < last:
                x = self.activation(x)
        return x
