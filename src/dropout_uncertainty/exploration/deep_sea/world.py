"""Deep Sea, R replicas at once: the rules of bsuite 0.3.6 (Osband et al. 2020), held to it by a recorded trace.

A sea of size N has N rows and N columns. An agent starts in the upper left cell; each move takes it one row down and
one column to the left or to the right, but not over the edges. Which of the two actions means right is drawn for every
cell. A move to the right costs 0.01/N; a move to the right in the lower right cell brings 1. Only N moves to the right
lead there, so that of 2^N sequences of moves one is good, and the costs teach whoever does not know of it to go left.

Cells that can be reached lie on and below the diagonal. They are numbered row by row: ``cell_number``.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Generator, Tensor

from dropout_uncertainty import rng

__all__ = ["ACTIONS", "DeepSea", "cell_count", "cell_number", "random_mapping"]

ACTIONS = 2
TREASURE = 1.0
#: Cost of going right at every move of an episode.
MOVE_COST = 0.01


def cell_number(row: int, column: Int[np.ndarray, " R"]) -> Int[np.ndarray, " R"]:
    """Return the number of a cell on or below the diagonal: 0 for the start, then row by row."""
    return row * (row + 1) // 2 + column


def cell_count(size: int) -> int:
    """Return how many cells of a sea can be reached."""
    return size * (size + 1) // 2


def random_mapping(size: int, seeds: Sequence[int]) -> Int[np.ndarray, "R N N"]:
    """Return for every cell which action, 0 or 1, means right: a function of each replica's seed and the size."""

    def draw(generator: Generator) -> Tensor:
        return torch.randint(ACTIONS, (size, size), generator=generator)

    return rng.stacked(draw, seeds, "environment", "deep-sea", size).numpy()


class DeepSea:
    """R seas of one size, in the same row at any time.

    Args:
        mapping: [R, N, N] the action that means right, by row and column.

    Attributes:
        row: of all replicas; N where an episode is over.
        column: [R] of each.

    Raises:
        ValueError: unless ``mapping`` is [R, N, N] of 0 and 1.
    """

    def __init__(self, mapping: Int[np.ndarray, "R rows columns"]) -> None:
        mapping = np.asarray(mapping)
        if mapping.ndim != 3 or mapping.shape[1] != mapping.shape[2] or not np.isin(mapping, (0, 1)).all():
            raise ValueError(f"expected a mapping [R, N, N] of actions 0 and 1, got shape {mapping.shape}")
        self.mapping, self.size = mapping, mapping.shape[1]
        self.replicas = np.arange(len(mapping))
        self.reset()

    def reset(self) -> None:
        """Bring all replicas to the upper left cell."""
        self.row, self.column = 0, np.zeros(len(self.mapping), dtype=np.int64)

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.row == self.size

    @property
    def cell(self) -> Int[np.ndarray, " R"]:
        """Number of each replica's cell; after the last row there is none, and the numbers mean nothing."""
        return cell_number(self.row, self.column)

    def step(self, action: Int[np.ndarray, " R"]) -> tuple[Float[np.ndarray, " R"], Bool[np.ndarray, " R"]]:
        """Make one move in every replica; return the rewards and who has found the treasure.

        Raises:
            ValueError: if the episode has ended.
        """
        if self.over:
            raise ValueError(f"an episode has {self.size} moves and is over: call reset first")
        right = action == self.mapping[self.replicas, self.row, self.column]
        found = right & (self.column == self.size - 1)
        reward = TREASURE * found - MOVE_COST / self.size * right
        self.column = np.clip(self.column + np.where(right, 1, -1), 0, self.size - 1)
        self.row += 1
        return reward, found
