"""The numbers of Deep Sea: who finds the treasure, who solves the sea and when, and how that grows with its size."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dropout_uncertainty.exploration.deep_sea.experiment import AGENTS, CONFIGS
from dropout_uncertainty.exploration.report.deep_sea.dives import FAMILY, HORIZON, LABELS, Dives, Seas, load
from dropout_uncertainty.exploration.report.deep_sea.growth import FORMS, growth
from dropout_uncertainty.judging.results import Result, listed, measured
from dropout_uncertainty.stats import Estimate, Interval, difference_of_shares, in_words, share_interval

__all__ = ["CONTRASTS", "coin", "difference", "growth_table", "not_run", "results", "score", "solved", "table"]

#: bsuite forgives this many episodes beyond 2^N.
FORGIVEN = 100
#: Agents whose shares of solved seas of size 10 are compared: statements EX9 and EX9b, and what another belief does.
CONTRASTS = (
    ("dropout-per-episode", "epsilon-greedy"),
    ("dropout-per-episode", "dropout-per-move"),
    ("ensemble-priors", "epsilon-greedy"),
    ("ensemble-priors", "dropout-per-episode"),
    ("ensemble", "epsilon-greedy"),
    ("ensemble", "dropout-per-episode"),
    ("ensemble-priors", "ensemble"),
)
SIZE = 10


def coin(size: int, episodes: int = HORIZON) -> float:
    """Return the probability of finding the treasure within some episodes by tossing a coin at every move."""
    return float(1 - (1 - 0.5**size) ** episodes)


def difference(first: Dives, second: Dives) -> Estimate:
    """Return the share solved by the first agent minus that by the second (statements EX9, EX9b)."""
    return difference_of_shares(first.within(), second.within())


def score(dives: Seas, agent: str) -> Interval:
    """Return bsuite's score over the sizes at hand: the share of seas solved before episode 2^N + 100."""
    mine = [d for (name, _), d in dives.items() if name == agent]
    return share_interval(np.concatenate([d.solved < 2**d.size + FORGIVEN for d in mine]))


def results(folder: Path | None = None) -> list[Result]:
    """Return what each agent found and solved in seas of each size, its score and growth, and ``CONTRASTS``."""
    dives = load(folder)
    found = [result for d in dives.values() for result in _of_size(d)]
    for agent in AGENTS:
        mine = [d for (name, _), d in dives.items() if name == agent]
        if mine:
            found += _of_agent(dives, agent, mine)
    for first, second in CONTRASTS:
        if (first, SIZE) in dives and (second, SIZE) in dives:
            one, two = dives[first, SIZE], dives[second, SIZE]
            found.append(
                measured(
                    f"{FAMILY}/contrast/{first}/{second}/{SIZE}", difference(one, two).interval,
                    [*one.records, *two.records], unit="share", config=f"{one.config}, {two.config}",
                    statistic=f"share of seas of size {SIZE} solved within {HORIZON} episodes, first minus second",
                )
            )  # fmt: skip
    return found


def _of_size(d: Dives) -> list[Result]:
    """Return the numbers of one agent in seas of one size."""
    of_found, in_all = share_interval(d.found <= HORIZON), share_interval(np.isfinite(d.solved))
    censored = "median of Kaplan and Meier; runs that end unsolved are censored, none: not reached"
    rows = [
        (f"solved-by-{HORIZON}", d.share(), "share", f"share of seas solved within {HORIZON} episodes"),
        (f"found-by-{HORIZON}", of_found, "share", f"share of seas whose treasure was found within {HORIZON} episodes"),
        ("share-solved", in_all, "share", f"share of seas solved within {CONFIGS[d.config].episodes} episodes"),
        ("episodes-to-solve", d.median(), "episodes", censored),
    ]
    return listed(f"{FAMILY}/{d.agent}/{d.size}", rows, d.records, d.config)


def _of_agent(dives: Seas, agent: str, mine: Sequence[Dives]) -> list[Result]:
    """Return the numbers of one agent over the sizes at hand."""
    sizes = ", ".join(str(d.size) for d in mine)
    before = f"bsuite's score: share of seas solved before episode 2^N + {FORGIVEN}; N = {sizes}"
    rows = [("score", score(dives, agent), "share", before)]
    if len(mine) > 1:
        for form, words in (("exponential", "2^(kN)"), ("power", "N^k")):
            statistic = f"k, where episodes to solve grow as {words}; N = {sizes}"
            rows.append((f"growth-{form}", growth(dives, agent, form), "exponent", statistic))
    return listed(f"{FAMILY}/{agent}", rows, [r for d in mine for r in d.records], f"{FAMILY}/{agent}")


# ------------------------------------------------------------------ tables


def not_run(dives: Seas, size: int) -> str:
    """Return a sentence that names the agents without runs in seas of this size; empty if there are none."""
    names = [label for agent, label in LABELS.items() if (agent, size) not in dives]
    return f"Not run yet in seas of size {size}: {'; '.join(names)}." if names else ""


def table(dives: Seas, sizes: Sequence[int]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: seas of each size that each agent solved, the median episode, and bsuite's score."""
    cells: list[list[object]] = []
    for agent, label in LABELS.items():
        row = [solved(dives.get((agent, size))) for size in sizes]
        ran = any((agent, size) in dives for size in sizes)
        cells.append([label, *row, _words(score(dives, agent)) if ran else None])
    return ["", *(f"N = {size}" for size in sizes), "bsuite's score"], cells


def solved(d: Dives | None) -> str:
    """Return how many seas an agent solved and, where half are, the median episode with its interval, in words."""
    if d is None:
        return "not run yet"
    found = d.median()
    median = f", {in_words(found, '.0f', unbounded='–')}" if np.isfinite(found.value) else ""
    return f"{np.isfinite(d.solved).sum()} of {found.n}{median}"


def growth_table(dives: Seas) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: the exponents of each agent that has dived in seas of two sizes or more."""
    lines: list[list[object]] = []
    for agent, label in LABELS.items():
        sizes = [size for name, size in dives if name == agent]
        if sizes:
            shown = [_words(growth(dives, agent, form)) if len(sizes) > 1 else "one size only" for form in FORMS]
            lines.append([label, ", ".join(map(str, sizes)), *shown])
    return ["", "sizes", "k of 2^(kN)", "k of N^k"], lines


def _words(found: Interval) -> str:
    if np.isnan(found.value):
        return "too few seas solved"
    words = in_words(found, unbounded="not bounded")
    return f"{words}, too few seas solved for an interval" if np.isnan(found.low) else words
