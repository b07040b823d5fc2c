"""The command line: ``python -m dropout_uncertainty`` or ``dropout-uncertainty``."""

import contextlib
import importlib
import itertools
import json
import math
import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from datetime import date
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer

import dropout_uncertainty
from dropout_uncertainty import folders, stopping
from dropout_uncertainty.errors import UserError, unknown

if TYPE_CHECKING:  # PyTorch takes seconds to import, which `--help` need not wait for
    from dropout_uncertainty.runs.unit import Unit

__all__ = ["EXPERIMENTS", "app", "main"]

#: Experiments by name, and the modules that hold their configs and units.
EXPERIMENTS: dict[str, tuple[str, ...]] = {
    "active_learning": ("dropout_uncertainty.active_learning.experiment",),
    "exploration": (
        "dropout_uncertainty.exploration.experiment",
        "dropout_uncertainty.exploration.deep_sea.experiment",
    ),
    "data_efficiency": ("dropout_uncertainty.data_efficiency.configs",),
}
#: Seeds of one command.
MOST_SEEDS = 100_000

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)
record_commands = typer.Typer(help="List, verify and pack the stored records.", no_args_is_help=True)
app.add_typer(record_commands, name="records")


def _print_version(wanted: bool) -> bool:
    if wanted:
        typer.echo(dropout_uncertainty.__version__)
        raise typer.Exit
    return wanted


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="print it")
    ] = False,
) -> None:
    """Dropout uncertainty in action: make the book, run the experiments, look at the records."""


@app.command()
def book(
    profile: Annotated[str | None, typer.Option(help="recorded (the default), quick or full")] = None,
    skip_run: Annotated[bool, typer.Option(help="build from the notebooks as last run")] = False,
) -> None:
    """Run all notebooks and build the HTML book."""
    from dropout_uncertainty.page.book import build

    build(profile, run=not skip_run)


@app.command()
def pdf() -> None:
    """Print the book as last built as one PDF, with Chromium."""
    from dropout_uncertainty.page.book import print_pdf

    print_pdf()


@app.command()
def epub() -> None:
    """Make an EPUB of the book as last built."""
    from dropout_uncertainty.page.book import build_epub

    build_epub()


@app.command()
def notebooks(
    names: Annotated[list[str] | None, typer.Argument(help="without suffix; all by default")] = None,
    profile: Annotated[str, typer.Option(help="recorded, quick or full")] = "recorded",
) -> None:
    """Run notebooks without building the book."""
    from dropout_uncertainty.page.book import run_notebooks

    run_notebooks(profile, names or None)


@app.command()
def front() -> None:
    """Write the numbers in the README, and the pictures of README and first page, from the records."""
    from dropout_uncertainty.page.landing import write

    for line in write():
        typer.echo(line)


@app.command()
def run(
    experiment: Annotated[str, typer.Argument(help=", ".join(EXPERIMENTS))],
    config: Annotated[str, typer.Option(help="name of a config, or of a family of configs such as ours")],
    seeds: Annotated[str, typer.Option(help="such as 0-4 or 0,3,7; published: 0-99, development: 100 and above")],
    device: Annotated[str, typer.Option(help="auto, cpu or cuda")] = "auto",
    precision: Annotated[str | None, typer.Option(help="float64, float32 or bfloat16; default: the section's")] = None,
    workers: Annotated[int, typer.Option(help="processes, one thread each", min=1)] = 1,
    scheduler: Annotated[str | None, typer.Option(help="of a Dask cluster to use, such as tcp://host:8786")] = None,
) -> None:
    """Compute the missing records of an experiment; a run that was stopped continues where it was."""
    from dropout_uncertainty.runs import execute, executors, records
    from dropout_uncertainty.runs.unit import PRECISIONS, Unit, check_device

    folders.create(records.root())
    any_device = device == "auto"
    if scheduler is not None:
        if workers > 1:
            raise UserError("--workers are processes of this machine, --scheduler has workers of its own: choose one")
        device = known({"auto": "cpu"}.get(device, device), ("cpu", "cuda"), "device")  # of the cluster's workers
    options: dict[str, Any] = {"device": check_device(device) if scheduler is None else device}
    if precision is not None:
        options["precision"] = known(precision, PRECISIONS, "precision")
    # what was computed on the other device type counts, unless one is asked for
    like = options | ({"device": None} if any_device else {})
    experiment = known(experiment.replace("-", "_"), EXPERIMENTS, "experiment")
    modules = config_modules(experiment)
    names, numbers = config_names(config, modules), seed_list(seeds)

    def missing(name: str) -> list[Unit]:
        left = records.missing_seeds(experiment, name, modules[name].CONFIGS[name], numbers, **like)
        return modules[name].units(name, left, **options) if left else []

    # Seed by seed, so that every config has its first repetition before any has its second.
    by_seed = itertools.zip_longest(*map(missing, names))
    units = [unit for group in by_seed for unit in group if unit is not None]
    if not units:
        typer.echo("Nothing to do: these repetitions have their records.")
    context: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()
    if scheduler is not None:
        context = executors.cluster(scheduler)
    elif workers > 1:
        context = executors.processes(workers)
    with context as executor:
        for record in execute.run(units, executor=executor):
            typer.echo(record.path)


