"""Resumable runs: carry units of work to their records, through kills and restarts, on any executor.

A unit is (config, seeds, device type, precision). Its process is advanced step by step; after steps a checkpoint is
kept in ``records/.partial``. A run that was killed continues from there and ends with the same arrays.
"""

import contextlib
import hashlib
import io
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from filelock import FileLock, Timeout
from tqdm.auto import tqdm

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record, RecordError

__all__ = [
    "Process", "RunError", "Unit", "check_device", "cluster", "differing", "precision_dtype", "processes",
    "rounding", "run", "run_unit",
]  # fmt: skip

#: Seconds between checkpoints; a kill loses at most this much work and the step under way.
CHECKPOINT_SECONDS = 20.0
#: Seconds to wait for a scheduler's answer.
CONNECT_SECONDS = 5.0
#: What the provenance says of the code of each sitting.
CODE = ("commit", "dirty", "python", "torch", "numpy", "scipy")
QUIET = "ignore::UserWarning:multiprocessing.resource_tracker"
PRECISIONS = {"float64": torch.float64, "float32": torch.float32, "bfloat16": torch.bfloat16}


class RunError(UserError):
    """A run cannot be done as asked."""


@runtime_checkable
class Process(Protocol):
    """The work of one unit, in steps.

    A process may have ``timings()``, computing time by part for the provenance; a number ``ROUNDING``, raised when a
    change of the code alters the last digits of its results: older records are then recomputed within a tolerance; and
    ``inherit(folder)``, which lets it stand where records in a folder end and returns these, its parents, as
    ``records.parent`` names them. Without that call it begins at the beginning, as it does to recompute a record.
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
        if not self.seeds or len(set(self.seeds)) != len(self.seeds) or min(self.seeds) < 0:
            raise RunError(f"a unit needs seeds that differ, none below 0: got {list(self.seeds)}")

    @property
    def label(self) -> str:
        """Path of the unit's record below the records folder, without suffix; it shows all of its identity.

        Of the precision and the device type only what is not the section's own and not a CPU (`records.file_name`).
        """
        other = self.precision if self.published not in (None, self.precision) else None
        return f"{self.experiment}/{self.name}/{records.file_name(self.seeds, self.identity['device'], other)}"

    @property
    def identity(self) -> dict[str, Any]:
        """What the result is a function of."""
        return {
            "experiment": self.experiment,
            "name": self.name,
            "config_hash": records.config_hash(self.config),
            "seeds": list(self.seeds),
            "device": torch.device(self.device).type,
            "precision": self.precision,
        }


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


def run_unit(unit: Unit, folder: Path | None = None, progress: bool = False) -> Record:
    """Return the unit's record, computing what is missing of it.

    Raises:
        RunError: if another process is at work on this unit, or its record is there but of another config.
        RecordError: if the record cannot be read or written.
    """
    folder = folder or records.root()
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
            return _compute(unit, folder, partial, progress)
    except Timeout:
        raise RunError(f"another process is computing {unit.label}: wait for it, or stop it") from None
    except OSError as error:
        raise RecordError(
            f"cannot write below {folder} ({error.strerror or error}): is it read-only or full?"
        ) from error


def run(
    units: Iterable[Unit], *, executor: Executor | None = None, folder: Path | None = None, progress: bool = True
) -> list[Record]:
    """Return the records of all units, in their order; units that have one are not computed again.

    Any ``concurrent.futures`` executor will do; without one the units run here, one after the other. Records made on
    machines that do not share this one's disk are written here.
    """
    units = list(units)
    if executor is None:
        return [run_unit(unit, folder, progress) for unit in units]
    here = folder or records.root()
    missing = [unit for unit in units if not _path(unit, here).exists()]
    with tqdm(total=len(units), initial=len(units) - len(missing), unit="unit", disable=not progress) as bar:
        for unit, record in _completed(executor, missing, folder):
            path = _path(unit, here)
            if not path.exists():  # computed on a machine that does not share our disk
                records.write(path, record.arrays, record.header)
            bar.set_postfix_str(unit.label)
            bar.update()
    return [run_unit(unit, folder) for unit in units]


def _completed(executor: Executor, units: Sequence[Unit], folder: Path | None) -> Iterator[tuple[Unit, Record]]:
    """Give units with their records as they are finished; if one fails, or this is left, the others are cancelled."""
    futures: dict[Future, Unit] = {}
    try:
        for unit in units:
            futures[executor.submit(run_unit, unit, folder)] = unit
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenExecutor:
        raise RunError("a worker process died; is the memory enough? The same command continues") from None
    finally:
        for future in futures:
            future.cancel()


def processes(workers: int | None = None) -> ProcessPoolExecutor:
    """Return an executor of single-threaded processes, by default one per core; use it as a context.

    An exception that leaves the context ends them at once, and so does the end of this process, whatever its cause.
    """
    # What a killed process leaves behind is put away by the tracker of the standard library, which need not say so.
    if QUIET not in sys.warnoptions:
        sys.warnoptions.append(QUIET)
    # Spawned, because a fork of a process that has started threads can hang.
    return _Processes(workers or os.cpu_count(), multiprocessing.get_context("spawn"), initializer=_become_worker)


class _Processes(ProcessPoolExecutor):
    def submit(self, *args: Any, **options: Any) -> Future:
        # Ctrl-C reaches every process of a terminal but is this one's to answer; those started here inherit the mask.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(*args, **options)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            for worker in list((self._processes or {}).values()):  # Python 3.14 has kill_workers() for this
                worker.kill()
        self.shutdown(cancel_futures=kind is not None)


def _become_worker() -> None:
    """Make a process that has just been started compute on one thread, and end when its parent does."""
    torch.set_num_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Give an executor that sends units to the workers of a Dask cluster with a scheduler at ``address``.

    A unit whose worker is lost goes to another one, which continues from the checkpoint if it shares the disk.

    Raises:
        RunError: if dask.distributed is not installed, no scheduler answers, it goes away, or a unit loses its workers
            again and again.
    """
    try:
        import distributed
    except ImportError:
        raise RunError("a Dask cluster needs the package distributed: `pip install 'distributed>=2024.8'`") from None
    try:
        distributed.comm.get_address_host_port(address)  # a client that cannot even begin complains when it is deleted
        client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise RunError(f"no Dask scheduler answers at {address}: is it running, and is the address right?") from error
    with client:
        if not client.nthreads():
            tqdm.write(f"the scheduler at {address} has no workers yet: units wait for one")
        try:
            # Not pure: a unit that failed is tried again when it is asked for again.
            yield client.get_executor(pure=False)
        except distributed.KilledWorker as error:
            raise RunError(f"workers died again and again of one unit; is their memory enough? {error}") from error
        except CancelledError:
            raise RunError(f"the scheduler at {address} is gone; the same command continues with another") from None


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


