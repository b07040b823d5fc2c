"""Resumable runs: carry units of work to their records, through kills and restarts, on any executor.

A unit is (config, seeds, device type, precision). Its process is advanced step by step; after steps a checkpoint is
kept in ``records/.partial``. A run that was killed continues from there and ends with the same arrays.
"""

import contextlib
import hashlib
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, as_completed
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from tqdm.auto import tqdm

from dropout_uncertainty.runs import checkpoints, records
from dropout_uncertainty.runs.process import Process, rounding
from dropout_uncertainty.runs.records import Record, RecordError
from dropout_uncertainty.runs.unit import RunError, Unit, check_memory, differing
from dropout_uncertainty.settings import config_dict

__all__ = ["OutOfTime", "run", "run_unit"]

#: Seconds between checkpoints; a kill loses at most this much work and the step under way.
CHECKPOINT_SECONDS = 20.0
#: What the provenance says of the code of each sitting.
CODE = ("commit", "dirty", "python", "torch", "numpy", "scipy", "threads")


class OutOfTime(RunError):
    """There was no time for another step; what was done is kept, and the same call goes on."""


def run_unit(
    unit: Unit, folder: Path | str | None = None, progress: bool = False, until: float | None = None
) -> Record:
    """Return the unit's record, computing what is missing of it.

    Args:
        unit: what is computed.
        folder: of the records.
        progress: whether a bar is shown.
        until: time of the clock, in seconds as ``time.time`` has it, after which no step begins.

    Raises:
        OutOfTime: if it is later than ``until`` before the unit is done.
        RunError: if another process is at work on this unit, or its record is there but of another config.
        RecordError: if the record cannot be read or written.
    """
    folder = Path(folder or records.root())
    path = _path(unit, folder)
    if path.exists():
        return _existing(path, unit)
    partial = folder / ".partial" / f"{unit.label.replace('/', '--')}-{_digest(unit)}.pt"
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(partial.with_suffix(".lock"), timeout=0):
            if path.exists():
                return _existing(path, unit)
            check_memory(unit)
            return _compute(unit, folder, partial, progress, until)
    except Timeout:
        raise RunError(f"another process is computing {unit.label}: wait for it, or stop it") from None
    except OSError as error:
        raise RecordError(
            f"cannot write below {folder} ({error.strerror or error}): is it read-only or full?"
        ) from error


def run(
    units: Iterable[Unit],
    *,
    executor: Executor | None = None,
    folder: Path | str | None = None,
    progress: bool = True,
    until: float | None = None,
) -> list[Record]:
    """Return the records of all units, in their order; units that have one are not computed again.

    Any ``concurrent.futures`` executor will do; without one the units run here, one after the other. Records made on
    machines that do not share this one's disk are written here. No step begins after ``until`` (see ``run_unit``).
    """
    units = list(units)
    if executor is None:
        return [run_unit(unit, folder, progress, until) for unit in units]
    here = Path(folder or records.root())
    missing = list({path: unit for unit in units if not (path := _path(unit, here)).exists()}.values())
    with tqdm(total=len(units), initial=len(units) - len(missing), unit="unit", disable=not progress) as bar:
        for unit, record in _completed(executor, missing, here if folder else None, until):
            path = _path(unit, here)
            if not path.exists():  # computed on a machine that does not share our disk
                records.write(path, record.arrays, record.header)
            bar.set_postfix_str(unit.label)
            bar.update()
    return [run_unit(unit, folder) for unit in units]


def _completed(
    executor: Executor, units: Sequence[Unit], folder: Path | None, until: float | None
) -> Iterator[tuple[Unit, Record]]:
    """Give units with their records as they are finished; if one fails, or this is left, the others are cancelled."""
    futures: dict[Future, Unit] = {}
    try:
        for unit in units:
            futures[executor.submit(run_unit, unit, folder, until=until)] = unit
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenExecutor:
        raise RunError(
            "a worker process died: is the memory enough, and does a script of yours begin its work behind "
            '`if __name__ == "__main__":`? The same command continues'
        ) from None
    finally:
        for future in futures:
            future.cancel()


def _path(unit: Unit, folder: Path) -> Path:
    return folder / f"{unit.label}.npz"


def _existing(path: Path, unit: Unit) -> Record:
    record = records.read(path)
    if other := differing(unit, record):
        raise RunError(
            f"{path} was made with another {' and '.join(other)} than is asked for: "
            "move it away, or give your config a new name"
        )
    return record


def _digest(unit: Unit) -> str:
    return hashlib.sha256(repr(sorted(unit.identity.items())).encode()).hexdigest()[:12]


