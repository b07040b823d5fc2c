"""Recomputing records: the first steps of a unit are done again and held against what its record says.

An array that grows with the steps of its process has one axis behind that of the replicas which is as long as there are
steps, or as ``PER_STEP`` of the process times that; its first entries are settled when as many steps are done. Arrays
without such an axis, final weights for instance, are compared when the whole unit has been recomputed.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from tqdm.auto import tqdm

from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.process import Process, rounding, threads
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.runs.unit import Unit, check_device, differing

__all__ = ["Comparison", "choose", "recompute"]

#: What must be the same for a result to come out bit for bit, beside device type and precision.
SAME = ("precision", "torch", "numpy", "scipy", "system", "processor", "processor_family", "rounding")
#: Elsewhere rounding sends runs on other ways. Then the mean of an array over replicas and steps must agree within this
#: share of its mean size, or within so many standard errors of the paired difference over replicas.
TOLERANCE, STANDARD_ERRORS = 0.2, 4.0
#: Steps at least: a second step tells whether the first has left the same state behind.
LEAST_STEPS = 2


@dataclass(frozen=True)
class Comparison:
    """What came of recomputing the first ``steps`` of ``total`` steps of a record's unit."""

    label: str  #: path of the record below the records folder.
    steps: int
    total: int
    seconds: float  #: CPU time that the steps took.
    arrays: Sequence[str]  #: names of the arrays that could be compared.
    unequal: Sequence[str]  #: what is not the same bit for bit, one phrase per array.
    elsewhere: Sequence[str]  #: what is not as it was when the record was made; if there is something, ``far`` decides.
    far: Sequence[str]  #: arrays beyond the stated tolerance, one phrase each.

    @property
    def problems(self) -> Sequence[str]:
        """Return what speaks against the record: nothing, if it is confirmed."""
        if not self.arrays:
            return [f"nothing can be compared after {self.steps} of {self.total} steps"]
        return self.far if self.elsewhere else self.unequal

    def __str__(self) -> str:
        """Return one line that says what was done and what came out."""
        done = f"{self.label}: {self.steps} of {self.total} steps again ({self.seconds:.0f} s)"
        why = f" (not made under the same conditions: {'; '.join(self.elsewhere)})" if self.elsewhere else ""
        if self.problems:
            return f"{done}: {'; '.join(self.problems)}{why}"
        if not self.unequal:
            return f"{done}: all {len(self.arrays)} arrays agree bit for bit"
        agree = f"mean within {TOLERANCE:.0%} or {STANDARD_ERRORS:g} standard errors"
        return f"{done}: all {len(self.arrays)} arrays agree, {agree}{why}"


def choose(found: Sequence[Record], count: int, seed: int) -> list[Record]:
    """Return ``count`` of the records, or all if they are fewer, drawn at random; equal seeds draw the same."""
    ordered = sorted(found, key=lambda record: record.label)
    drawn = np.random.default_rng(seed).choice(len(ordered), min(count, len(ordered)), replace=False)
    return [ordered[index] for index in sorted(drawn)]


def recompute(unit: Unit, record: Record, seconds: float = np.inf, progress: bool = True) -> Comparison:
    """Do the first steps of a unit again, as many as fit into ``seconds`` of CPU time but at least two, and compare.

    A record made on a GPU is recomputed on the CPU where there is no GPU, and one made in bfloat16 in float32 where the
    CPU has no instructions for it and would take ten times as long; what is compared says so.

    Raises:
        ValueError: if ``record`` is not that of the unit.
    """
    if other := differing(unit, record):
        raise ValueError(f"{record.label} is not the record of {unit.label}: other {', '.join(other)}")
    device = check_device("auto") if unit.device == "cuda" else "cpu"
    precision = (
        "float32" if unit.precision == "bfloat16" and device == "cpu" and not _has_bfloat16() else unit.precision
    )
    origin = {"rounding": 1, **record.header["provenance"], "precision": unit.precision}
    with threads(origin.get("threads", 1)):
        process = replace(unit, device=device, precision=precision).process()
        spent = _advance(process, seconds, unit.label, progress)
    here = {**records.provenance(device), "rounding": rounding(process), "precision": precision}
    with np.errstate(invalid="ignore"):  # counts of steps to come are integers that were NaN
        again = process.result()
    settled = {name: _settled(array, again.get(name), process) for name, array in record.arrays.items()}
    pairs = {name: pair for name, pair in settled.items() if pair is not None}
    return Comparison(
        label=record.label,
        steps=process.done,
        total=process.total,
        seconds=spent,
        arrays=list(pairs),
        unequal=[phrase for name, pair in pairs.items() if (phrase := _unequal(name, *pair))],
        elsewhere=[phrase for key in SAME if (phrase := _changed(key, origin.get(key), here[key]))] + _mixed(origin),
        far=[phrase for name, pair in pairs.items() if (phrase := _far(name, *pair))],
    )


