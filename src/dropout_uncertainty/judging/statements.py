"""Statements of the chapter: one sentence, one quantity, one verdict by ``judging.rules``."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from dropout_uncertainty.judging import rules
from dropout_uncertainty.judging.results import Result, finite
from dropout_uncertainty.judging.rules import Verdict
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Estimate, Interval, mean_estimate

__all__ = [
    "KINDS", "NEAR", "Judged", "Kind", "Measure", "Measured", "NotRun", "Statement", "StatementResult", "audit",
    "audited", "from_range", "judge", "needed", "nothing", "on_average", "shifted",
]  # fmt: skip

Found = TypeVar("Found")
Kind = Literal["value", "less", "more", "equality", "audit"]

#: What each kind of statement can come out as.
KINDS = {
    "printed values": (("value",), ("agrees", "differs", "imprecise", "untested")),
    "comparisons": (("less", "more"), ("supported", "contradicted", "no difference", "inconclusive", "untested")),
    "equalities": (("equality",), ("supported", "contradicted", "inconclusive", "untested")),
    "audits": (("audit",), ("confirmed", "refuted", "untested")),
}

#: The margin of a printed value, as a share of it, where there is no special one.
NEAR = 0.15
#: Repetitions of a primary statement; of section 5.4, whose learners differ more from seed to seed.
PRIMARY, PRIMARY_5_4 = 20, 40


@dataclass(frozen=True)
class Measured:
    """What the records say about a statement."""

    #: what its rule judges: ours minus the thesis's value, or first minus second. Of an audit its ``value`` is 1 (the
    #: fact holds) or 0.
    difference: Estimate
    ours: Interval  #: what is shown beside the thesis's value, with its 95 % interval.
    records: Sequence[Record] = ()  #: those behind it.
    #: other ways to count, by name, which are shown and not judged.
    beside: Mapping[str, Interval] = field(default_factory=dict)


#: Computes what the records of a folder (None: the published ones) say; raises NotRun while there are none.
Measure = Callable[[Path | None], Measured]


class NotRun(LookupError):
    """There are no records yet of what a statement is about."""


def needed(found: Found | None) -> Found:
    """Return what was found; raises NotRun if that is nothing."""
    if found is None:
        raise NotRun
    return found


def nothing(folder: Path | None) -> Measured:
    """Raise NotRun: nothing has been run for this statement."""
    raise NotRun


def audited(holds: bool) -> Measured:
    """Return the evidence about a fact."""
    value, nan = float(holds), math.nan
    return Measured(Estimate(value, nan, nan, nan, nan, nan, 0), Interval(value, nan, nan, 0))


def shifted(interval: Interval, by: float) -> Interval:
    """Return an interval moved along, such as that of a difference back to the quantity itself."""
    return Interval(interval.value + by, interval.low + by, interval.high + by, interval.n)


def on_average(
    values: Sequence[float] | np.ndarray,
    records: Sequence[Record],
    claimed: float = 0.0,
    beside: Mapping[str, Interval] | None = None,
) -> Measured:
    """Return the mean of a value per repetition, less what is claimed; ``beside`` as in ``Measured``."""
    difference = mean_estimate(np.asarray(values) - claimed)
    return Measured(difference, shifted(difference.interval, claimed), records, beside or {})


def from_range(estimate: Estimate, low: float, high: float) -> Estimate:
    """Return how far a quantity lies outside a printed range, counted from its nearer end; no p-value."""
    value, *ends = (x - min(max(x, low), high) for x in estimate[:5])
    return Estimate(value, ends[0], ends[1], ends[2], ends[3], math.nan, estimate.n)


@dataclass(frozen=True)
class Statement:
    """One sentence of the chapter that can be true or not."""

    id: str  #: e.g. "AL1a".
    text: str  #: the sentence in our words.
    where: str  #: its place in the thesis.
    #: "value" (the thesis prints a number), "less" or "more" (A is below or above B), "equality", or "audit" (a fact
    #: about text, data or programs, no claim of the thesis).
    kind: Kind
    margin: float  #: the largest difference, in ``unit``, that does not matter; 0 for an audit.
    measure: Measure = field(repr=False)  #: see ``Measure``.
    unit: str = ""  #: of margin, difference and values.
    thesis: float | None = None  #: the printed value.
    primary: bool = False  #: whether it is one of the few that the chapter stands on, adjusted together.
    would_test: str = ""  #: why it is untested, and what would test it, where nothing has been run.
    chapter: str = field(kw_only=True)  #: the notebook that shows it.

    @property
    def least(self) -> int:
        """Repetitions that a verdict needs."""
        if not self.primary:
            return rules.LEAST
        return PRIMARY_5_4 if self.id.startswith("DE") else PRIMARY

    def verdict(self, difference: Estimate) -> Verdict:
        """Return the verdict of an estimate, not adjusted for other statements."""
        if self.kind == "audit":
            return "confirmed" if difference.value else "refuted"
        if difference.n < self.least:
            return "untested"
        if self.kind == "value":
            return rules.value(difference, self.margin)
        if self.kind == "equality":
            return rules.equality(difference, self.margin)
        return rules.comparison(difference, self.kind, self.margin)


def audit(identifier: str, text: str, where: str, measure: Measure, *, chapter: str) -> Statement:
    """Return a statement about a fact, that is no claim of the thesis."""
    return Statement(identifier, text, where, "audit", 0.0, measure, chapter=chapter)


@dataclass(frozen=True)
class Judged:
    """A statement with its verdict."""

    statement: Statement
    measured: Measured | None
    plain: Verdict  #: the verdict of the statement by itself.
    #: of a primary statement the one adjusted together with the others of its section, else ``plain``.
    verdict: Verdict
    p: float  #: the p-value that ``verdict`` rests on; NaN where there is none.
    small: bool  #: whether the difference is there, but too little to matter.

    @property
    def why(self) -> str:
        """Why nothing could be said, or how small a difference could have been seen; empty for other verdicts."""
        statement, measured = self.statement, self.measured
        if measured is None:
            return statement.would_test or "no records yet"
        if self.plain == "untested":
            return f"{measured.difference.n} of {statement.least} repetitions"
        if math.isinf(measured.ours.value):
            return "not reached by the end of the runs, so that only a lower limit is known"
        if self.verdict in ("inconclusive", "imprecise"):
            half = (measured.difference.high - measured.difference.low) / 2
            if math.isinf(half):
                return "some runs do not reach it, so that there is no upper limit"
            return f"differences below {half:.2g} {statement.unit} could not be seen".replace("  ", " ").strip()
        return "small: within the margin" if self.small else ""

    @property
    def sources(self) -> list[Record]:
        """The records behind it, each once."""
        return list({record.label: record for record in self.measured.records}.values()) if self.measured else []

    def result(self) -> "StatementResult":
        """Return it in the form of ``python -m dropout_uncertainty results``."""
        statement, measured, found = self.statement, self.measured, self.sources
        ours = measured.ours if measured else Interval(math.nan, math.nan, math.nan, 0)
        return StatementResult(
            id=f"statement/{statement.id}",
            unit=statement.unit,
            statistic=statement.text,
            thesis=statement.thesis,
            ours=finite(ours.value),
            low=finite(ours.low),
            high=finite(ours.high),
            seeds=sorted({seed for record in found for seed in record.seeds}),
            config=", ".join(dict.fromkeys(record.header["name"] for record in found)),
            verdict=self.verdict,
            records=[record.label for record in found],
            kind=statement.kind,
            primary=statement.primary,
            plain=self.plain,
            margin=statement.margin,
            n=measured.difference.n if measured else 0,
            p=finite(self.p),
            small=self.small,
            why=self.why,
        )


@dataclass(frozen=True)
class StatementResult(Result):
    """A statement among the numbers of the book; its fields are those of ``Statement`` and ``Judged``."""

    kind: Kind
    primary: bool
    plain: Verdict
    margin: float
    p: float | None
    small: bool
    why: str


def _measured(statement: Statement, folder: Path | None) -> Measured | None:
    try:
        return statement.measure(folder)
    except NotRun:
        return None


def judge(statements: Iterable[Statement], folder: Path | None = None) -> list[Judged]:
    """Return the statements of one section with the verdicts that the records of ``folder`` give them.

    Raises:
        ValueError: if two statements have one id.
    """
    statements = list(statements)
    if len({s.id for s in statements}) < len(statements):
        raise ValueError(f"expected an id of its own for each statement, got {[s.id for s in statements]}")
    found = [(statement, _measured(statement, folder)) for statement in statements]
    plain = {s.id: s.verdict(m.difference) if m else "untested" for s, m in found}
    p = {s.id: m.difference.p if m and plain[s.id] != "untested" else math.nan for s, m in found if s.primary}
    adjusted = rules.holm(p)
    judged = []
    for statement, measured in found:
        verdict: Verdict = plain[statement.id]
        if statement.primary:
            verdict = rules.adjusted(verdict, adjusted[statement.id])
        small = (
            measured is not None
            and statement.kind in ("less", "more")
            and rules.small(verdict, measured.difference, statement.margin)
        )
        level = adjusted.get(statement.id, measured.difference.p if measured else math.nan)
        judged.append(Judged(statement, measured, plain[statement.id], verdict, level, small))
    return judged
