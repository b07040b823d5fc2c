"""Dropout Q-networks, R replicas side by side, with the gradient of the demo's learning step written out.

The network is small (59-50-50-5), so the time goes into calling operations rather than into arithmetic: the two-layer
gradient by hand needs a third of the calls that automatic differentiation makes. Tests hold it to autograd, to
``bayes.MLP`` and to the original program.

A draw of the weights is a value here as everywhere: one mask per row, ``net.forward(x, masks)``; ``None`` is the pass
without dropout.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Generator, Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import Masks, check_probability
from dropout_uncertainty.errors import UserError

__all__ = ["MaskStream", "QNetwork", "keep_units", "product", "td_error"]

#: What a network sees: vectors, or for ``deep_sea.network`` the numbers of one-hot vectors.
Inputs = Float[Tensor, "R rows D"] | Int[Tensor, "R rows"]
HIDDEN_BIAS = 0.1  # convnetjs starts the biases of ReLU layers here, so that all units are alive


def product(a: Tensor, b: Tensor, out: Tensor) -> Tensor:
    """Write the batched matrix product of a [R, n, k] and b [R, k, m] to ``out`` and return it.

    On a CPU through NumPy: at these sizes its BLAS was measured 1.5 (AMD EPYC) times as fast as ``torch.bmm``.
    """
    if out.device.type == "cpu":
        np.matmul(a.numpy(), b.numpy(), out=out.numpy())
        return out
    return torch.bmm(a, b, out=out)


class QNetwork:
    """R replicas of a Q-network with ReLU hidden layers; all parameters of a replica lie in one row of ``parameters``.

    Args:
        sizes: widths from input to output, e.g. (59, 50, 50, 5).
        seeds: one per replica.
        path: further names of the random streams of the initial weights.

    Weights start from N(0, 1/fan-in), biases at 0.1 in hidden layers and at 0 in the last (convnetjs).

    Raises:
        ValueError: if there are fewer than two widths, or one is below 1.

    ``weights[l]`` [R, in, out] and ``biases[l]`` [R, 1, out] are views of ``parameters`` [R, P].
    """

    def __init__(
        self,
        sizes: Sequence[int],
        seeds: Sequence[int],
        *path: str | int,
        dtype: torch.dtype = torch.float32,
        device: str = "cpu",
    ) -> None:
        if len(sizes) < 2 or min(sizes) < 1:
            raise ValueError(f"expected the widths of inputs, hidden layers and outputs, each at least 1, got {sizes}")
        self.sizes, self.seeds = tuple(sizes), tuple(seeds)
        self.layers = len(sizes) - 1
        pairs = list(zip(self.sizes[:-1], self.sizes[1:], strict=True))
        count = self._count(sum((fan_in + 1) * fan_out for fan_in, fan_out in pairs))
        self.parameters = torch.zeros(len(self.seeds), count, dtype=dtype, device=device)
        self.gradients = torch.zeros_like(self.parameters)
        self.decayed = torch.zeros(count, dtype=dtype, device=device)  # 1 for weights, 0 for biases
        self.weights, self.biases = self._views(self.parameters)
        self.weight_gradients, self.bias_gradients = self._views(self.gradients)
        self._buffers: dict[tuple, Tensor] = {}
        for layer, (fan_in, fan_out) in enumerate(pairs):
            normal = rng.stacked(partial(_normal, (fan_in, fan_out)), self.seeds, "init", *path, layer)
            self.weights[layer].copy_(normal / fan_in**0.5)
            self.biases[layer].fill_(HIDDEN_BIAS if layer < self.layers - 1 else 0.0)
        for weight in self._views(self.decayed[None])[0]:
            weight.fill_(1.0)

    def _count(self, used: int) -> int:
        """Return how many numbers a row of ``parameters`` has, of which ``used`` are parameters."""
        return used

    def _views(self, flat: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Return the weights and biases of every layer as views of [R, P]."""
        weights, biases, start = [], [], 0
        for fan_in, fan_out in zip(self.sizes[:-1], self.sizes[1:], strict=True):
            end = start + fan_in * fan_out
            weights.append(flat[:, start:end].view(-1, fan_in, fan_out))
            biases.append(flat[:, end : end + fan_out].view(-1, 1, fan_out))
            start = end + fan_out
        return weights, biases

    def _buffer(self, role: str, layer: int, rows: int, width: int) -> Tensor:
        """Return working memory that is used again at the next call."""
        key = role, layer, rows
        if key not in self._buffers:
            self._buffers[key] = self.parameters.new_empty(len(self.seeds), rows, width)
        return self._buffers[key]

    def forward(self, x: Inputs, masks: Masks | None = None) -> list[Tensor]:
        """Return the inputs of every layer after its mask, and last the Q-values [R, B, C].

        The tensors are overwritten by the next call with as many rows.
        """
        rows, activations = x.shape[1], []
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            mask = masks[layer] if masks is not None else None
            if mask is not None:
                x = torch.mul(x, mask, out=self._buffer("input", 0, rows, self.sizes[0]) if layer == 0 else x)
            activations.append(x)
            x = self._product(layer, x, weight, self._buffer("layer", layer, rows, self.sizes[layer + 1])).add_(bias)
            if layer < self.layers - 1:
                x = x.relu_()
        return [*activations, x]

    def backward(self, activations: list[Tensor], masks: Masks | None, error: Float[Tensor, "R B C"]) -> None:
        """Set ``gradients`` to the sum over the first B rows of ``activations``, for dLoss/dQ = ``error`` there."""
        batch = error.shape[1]
        for layer in reversed(range(self.layers)):
            below = activations[layer][:, :batch]
            self._weight_gradient(layer, below, error)
            torch.sum(error, 1, keepdim=True, out=self.bias_gradients[layer])
            if layer:
                error = product(error, self.weights[layer].mT, self._buffer("error", layer, batch, self.sizes[layer]))
                # an activation is positive where its unit was neither clipped by the ReLU nor dropped
                error = torch.ops.aten.threshold_backward(error, below, 0)
                mask = masks[layer] if masks is not None else None
                if mask is not None:
                    error.mul_(mask[:, :batch])

    def _product(self, layer: int, x: Tensor, weight: Tensor, out: Tensor) -> Tensor:
        """Write what a layer makes of its inputs, but for the bias, to ``out`` and return it."""
        return product(x, weight, out)

    def _weight_gradient(self, layer: int, below: Tensor, error: Tensor) -> None:
        """Set the gradient in a layer's weights from its inputs and the error of its outputs."""
        product(below.mT, error, self.weight_gradients[layer])

    def descend(self, rate: float, decay: float, batch: int) -> None:
        """Take one step of gradient descent on the mean over ``batch`` rows.

        ``decay`` times the weights (not the biases) joins the sum before the division, as in convnetjs.
        """
        self.gradients.addcmul_(self.parameters, self.decayed, value=decay)
        self.parameters.sub_(self.gradients, alpha=rate / batch)

    def check_finite(self) -> None:
        """Raise UserError where learning has diverged: an agent would take its first action for ever."""
        if lost := int((~self.parameters.isfinite().all(1)).sum()):
            raise UserError(
                f"{lost} of {len(self.parameters)} networks are no longer finite: learning has diverged, take a "
                "smaller learning_rate"
            )

    def learn(
        self,
        x: Inputs,
        taken: Float[Tensor, "R B C"],
        reward: Float[Tensor, "R B"],
        masks: Masks | None,
        *,
        discount: float | Float[Tensor, "R B"],
        rate: float,
        decay: float,
        prior: Float[Tensor, "R rows C"] | None = None,
    ) -> tuple[Float[Tensor, "R rest C"], Float[Tensor, "R B"]]:
        """Take one Q-learning step; return the Q-values of the further rows and the TD errors before the step.

        Rows of ``x``: B states, their B successors, then any states whose values are wanted from the same weights
        (those before the step). ``taken`` is the one-hot action taken in each state. Each row has a weight draw of its
        own, thus target and prediction differ in theirs; the target takes no part in the gradient. ``prior`` is added
        to all Q-values.
        """
        batch = taken.shape[1]
        activations = self.forward(x, masks)
        q = activations[-1] if prior is None else activations[-1].add_(prior)
        error = td_error(q, taken, reward, discount)
        self.backward(activations, masks, taken * error[..., None])
        self.descend(rate, decay, batch)
        return q[:, 2 * batch :], error


