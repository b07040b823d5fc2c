"""The profiles in which notebooks run, and what each of them computes."""

import contextlib
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import execute, executors
from dropout_uncertainty.runs.unit import Unit, missing

PROFILES = ("recorded", "quick", "full")


def check(profile: str) -> None:
    """Raise UserError if ``profile`` is none of ``PROFILES``."""
    if profile not in PROFILES:
        raise UserError(f"unknown profile {profile!r}, choose one of {', '.join(PROFILES)}")


def complete(profile: str, *stages: Iterable[Unit]) -> None:
    """In ``full``, compute the repetitions that have no record yet, one stage after the other; else do nothing."""
    if profile == "full":
        with executors.processes() as executor:
            for units in stages:
                execute.run(missing(units), executor=executor)


@contextlib.contextmanager
def computed(profile: str, quick: Iterable[Unit], full: Iterable[Unit]) -> Iterator[Path | None]:
    """Compute what a profile computes and give the folder of its records, None for that of the repository.

    The records of ``quick`` are gone when the context is left.
    """
    complete(profile, full)
    if profile != "quick":
        yield None
        return
    with tempfile.TemporaryDirectory() as folder, executors.processes() as executor:
        execute.run(quick, executor=executor, folder=Path(folder))
        yield Path(folder)
