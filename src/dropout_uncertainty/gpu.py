"""A quarter of an hour on a GPU, prepared: what only a GPU makes affordable, in the order in which it is missed.

Every part is resumable and leaves its records, so that nothing of the time is lost.
"""

import contextlib
import itertools
import json
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dropout_uncertainty import folders
from dropout_uncertainty.active_learning import experiment as images
from dropout_uncertainty.data_efficiency import configs as plants
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration import experiment as worlds
from dropout_uncertainty.runs import execute, executors, records
from dropout_uncertainty.runs.unit import Unit, missing

__all__ = ["KERNELS", "REPORT", "run"]

REPORT = "report.json"
#: A config of each kind of network or model, and its section: what is run twice, and timed with replicas stacked.
KERNELS = {"ours/dropout/bald": images, "as-demo": worlds, "deep-pilco-ours": plants, "pilco-paper": plants}
STACKED = (1, 10, 40, 200)
#: The least work that goes through every part of a kernel, to try the run where there is no GPU.
TINY = {
    "epochs": 1, "rounds": 1, "draws": 2, "subset": 20, "mc_test_every": 0, "tested": 100,
    "learning_start": 99, "burn_in": 100, "ticks": 1_000, "hidden": (16, 16), "basis": 5, "particles": 5,
    "trials": 1, "policy_steps": 2, "policy_iterations": 2, "model_steps": 2, "model_iterations": 2,
}  # fmt: skip


def run(out: Path, seconds: float, *, device: str = "cuda", tiny: bool = False, workers: int = 8) -> dict[str, Any]:
    """Do as much as there is time for, write records and ``report.json`` below a folder, and return the report.

    In this order: a short unit of each section twice, whose bits must agree; the pools of section 5.2; what is missing
    of ten repetitions of Tables 5.1 and 5.2; forty repetitions of Deep PILCO and of PILCO; seconds of a step of each
    kernel with 1 to 200 replicas. The same call again goes on where this one stopped. Of a part that fails the report
    tells why, and the next one begins.

    Args:
        out: folder, made if it is not there; copy its records to ``records/`` afterwards.
        seconds: of the clock, for all parts together; a step that has begun is finished.
        device: "cuda", or "cpu" to try it.
        tiny: whether everything is cut down to seconds, for a test.
        workers: units of section 5.2 that share the device.

    Raises:
        UserError: if the folder cannot be made.
    """
    begin = time.time()
    until = begin + seconds
    out = out.absolute()
    folders.create(out)
    report = {**records.provenance(device), "tiny": tiny, "parts": {}}
    for name, part in _parts(out, device, tiny, workers, until).items():
        start = time.time()
        report["parts"][name] = {**_attempt(part, until), "seconds": round(time.time() - start, 1)}
        report["bytes"] = sum(path.stat().st_size for path in out.rglob("*.npz"))
        (out / REPORT).write_text(json.dumps(report, indent=1), encoding="utf-8")
        print(f"{name}: {report['parts'][name]['state']} after {time.time() - begin:.0f} s", flush=True)
    return report


def _attempt(part: Callable[[], dict[str, Any]], until: float) -> dict[str, Any]:
    """Return what a part gives and how it ended; whatever is wrong with it is told, so that the next can begin."""
    if time.time() >= until:
        return {"state": "not begun"}
    try:
        return {"state": "done", **part()}
    except execute.OutOfTime as error:
        return {"state": "stopped", "where": str(error)}
    except (UserError, RuntimeError, ValueError) as error:  # out of memory is a RuntimeError
        return {"state": "failed", "error": f"{type(error).__name__}: {error}"}


def _parts(out: Path, device: str, tiny: bool, workers: int, until: float) -> dict[str, Callable[[], dict[str, Any]]]:
    pools, tables = ([name for name in images.CONFIGS if name.startswith(family)] for family in ("pools/", "ours/"))
    forty = range(records.DEVELOPMENT, records.DEVELOPMENT + (1 if tiny else 40))

    def units(found: Iterable[Unit]) -> list[Unit]:
        return [_cut(unit) for unit in itertools.islice(found, 2)] if tiny else list(found)

    def recorded(found: Iterable[Unit], at_once: int = 1) -> Callable[[], dict[str, Any]]:
        return lambda: _record(units(found), out, at_once, until)

    return {
        "bits": lambda: {"equal": {unit.name: _same_twice(unit) for unit in map(_cut, _kernels(device, 2))}},
        "pools": recorded(missing(unit for name in pools for unit in images.units(name, None, device)), workers),
        "tables": recorded(missing(u for name in tables for u in images.units(name, range(10), device)), workers),
        "deep-pilco": recorded(plants.units("deep-pilco-ours", forty, device)),
        "pilco": recorded(plants.units("pilco-paper", forty, device)),
        "kernels": lambda: {
            "steps": [
                _seconds(unit, until) for n in STACKED[: 2 if tiny else None] for unit in units(_kernels(device, n))
            ]
        },
    }


def _kernels(device: str, replicas: int) -> list[Unit]:
    seeds = range(records.DEVELOPMENT, records.DEVELOPMENT + replicas)
    return [replace(section.units(name, seeds[:1], device)[0], seeds=tuple(seeds)) for name, section in KERNELS.items()]


def _cut(unit: Unit) -> Unit:
    """Return a unit of the least work under a name of its own."""
    known = {field.name for field in fields(unit.config)}
    less = {name: value for name, value in TINY.items() if name in known}
    unit = replace(unit, name=f"tiny/{unit.name}", config=replace(unit.config, **less), seeds=unit.seeds[:2])
    return replace(unit, precision=unit.precision.replace("bfloat16", "float32"), published=None)


def _record(units: Sequence[Unit], out: Path, at_once: int, until: float) -> dict[str, Any]:
    """Compute the records of units, several at once where it is asked for, and return their paths and size."""
    stopped: execute.OutOfTime | None = None
    context = executors.processes(min(at_once, len(units))) if at_once > 1 and units else contextlib.nullcontext()
    with context as executor:
        try:
            made = execute.run(units, executor=executor, folder=out, progress=False, until=until)
        except execute.OutOfTime as error:  # raised once the others have ended their steps: leaving now kills them
            stopped = error
    if stopped is not None:
        raise stopped
    return {"records": [str(record.path.relative_to(out)) for record in made]}


def _same_twice(unit: Unit) -> bool:
    """Return whether a unit gives the same bits when it is computed again."""
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as two:
        first, second = (execute.run_unit(unit, Path(folder)).arrays for folder in (one, two))
    return all(np.array_equal(first[name], second[name], equal_nan=True) for name in first)


def _seconds(unit: Unit, until: float) -> dict[str, Any]:
    """Return what the second step of a unit takes, None if there is no time; the first warms up, or moves at random."""
    measured = {"config": unit.name, "replicas": len(unit.seeds)}
    if time.time() >= until:
        return {**measured, "seconds": None}
    process = unit.process()
    process.advance()
    _wait(unit.device)
    begin = time.perf_counter()
    process.advance()
    _wait(unit.device)
    return {**measured, "seconds": time.perf_counter() - begin}


def _wait(device: str) -> None:
    if torch.device(device).type == "cuda":
        torch.cuda.synchronize()
