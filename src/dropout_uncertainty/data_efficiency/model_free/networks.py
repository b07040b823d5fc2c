"""Fully connected networks of R replicas side by side; each is trained by Adam and followed by a target network."""

import copy
from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor

from dropout_uncertainty import rng

__all__ = ["Network", "Trained"]

#: Of batch normalisation: added to variances, and the share of a minibatch in the running moments; both PyTorch's.
EPSILON, MOMENTUM = 1e-5, 0.1


def _even(generator: Generator, shape: tuple[int, ...], bound: float) -> Tensor:
    return bound * (2 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1)


class Network:
    """R networks of one shape, with ReLU between their layers.

    First weights and biases are drawn evenly within 1 / √(inputs of the layer), those of the last layer within 0.003
    (Lillicrap et al., 2015, experiment details).

    Args:
        sizes: numbers of inputs, hidden units and outputs.
        seeds: one per replica.
        path: names of the streams of the first weights.
        normalised: how many layers of units are batch-normalised, from the inputs on; hidden ones before their ReLU.
        joined: layer (1: the first hidden one) to whose units further inputs are joined, and the number of these.

    Attributes:
        parameters: weights [R, inputs, outputs] and biases [R, 1, outputs] layer by layer, then scale and shift
            [R, 1, units] of each normalised layer.
        moments: running mean and variance [R, 1, units] of each normalised layer.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        seeds: Sequence[int],
        *path: str | int,
        normalised: int = 0,
        joined: tuple[int, int] = (0, 0),
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.layers, self.normalised, self.joined = len(sizes) - 1, normalised, joined[0]
        self.parameters: list[Tensor] = []
        for layer in range(self.layers):
            inputs = sizes[layer] + (joined[1] if 0 < layer == joined[0] else 0)
            bound = inputs**-0.5 if layer < self.layers - 1 else 3e-3
            draw = partial(_even, shape=(inputs + 1, sizes[layer + 1]), bound=bound)
            drawn = rng.stacked(draw, seeds, "init", *path, layer).to(dtype)
            self.parameters += [drawn[:, :-1].contiguous(), drawn[:, -1:].contiguous()]
        zeros = [torch.zeros(len(seeds), 1, size, dtype=dtype) for size in sizes[:normalised]]
        self.parameters += [x for zero in zeros for x in (zero + 1, zero.clone())]
        self.moments = [x for zero in zeros for x in (zero.clone(), zero + 1)]

    def __call__(
        self, rows: Float[Tensor, "R B inputs"], further: Tensor | None = None, training: bool = False
    ) -> Float[Tensor, "R B outputs"]:
        """Return the outputs of each replica for rows of its own.

        Args:
            rows: the inputs.
            further: [R, B, ...] inputs that are joined later.
            training: units are normalised by the moments of these rows, and the running ones learn from them.
        """
        h = self._normalise(0, rows, training)
        for layer in range(self.layers):
            if further is not None and layer == self.joined:
                h = torch.cat((h, further), -1)
            weights, biases = self.parameters[2 * layer : 2 * layer + 2]
            h = torch.baddbmm(biases, h, weights)
            if layer + 1 < self.layers:
                h = self._normalise(layer + 1, h, training).relu()
        return h

    def _normalise(self, layer: int, h: Tensor, training: bool) -> Tensor:
        if layer >= self.normalised:
            return h
        first = 2 * (self.layers + layer)
        scale, shift = self.parameters[first : first + 2]
        mean, variance = running = self.moments[2 * layer : 2 * layer + 2]
        if not training:
            gain = scale * (variance + EPSILON).rsqrt()
            return torch.addcmul(shift - mean * gain, h, gain)
        normalised, *moments = _Normalise.apply(h, scale, shift)
        for old, new in zip(running, moments, strict=True):
            old.lerp_(new, MOMENTUM)
        return normalised

    def tensors(self) -> list[Tensor]:
        """Return parameters and moments, replicas first."""
        return [*self.parameters, *self.moments]

    def load(self, tensors: Sequence[Tensor]) -> None:
        """Take the place of a network with these `tensors`; of how many replicas is up to them."""
        count = len(self.parameters)
        self.parameters, self.moments = list(tensors[:count]), list(tensors[count:])


class _Normalise(torch.autograd.Function):
    """Rows [R, B, units] normalised by their own moments over B, with the moments for the running ones.

    By hand: a third of the passes over memory, which are most of what a learning step has beside products.
    """

    @staticmethod
    def forward(ctx: Any, h: Tensor, scale: Tensor, shift: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        count = h.shape[1]
        mean = h.mean(1, keepdim=True)
        centred = h - mean
        square = torch.linalg.vector_norm(centred, dim=1, keepdim=True).square()
        root = (square / count + EPSILON).rsqrt()
        ctx.save_for_backward(centred, root, scale)
        ctx.mark_non_differentiable(mean, square)
        return torch.addcmul(shift, centred, scale * root), mean, square.div_(count - 1)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, slope: Tensor, *_: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        centred, root, scale = ctx.saved_tensors
        in_shift = slope.sum(1, keepdim=True)
        in_scale = (slope * centred).sum(1, keepdim=True) * root
        rest = torch.addcmul(in_shift, centred, in_scale * root).div_(-slope.shape[1])
        return rest.add_(slope).mul_(scale * root), in_scale, in_shift


class Trained:
    """A network with its target network and Adam.

    Args:
        network: at its first weights.
        rate: step size of Adam.
        decay: of all parameters, added to their gradients.
        follow: τ, the share of the network that goes into its target after each step.
    """

    def __init__(self, network: Network, rate: float, decay: float, follow: float) -> None:
        self.network, self.target, self.follow, self.steps = network, copy.copy(network), follow, 0
        self.optimiser = partial(torch.optim.Adam, lr=rate, weight_decay=decay, fused=True)
        zeros = [torch.zeros_like(x) for x in network.parameters]
        self._set([*network.tensors(), *network.tensors(), *zeros, *zeros])

    def step(self, loss: Tensor) -> None:
        """Lower a loss, the sum over replicas of their own."""
        parameters = self.network.parameters
        for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
            parameter.grad = gradient
        self.adam.step()
        self.steps += 1
        with torch.no_grad():
            torch._foreach_lerp_(self.target.tensors(), self.network.tensors(), self.follow)

    def keep(self, which: Int[Tensor, " r"]) -> None:
        """Go on with some of the replicas."""
        self._set([x[which] for x in self._tensors()])

    def state(self) -> dict:
        """Return everything needed to continue."""
        return {"steps": self.steps, "tensors": [x.detach() for x in self._tensors()]}

    def restore(self, state: dict) -> None:
        """Continue from ``state()``."""
        self.steps = state["steps"]
        self._set(state["tensors"])

    def _tensors(self) -> list[Tensor]:
        moments = [[self.adam.state[p][name] for p in self.network.parameters] for name in ("exp_avg", "exp_avg_sq")]
        return [*self.network.tensors(), *self.target.tensors(), *moments[0], *moments[1]]

    def _set(self, tensors: Sequence[Tensor]) -> None:
        copies = [x.detach().clone() for x in tensors]
        size, count = len(self.network.tensors()), len(self.network.parameters)
        self.network.load(copies[:size])
        self.target.load(copies[size : 2 * size])
        first, second = copies[2 * size : 2 * size + count], copies[2 * size + count :]
        parameters = [x.requires_grad_() for x in self.network.parameters]
        self.adam = self.optimiser(parameters)
        for parameter, mean, square in zip(parameters, first, second, strict=True):
            self.adam.state[parameter] = {
                "step": torch.tensor(float(self.steps)),
                "exp_avg": mean,
                "exp_avg_sq": square,
            }
