"""Verdicts: pure functions of an estimate, a margin and what is claimed. Nothing else in the project makes one.

A statement is one sentence, one quantity, one verdict. Its estimate is of *ours minus the thesis's* for a printed
value, of *first minus second* for a comparison. Wide intervals never help a claim: what they leave open is
*imprecise* or *inconclusive*, and not finding a difference is no support for equality.
"""

import math
from collections.abc import Mapping
from typing import Literal

from dropout_uncertainty.stats import Estimate

__all__ = ["LEAST", "Side", "Verdict", "adjusted", "comparison", "equality", "holm", "small", "value"]

Verdict = Literal[
    "agrees", "differs", "imprecise",  # values
    "supported", "contradicted", "no difference", "inconclusive",  # comparisons and equalities
    "confirmed", "refuted",  # audits
    "untested",
]  # fmt: skip
Side = Literal["less", "more"]

#: Repetitions that any verdict but "untested" needs.
LEAST = 5
#: A family of primary statements keeps this rate of false findings.
LEVEL = 0.05


def enough(estimate: Estimate) -> bool:
    """Return whether an estimate can be judged at all."""
    return estimate.n >= LEAST and not math.isnan(estimate.low)


def within(estimate: Estimate, margin: float) -> bool:
    """Return whether the 90 % interval lies within ±margin: two one-sided tests at 5 %."""
    return -margin <= estimate.low90 and estimate.high90 <= margin


def value(difference: Estimate, margin: float) -> Verdict:
    """Judge "the thesis prints v" by the estimate of ours - v; the margin is in the same unit."""
    if not enough(difference):
        return "untested"
    if within(difference, margin):
        return "agrees"
    return "differs" if difference.low > 0 or difference.high < 0 else "imprecise"


def comparison(difference: Estimate, claimed: Side, margin: float) -> Verdict:
    """Judge "A is less (more) than B" by the estimate of A - B."""
    if claimed not in ("less", "more"):
        raise ValueError(f"a comparison claims less or more, got {claimed!r}")
    if not enough(difference):
        return "untested"
    if difference.high < 0 or difference.low > 0:
        return "supported" if (difference.high < 0) == (claimed == "less") else "contradicted"
    return "no difference" if within(difference, margin) else "inconclusive"


def equality(difference: Estimate, margin: float) -> Verdict:
    """Judge "A is as B" by the estimate of A - B."""
    if not enough(difference):
        return "untested"
    if within(difference, margin):
        return "supported"
    return "contradicted" if difference.low > margin or difference.high < -margin else "inconclusive"


def small(verdict: Verdict, difference: Estimate, margin: float) -> bool:
    """Return whether a difference was found that is too little to matter: its 90 % interval lies within ±margin."""
    return verdict in ("supported", "contradicted") and within(difference, margin)


def holm(p: Mapping[str, float]) -> dict[str, float]:
    """Return p-values adjusted together (Holm, 1979); NaN (untested) stays NaN but counts as one of the family."""
    adjusted_p, worst = dict(p), 0.0
    for rank, name in enumerate(sorted((n for n in p if not math.isnan(p[n])), key=lambda n: p[n])):
        worst = max(worst, min(1.0, (len(p) - rank) * p[name]))
        adjusted_p[name] = worst
    return adjusted_p


def adjusted(verdict: Verdict, p: float) -> Verdict:
    """Return the verdict of a primary statement given its adjusted p-value."""
    return "inconclusive" if verdict in ("supported", "contradicted") and not p < LEVEL else verdict
