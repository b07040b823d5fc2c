"""The statements of section 5.3: what the thesis says of Figure 5.4, and how our runs are held against it.

A batch is 500 ticks here, the interval at which the original program takes a point of its curve; batches of 200 ticks,
the unit of the program that it was made from, are shown beside.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from dropout_uncertainty.exploration.experiment import CONFIGS
from dropout_uncertainty.exploration.report.analysis import (
    BLOCK,
    BURN_IN,
    EARLY,
    LATE,
    TARGET,
    Curves,
    advantage,
    batches,
    held_out_gap,
    load,
    paired,
    ratio,
)
from dropout_uncertainty.exploration.report.deep_sea import analysis as deep_sea
from dropout_uncertainty.exploration.report.deep_sea import dives
from dropout_uncertainty.judging.results import printed
from dropout_uncertainty.judging.statements import (
    NEAR,
    Kind,
    Measured,
    Statement,
    audit,
    audited,
    needed,
    nothing,
    on_average,
    shifted,
)
from dropout_uncertainty.stats import (
    bootstrap_estimate,
    mean_estimate,
    median_interval,
    share_estimate,
    smaller_median,
    t_interval,
)

__all__ = ["STATEMENTS"]

CHAPTER, TWO_BY_TWO = "5_3_exploration", "5_3_is_it_exploration"
#: Margins: of rewards per move, of shares, and of squared TD errors, a tenth of their size.
MARGIN, MARGIN_SHARE, MARGIN_TD = 0.02, 0.1, 0.017
#: Batches from the end of the burn-in that the text counts.
CLAIMED = {agent: printed(f"figure-5.4/{agent}/first-crossing") for agent in ("thompson", "epsilon-greedy")}

Pair = tuple[Curves, Curves]


def agents(config: str, folder: Path | None, *policies: str) -> tuple[Curves, ...]:
    """Return the curves of some agents of a config; raises NotRun if one of them has no record."""
    found = load(config, folder)
    return tuple(needed(found.get(name)) for name in policies)


def records_of(*curves: Curves) -> list:
    """Return the records behind some curves."""
    return [record for one in curves for record in one.records]


# ------------------------------------------------------------------ Figure 5.4


def touched(config: str, folder: Path | None) -> Measured:
    """Return the share of Thompson runs that have reached 1 by batch 25, less the half from which "does" begins."""
    found = agents(config, folder, "thompson")
    by, runs = CLAIMED["thompson"], found[0].crossings()
    half = share_estimate(batches(runs) <= by, 0.5)
    short = share_estimate(batches(runs, 200) <= by, 0.0).interval
    beside = {"batches of 200 ticks": short}
    if text := load("as-written", folder).get("thompson"):
        beside["dropout where the text has it"] = share_estimate(batches(text.crossings()) <= by, 0.0).interval
    return Measured(half, shifted(half.interval, 0.5), found[0].records, beside)


def height(config: str, folder: Path | None) -> Measured:
    """Return the mean curve of Thompson sampling at batch 25, less 1."""
    found = agents(config, folder, "thompson")
    ends = {unit: int(BURN_IN + CLAIMED["thompson"] * unit) for unit in (500, 200)}
    above = {unit: mean_estimate(found[0].mean(end - BLOCK, end) - TARGET) for unit, end in ends.items()}
    beside = {"batches of 200 ticks": shifted(above[200].interval, TARGET)}
    return Measured(above[500], shifted(above[500].interval, TARGET), found[0].records, beside)


def beyond(curves: Curves) -> float:
    """Return the least batch at which a run that has not reached a reward by the end of its curve can reach it."""
    return float(batches(curves.ticks)[-1]) + 1


def arrival(config: str, folder: Path | None) -> Measured:
    """Return the median batch at which ε-greedy reaches 1, less the printed one."""
    found = agents(config, folder, "epsilon-greedy")
    when, claimed = batches(found[0].crossings()), CLAIMED["epsilon-greedy"]
    least = np.minimum(when, beyond(found[0]))
    late = bootstrap_estimate(
        lambda i: smaller_median(least[i]) - claimed, len(when), most=lambda i: smaller_median(when[i]) - claimed
    )
    beside = {"batches of 200 ticks": median_interval(batches(found[0].crossings(), 200))}
    return Measured(late, shifted(late.interval, claimed), found[0].records, beside)


def quicker(claimed: float, folder: Path | None) -> Measured:
    """Return how many times as many batches ε-greedy needs as Thompson sampling at the median, less what is claimed."""
    found = agents("ours", folder, "thompson", "epsilon-greedy")
    pair = paired(*found)
    fast, slow = (batches(curves.crossings()) for curves in pair)
    least_fast, least_slow = (np.minimum(when, beyond(x)) for when, x in zip((fast, slow), pair, strict=True))
    difference = bootstrap_estimate(
        lambda i: ratio(least_slow[i], fast[i]) - claimed, len(slow),
        most=lambda i: ratio(slow[i], least_fast[i]) - claimed,
    )  # fmt: skip
    beside = {}
    for words, config in (("one world", "as-demo"), ("dropout where the text has it", "as-written")):
        together = load(config, folder)
        if {"thompson", "epsilon-greedy"} <= together.keys():
            beside[words] = advantage(together, "thompson", "epsilon-greedy")
    return Measured(difference, shifted(difference.interval, claimed), records_of(*found), beside)


def gain(agent: str, folder: Path | None) -> Measured:
    """Return the mean reward over batches 1000-2000 from the burn-in minus that over 600-1000."""
    found = agents("as-demo", folder, agent)

    def later(unit: int) -> np.ndarray:
        start, middle, end = (BURN_IN + unit * count for count in (600, 1000, 2000))
        return found[0].mean(middle, end) - found[0].mean(start, middle)

    return on_average(later(500), found[0].records, beside={"batches of 200 ticks": t_interval(later(200))})


def late_moves(found: Pair) -> tuple[np.ndarray, ...]:
    """Return the share of moves after batch 1000 that are not the best of the network without dropout, by agent."""
    end = int(found[0].ticks[-1])
    return tuple(curves.share("explored", BURN_IN + 1000 * BLOCK, end) for curves in paired(*found))


def random_moves(folder: Path | None) -> Measured:
    """Return that share of Thompson sampling less that of ε-greedy."""
    found = agents("as-demo", folder, "thompson", "epsilon-greedy")
    first, second = late_moves((found[0], found[1]))
    return on_average(first - second, records_of(*found))


def only_exploits(folder: Path | None) -> Measured:
    """Return whether ε-greedy takes no other move than its best after batch 1000."""
    found = agents("as-demo", folder, "thompson", "epsilon-greedy")
    share = t_interval(late_moves((found[0], found[1]))[1])
    return Measured(audited(share.value == 0).difference, share, found[1].records)


def everywhere(_: Path | None) -> Measured:
    """Return whether the published program drops before every weight layer as the text says."""
    text, program = (CONFIGS[name].agents[0].drop for name in ("as-written", "as-demo"))
    return audited(program == text)


# ------------------------------------------------------------------ agents held against each other


def reward(first: str, second: str, ticks: tuple[int, int], folder: Path | None) -> Measured:
    """Return the reward per move of one of our agents less that of another, paired by seed."""
    found = agents("ours", folder, first, second)
    one, two = paired(*found)
    return on_average(one.mean(*ticks) - two.mean(*ticks), records_of(one, two))


def widths(quantity: Callable[[Curves], np.ndarray], first: str, second: str, folder: Path | None) -> Measured:
    """Return a quantity of one network less that of another (configs "narrow", "wide", "wide-dropout")."""
    one, two = paired(*(agents(name, folder, "epsilon-greedy")[0] for name in (first, second)))
    return on_average(quantity(one) - quantity(two), records_of(one, two))


def contrast(first: str, second: str, ticks: tuple[int, int], folder: Path | None) -> Measured:
    """Return the reward per move of one agent of the two-by-two family less that of another."""
    found = (next(iter(load(f"two-by-two/{name}", folder).values()), None) for name in (first, second))
    one, two = paired(*map(needed, found))
    return on_average(one.mean(*ticks, "reward") - two.mean(*ticks, "reward"), records_of(one, two))


def deeper(other: str, folder: Path | None) -> Measured:
    """Return the share of seas of size 10 that a draw held for an episode solves, less that of another agent."""
    seas = dives.load(folder)
    one, two = (needed(seas.get((name, 10))) for name in ("dropout-per-episode", other))
    difference = deep_sea.difference(one, two)
    return Measured(difference, difference.interval, [*one.records, *two.records])


# ------------------------------------------------------------------ the list

TEXT, FOOTNOTE, REMARK = "Section 5.3, text to Figure 5.4", "Section 5.3, footnote 4", "Section 5.3, Remark"
STADIE = "runs on the Atari games of Stadie et al. (2015), out of reach here; the thesis quotes the counts"


stated = partial(Statement, chapter=CHAPTER, unit="reward")
fact = partial(audit, chapter=CHAPTER)


def cut(
    identifier: str, text: str, where: str, first: str, second: str, ticks: tuple[int, int] = EARLY, *,
    kind: Kind = "more", primary: bool = False,
) -> Statement:  # fmt: skip
    """Return a statement about two agents that differ in how they learn, or act, or for how long they hold a draw."""
    return stated(
        identifier, text, where, kind, MARGIN, partial(contrast, first, second, ticks), primary=primary,
        would_test="20 runs of both agents in worlds of their own", chapter=TWO_BY_TWO,
    )  # fmt: skip


def dived(identifier: str, text: str, other: str, *, primary: bool = False) -> Statement:
    """Return a statement about the agent that holds a draw for an episode and another one, in Deep Sea."""
    return stated(
        identifier, text, "Section 5.3, first paragraph", "more", MARGIN_SHARE, partial(deeper, other), unit="share",
        primary=primary, would_test="40 runs of both agents in Deep Sea of size 10, 2,000 episodes each",
        chapter=TWO_BY_TWO,
    )  # fmt: skip


def quoted(identifier: str, text: str) -> Statement:
    """Return a statement about counts that the thesis quotes from Stadie et al. (2015)."""
    return stated(identifier, text, REMARK, "more", 0.0, nothing, unit="games", would_test=STADIE)


STATEMENTS: list[Statement] = [
    stated("EX1a", "By batch 25 more than half of the runs of Thompson sampling have reached a reward of 1.", TEXT,
           "more", MARGIN_SHARE, partial(touched, "ours"), unit="share", thesis=0.5),
    stated("EX1b", "At batch 25 the mean curve of Thompson sampling is above 1.", TEXT, "more", MARGIN,
           partial(height, "ours"), thesis=TARGET),
    stated("EX1c", "EX1a with both agents in one world, as in the original program.", TEXT, "more", MARGIN_SHARE,
           partial(touched, "as-demo"), unit="share", thesis=0.5),
    stated("EX1d", "EX1b with both agents in one world.", TEXT, "more", MARGIN, partial(height, "as-demo"),
           thesis=TARGET),
    *(
        stated(identifier, f"ε-greedy takes 175 batches to a reward of 1{words}.", TEXT, "value",
               NEAR * CLAIMED["epsilon-greedy"], partial(arrival, config), unit="batches",
               thesis=CLAIMED["epsilon-greedy"])
        for identifier, words, config in (("EX2a", "", "ours"), ("EX2b", ", both agents in one world", "as-demo"))
    ),
    stated("EX2c", "ε-greedy takes seven times as many batches as Thompson sampling.", TEXT, "value", NEAR * 7,
           partial(quicker, 7.0), unit="times", thesis=7.0),
    stated("EX2d", "Thompson sampling is the quicker of the two.", "Section 5.3, second paragraph", "more", NEAR,
           partial(quicker, 1.0), unit="times", thesis=1.0),
    stated("EX3a", "Thompson sampling stops improving after 1000 batches.", FOOTNOTE, "equality", MARGIN,
           partial(gain, "thompson")),
    stated("EX3b", "ε-greedy goes on improving after 1000 batches.", FOOTNOTE, "more", MARGIN,
           partial(gain, "epsilon-greedy")),
    cut("EX3c", "That is because Thompson sampling still draws: with masks off while acting it earns more late.",
        FOOTNOTE, "masks-off-late", "dropout-draw", (100_000, 200_000)),
    stated("EX3d", "After 1000 batches Thompson sampling leaves its best move more often than ε-greedy.", FOOTNOTE,
           "more", MARGIN_SHARE, random_moves, unit="share"),
    fact("EX3e", "ε-greedy only exploits after 1000 batches.", FOOTNOTE, only_exploits),
    fact("EX4", "In the published program dropout stands before every weight layer.", "Section 5.3, fourth paragraph",
         everywhere),
    *(
        stated(f"EX5{letter}", f"{words} earns more than Thompson sampling, {when}.", REMARK, "more", MARGIN,
               partial(reward, policy, "thompson", ticks))
        for letter, words, policy, when, ticks in (
            ("a", "Boltzmann exploration", "boltzmann", "early", EARLY),
            ("b", "Boltzmann exploration", "boltzmann", "late", LATE),
            ("c", "Annealed Thompson sampling", "annealed-thompson", "early", EARLY),
            ("d", "Annealed Thompson sampling", "annealed-thompson", "late", LATE),
        )
    ),
    stated("EX6a", "The wide network over-fits more than the narrow one.", "Section 5.3, fourth paragraph", "more",
           MARGIN_TD, partial(widths, held_out_gap, "wide", "narrow"), unit="squared TD error"),
    stated("EX6b", "Dropout lowers the over-fitting of the wide network.", "Section 5.3, second paragraph", "less",
           MARGIN_TD, partial(widths, held_out_gap, "wide-dropout", "wide"), unit="squared TD error"),
    stated("EX6c", "The wide network with dropout earns more than the narrow one without.",
           "Section 5.3, fourth paragraph", "more", MARGIN,
           partial(widths, lambda c: c.later("reward"), "wide-dropout", "narrow")),
    cut("EX7a", "An agent that acts on a draw of its weights earns more than one that acts on their mean.", TEXT,
        "dropout-draw", "dropout-mean", primary=True),
    cut("EX7b", "An agent that learns with dropout earns more than one that learns without.", TEXT,
        "dropout-mean", "plain-mean", primary=True),
    cut("EX7c", "Acting on a draw helps an agent that learned without dropout.", TEXT, "plain-draw", "plain-mean"),
    cut("EX7d", "The Thompson agent earns more than one with neither.", TEXT, "dropout-draw", "plain-mean"),
    cut("EX7e", "It earns more than ε-greedy, ticks 3,000 to 50,000.", TEXT, "dropout-draw", "epsilon-greedy"),
    cut("EX7f", "It earns more than ε-greedy whose schedule is ten times shorter.", TEXT, "dropout-draw",
        "epsilon-greedy-short"),
    *(
        cut(f"EX7{letter}", f"A draw held for {ticks:,} ticks earns more than one drawn anew at every tick.", TEXT,
            f"hold-{ticks}", "dropout-draw")
        for letter, ticks in zip("ghi", (10, 100, 1000), strict=True)
    ),
    quoted("EX8a", "On Atari, Thompson sampling beats DQN's score on more games (7) than it loses (6)."),
    quoted("EX8b", "On Atari, it learns faster than DQN on more games (8) than not (5), by area under the curve."),
    quoted("EX8c", "On Atari, Boltzmann exploration beats Thompson sampling's score on more games (8) than not (4)."),
    quoted("EX8d", "On Atari, it learns faster than Thompson sampling on more games (9) than not (3)."),
    dived("EX9", "Uncertainty tells an agent when to explore: an agent that holds a draw of its weights for an episode "
          "solves Deep Sea of size 10 more often than ε-greedy.", "epsilon-greedy", primary=True),
    dived("EX9b", "A draw held for an episode solves it more often than a draw per move.", "dropout-per-move"),
]  # fmt: skip