@app.command()
def gpu(
    out: Annotated[Path, typer.Option(help="folder of the records and of report.json; the same one continues")],
    minutes: Annotated[float, typer.Option(help="of the clock", min=0)] = 12.0,
    workers: Annotated[int, typer.Option(help="units of section 5.2 that share the GPU", min=1)] = 8,
    tiny: Annotated[bool, typer.Option(help="cut everything down to seconds; runs without a GPU, too")] = False,
) -> None:
    """Do what only a GPU makes affordable, the most missed first, and stop when the time is up."""
    from dropout_uncertainty import gpu
    from dropout_uncertainty.runs.unit import check_device

    device = check_device("auto")
    if device == "cpu" and not tiny:
        raise UserError("expected a CUDA GPU, PyTorch finds none here; --tiny tries everything without one")
    report = gpu.run(out, 60 * minutes, device=device, tiny=tiny, workers=workers)
    failed = [name for name, part in report["parts"].items() if part["state"] == "failed"]
    raise typer.Exit(code=1 if failed else 0)


@record_commands.command("list")
def list_records() -> None:
    """List the stored records with their seeds and computing times."""
    from dropout_uncertainty.runs import records

    for path, problem in records.verify():
        label = path.relative_to(records.root())
        if problem is None:
            origin = records.read(path).header["provenance"]
            minutes = f"{origin['wall_s'] / 60:.1f} min" if "wall_s" in origin else "time unknown"
            date, commit = (str(origin.get(key) or "unknown") for key in ("date", "commit"))
            typer.echo(f"{label}  {minutes}  {date[:10]}  {commit[:8]}")
        else:
            typer.echo(f"{label}  {problem}")


@record_commands.command("verify")
def verify_records(
    recompute: Annotated[int, typer.Option(help="units of each section to recompute, drawn at random", min=0)] = 0,
    seed: Annotated[int | None, typer.Option(help="of the drawing; default: today's date as a number", min=0)] = None,
    seconds: Annotated[float, typer.Option(help="CPU time for the first steps of each; 0: all its steps")] = 30.0,
) -> None:
    """Check every stored record against its checksums, place and config; recompute a few and compare."""
    from dropout_uncertainty.runs import records

    found = records.verify()
    if not found:
        raise UserError(f"there are no records below {records.root()}")
    problems = [problem for _, problem in found if problem is not None]
    for problem in problems:
        typer.echo(problem, err=True)
    typer.echo(
        f"{len(found) - len(problems)} of {len(found)} records are intact: arrays and header agree with their "
        "checksums, each is where its label says, and no seed of a config is in two"
    )
    intact = [records.read(path) for path, problem in found if problem is None]
    failed = bool(problems)
    if recompute:
        failed |= _recompute(intact, recompute, seed if seed is not None else int(f"{date.today():%Y%m%d}"), seconds)
    raise typer.Exit(code=1 if failed else 0)


@record_commands.command("crate")
def write_crate(out: Annotated[Path, typer.Option(help="the archive")] = Path("_build", "records.zip")) -> None:
    """Pack the records into an archive that describes itself, an RO-Crate."""
    from dropout_uncertainty.page import public
    from dropout_uncertainty.runs import crate

    if (repository := public.repository()) is None:
        raise UserError(f"the archive says where its program is: name the repository in {public.REPOSITORY}")
    typer.echo(crate.write(out, repository))


