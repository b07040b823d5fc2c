"""Every sentence of sections 5.2-5.4 that asserts something, with the statements that test it or why none does."""

from collections.abc import Sequence
from typing import Any

from dropout_uncertainty.judging.statements import Judged
from dropout_uncertainty.runs import records


def rows() -> list[dict[str, str]]:
    """Return the lines of ``records/coverage.csv``: place, words, statements (ids with a space between) and reason."""
    return records.table("coverage")


def sentences(section: str, judged: Sequence[Judged]) -> tuple[list[str], list[list[Any]]]:
    """Return the sentences of a section, e.g. "5.2", with the verdicts of their statements, as heads and rows."""
    verdicts = {j.statement.id: j.verdict for j in judged}
    cells = []
    for row in rows():
        if row["place"].startswith(section):
            tested = ", ".join(f"{name} ({verdicts[name]})" for name in row["statements"].split())
            cells.append([row["place"], row["words"], tested or row["reason"]])
    return ["place", "what it says, in our words", "statements (verdict), or why none"], cells
