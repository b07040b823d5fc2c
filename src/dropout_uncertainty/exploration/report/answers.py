"""What the runs of "Is it exploration?" say, in sentences no stronger than their intervals.

A sentence about two agents follows from the verdict of its statement (``judging.rules``): who is ahead, that they are
level to within the margin, that the runs do not tell, or that there are none.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropout_uncertainty.exploration.report.deep_sea import analysis as sea
from dropout_uncertainty.exploration.report.deep_sea.dives import HORIZON, LABELS, Seas
from dropout_uncertainty.exploration.report.statements import STATEMENTS
from dropout_uncertainty.judging.rules import Verdict
from dropout_uncertainty.judging.statements import Judged, judge
from dropout_uncertainty.stats import Estimate, in_digits, share_interval

__all__ = [
    "COMPARED", "READINGS", "Compared", "answer", "beside_a_coin", "exploration", "found", "judged", "sentence",
    "sentences", "without_priors",
]  # fmt: skip


class Compared(NamedTuple):
    """Two agents of a statement as a sentence names them."""

    first: str
    second: str


class Words(NamedTuple):
    """How a difference in one unit is told."""

    more: str
    less: str
    level: str
    open: str
    unit: str


WORDS = {
    "reward": Words("earns **more**", "earns **less**", "earns as much as", "earns more or less", "a move"),
    "share": Words(
        "solves **more** seas", "solves **fewer** seas", "solves as many seas as", "solves more or fewer seas",
        "of the seas",
    ),
}  # fmt: skip
DRAW = "an agent that acts on a draw"
HOLDS, FRESH = "an agent that holds a draw for {} ticks", "one that draws anew at every tick"
EPISODE = "an agent that holds a draw of dropout for an episode"
#: The agents of the statements of this page.
COMPARED = {
    "EX3c": Compared("from tick 100,000 on, an agent with its masks off while it acts", "the same agent with them on"),
    "EX7a": Compared(f"with dropout in learning, {DRAW}", "one that acts on the mean of the same weights"),
    "EX7b": Compared("among agents that act on the mean, one that learns with dropout", "one that learns without"),
    "EX7c": Compared(f"without dropout in learning, {DRAW}", "one that acts on the mean"),
    "EX7d": Compared("the Thompson agent, which learns with dropout and acts on a draw,", "one that does neither"),
    "EX7e": Compared("the Thompson agent", "ε-greedy"),
    "EX7f": Compared("the Thompson agent", "ε-greedy with a schedule ten times shorter"),
    "EX7g": Compared(HOLDS.format("10"), FRESH),
    "EX7h": Compared(HOLDS.format("100"), FRESH),
    "EX7i": Compared(HOLDS.format("1,000"), FRESH),
    "EX9": Compared(EPISODE, "ε-greedy"),
    "EX9b": Compared(EPISODE, "one that draws anew at every move"),
}  # fmt: skip


def judged(folder: Path | None = None) -> dict[str, Judged]:
    """Return the statements of section 5.3 by id; primary ones are adjusted for each other."""
    return {j.statement.id: j for j in judge(STATEMENTS, folder)}


def sentence(j: Judged) -> str:
    """Return what the runs say about one of ``COMPARED``."""
    first, second = COMPARED[j.statement.id]
    first, words = first[0].upper() + first[1:], WORDS[j.statement.unit]
    if j.measured is None:
        return f"{first} against {second}: not run yet."
    difference = j.measured.difference
    if j.verdict == "untested":
        return f"{first} against {second}: too few runs to tell ({j.why})."
    if j.verdict == "inconclusive":
        return f"{first}: whether it {words.open} than {second}, these runs do not tell ({number(difference, words)})."
    if j.verdict == "no difference":
        level = number(difference, words, level=90)
        return f"{first} {words.level} {second}, to within {j.statement.margin:g} ({level})."
    ahead = words.more if difference.value > 0 else words.less
    return f"{first} {ahead} than {second} ({number(difference, words)}{'; too little to matter' if j.small else ''})."


def number(found: Estimate, words: Words, level: int = 95) -> str:
    """Return a difference with its interval; equality is judged by that of 90 %."""
    limits = found[1:3] if level == 95 else found[3:5]
    value, low, high = (in_digits(x, "+.3f") for x in (found.value, *limits))
    return f"{value} {words.unit}, {level} % interval {low} to {high}, {found.n} seeds"


def sentences(all_judged: Mapping[str, Judged], *names: str) -> str:
    """Return the sentences of some statements as one paragraph."""
    return " ".join(sentence(all_judged[name]) for name in names)


def found(dives: Seas, size: int, episodes: int = HORIZON) -> str:
    """Return how often each agent has found the treasure, and found it again, beside a coin; as Markdown."""
    lines = []
    for d in (d for (_, n), d in dives.items() if n == size):
        in_time = d.found <= episodes
        later = d.again[in_time & ~np.isnan(d.again)]
        again = f", then again in {100 * later.mean():.1f} % of the episodes that it went on for" if len(later) else ""
        lines.append(f"- {d.label}: found in {in_time.sum()} of {len(d.seeds)} seas{again}")
    if not lines:
        return "Not run yet."
    share = sea.coin(size, episodes)
    return "\n".join([f"A coin at every move would find the treasure in {100 * share:.0f} % of the seas.", "", *lines])


#: What follows from a statement, by verdict.
READINGS: dict[str, dict[Verdict, str]] = {
    "EX3c": {
        "supported": "So the draws are what holds the agent back, as the footnote says.",
        "contradicted": "So in this time it is not its draws that hold the agent back: without them it earns less.",
        "no difference": "So in this time it is not its draws that hold the agent back: without them it earns as much.",
        "inconclusive": "So the footnote's reason stays open.",
        "untested": "So the footnote's reason stays open.",
    },
    "EX7f": {
        "supported": "So its lead is more than one over ε-greedy's schedule.",
        "contradicted": "So its lead in the thesis is over a long schedule: with a shorter one ε-greedy leads.",
        "no difference": "So its lead over ε-greedy in the thesis is one over ε-greedy's schedule.",
        "inconclusive": "So these runs leave open whether its lead is more than one over ε-greedy's schedule.",
        "untested": "So whether its lead is more than one over ε-greedy's schedule is still open.",
    },
    "EX9": {
        "supported": "So a draw of dropout that is held explores better than ε-greedy.",
        "contradicted": "So holding a draw is not enough: it matters what is drawn.",
        "no difference": "So a held draw of dropout explores as well as ε-greedy, and no better.",
        "inconclusive": "So these runs leave open whether a held draw of dropout explores better than ε-greedy.",
        "untested": "So whether a held draw of dropout explores better than ε-greedy is still open.",
    },
}


def answer(all_judged: Mapping[str, Judged], name: str) -> str:
    """Return what the runs say about a statement of ``READINGS``, and what follows."""
    return f"{sentence(all_judged[name])} {READINGS[name][all_judged[name].verdict]}"


def exploration(all_judged: Mapping[str, Judged], dives: Seas) -> str:
    """Return the page's answer to "uncertainty decides when to explore", as the data have it."""
    against = [_ensemble(dives, other) for other in ("dropout-per-episode", "epsilon-greedy")]
    parts = [answer(all_judged, "EX9"), beside_a_coin(dives), *(words for _, words in against)]
    if all(difference is not None and difference.low > 0 for difference, _ in against):
        parts.append("So draws that are held can explore, if they come from another belief than that of dropout.")
    parts.append(without_priors(dives))
    return " ".join(filter(None, parts))