def _recompute(found: list[Any], count: int, seed: int, seconds: float) -> bool:
    """Recompute some records of each section, print what comes out, and return whether one is not confirmed."""
    from dropout_uncertainty.runs.recompute import choose, recompute

    failed = False
    typer.echo(f"recomputing {count} of the records of each section, drawn with seed {seed}")
    for experiment in EXPERIMENTS:
        for record in choose([r for r in found if r.header["experiment"] == experiment], count, seed):
            comparison = recompute(recorded_unit(record.header), record, seconds or math.inf)
            typer.echo(str(comparison), err=bool(comparison.problems))
            failed |= bool(comparison.problems)
    return failed


@app.command()
def results(as_json: Annotated[bool, typer.Option("--json", help="print JSON")] = False) -> None:
    """Print every number of the book beside the thesis's, with its interval and verdict."""
    from dropout_uncertainty.judging.collect import collect

    found = collect()
    if as_json:
        typer.echo(json.dumps([result.data() for result in found], indent=1, ensure_ascii=False))
        return
    for r in found:
        numbers = " ".join(f"{name} {value:g}" for name, value in _numbers(r) if value is not None)
        typer.echo(f"{r.id}: {numbers} {r.unit} ({r.statistic}; {r.n} repetitions) {r.verdict or ''}".rstrip())


def _numbers(result: Any) -> list[tuple[str, float | None]]:
    return [(name, getattr(result, name)) for name in ("thesis", "ours", "low", "high")]


def known(name: str, choices: Any, what: str) -> str:
    """Return ``name`` if it is one of the choices; raises UserError naming them otherwise."""
    if name not in choices:
        raise UserError(unknown(what, name, choices))
    return name


def config_modules(experiment: str) -> dict[str, ModuleType]:
    """Return the names of all configs of an experiment, each with the module that holds it."""
    modules = [importlib.import_module(name) for name in EXPERIMENTS[experiment]]
    return {name: module for module in modules for name in module.CONFIGS}


def recorded_unit(header: Mapping[str, Any]) -> "Unit":
    """Return the unit that a record with this header is the result of, as the code makes it now.

    Raises:
        UserError: if the code has no such config any more, or another one of that name.
    """
    from dropout_uncertainty.settings import config_diff, config_hash

    where = f"{header['experiment']}/{header['name']}"
    modules = config_modules(header["experiment"])
    if header["name"] not in modules:
        raise UserError(f"{where} cannot be recomputed: there is no config of that name any more")
    module, seeds = modules[header["name"]], tuple(header["seeds"])
    unit = replace(module.units(header["name"], seeds[:1])[0], seeds=seeds, precision=header["precision"])
    if config_hash(unit.config) != header["config_hash"]:
        changed = ", ".join(field for field, *_ in config_diff(header["config"], unit.config))
        raise UserError(f"{where} cannot be recomputed: its config has changed since ({changed})")
    return replace(unit, device=header["device"])


def config_names(name: str, configs: dict[str, Any]) -> list[str]:
    """Return the configs of that name, or of the family of that name ("ours": all that begin with "ours/").

    Raises:
        UserError: if there is none.
    """
    if name in configs:
        return [name]
    family = [known_name for known_name in configs if known_name.startswith(f"{name}/")]
    if not family:
        known(name, list(dict.fromkeys([*(c.split("/")[0] for c in configs), *configs])), "config")
    return family


def seed_list(text: str) -> list[int]:
    """Return the seeds that a text such as "0-4,7" names; raises UserError if it names none."""
    seeds: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,18})(?:-(\d{1,18}))?\s*", part)
        if match is None or (match[2] is not None and int(match[2]) < int(match[1])):
            raise UserError(f"seeds are given like 0-4 or 0,3,7, got {text!r}")
        first, last = int(match[1]), int(match[2] or match[1])
        if len(seeds) + last - first >= MOST_SEEDS:
            raise UserError(f"at most {MOST_SEEDS:,} seeds can be asked for at a time, got {text!r}")
        seeds += range(first, last + 1)
    return list(dict.fromkeys(seeds))


@stopping.one_sentence()
def main() -> None:
    """Run the command line; a mistake of the caller is one sentence and exit status 2, without a traceback."""
    try:
        app()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