def differing(unit: Unit, record: Record) -> list[str]:
    """Return in what the identity of a unit differs from that of a record, in words."""
    keys = [key for key, value in unit.identity.items() if record.header.get(key) != value]
    return ["config" if key == "config_hash" else key for key in keys]


def _digest(unit: Unit) -> str:
    return hashlib.sha256(repr(sorted(unit.identity.items())).encode()).hexdigest()[:12]


def _compute(unit: Unit, folder: Path, partial: Path, progress: bool) -> Record:
    torch.backends.cudnn.deterministic = True  # the same bits each time, also on a GPU
    process = unit.start(unit.config, unit.seeds, device=unit.device, precision=unit.precision)
    clock: dict[str, Any] = {"wall_s": 0.0, "cpu_s": 0.0, "interruptions": 0, "rounding": rounding(process)}
    where = records.provenance(unit.device)
    commits, parents = [], []
    saved = _load(partial)
    if saved is not None:
        process.restore(saved["state"])
        older = min(saved["clock"].get("rounding", 1), rounding(process))
        clock = {**saved["clock"], "interruptions": saved["clock"]["interruptions"] + 1, "rounding": older}
        commits, parents = saved.get("commits", [{"commit": None}]), saved.get("parents", [])
    elif hasattr(process, "inherit"):
        parents = process.inherit(folder)
        clock["rounding"] = min([clock["rounding"], *(one["rounding"] for one in parents)])
    commits = _joined(commits, {key: where[key] for key in CODE})
    with tqdm(total=process.total, initial=process.done, desc=unit.label, disable=not progress) as bar:
        last, saving = time.monotonic(), 0.0
        while process.done < process.total:
            if _unwanted():
                raise CancelledError
            with _timed(clock):
                status = process.advance()
            bar.set_postfix_str(status, refresh=False)
            bar.update()
            begin = time.monotonic()
            # A large state is saved less often, so that saving takes a thirtieth of the time at most.
            if begin - last > max(CHECKPOINT_SECONDS, 30 * saving) and process.done < process.total:
                _save(partial, {"state": process.state(), "clock": clock, "commits": commits, "parents": parents})
                last = time.monotonic()
                saving = last - begin
    timings: dict[str, Any] = getattr(process, "timings", dict)()
    # ``commit`` is that of the last sitting, ``commits`` what each sitting ran under
    origin = {**where, **clock, **timings, "commits": commits, "dirty": _any_dirty(commits)}
    if parents:
        origin |= {f"whole_{key}": clock[key] + sum(one[key] for one in parents) for key in ("wall_s", "cpu_s")}
    header = {**unit.identity, "config": records.config_dict(unit.config), "parents": parents, "provenance": origin}
    record = records.write(_path(unit, folder), process.result(), header)
    partial.unlink(missing_ok=True)
    return record


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


def rounding(process: Process) -> int:
    """Return the number of the process's way of rounding, 1 at first."""
    return getattr(process, "ROUNDING", 1)


@contextlib.contextmanager
def _timed(clock: dict[str, Any]) -> Iterator[None]:
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    clock["wall_s"] += time.perf_counter() - wall
    clock["cpu_s"] += time.process_time() - cpu


def _save(path: Path, content: dict[str, Any]) -> None:
    """Write a checkpoint beside ``path`` and move it into place, so that a kill leaves the old one or the new one."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    temporary = path.with_suffix(".tmp")
    with open(temporary, "wb") as file:
        file.write(hashlib.sha256(buffer.getvalue()).digest() + buffer.getvalue())
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def _load(path: Path) -> dict[str, Any] | None:
    """Return the checkpoint at ``path``; None (start again) if there is none or, which is said, it is damaged."""
    if not path.exists():
        return None
    content = path.read_bytes()
    if hashlib.sha256(content[32:]).digest() == content[:32]:
        with contextlib.suppress(pickle.UnpicklingError):  # written by a version that kept other things in it
            return torch.load(io.BytesIO(content[32:]), weights_only=True)
    tqdm.write(f"the checkpoint {path.name} cannot be read: starting this unit again")
    return None