def _compute(unit: Unit, folder: Path, partial: Path, progress: bool, until: float | None) -> Record:
    with _own_errors(unit):
        process = unit.process()
    clock: dict[str, Any] = {"wall_s": 0.0, "cpu_s": 0.0, "interruptions": 0, "rounding": rounding(process)}
    where = records.provenance(unit.device)
    commits, parents = [], []
    saved = _load(partial)
    if saved is not None:
        _restore(process, saved, partial)
        older = min(saved["clock"].get("rounding", 1), rounding(process))
        clock = {**saved["clock"], "interruptions": saved["clock"]["interruptions"] + 1, "rounding": older}
        commits, parents = saved.get("commits", [{"commit": None}]), saved.get("parents", [])
    elif hasattr(process, "inherit"):
        parents = process.inherit(folder)
        clock["rounding"] = min([clock["rounding"], *(one["rounding"] for one in parents)])
    commits = _joined(commits, {key: where[key] for key in CODE})
    with tqdm(total=process.total, initial=process.done, desc=unit.label, disable=not progress) as bar:
        last, saving, readable = time.monotonic(), 0.0, False
        while process.done < process.total:
            if _unwanted():
                raise CancelledError
            begin = time.monotonic()
            late = until is not None and time.time() > until
            # A large state is saved less often, so that saving takes a thirtieth of the time at most.
            if late or begin - last > max(CHECKPOINT_SECONDS, 30 * saving):
                content = {"state": process.state(), "clock": clock, "commits": commits, "parents": parents}
                checkpoints.save(partial, content)
                readable = readable or _readable(partial)
                last = time.monotonic()
                saving = last - begin
                if late:
                    raise OutOfTime(f"no time was left in {unit.label} after {process.done} of {process.total} steps")
            with _own_errors(unit), _timed(clock):
                status = process.advance()
            bar.set_postfix_str(status, refresh=False)
            bar.update()
    timings: dict[str, Any] = getattr(process, "timings", dict)()
    # ``commit`` is that of the last sitting, ``commits`` what each sitting ran under
    origin = {**where, **clock, **timings, "commits": commits, "dirty": _any_dirty(commits)}
    if parents:
        origin |= {f"whole_{key}": clock[key] + sum(one[key] for one in parents) for key in ("wall_s", "cpu_s")}
    header = {**unit.identity, "config": config_dict(unit.config), "parents": parents, "provenance": origin}
    record = records.write(_path(unit, folder), process.result(), header)
    partial.unlink(missing_ok=True)
    return record


@contextlib.contextmanager
def _own_errors(unit: Unit) -> Iterator[None]:
    """Tell what goes wrong with files of the unit's own from what goes wrong with its record."""
    try:
        yield
    except OSError as error:
        raise RunError(f"{unit.label} stopped: {error}") from error


def _readable(partial: Path) -> bool:
    """Return whether a checkpoint that has been written can be read; raises RunError if not."""
    try:
        checkpoints.load(partial)
    except ValueError:
        raise RunError(
            f"the checkpoint {partial} cannot be read again: state() may hold numbers, strings and tensors, and lists, "
            "tuples and dictionaries of these"
        ) from None
    return True


def _restore(process: Process, saved: dict[str, Any], partial: Path) -> None:
    """Put a process back where a checkpoint was made; raises RunError where another version made it."""
    try:
        process.restore(saved["state"])
    except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise RunError(
            f"the checkpoint {partial} is of a version that kept other things ({reason}): go on with that version, or "
            "delete it to start this unit again"
        ) from error


def _joined(commits: list[dict[str, Any]], last: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what the sittings of a run ran under, in order; sittings alike that follow each other count once."""
    return commits if commits[-1:] == [last] else [*commits, last]


def _any_dirty(commits: Iterable[dict[str, Any]]) -> bool | None:
    """Return whether a sitting ran with changes that were not committed; None if that is not known of all others."""
    flags = [commit.get("dirty") for commit in commits]
    return True if True in flags else None if None in flags else False


def _unwanted() -> bool:
    """Return whether this is a task of a Dask worker that was cancelled; its thread cannot be ended from outside."""
    if "distributed" not in sys.modules:
        return False
    from distributed.worker import get_worker, thread_state

    try:
        task = get_worker().state.tasks.get(thread_state.key)
    except (ValueError, AttributeError):  # not a worker, or a thread of its own
        return False
    return task is None or task.state == "cancelled"


@contextlib.contextmanager
def _timed(clock: dict[str, Any]) -> Iterator[None]:
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    clock["wall_s"] += time.perf_counter() - wall
    clock["cpu_s"] += time.process_time() - cpu


def _load(path: Path) -> dict[str, Any] | None:
    """Return the checkpoint at ``path``; None (start again) if there is none or, which is said, it is damaged."""
    if not path.exists():
        return None
    try:
        return checkpoints.load(path)
    except checkpoints.OtherVersion as error:
        raise RunError(f"{error}: go on with that version, or delete it to start this unit again") from None
    except ValueError:
        pass
    tqdm.write(f"the checkpoint {path.name} cannot be read: starting this unit again")
    return None
