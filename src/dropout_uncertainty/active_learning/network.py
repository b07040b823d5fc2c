"""The Bayesian CNN of thesis section 5.2, for R replicas at once, with weight draws as values.

convolution - relu - convolution - relu - max pooling - dropout - dense - relu - dropout - dense - softmax. No dropout
stands before the convolutions, so everything up to the pooled features is the same in every weight draw and is computed
once per image (``features``); only the dense head is repeated (``head``).
"""

import itertools
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Generator, Tensor, nn

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import Masks, check_probability, draw_masks

__all__ = ["INITIALISATIONS", "BayesianCNN"]

#: Fan-out of a convolution with ``filters`` filters of ``area`` pixels. Keras 0.3.1, which the original programs used,
#: counts the filters only, so its first layer starts three times larger than Glorot's rule as stated today.
INITIALISATIONS = {"keras-0.3": lambda filters, area: filters, "glorot": lambda filters, area: filters * area}

FILTERS, HIDDEN, CLASSES, SIDE = 32, 128, 10, 28
#: Images of all replicas that a CPU takes through the convolutions at a time when nothing is learned: of more, the maps
#: would leave the cache.
CACHED = 200


class BayesianCNN(nn.Module):
    """R convolutional networks on [28, 28] images; parameters carry the replica axis first.

    Args:
        seeds: one seed per replica; the initial weights are a function of it and ``path``.
        path: further names of the stream, e.g. the acquisition round.
        kernel: side of the convolution kernels in pixels (4 in the thesis).
        blocks: 1, or 2 for the original scripts' first round, which has a second block of two convolutions with 64
            filters, pooling and dropout.
        drop: drop probabilities after pooling and after the dense layer, (0.25, 0.5) in the thesis.
        initialisation: "keras-0.3" or "glorot"; uniform weights, zero biases.
        compute: dtype of convolutions and matrix products; parameters and log-probabilities are at least float32.

    Raises:
        ValueError: if an argument is not one of those above.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        *path: str | int,
        kernel: int = 4,
        blocks: int = 1,
        drop: tuple[float, float] = (0.25, 0.5),
        initialisation: str = "keras-0.3",
        compute: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if initialisation not in INITIALISATIONS:
            raise ValueError(f"unknown initialisation {initialisation!r}, choose one of {', '.join(INITIALISATIONS)}")
        if blocks not in (1, 2) or kernel < 2:
            raise ValueError(f"expected 1 or 2 blocks and kernels of at least 2 pixels, got {blocks} and {kernel}")
        self.seeds, self.compute = tuple(seeds), compute
        #: Of parameters, masks and the output layer.
        self.dtype = torch.promote_types(compute, torch.float32)
        self.drop = (check_probability(drop[0]),) * blocks + (check_probability(drop[1]),)
        filters = [1, FILTERS, FILTERS, 2 * FILTERS, 2 * FILTERS][: 2 * blocks + 1]
        sides = [SIDE]
        for _ in range(blocks):
            sides.append((sides[-1] - 2 * (kernel - 1)) // 2)
        if sides[-1] < 1:
            raise ValueError(f"nothing is left of {SIDE} pixels behind kernels of {kernel} in {blocks} blocks")
        #: Width of the dropout sites: the pooled features of each block, and the dense layer.
        self.widths = [filters[2 * b + 2] * sides[b + 1] ** 2 for b in range(blocks)] + [HIDDEN]
        fan_out, area = INITIALISATIONS[initialisation], kernel**2
        self.kernels, self.kernel_biases = nn.ParameterList(), nn.ParameterList()
        for layer, (inside, outside) in enumerate(itertools.pairwise(filters)):
            shape = (outside, inside, kernel, kernel)
            self.kernels.append(self._uniform(shape, inside * area + fan_out(outside, area), *path, "kernel", layer))
            self.kernel_biases.append(nn.Parameter(torch.zeros(len(self.seeds), outside, dtype=self.dtype)))
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for layer, (inside, outside) in enumerate([(self.widths[-2], HIDDEN), (HIDDEN, CLASSES)]):
            self.weights.append(self._uniform((inside, outside), inside + outside, *path, "dense", layer))
            self.biases.append(nn.Parameter(torch.zeros(len(self.seeds), 1, outside, dtype=self.dtype)))

    def _uniform(self, shape: tuple[int, ...], fans: int, *path: str | int) -> nn.Parameter:
        """Return [R, *shape] weights, uniform within ±sqrt(6 / fans)."""
        limit = (6.0 / fans) ** 0.5

        def draw(generator: Generator) -> Tensor:
            return torch.empty(shape).uniform_(-limit, limit, generator=generator)

        return nn.Parameter(rng.stacked(draw, self.seeds, "init", *path).to(self.dtype))

    def _block(self, maps: Float[Tensor, "B RC H W"], block: int) -> Float[Tensor, "B RF h w"]:
        """Return two convolutions with relu, max-pooled; replicas are groups of channels."""
        replicas = len(self.seeds)
        for layer in (2 * block, 2 * block + 1):
            kernels = self.kernels[layer].flatten(0, 1).to(self.compute, memory_format=torch.channels_last)
            bias = self.kernel_biases[layer].flatten().to(self.compute)
            maps = _convolve(maps, kernels, bias, replicas)
            # relu and max pooling commute, and after the pooling there is a quarter to do.
            maps = F.max_pool2d(maps, 2).relu_() if layer % 2 else maps.relu_()
        return maps

    def _flat(self, maps: Float[Tensor, "B RF h w"]) -> Float[Tensor, "R B Fhw"]:
        """Return the maps as one row of features per replica and image."""
        batch, _, height, width = maps.shape
        rows = maps.permute(0, 2, 3, 1).reshape(batch, height * width, len(self.seeds), -1)
        return rows.permute(2, 0, 1, 3).flatten(2)

    def features(self, images: Float[Tensor, "R B 28 28"]) -> Float[Tensor, "R B F"]:
        """Return what lies before the first dropout: the pooled maps of the first block, flattened.

        Raises:
            ValueError: if the images are not grey ones of 28 × 28 pixels, B for each replica.
        """
        if images.ndim != 4 or (len(images), *images.shape[2:]) != (len(self.seeds), SIDE, SIDE):
            raise ValueError(
                f"expected grey images [{len(self.seeds)}, B, {SIDE}, {SIDE}], replicas first, got "
                f"{list(images.shape)}; `simulate` takes other images, with a network of your own"
            )
        maps = images.transpose(0, 1).to(self.compute).contiguous(memory_format=torch.channels_last)
        if maps.is_cuda or torch.is_grad_enabled():
            return self._flat(self._block(maps, 0))
        parts = maps.split(max(1, CACHED // len(self.seeds)))
        return torch.cat([self._flat(self._block(part, 0)) for part in parts], 1)

    def draw(self, count: int, *path: str | int) -> Masks:
        """Return ``count`` weight draws per replica: masks [R, count, width], one per dropout site.

        With one row, the draw is shared by all points of a call; with one row per point, each point has its own.
        """
        return draw_masks(self.seeds, self.widths, self.drop, count, *path, weight=self.weights[0])

    def head(self, features: Float[Tensor, "R B F"], masks: Masks | None = None) -> Float[Tensor, "R B 10"]:
        """Return log-probabilities from features under the given weight draws (None: weight scaling)."""
        if masks is None:
            masks = (None,) * len(self.drop)
        if len(self.drop) == 3:  # the second block of the original scripts' first round
            features = self._second_block(features, masks[0])
        hidden = self._dense(features, masks[-2], 0, self.compute).relu()
        # The output layer is not computed in bfloat16: rounded logits would make scores tie.
        return F.log_softmax(self._dense(hidden, masks[-1], 1, self.dtype), -1)

    def forward(self, images: Float[Tensor, "R B 28 28"], masks: Masks | None = None) -> Float[Tensor, "R B 10"]:
        """Return log-probabilities of the ten classes."""
        return self.head(self.features(images), masks)

    def _second_block(self, features: Float[Tensor, "R B F"], mask: Tensor | None) -> Float[Tensor, "R B G"]:
        replicas, batch, width = features.shape
        side = round((width / FILTERS) ** 0.5)
        kept = features if mask is None else (features * mask).to(self.compute)
        maps = kept.view(replicas, batch, side, side, FILTERS).permute(1, 0, 4, 2, 3).flatten(1, 2)
        return self._flat(self._block(maps.contiguous(memory_format=torch.channels_last), 1))

    def _dense(
        self, inputs: Float[Tensor, "R B I"], mask: Tensor | None, layer: int, dtype: torch.dtype
    ) -> Float[Tensor, "R B O"]:
        weight = self.weights[layer]
        if mask is not None and mask.shape[1] == 1:
            weight = weight * mask.transpose(1, 2)  # one draw for all rows: mask the weights, which are fewer
        elif mask is not None:
            inputs = inputs * mask
        return torch.baddbmm(self.biases[layer].to(dtype), inputs.to(dtype), weight.to(dtype))


def _convolve(
    maps: Float[Tensor, "B RC H W"], kernels: Float[Tensor, "RF C K K"], bias: Float[Tensor, " RF"], replicas: int
) -> Float[Tensor, "B RF h w"]:
    if not (maps.is_cuda and torch.is_grad_enabled()):
        return F.conv2d(maps, kernels, bias, groups=replicas)
    # On a GPU the backward pass of grouped convolutions keeps it busy for longer than one convolution per replica.
    parts = zip(maps.chunk(replicas, 1), kernels.chunk(replicas), bias.chunk(replicas), strict=True)
    last = torch.channels_last
    return torch.cat([F.conv2d(m.contiguous(memory_format=last), k, b) for m, k, b in parts], 1)
