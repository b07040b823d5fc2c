"""Memories of R replicas: the transitions of all trials so far, the oldest overwritten when a memory is full."""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor


class Transitions(NamedTuple):
    """B steps of each of R replicas."""

    inputs: Float[Tensor, "R B inputs"]  #: What the networks were given before the step.
    following: Float[Tensor, "R B inputs"]  #: What they are given after it.
    action: Float[Tensor, "R B 1"]  #: In [-1, 1], as a share of the force limit.
    reward: Float[Tensor, "R B 1"]  #: One minus the cost of the state that was reached, in [0, 1].
    discount: Float[Tensor, "R B 1"]  #: Of what comes after the step; 0 where nothing does.


class Memory:
    """The last transitions of R replicas, in the order of their steps.

    That of section 5.3 is another: once full, it forgets at random, as the original program there does.

    Args:
        replicas: how many agents, R.
        capacity: transitions of each.
        inputs: how many numbers the networks are given.
        dtype: of what is stored.

    Attributes:
        rows: [R, capacity, 2 inputs + 3], the parts of `Transitions` side by side.
        seen: how many transitions of each replica were ever stored.
    """

    def __init__(self, replicas: int, capacity: int, inputs: int, dtype: torch.dtype = torch.float32) -> None:
        self.widths = inputs, inputs, 1, 1, 1
        self.rows, self.seen = torch.zeros(replicas, capacity, sum(self.widths), dtype=dtype), 0

    def __len__(self) -> int:
        return min(self.seen, self.rows.shape[1])

    def store(self, one: Transitions) -> None:
        """Add one transition of each replica, B = 1."""
        self.rows[:, self.seen % self.rows.shape[1]] = torch.cat(one, -1)[:, 0]
        self.seen += 1

    def sample(self, uniform: Float[Tensor, "R B"]) -> Transitions:
        """Return stored transitions, drawn with replacement by uniform numbers in [0, 1)."""
        chosen = (uniform * len(self)).long()
        rows = self.rows.gather(1, chosen[..., None].expand(-1, -1, self.rows.shape[2]))
        return Transitions(*rows.split(self.widths, -1))

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
