"""What computes a unit: a process that is advanced step by step, and whose state is its checkpoint."""

import contextlib
from collections.abc import Iterator
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch


@runtime_checkable
class Process(Protocol):
    """The work of one unit, in steps.

    A process may have ``timings()``, computing time by part for the provenance; a number ``ROUNDING``, raised when a
    change of the code alters the last digits of its results: older records are then recomputed within a tolerance; a
    number ``PER_STEP`` of entries that a step adds to its arrays, where it is not 1; and ``inherit(folder)``, which
    lets it stand where records in a folder end and returns these, its parents, as ``records.parent`` names them.
    Without that call it begins at the beginning, as it does to recompute a record.
    """

    total: int
    done: int

    def advance(self) -> str:
        """Do one step and return a short status for the progress bar."""

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue: tensors, numbers, strings and nested containers of them."""

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from ``state()`` of a process made with the same arguments."""

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the record, replicas first."""


def finished(process: Process) -> Process:
    """Return a process when it has done all its steps."""
    while process.done < process.total:
        process.advance()
    return process


def rounding(process: Process) -> int:
    """Return the number of the process's way of rounding, 1 at first."""
    return getattr(process, "ROUNDING", 1)


@contextlib.contextmanager
def threads(count: int) -> Iterator[None]:
    """Let PyTorch use so many threads for a while."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