def _normal(shape: tuple[int, int], generator: Generator) -> Tensor:
    return torch.randn(shape, generator=generator, dtype=torch.float64)


def td_error(
    q: Float[Tensor, "R rows C"],
    taken: Float[Tensor, "R B C"],
    reward: Float[Tensor, "R B"],
    discount: float | Float[Tensor, "R B"],
) -> Float[Tensor, "R B"]:
    """Return Q(s, a) - (r + γ max Q(s', ·)) from the values of B states and, behind them, of their B successors.

    Where episodes end ``discount`` is given for each transition: 0 for the last of an episode.
    """
    batch = taken.shape[1]
    best = q[:, batch : 2 * batch].amax(-1)
    if isinstance(discount, Tensor):
        target = torch.addcmul(reward, discount, best)
    else:
        target = torch.add(reward, best, alpha=discount)
    return (q[:, :batch] * taken).sum(-1) - target


def keep_units(p: float, generator: Generator, out: Bool[np.ndarray, "..."]) -> None:
    """Write to ``out`` (contiguous) which units stay when each is dropped with probability ``p``.

    One random byte decides, and a second number where the byte is not enough, so that the probability is exact. That
    costs a tenth of a Bernoulli variate; the masks of one learning step need sixty thousand.

    Raises:
        ValueError: if ``out`` is not contiguous, or ``p`` is no probability below 1.
    """
    if not out.flags.c_contiguous:
        raise ValueError("expected a contiguous array to write to")
    words = torch.empty(-(-out.size // 8), dtype=torch.int64)
    words.random_(torch.iinfo(torch.int64).min, None, generator=generator)
    level, rest = divmod(256 * check_probability(p), 1)
    noise = words.numpy().view(np.uint8)[: out.size]
    keep = out.reshape(-1)
    np.greater(noise, level, out=keep)
    ties = np.flatnonzero(noise == level)
    keep[ties] = torch.rand(len(ties), dtype=torch.float64, generator=generator).numpy() >= rest


class MaskStream:
    """Weight draws for a known number of coming steps: at each step ``rows`` of them per replica, then one row of ones.

    Args:
        seeds: one per replica.
        widths: the inputs of every weight layer.
        drop: the drop probability before every weight layer; at p = 0 the mask is None.
        steps: how many steps the stream is good for.
        rows: draws per step.
        path: further names of the random streams.

    Raises:
        ValueError: if a probability is outside [0, 1).
    """

    def __init__(
        self,
        seeds: Sequence[int],
        widths: Sequence[int],
        drop: Sequence[float],
        steps: int,
        rows: int,
        *path: str | int,
        dtype: torch.dtype = torch.float32,
        device: str = "cpu",
    ) -> None:
        self.device = device
        self.masks: list[Tensor | None] = [None] * len(drop)
        self.kept: dict[int, np.ndarray] = {}
        self.scale: dict[int, np.floating] = {}
        for layer, (width, p) in enumerate(zip(widths, drop, strict=True)):
            if check_probability(p) == 0.0:
                continue
            mask = torch.ones(len(seeds), rows + 1, width, dtype=dtype)
            kept = np.empty((len(seeds), steps, rows, width), dtype=bool)
            for replica, seed in enumerate(seeds):
                keep_units(p, rng.generator(seed, "masks", *path, layer), out=kept[replica])
            self.masks[layer], self.kept[layer] = mask, kept.view(np.uint8)
            self.scale[layer] = mask.numpy().dtype.type(1.0 / (1.0 - p))

    def at(self, step: int) -> Masks:
        """Return the masks [R, rows + 1, width] of one step; the next call overwrites them."""
        for layer, kept in self.kept.items():
            np.multiply(kept[:, step], self.scale[layer], out=self._numpy(layer)[:, :-1])
        return tuple(None if mask is None else mask.to(self.device) for mask in self.masks)

    def _numpy(self, layer: int) -> np.ndarray:
        mask = self.masks[layer]
        assert mask is not None
        return mask.numpy()
