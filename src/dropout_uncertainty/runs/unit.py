"""One unit of work, (config, seeds, device type, precision), and whether it can be done here."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from dropout_uncertainty import rng
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.process import Process
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.settings import config_hash

__all__ = ["RunError", "Unit", "check_device", "check_memory", "differing", "missing", "precision_dtype"]

PRECISIONS = {"float64": torch.float64, "float32": torch.float32, "bfloat16": torch.bfloat16}


class RunError(UserError):
    """A run cannot be done as asked."""


@dataclass(frozen=True)
class Unit:
    """One unit of work; ``start(config, seeds, device=..., precision=...)`` makes its process."""

    experiment: str
    name: str
    start: Callable[..., Process]
    config: Any
    seeds: tuple[int, ...]
    device: str = "cpu"
    precision: str = "float32"
    published: str | None = None  # the section's own precision; None: that of the unit
    memory: float = 0.0  # bytes at the height of the work, an estimate; 0: not known

    def __post_init__(self) -> None:
        try:  # plain, as the header of a record can hold them
            object.__setattr__(self, "seeds", rng.check_seeds(self.seeds))
        except ValueError as error:
            raise RunError(f"a unit needs seeds that differ: {error}") from None
        if min(self.seeds) < records.DEVELOPMENT <= max(self.seeds):  # its record would count as neither
            raise RunError(
                f"a unit needs published seeds, below {records.DEVELOPMENT}, or those of development, got both: "
                f"{min(self.seeds)} to {max(self.seeds)}"
            )

    @property
    def label(self) -> str:
        """Path of the unit's record below the records folder, without suffix; it shows all of its identity.

        Of the precision and the device type only what is not the section's own and not a CPU (`records.file_name`).
        """
        other = self.precision if self.published not in (None, self.precision) else None
        return f"{self.experiment}/{self.name}/{records.file_name(self.seeds, self.identity['device'], other)}"

    def process(self) -> Process:
        """Return the process at step 0, which makes the same bits each time, also on a GPU."""
        torch.backends.cudnn.deterministic = True
        return self.start(self.config, self.seeds, device=self.device, precision=self.precision)

    @property
    def identity(self) -> dict[str, Any]:
        """What the result is a function of."""
        return {
            "experiment": self.experiment,
            "name": self.name,
            "config_hash": config_hash(self.config),
            "seeds": list(self.seeds),
            "device": torch.device(self.device).type,
            "precision": self.precision,
        }


def missing(units: Iterable[Unit]) -> Iterator[Unit]:
    """Yield what is left of units without the seeds that have a record, whatever unit and device that was made in.

    Raises:
        RecordError: if one of the records cannot be trusted.
    """
    for unit in units:
        left = records.missing_seeds(unit.experiment, unit.name, unit.config, unit.seeds, precision=unit.precision)
        if left:
            yield replace(unit, seeds=tuple(left), memory=unit.memory * len(left) / len(unit.seeds))


def differing(unit: Unit, record: Record) -> list[str]:
    """Return in what the identity of a unit differs from that of a record, in words."""
    keys = [key for key, value in unit.identity.items() if record.header.get(key) != value]
    return ["config" if key == "config_hash" else key for key in keys]


def precision_dtype(name: str) -> torch.dtype:
    """Return the dtype of a precision; raises RunError if it is not float64, float32 or bfloat16."""
    if name not in PRECISIONS:
        raise RunError(f"unknown precision {name!r}, choose one of {', '.join(PRECISIONS)}")
    return PRECISIONS[name]


def check_device(name: str) -> str:
    """Return "cpu" or "cuda" for "auto", "cpu" or "cuda"; raises RunError where that device is not to be had."""
    if name not in ("auto", "cpu", "cuda"):
        raise RunError(f"unknown device {name!r}, choose auto, cpu or cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise RunError("device cuda was asked for, but PyTorch finds no CUDA GPU here: use --device cpu")
    return "cuda" if name != "cpu" and torch.cuda.is_available() else "cpu"


def check_memory(unit: Unit) -> None:
    """Raise RunError if a unit is estimated to take more memory than its device has left."""
    free = free_memory(unit.device)
    if free is not None and unit.memory > free:
        raise RunError(
            f"{unit.label} takes about {unit.memory / 1e9:.1f} GB of memory for {len(unit.seeds)} seeds, and "
            f"{free / 1e9:.1f} GB are free: ask for fewer seeds at a time, or use fewer workers"
        )


def free_memory(device: str = "cpu") -> float | None:
    """Return how many bytes a device type has left, None where the system does not say."""
    if torch.device(device).type == "cuda":
        return torch.cuda.mem_get_info()[0]
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        return 1024.0 * int(next(line for line in lines if line.startswith("MemAvailable")).split()[1])
    return None
