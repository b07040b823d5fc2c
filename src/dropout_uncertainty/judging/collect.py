"""All statements about sections 5.2-5.4 and all numbers of the book in one place."""

import re
from pathlib import Path

from dropout_uncertainty.active_learning.report import analysis as active_learning
from dropout_uncertainty.active_learning.report import pools
from dropout_uncertainty.active_learning.report.statements import STATEMENTS as ACTIVE_LEARNING
from dropout_uncertainty.data_efficiency.ablations.report import analysis as what_matters
from dropout_uncertainty.data_efficiency.ablations.report.statements import STATEMENTS as WHAT_MATTERS
from dropout_uncertainty.data_efficiency.ablations.report.worth import analysis as worth
from dropout_uncertainty.data_efficiency.hidden_state.report import analysis as hidden_state
from dropout_uncertainty.data_efficiency.hidden_state.report.statements import STATEMENTS as HIDDEN_STATE
from dropout_uncertainty.data_efficiency.model_free.report import analysis as model_free
from dropout_uncertainty.data_efficiency.model_free.report.statements import STATEMENTS as MODEL_FREE
from dropout_uncertainty.data_efficiency.report import analysis as data_efficiency
from dropout_uncertainty.data_efficiency.report.statements import STATEMENTS as DATA_EFFICIENCY
from dropout_uncertainty.exploration.report import analysis as exploration
from dropout_uncertainty.exploration.report import two_by_two
from dropout_uncertainty.exploration.report.deep_sea import analysis as deep_sea
from dropout_uncertainty.exploration.report.statements import STATEMENTS as EXPLORATION
from dropout_uncertainty.judging.results import Result
from dropout_uncertainty.judging.statements import Judged, Statement, judge

#: Sections by the letters with which the ids of their statements begin.
SECTIONS = {"AL": "5.2 Active learning", "EX": "5.3 Exploration", "DE": "5.4 Data efficiency"}


def number(identifier: str) -> tuple[int, int, str]:
    """Return what ids are ordered by: section, number, letter."""
    found = re.fullmatch(r"([A-Z]{2})(\d+)([a-z]?)", identifier)
    if found is None or found[1] not in SECTIONS:
        raise ValueError(f"a statement is called like AL1a, got {identifier!r}")
    return list(SECTIONS).index(found[1]), int(found[2]), found[3]


#: All statements in order.
STATEMENTS: dict[str, Statement] = {
    statement.id: statement
    for statement in sorted(
        [*ACTIVE_LEARNING, *EXPLORATION, *DATA_EFFICIENCY, *WHAT_MATTERS, *HIDDEN_STATE, *MODEL_FREE],
        key=lambda s: number(s.id),
    )
}


def judged(folder: Path | None = None, letters: str = "") -> list[Judged]:
    """Return the statements with the verdicts that the records of ``folder`` give them, of one section or of all.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    sections = [[s for s in STATEMENTS.values() if s.id.startswith(section)] for section in SECTIONS]
    return [j for mine in sections if mine[0].id.startswith(letters) for j in judge(mine, folder)]


def collect(folder: Path | None = None) -> list[Result]:
    """Return every number and verdict that the records of ``folder`` give, numbers first, then statements.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    sections = (
        active_learning, pools, exploration, two_by_two, deep_sea, data_efficiency, what_matters, worth, hidden_state,
        model_free,
    )  # fmt: skip
    numbers = [result for section in sections for result in section.results(folder)]
    return numbers + [j.result() for j in judged(folder)]
