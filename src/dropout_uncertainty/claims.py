"""All claims of sections 5.2-5.4 and all numbers of the book in one place."""

import re
from pathlib import Path

from dropout_uncertainty.active_learning import analysis as active_learning
from dropout_uncertainty.active_learning.claims import CLAIMS as ACTIVE_LEARNING
from dropout_uncertainty.data_efficiency import analysis as data_efficiency
from dropout_uncertainty.data_efficiency import what_matters_analysis as what_matters
from dropout_uncertainty.data_efficiency.claims import CLAIMS as DATA_EFFICIENCY
from dropout_uncertainty.data_efficiency.what_matters_claims import CLAIMS as WHAT_MATTERS
from dropout_uncertainty.exploration import analysis as exploration
from dropout_uncertainty.exploration.claims import CLAIMS as EXPLORATION
from dropout_uncertainty.records import Record
from dropout_uncertainty.results import Claim, Part, Result, missing

__all__ = ["CLAIMS", "SECTIONS", "WAITING", "collect"]

#: Sections by the letters with which the ids of their claims begin.
SECTIONS = {"AL": "5.2 Active learning", "EX": "5.3 Exploration", "DE": "5.4 Data efficiency"}


def waiting(identifier: str, where: str, text: str, rule: str) -> Claim:
    """Return a claim whose quantity is not computed yet: a text and a rule, and no records behind it."""

    def measure(_folder: Path | None) -> tuple[list[Part], list[Record]]:
        return [missing(rule)], []

    return Claim(identifier, text, where, rule, "5_4_data_efficiency", measure)


#: Claims for which there is no code yet. One that gets code leaves this list.
WAITING: list[Claim] = [
    waiting(
        "DE2", "Figure 5.7 and Figure 5.8",
        "Deep PILCO balances the pole within 20 to 25 trials.",
        "trial by which half of the repetitions are solved, and its distribution, as written and in our setting",
    ),
    waiting(
        "DE3", "Figure 5.8",
        "After one trial the model is of no use; after 10 it predicts about 13 steps and the pole is held for a "
        "second; after 20 a little better; from about 26 most trials are stable.",
        "steps until the true trial leaves two standard deviations of the prediction, at those trials",
    ),
    waiting(
        "DE9", "Figure 5.7",
        "Both need orders of magnitude fewer trials than model-free learners, which take 400 and 2500.",
        "trials to solve against the printed lines, once a model-free learner has been run on our cart-pole",
    ),
]  # fmt: skip

CLAIMS: dict[str, Claim] = {
    claim.id: claim
    for claim in sorted(
        [*ACTIVE_LEARNING, *EXPLORATION, *DATA_EFFICIENCY, *WHAT_MATTERS, *WAITING],
        key=lambda claim: (list(SECTIONS).index(claim.id[:2]), int(re.sub(r"\D", "", claim.id))),
    )
}


def collect(folder: Path | None = None) -> list[Result]:
    """Return every number and verdict that the records of ``folder`` give, tables first, then claims.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    sections = (active_learning, exploration, data_efficiency, what_matters)
    numbers = [number for section in sections for number in section.results(folder)]
    return numbers + [claim.judge(folder).result() for claim in CLAIMS.values()]
