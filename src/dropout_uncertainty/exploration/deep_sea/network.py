"""The Q-network of the section where a state is one of a few cells, which it sees as a one-hot vector.

A product with a one-hot vector picks a row of the first weight matrix. So states are passed as their numbers, and the
first layer gathers rows; that saves more than half of the arithmetic of a learning step.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from dropout_uncertainty.exploration.q_network import QNetwork


class CellNetwork(QNetwork):
    """A Q-network whose ``forward`` and ``learn`` take cell numbers [R, rows] for one-hot vectors [R, rows, D].

    Args:
        sizes, seeds, path, dtype, device: as for ``QNetwork``; ``sizes[0]`` is the number of cells.
        scale: what stands in the one-hot vectors for 1.

    The first layer can have no dropout: a one-hot input is there or not.
    """

    def __init__(
        self, sizes: Sequence[int], seeds: Sequence[int], *path: str | int, scale: float = 1.0,
        dtype: torch.dtype = torch.float32, device: str = "cpu",
    ) -> None:  # fmt: skip
        super().__init__(sizes, seeds, *path, dtype=dtype, device=device)
        self.scale, self.width = scale, sizes[1]
        self.first_row = torch.arange(len(self.seeds), device=device)[:, None] * (
            self.parameters.shape[1] // self.width
        )

    def _count(self, used: int) -> int:
        """Round up to whole rows of the first weight matrix, so that all parameters are one table of such rows."""
        return used + -used % self.sizes[1]

    def _table_rows(self, cells: Tensor) -> Tensor:
        return (cells + self.first_row).reshape(-1)

    def _product(self, layer: int, x: Tensor, weight: Tensor, out: Tensor) -> Tensor:
        if layer:
            return super()._product(layer, x, weight, out)
        table = self.parameters.view(-1, self.width)
        torch.index_select(table, 0, self._table_rows(x), out=out.view(-1, self.width))
        return out.mul_(self.scale)

    def _weight_gradient(self, layer: int, below: Tensor, error: Tensor) -> None:
        if layer:
            super()._weight_gradient(layer, below, error)
            return
        self.weight_gradients[0].zero_()
        rows = self._table_rows(below)[:, None].expand(-1, self.width)
        self.gradients.view(-1, self.width).scatter_add_(0, rows, (self.scale * error).reshape(-1, self.width))