def beside_a_coin(dives: Seas, size: int = sea.SIZE) -> str:
    """Return how often held draws of dropout find the treasure, and how often a coin would; empty without runs."""
    if ("dropout-per-episode", size) not in dives:
        return ""
    value, low, high, n = share_interval(dives["dropout-per-episode", size].found <= HORIZON)
    coin = sea.coin(size)
    ends = f"{100 * low:.0f} to {100 * high:.0f}"
    side = "more than" if low > coin else "fewer than" if high < coin else "which holds"
    return (
        f"Held for an episode, draws of dropout find the treasure within {HORIZON:,} episodes in {100 * value:.0f} % "
        f"of {n} seas (95 % interval {ends}), {side} the {100 * coin:.0f} % in which a coin at every move would."
    )


def without_priors(dives: Seas, size: int = sea.SIZE) -> str:
    """Return how many seas an ensemble solves without priors and with them, and when; empty without runs of both."""
    if not {("ensemble", size), ("ensemble-priors", size)} <= dives.keys():
        return ""
    without, those = (sea.solved(dives[agent, size]) for agent in ("ensemble", "ensemble-priors"))
    return f"Seas that the ensemble solves, and the median episode: without priors {without}; with them {those}."


def _ensemble(dives: Seas, other: str, size: int = sea.SIZE) -> tuple[Estimate | None, str]:
    """Return the share that the ensemble with priors solves less that of another agent, and a sentence."""
    name = f"An ensemble of ten networks with priors, against *{LABELS[other]}*:"
    if not {("ensemble-priors", size), (other, size)} <= dives.keys():
        return None, f"{name} not run yet."
    difference, words = sea.difference(dives["ensemble-priors", size], dives[other, size]), WORDS["share"]
    if difference.low <= 0 <= difference.high:
        ahead = "solves neither visibly more seas nor fewer"
    else:
        ahead = words.more if difference.value > 0 else words.less
    return difference, f"{name} it {ahead} ({number(difference, words)})."
