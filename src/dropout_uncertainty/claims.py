"""All claims of sections 5.2-5.4 and all numbers of the book in one place."""

from pathlib import Path

from dropout_uncertainty.active_learning import analysis as active_learning
from dropout_uncertainty.active_learning.claims import CLAIMS as ACTIVE_LEARNING
from dropout_uncertainty.exploration import analysis as exploration
from dropout_uncertainty.exploration.claims import CLAIMS as EXPLORATION
from dropout_uncertainty.results import Claim, Result

__all__ = ["CLAIMS", "collect"]

CLAIMS: dict[str, Claim] = {claim.id: claim for claim in [*ACTIVE_LEARNING, *EXPLORATION]}


def collect(folder: Path | None = None) -> list[Result]:
    """Return every number and verdict that the records of ``folder`` give, tables first, then claims.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    numbers = active_learning.results(folder) + exploration.results(folder)
    return numbers + [claim.judge(folder).result() for claim in CLAIMS.values()]
