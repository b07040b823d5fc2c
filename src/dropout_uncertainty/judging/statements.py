"""Statements of the chapter: one sentence, one quantity, one verdict by ``judging.rules``."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from dropout_uncertainty.judging import rules
from dropout_uncertainty.judging.rules import Verdict
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Estimate, Interval

__all__ = ["Judged", "Kind", "Measured", "Statement", "judge"]

Kind = Literal["value", "less", "more", "equality", "audit"]


@dataclass(frozen=True)
class Measured:
    """What the records say about a statement.

    Attributes:
        difference: what its rule judges: ours minus the thesis's value, or first minus second. Of an audit its
            ``value`` is 1 (the fact holds) or 0.
        ours: what is shown beside the thesis's value, with its 95 % interval.
        records: those behind it.
    """

    difference: Estimate
    ours: Interval
    records: Sequence[Record]


@dataclass(frozen=True)
class Statement:
    """One sentence of the chapter that can be true or not.

    Attributes:
        id: e.g. "AL1a".
        text: the sentence in our words.
        where: its place in the thesis.
        kind: "value" (the thesis prints a number), "less" or "more" (A is below or above B), "equality", or "audit" (a
            fact about text, data or programs, no claim of the thesis).
        margin: the largest difference, in ``unit``, that does not matter; 0 for an audit.
        chapter: the notebook that shows it.
        measure: computes what the records of a folder (None: the published ones) say; None while there are none.
        unit: of margin, difference and values.
        thesis: the printed value.
        primary: whether it is one of the few that the chapter stands on, adjusted together.
        would_test: why it is untested, and what would test it, where ``measure`` gives None.
    """

    id: str
    text: str
    where: str
    kind: Kind
    margin: float
    chapter: str
    measure: Callable[[Path | None], Measured | None] = field(repr=False)
    unit: str = ""
    thesis: float | None = None
    primary: bool = False
    would_test: str = ""

    def verdict(self, difference: Estimate) -> Verdict:
        """Return the verdict of an estimate, not adjusted for other statements."""
        if self.kind == "audit":
            return "confirmed" if difference.value else "refuted"
        if self.kind == "value":
            return rules.value(difference, self.margin)
        if self.kind == "equality":
            return rules.equality(difference, self.margin)
        return rules.comparison(difference, self.kind, self.margin)


@dataclass(frozen=True)
class Judged:
    """A statement with its verdict.

    Attributes:
        plain: the verdict of the statement by itself.
        verdict: of a primary statement the one adjusted together with the others of its section, else ``plain``.
        p: the p-value that ``verdict`` rests on; NaN where there is none.
        small: whether the difference is there, but too little to matter.
    """

    statement: Statement
    measured: Measured | None
    plain: Verdict
    verdict: Verdict
    p: float
    small: bool


def judge(statements: Iterable[Statement], folder: Path | None = None) -> list[Judged]:
    """Return the statements of one section with the verdicts that the records of ``folder`` give them."""
    found = [(statement, statement.measure(folder)) for statement in statements]
    plain = {s.id: s.verdict(m.difference) if m else "untested" for s, m in found}
    p = {s.id: m.difference.p if m else float("nan") for s, m in found if s.primary}
    adjusted = rules.holm(p)
    judged = []
    for statement, measured in found:
        verdict: Verdict = plain[statement.id]
        if statement.primary:
            verdict = rules.adjusted(verdict, adjusted[statement.id])
        small = measured is not None and rules.small(verdict, measured.difference, statement.margin)
        level = adjusted.get(statement.id, measured.difference.p if measured else float("nan"))
        judged.append(Judged(statement, measured, plain[statement.id], verdict, level, small))
    return judged
