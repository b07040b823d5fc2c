"""Numbers with a name: ours beside the thesis's, with interval, verdict and the records behind them.

The rules that turn numbers into verdicts stand here, once. They were fixed before the published seeds were run.
"""

import functools
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Interval

__all__ = [
    "MIN_REPETITIONS", "Claim", "Judgement", "Part", "Result", "Sign", "Verdict", "combine", "direction", "measured",
    "missing", "same_value", "thesis_value",
]  # fmt: skip

Verdict = Literal["replicated", "partly", "not replicated", "undecided"]
Sign = Literal["positive", "negative"]

#: Fewer repetitions than this leave every verdict undecided.
MIN_REPETITIONS = 5
#: A value within this share of the thesis's, but with an interval that misses it, is partly replicated.
NEAR = 0.15


@dataclass(frozen=True)
class Result:
    """One number or verdict of the book.

    Attributes:
        id: e.g. "table-5.1/dropout/bald" or "claim/AL1".
        unit: of ``thesis``, ``ours``, ``low`` and ``high``.
        statistic: what was computed, in words.
        thesis: the printed value; None if the thesis has none.
        ours: None if not reached or not measured; ``low`` and ``high`` limit the 95 % interval.
        seeds: of the repetitions.
        config: name of the config.
        verdict: or None where there is nothing to judge.
        records: paths of the record files, below the records folder.
    """

    id: str
    unit: str
    statistic: str
    thesis: float | None
    ours: float | None
    low: float | None
    high: float | None
    seeds: list[int]
    config: str
    verdict: Verdict | None
    records: list[str]

    def plain(self) -> dict[str, Any]:
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
    judge: bool = True,
) -> Result:
    """Return the result of an interval computed from records; ``thesis`` is the id of the printed value, if another."""
    found = list(found)
    printed = thesis_value(thesis or identifier)
    return Result(
        id=identifier,
        unit=unit,
        statistic=statistic,
        thesis=printed,
        ours=_finite(interval.value),
        low=_finite(interval.low),
        high=_finite(interval.high),
        seeds=sorted(seed for record in found for seed in record.seeds),
        config=config,
        verdict=same_value(interval, printed) if judge and printed is not None else None,
        records=[record.label for record in found],
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def same_value(interval: Interval, thesis: float) -> Verdict:
    """Judge whether a printed number comes out again.

    Replicated: the 95 % interval holds it. Partly: it does not, but our value is within ``NEAR`` of it. Undecided:
    fewer than ``MIN_REPETITIONS``.
    """
    if interval.n < MIN_REPETITIONS:
        return "undecided"
    if interval.low <= thesis <= interval.high:
        return "replicated"
    return "partly" if abs(interval.value - thesis) <= NEAR * abs(thesis) else "not replicated"


def direction(interval: Interval, *, expected: Sign, null: float = 0.0) -> Verdict:
    """Judge whether a difference (or, with ``null=1``, a ratio) has the claimed sign.

    Replicated: the whole 95 % interval lies on the claimed side of ``null``. Not replicated: it lies on the other side
    or the value itself does. Partly: the value has the sign, the interval not. Undecided: too few repetitions.
    """
    if interval.n < MIN_REPETITIONS or math.isnan(interval.value):
        return "undecided"
    sign = 1.0 if expected == "positive" else -1.0
    value, ends = sign * (interval.value - null), (sign * (interval.low - null), sign * (interval.high - null))
    if value <= 0:
        return "not replicated"
    return "replicated" if min(ends) > 0 else "partly"


def combine(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict of a claim that has several parts.

    Undecided if a part is, else the common verdict, else partly.
    """
    found = set(verdicts)
    if not found or "undecided" in found:
        return "undecided"
    return found.pop() if len(found) == 1 else "partly"


def missing(what: str) -> "Part":
    """Return the part of a claim for which there are no records yet; it leaves the claim undecided."""
    return Part(what, Interval(math.nan, math.nan, math.nan, 0), "", "undecided")


@dataclass(frozen=True)
class Part:
    """One quantity that a claim rests on: what it is, its interval and unit, and how it is judged by itself."""

    what: str
    interval: Interval
    unit: str
    verdict: Verdict

    def __str__(self) -> str:
        """Return the part in words, e.g. "BALD, end: -2.1 [-2.4, -1.8] points"."""
        value, low, high, n = self.interval
        if n == 0:
            return f"{self.what}: no records yet"
        ends = ", ".join("not reached" if math.isinf(end) else f"{end:.3g}" for end in (low, high))
        limits = f" [{ends}]" if n > 1 and not math.isnan(low) else ""
        return f"{self.what}: {value:.3g}{limits}{' ' if self.unit else ''}{self.unit}"


@dataclass(frozen=True)
class Claim:
    """A numbered claim of the chapter.

    Attributes:
        id: e.g. "AL1".
        text: the claim in our words.
        where: the place in the thesis.
        rule: how it is judged, in words.
        chapter: the notebook that shows it.
        measure: computes the parts and the records they come from; called with a records folder or None.
    """

    id: str
    text: str
    where: str
    rule: str
    chapter: str
    measure: Callable[[Path | None], tuple[list[Part], list[Record]]]

    def judge(self, folder: Path | None = None) -> "Judgement":
        """Return the verdict that the records of ``folder`` give."""
        parts, found = self.measure(folder)
        return Judgement(
            self, parts, combine(part.verdict for part in parts), list({r.label: r for r in found}.values())
        )


@dataclass(frozen=True)
class Judgement:
    """A claim with its verdict and what it rests on."""

    claim: Claim
    parts: list[Part]
    verdict: Verdict
    records: list[Record]

    @property
    def sentence(self) -> str:
        """The explanation: every part, and how many repetitions there are."""
        counts = [part.interval.n for part in self.parts if part.interval.n]
        if not counts:
            return "No records yet."
        least = min(counts)
        few = self.verdict == "undecided" and least < MIN_REPETITIONS
        hint = f" At least {MIN_REPETITIONS} repetitions are needed for a verdict." if few else ""
        return "; ".join(map(str, self.parts)) + f". Repetitions: {least} or more.{hint}"

    def result(self) -> Result:
        """Return the verdict in the form of ``python -m dropout_uncertainty results``."""
        return Result(
            id=f"claim/{self.claim.id}",
            unit="",
            statistic=self.claim.rule,
            thesis=None,
            ours=None,
            low=None,
            high=None,
            seeds=sorted({seed for record in self.records for seed in record.seeds}),
            config=", ".join(dict.fromkeys(record.header["name"] for record in self.records)),
            verdict=self.verdict,
            records=[record.label for record in self.records],
        )
