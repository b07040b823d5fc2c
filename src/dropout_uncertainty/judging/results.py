"""Numbers with a name: ours beside the thesis's, with interval and the records behind them.

A number carries no verdict; statements do (``judging.statements``).
"""

import functools
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Interval


@dataclass(frozen=True)
class Result:
    """One number of the book."""

    id: str  #: e.g. "table-5.1/dropout/bald".
    unit: str  #: of ``thesis``, ``ours``, ``low`` and ``high``.
    statistic: str  #: what was computed, in words.
    thesis: float | None  #: the printed value; None if the thesis has none.
    ours: float | None  #: None if not reached or not measured; ``low`` and ``high`` limit the 95 % interval.
    low: float | None
    high: float | None
    seeds: list[int]  #: of all repetitions in the records, each once.
    config: str  #: name of the config.
    verdict: str | None  #: that of a statement (``judging.rules``); None of all other numbers.
    records: list[str]  #: paths of the record files, below the records folder.
    n: int  #: repetitions that the interval rests on, of a paired difference the pairs.

    def data(self) -> dict[str, Any]:
        """Return the result as JSON data."""
        return asdict(self)


@functools.cache
def _thesis() -> dict[str, float]:
    return {row["id"]: float(row["value"]) for row in records.table("thesis")}


def thesis_value(identifier: str) -> float | None:
    """Return the value that the thesis prints under an id of ``records/thesis.csv``, None if there is none."""
    return _thesis().get(identifier)


def printed(identifier: str) -> float:
    """Return a value that the thesis prints.

    Raises:
        KeyError: if ``records/thesis.csv`` has none of that id.
    """
    return _thesis()[identifier]


def measured(
    identifier: str,
    interval: Interval,
    found: Iterable[Record],
    *,
    unit: str,
    statistic: str,
    config: str,
    thesis: str | None = None,
) -> Result:
    """Return the result of an interval computed from records; ``thesis`` is the id of the printed value, if another."""
    found = list(found)
    return Result(
        id=identifier,
        unit=unit,
        statistic=statistic,
        thesis=thesis_value(thesis or identifier),
        ours=finite(interval.value),
        low=finite(interval.low),
        high=finite(interval.high),
        seeds=sorted({seed for record in found for seed in record.seeds}),
        config=config,
        verdict=None,
        records=[record.label for record in found],
        n=interval.n,
    )


def listed(
    name: str, rows: Iterable[tuple[str, Interval, str, str]], found: Iterable[Record], config: str
) -> list[Result]:
    """Return results called ``name/kind`` of the same records, from rows of kind, interval, unit and statistic."""
    found = list(found)
    return [
        measured(f"{name}/{kind}", interval, found, unit=unit, statistic=statistic, config=config)
        for kind, interval, unit, statistic in rows
    ]


def finite(value: float) -> float | None:
    """Return a number, None where it is infinite (not reached) or not known."""
    return float(value) if math.isfinite(value) else None
