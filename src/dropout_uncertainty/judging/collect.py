"""All claims of sections 5.2-5.4 and all numbers of the book in one place."""

import re
from pathlib import Path

from dropout_uncertainty.active_learning.report import analysis as active_learning
from dropout_uncertainty.active_learning.report import pools
from dropout_uncertainty.active_learning.report.statements import CLAIMS as ACTIVE_LEARNING
from dropout_uncertainty.data_efficiency.ablations.report import analysis as what_matters
from dropout_uncertainty.data_efficiency.ablations.report.statements import CLAIMS as WHAT_MATTERS
from dropout_uncertainty.data_efficiency.report import analysis as data_efficiency
from dropout_uncertainty.data_efficiency.report.statements import CLAIMS as DATA_EFFICIENCY
from dropout_uncertainty.exploration.report import analysis as exploration
from dropout_uncertainty.exploration.report import two_by_two
from dropout_uncertainty.exploration.report.deep_sea import analysis as deep_sea
from dropout_uncertainty.exploration.report.statements import CLAIMS as EXPLORATION
from dropout_uncertainty.judging.results import Claim, Result

__all__ = ["CLAIMS", "SECTIONS", "collect"]

#: Sections by the letters with which the ids of their claims begin.
SECTIONS = {"AL": "5.2 Active learning", "EX": "5.3 Exploration", "DE": "5.4 Data efficiency"}


CLAIMS: dict[str, Claim] = {
    claim.id: claim
    for claim in sorted(
        [*ACTIVE_LEARNING, *EXPLORATION, *DATA_EFFICIENCY, *WHAT_MATTERS],
        key=lambda claim: (list(SECTIONS).index(claim.id[:2]), int(re.sub(r"\D", "", claim.id))),
    )
}


def collect(folder: Path | None = None) -> list[Result]:
    """Return every number and verdict that the records of ``folder`` give, tables first, then claims.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    sections = (active_learning, pools, exploration, two_by_two, deep_sea, data_efficiency, what_matters)
    numbers = [number for section in sections for number in section.results(folder)]
    return numbers + [claim.judge(folder).result() for claim in CLAIMS.values()]
