"""Memories of R replicas: the transitions of all trials so far, the oldest overwritten when a memory is full."""

from collections.abc import Mapping

import torch
from jaxtyping import Float, Int
from torch import Tensor

__all__ = ["Memory"]


class Memory:
    """The last transitions of R replicas, each an array of ``width`` numbers.

    Attributes:
        rows: [R, capacity, width].
        seen: how many transitions were ever stored.
    """

    def __init__(self, replicas: int, capacity: int, width: int, dtype: torch.dtype = torch.float32) -> None:
        self.rows, self.seen = torch.zeros(replicas, capacity, width, dtype=dtype), 0

    def __len__(self) -> int:
        return min(self.seen, self.rows.shape[1])

    def store(self, transitions: Float[Tensor, "R width"]) -> None:
        """Add one transition of each replica."""
        self.rows[:, self.seen % self.rows.shape[1]] = transitions
        self.seen += 1

    def sample(self, uniform: Float[Tensor, "R B"]) -> Float[Tensor, "R B width"]:
        """Return stored transitions, drawn with replacement by uniform numbers in [0, 1)."""
        chosen = (uniform * len(self)).long()
        return self.rows.gather(1, chosen[..., None].expand(-1, -1, self.rows.shape[2]))

    def keep(self, which: Int[Tensor, " r"]) -> None:
        """Go on with some of the replicas."""
        self.rows = self.rows[which]

    def state(self) -> dict:
        """Return everything needed to continue."""
        return {"rows": self.rows[:, : len(self)].clone(), "seen": self.seen}

    def restore(self, state: Mapping) -> None:
        """Continue from ``state()``, perhaps of fewer replicas."""
        stored = state["rows"]
        self.rows = self.rows.new_zeros(len(stored), *self.rows.shape[1:])
        self.rows[:, : stored.shape[1]] = stored
        self.seen = state["seen"]
