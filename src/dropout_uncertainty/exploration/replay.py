"""Replay memory: R replicas in one preallocated tensor, read with a single gather per learning step."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor


class Plan(NamedTuple):
    """Which transitions the coming steps overwrite and read, for each step.

    ``slots`` [T, R] are written first, then ``rows`` [T, R x (2B + extra)] are read; both follow from uniform numbers
    because the memory grows by one transition per step, whatever the transitions are.
    """

    slots: NDArray
    rows: Tensor


class ReplayMemory:
    """The last transitions of R agents: when the memory is full, a new one overwrites a slot chosen at random.

    A row holds a state and, behind it, what belongs to it: for the state of a transition its one-hot action, for the
    successor the reward. Slot i of a replica has rows 2i and 2i + 1; the last row is the agent's current state, so that
    one gather fetches a minibatch and the state to act in.

    Args:
        replicas: how many agents, R.
        capacity: transitions kept per replica.
        state_size: D, the width of a state.
        actions: C, the number of actions.

    Raises:
        ValueError: if one of these is below 1.
    """

    def __init__(
        self,
        replicas: int,
        capacity: int,
        state_size: int,
        actions: int,
        *,
        dtype: torch.dtype = torch.float32,
        device: str = "cpu",
    ) -> None:
        if min(replicas, capacity, state_size, actions) < 1:
            raise ValueError(
                f"a replay memory holds at least one transition of one replica, got a capacity of {capacity}, "
                f"{replicas} replicas, states of {state_size} numbers and {actions} actions"
            )
        self.replicas, self.capacity, self.state_size = replicas, capacity, state_size
        self.per_replica = 2 * capacity + 1
        self.memory = torch.zeros(replicas * self.per_replica, state_size + actions, dtype=dtype, device=device)
        self.first_row = np.arange(replicas) * self.per_replica
        self.current_row = self.first_row + self.per_replica - 1
        self.stored = 0

    @property
    def size(self) -> int:
        """Transitions held per replica."""
        return min(self.stored, self.capacity)

    def plan(self, uniform: Float[np.ndarray, "T R draws"], writes: Bool[np.ndarray, " T"], extra: int) -> Plan:
        """Return which rows the next T steps use.

        ``uniform`` [T, R, 1 + B] gives the slot to overwrite and B transitions to read; ``writes`` [T] says for each
        step whether a transition is stored before reading; ``extra`` current states are read behind each minibatch.
        """
        stored = self.stored + np.cumsum(writes)
        random_slot = np.floor(uniform[:, :, 0] * self.capacity).astype(np.int64)
        slots = np.where(stored[:, None] <= self.capacity, np.maximum(stored[:, None] - 1, 0), random_slot)
        size = np.minimum(stored, self.capacity)[:, None, None]
        states = self.first_row[:, None] + 2 * np.floor(uniform[:, :, 1:] * size).astype(np.int64)
        current = np.broadcast_to(self.current_row[:, None], (*states.shape[:2], extra))
        rows = np.concatenate((states, states + 1, current), axis=-1).reshape(len(states), -1)
        return Plan(slots, torch.from_numpy(rows).to(self.memory.device))

    def observe(self, state: NDArray) -> None:
        """Make ``state`` [R, D + C] the current state."""
        self._write(self.current_row, state)

    def store(self, slots: NDArray, before: NDArray, after: NDArray) -> None:
        """Write one transition per replica: rows [R, D + C] of a state with its action, and of its successor.

        The successor becomes the current state.
        """
        rows = self.first_row + 2 * slots
        self._write(np.concatenate((rows, rows + 1, self.current_row)), np.concatenate((before, after, after)))
        self.stored += 1

    def _write(self, rows: NDArray, values: NDArray) -> None:
        device = self.memory.device
        self.memory.index_copy_(0, torch.from_numpy(rows).to(device), torch.from_numpy(values).to(device))

    def read(self, rows: Tensor, out: Tensor | None = None) -> Tensor:
        """Return memory rows [R, rows per replica, D + C]."""
        shape = (self.replicas, -1, self.memory.shape[1])
        return torch.index_select(self.memory, 0, rows, out=None if out is None else out.flatten(0, 1)).view(shape)

    def spread(self, count: int) -> Tensor:
        """Return the rows of ``count`` transitions spread evenly over the filled slots: all states, then successors.

        Raises:
            ValueError: if the memory is empty or ``count`` < 1.
        """
        if not self.size or count < 1:
            raise ValueError(f"expected at least one of the transitions held, got {count} of {self.size}")
        slots = np.linspace(0, self.size - 1, count).round().astype(np.int64)
        rows = self.first_row[:, None] + np.concatenate((2 * slots, 2 * slots + 1))
        return torch.from_numpy(rows.reshape(-1)).to(self.memory.device)

    def state(self) -> dict:
        """Return everything needed to continue; slots not yet filled are left out."""
        filled = self.memory.view(self.replicas, self.per_replica, -1)
        return {
            "transitions": filled[:, : 2 * self.size].clone(),
            "current": filled[:, -1].clone(),
            "stored": self.stored,
        }

    def restore(self, state: dict) -> None:
        """Continue from ``state()``."""
        self.stored = int(state["stored"])
        filled = self.memory.view(self.replicas, self.per_replica, -1)
        filled[:, : 2 * self.size] = state["transitions"]
        filled[:, -1] = state["current"]