def _has_bfloat16() -> bool:
    """Return whether the CPU may have instructions for bfloat16: without AVX-512 and AMX there are none."""
    return torch.backends.cpu.get_cpu_capability() not in ("DEFAULT", "AVX2")


def _advance(process: Process, seconds: float, label: str, progress: bool) -> float:
    begin = now = time.process_time()
    with tqdm(total=process.total, desc=label, disable=None if progress else True, leave=False) as bar:
        while process.done < process.total:
            bar.set_postfix_str(process.advance())
            bar.update()
            before, now = now, time.process_time()
            if process.done >= LEAST_STEPS and 2 * now - before - begin > seconds:  # another like the last one
                break
    return now - begin


def _settled(recorded: np.ndarray, again: np.ndarray | None, process: Process) -> tuple[np.ndarray, np.ndarray] | None:
    """Return what can be compared of an array, None if that is nothing yet."""
    entries = getattr(process, "PER_STEP", 1)
    axes = [axis for axis in range(1, recorded.ndim) if recorded.shape[axis] == process.total * entries]
    if process.done < process.total and not axes:
        return None
    if again is None:
        return recorded, np.empty(0)
    if process.done == process.total:
        return recorded, again
    part = (slice(None),) * axes[0] + (slice(process.done * entries),)
    return recorded[part], again[part]


def _unequal(name: str, recorded: np.ndarray, again: np.ndarray) -> str | None:
    if (recorded.dtype, recorded.shape) != (again.dtype, again.shape):
        return f"{name} was {recorded.dtype} {recorded.shape}, is {again.dtype} {again.shape}"
    differ = recorded != again
    if np.issubdtype(recorded.dtype, np.floating):
        differ &= ~(np.isnan(recorded) & np.isnan(again))
    if not differ.any():
        return None
    first = tuple(int(index) for index in np.argwhere(differ)[0])
    return f"{name} differs in {differ.mean():.2%}, first at {first}: {recorded[first]} recorded, {again[first]} now"


def _far(name: str, recorded: np.ndarray, again: np.ndarray) -> str | None:
    if recorded.shape != again.shape:
        return f"{name} was of shape {recorded.shape}, is {again.shape}"
    first, second = (array.astype(np.float64) for array in (recorded, again))
    if (np.isnan(first) != np.isnan(second)).any():
        return f"{name} is not a number in other places than before"
    if not np.isfinite(first).any():
        return None
    replicas = range(len(first)) if first.ndim > 1 else (...,)
    differences = np.array([np.nanmean(second[r] - first[r]) for r in replicas if np.isfinite(first[r]).any()])
    error = differences.std(ddof=1) / len(differences) ** 0.5 if len(differences) > 1 else 0.0
    allowed = max(TOLERANCE * np.nanmean(abs(first)), STANDARD_ERRORS * error)
    if abs(differences.mean()) <= allowed:
        return None
    return f"{name} is {differences.mean():+.3g} off on average, {allowed:.3g} is allowed"


def _mixed(origin: Mapping[str, Any]) -> list[str]:
    """Return that a record's sittings had different numbers of threads, if they had: sums round otherwise."""
    threads = {sitting["threads"] for sitting in origin.get("commits", ()) if sitting.get("threads")}
    return [f"threads {' and '.join(map(str, sorted(threads)))} there"] if len(threads) > 1 else []


def _changed(key: str, recorded: str | int | None, here: str | int) -> str | None:
    return None if recorded == here else f"{key} {recorded or 'not recorded'} there, {here} here"
