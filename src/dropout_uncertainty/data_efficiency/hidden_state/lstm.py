"""A recurrent network whose weight draws are values: an LSTM with masks on its inputs, its state and its output.

A mask without a time axis is held over the sequence, which makes the sequence a function of one draw of the weights
(Gal and Ghahramani, A theoretically grounded application of dropout in recurrent neural networks, 2016); a mask with a
time axis is fresh at every step. The masks of one site are shared by the four gates. Replicas R first.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Generator, Tensor, nn

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import Masks, check_probability, draw_masks

__all__ = ["LSTM", "Memory"]

#: Output and cell of the layer after a step, both [R, B, H].
Memory = tuple[Tensor, Tensor]


class LSTM(nn.Module):
    """R independent networks of one LSTM layer and a linear output, evaluated together.

    Parameters carry the replica axis first. The gates stand side by side in the order of `torch.nn.LSTM`: input,
    forget, cell, output. Replica r is initialised from the streams of ``seeds[r]`` alone.

    Args:
        sizes: numbers of inputs D, units H and outputs E.
        drop: drop probabilities of the inputs, of the recurrent state, and of the units before the output.
        seeds: one per replica.
        dtype: of the parameters.

    Weights start from a normal distribution of variance 2 / (in + out) (Glorot and Bengio, 2010), biases at 0 but that
    of the forget gate, at 1, so that the cell remembers at first (Jozefowicz, Zaremba and Sutskever, 2015).

    Raises:
        ValueError: if there are not three sizes and three drop probabilities in [0, 1), or a seed is negative or twice.
    """

    def __init__(
        self, sizes: Sequence[int], drop: Sequence[float], seeds: Sequence[int], *, dtype: torch.dtype = torch.float32
    ) -> None:
        super().__init__()
        if len(sizes) != 3 or len(drop) != 3:
            raise ValueError(
                f"expected sizes and drop probabilities of inputs, state and output, got {sizes} and {drop}"
            )
        self.sizes, self.seeds = tuple(sizes), rng.check_seeds(seeds)
        self.drop = tuple(check_probability(p) for p in drop)
        inputs, width, outputs = sizes

        def glorot(name: str, fan_in: int, fan_out: int, blocks: int = 1) -> nn.Parameter:
            def draw(g: Generator) -> Tensor:
                return torch.randn(fan_in, blocks * fan_out, generator=g, dtype=dtype)

            return nn.Parameter((2.0 / (fan_in + fan_out)) ** 0.5 * rng.stacked(draw, self.seeds, "init", name))

        self.from_inputs = glorot("inputs", inputs, width, 4)
        self.from_state = glorot("state", width, width, 4)
        self.to_output = glorot("output", width, outputs)
        remember = torch.arange(4 * width).div(width, rounding_mode="floor") == 1
        self.bias = nn.Parameter(remember.to(dtype).expand(len(self.seeds), 1, -1).clone())
        self.output_bias = nn.Parameter(torch.zeros(len(self.seeds), 1, outputs, dtype=dtype))

    @property
    def weights(self) -> tuple[Tensor, Tensor, Tensor]:
        """The weight matrices, in the order of the drop probabilities."""
        return self.from_inputs, self.from_state, self.to_output

    def draw(self, count: int, *path: str | int, steps: int | None = None) -> Masks:
        """Return ``count`` weight draws per replica: masks [R, count, width], to be held over the sequence.

        With ``steps`` every step has a draw of its own: masks [R, count, steps, width]. The draw is a function of each
        replica's seed and ``path``.
        """
        widths = self.sizes[0], self.sizes[1], self.sizes[1]
        if steps is None:
            return draw_masks(self.seeds, widths, self.drop, count, *path, weight=self.bias)
        masks = draw_masks(self.seeds, widths, self.drop, count * steps, *path, weight=self.bias)
        return tuple(mask if mask is None else mask.unflatten(1, (count, steps)) for mask in masks)

    def blank(self, count: int) -> Memory:
        """Return the memory before the first step, zeros."""
        zeros = self.bias.new_zeros(len(self.seeds), count, self.sizes[1])
        return zeros, zeros

    def step(
        self, x: Float[Tensor, "R B D"], memory: Memory, masks: Masks | None, t: int = 0
    ) -> tuple[Float[Tensor, "R B E"], Memory]:
        """Return output and memory after one step, the ``t``-th where the masks have a time axis."""
        seen, kept, out = (at(mask, t) for mask in masks or (None,) * 3)
        memory = self._move(torch.baddbmm(self.bias, dropped(x, seen), self.from_inputs), memory, kept)
        return torch.baddbmm(self.output_bias, dropped(memory[0], out), self.to_output), memory

    def forward(
        self, x: Float[Tensor, "R B T D"], masks: Masks | None = None, memory: Memory | None = None
    ) -> tuple[Float[Tensor, "R B T E"], Memory]:
        """Return the outputs of a sequence under one weight draw per row, and the memory at its end.

        Row k of the masks belongs to row k of the inputs; ``masks=None`` is the deterministic pass (weight scaling).
        ``memory`` is what an earlier part of the sequence has left; None: nothing.
        """
        seen, kept, out = masks or (None,) * 3
        inputs = dropped(x, timed(seen)).flatten(1, 2)
        gates = torch.baddbmm(self.bias, inputs, self.from_inputs).unflatten(1, x.shape[1:3])
        memory, states = memory or self.blank(x.shape[1]), []
        for t, gate in enumerate(gates.unbind(2)):
            memory = self._move(gate, memory, at(kept, t))
            states.append(memory[0])
        left = dropped(torch.stack(states, 2), timed(out)).flatten(1, 2)
        return torch.baddbmm(self.output_bias, left, self.to_output).unflatten(1, x.shape[1:3]), memory

    def _move(self, gate: Float[Tensor, "R B G"], memory: Memory, mask: Tensor | None) -> Memory:
        """Return the memory after a step whose inputs have added ``gate``."""
        state, cell = memory
        enter, forget, new, leave = torch.baddbmm(gate, dropped(state, mask), self.from_state).chunk(4, -1)
        cell = forget.sigmoid() * cell + enter.sigmoid() * new.tanh()
        return leave.sigmoid() * cell.tanh(), cell


def at(mask: Tensor | None, t: int) -> Tensor | None:
    """Return the mask of a step [R, B, width]: one that is held is that of every step."""
    return mask[:, :, t] if mask is not None and mask.ndim == 4 else mask


def timed(mask: Tensor | None) -> Tensor | None:
    """Return a mask with a time axis, of length 1 if it is held."""
    return mask if mask is None or mask.ndim == 4 else mask[:, :, None]


def dropped(x: Tensor, mask: Tensor | None) -> Tensor:
    """Return what a mask leaves."""
    return x if mask is None else x * mask
