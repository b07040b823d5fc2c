"""All claims of sections 5.2-5.4 and all numbers of the book in one place."""

import re
from pathlib import Path

from dropout_uncertainty.active_learning import analysis as active_learning
from dropout_uncertainty.active_learning.claims import CLAIMS as ACTIVE_LEARNING
from dropout_uncertainty.data_efficiency import analysis as data_efficiency
from dropout_uncertainty.data_efficiency.claims import CLAIMS as DATA_EFFICIENCY
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
        "DE4", "Section 5.4.2",
        "Matching moments at every step is crucial: it penalises policies whose trajectories part, and smooths the "
        "gradient.",
        "Deep PILCO with and without it: success, bimodality of the particles, variance of the gradient",
    ),
    waiting(
        "DE5", "Section 5.4.2",
        "Fresh particles and masks at every step of Adam work, while fixed ones with BFGS get stuck in local optima.",
        "success of both optimisers with the same budget; bias of the objective against the number of particles",
    ),
    waiting(
        "DE6", "Section 5.4.2",
        "Without the correlation of the model's error over time uncertainty about the future is too small; one weight "
        "draw per trajectory repairs it.",
        "masks held or redrawn, moments matched or not: predicted variance and coverage of true trajectories",
    ),
    waiting(
        "DE7", "Section 5.4.1",
        "It is the uncertainty of the dynamics model that makes the learner data-efficient.",
        "trials to solve of the same learner with dropout and without",
    ),
    waiting(
        "DE8", "Sections 5.4 and 5.4.3",
        "Deep PILCO's time per trial does not grow with the number of trials and is linear in the dimensions; PILCO's "
        "grows with the square of both.",
        "exponents fitted to the time per trial against transitions, inputs and outputs",
    ),
    waiting(
        "DE10", "Section 5.4.2",
        "Few hyper-parameters need tuning.",
        "change of success with dropout probability, length-scale, learning rate and number of particles",
    ),
]  # fmt: skip

CLAIMS: dict[str, Claim] = {
    claim.id: claim
    for claim in sorted(
        [*ACTIVE_LEARNING, *EXPLORATION, *DATA_EFFICIENCY, *WAITING],
        key=lambda claim: (list(SECTIONS).index(claim.id[:2]), int(re.sub(r"\D", "", claim.id))),
    )
}


def collect(folder: Path | None = None) -> list[Result]:
    """Return every number and verdict that the records of ``folder`` give, tables first, then claims.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    numbers = active_learning.results(folder) + exploration.results(folder) + data_efficiency.results(folder)
    return numbers + [claim.judge(folder).result() for claim in CLAIMS.values()]
