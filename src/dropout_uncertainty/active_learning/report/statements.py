"""The statements of section 5.2: what the thesis says of tables and curves, and how our runs are held against it."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations
from operator import methodcaller
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dropout_uncertainty.active_learning.experiment import CONFIGS
from dropout_uncertainty.active_learning.report import pools
from dropout_uncertainty.active_learning.report.analysis import (
    EARLY,
    END,
    LABELS,
    THRESHOLD,
    Row,
    early_rows,
    load_rows,
    original_rows,
    paired,
    share_tied,
)
from dropout_uncertainty.judging.results import printed
from dropout_uncertainty.judging.statements import (
    NEAR,
    Kind,
    Measured,
    NotRun,
    Statement,
    audit,
    audited,
    needed,
    on_average,
    shifted,
)
from dropout_uncertainty.stats import Interval, Statistic, apart, bootstrap_estimate, first_crossings

__all__ = ["STATEMENTS", "ranges"]

TABLES, POOLS = "5_2_active_learning", "5_2_when_draws_help"
#: Margins in points of test error: over 100-400 acquired points, and at the end.
MARGIN, MARGIN_END = 0.5, 0.25
#: Acquired points over which a curve that has converged is flat.
LAST = (880, 980)
#: Cells of the tables in the order of their statements, and the scores that both kinds of networks can be given.
CELLS = [
    "random", "softmax/max-entropy", "softmax/variation-ratios", "softmax/bald",
    "dropout/max-entropy", "dropout/variation-ratios", "dropout/bald",
]  # fmt: skip
SCORES = {"bald": "BALD", "variation-ratios": "Variation Ratios", "max-entropy": "Max Entropy"}


stated = partial(Statement, chapter=TABLES)
fact = partial(audit, chapter=TABLES)


# ------------------------------------------------------------------ printed values


def lowest(curves: Float[np.ndarray, "R T"]) -> Statistic:
    """Return the minimum of the mean curve of three repetitions, mean over all triples: noise lowers a minimum."""
    triples = np.stack(np.meshgrid(*[np.arange(len(curves))] * 3, indexing="ij"), -1)
    minima = curves[triples].mean(-2).min(-1)  # [R, R, R]: a resample may hold a repetition more than once

    def statistic(indices: np.ndarray) -> Any:
        first, second, third = np.array(list(combinations(range(indices.shape[-1]), 3))).T
        return minima[indices[..., first], indices[..., second], indices[..., third]].mean(-1)

    return statistic


def crossing(curves: Float[np.ndarray, "R T"]) -> Statistic:
    """Return the acquisitions until the mean curve is at 5 %; infinite if it never is."""
    return lambda indices: first_crossings(curves[indices].mean(-2), THRESHOLD)


def crossing_at_least(curves: Float[np.ndarray, "R T"]) -> Statistic:
    """Return the same, but where it never is, the least that it can be: one more than there are."""
    return lambda indices: np.minimum(crossing(curves)(indices), curves.shape[1])


def cell(name: str, table: str, folder: Path | None) -> Measured:
    """Return a cell of Table 5.1 or 5.2: our statistic less that of the original program's curves, both resampled.

    The estimate counts our repetitions; the original program has three.
    """
    row = needed(load_rows("ours", folder).get(name))
    if len(row.error) < 3:
        raise NotRun
    least, most = (lowest, lowest) if table == "table-5.1" else (crossing_at_least, crossing)
    error, original = row.error, original_rows()[name].error
    difference = bootstrap_estimate(
        lambda i, j: least(error)(i) - most(original)(j), len(error), len(original),
        most=lambda i, j: most(error)(i) - least(original)(j),
    )  # fmt: skip
    beside = {"last point": row.last} if table == "table-5.1" else {"after a median of five": row.crossing(width=5)}
    if script := load_rows("as-recorded", folder).get(name):
        beside["as its script ran it"] = script.minimum if table == "table-5.1" else script.crossing()
    ours = bootstrap_estimate(least(error), len(error), most=most(error)).interval
    return Measured(difference._replace(n=len(error)), ours, row.records, beside)


def of_table(identifier: str, table: str, name: str) -> Statement:
    """Return the statement that a cell of a table makes."""
    value = printed(f"{table}/{name}")
    what = (
        f"{LABELS[name]}: test error {value:g} % with 1000 labels"
        if table == "table-5.1"
        else f"{LABELS[name]}: {value:g} acquisitions to a test error of 5 %"
    )
    return stated(
        identifier, f"{what}.", f"Table {table[-3:]}", "value", NEAR * value, partial(cell, name, table),
        unit="%" if table == "table-5.1" else "acquisitions", thesis=value,
    )  # fmt: skip


# ------------------------------------------------------------------ comparisons


def curves(first: str, second: str, acquired: tuple[int, int], folder: Path | None, family: str = "ours") -> Measured:
    """Return the test error of one row less that of another, paired by seed."""
    rows = early_rows(folder) if family == "ours" and acquired[1] <= EARLY[1] else load_rows(family, folder)
    one, two = (needed(rows.get(name)) for name in (first, second))
    shared = {*one.seeds} & {*two.seeds}
    used = [record for record in (*one.records, *two.records) if shared & {*record.seeds}]
    return on_average(apart(methodcaller("mean", acquired), one, two), used)


def compared(
    identifier: str, text: str, where: str, kind: Kind, first: str, second: str,
    acquired: tuple[int, int] = EARLY, *, primary: bool = False,
) -> Statement:  # fmt: skip
    """Return a statement about two rows of the tables."""
    margin = MARGIN_END if acquired == END else MARGIN
    measure = partial(curves, first, second, acquired)
    return stated(identifier, text, where, kind, margin, measure, unit="points", primary=primary)


def in_pool(name: str, text: str, where: str, *, primary: bool = False) -> Statement:
    """Return a statement about two rows on one of the pools of "When do weight draws help?"."""
    pool, first, second = pools.CONTRASTS[name]
    measure = partial(curves, first, second, pools.RANGE, family=f"pools/{pool}")
    return stated(
        name, text, where, pools.side_of(name), pools.MARGIN, measure, unit="points", primary=primary,
        would_test=f"20 runs of both rows on the {pool} pool", chapter=POOLS,
    )  # fmt: skip


def ratio(score: str, folder: Path | None) -> Measured:
    """Return acquisitions to 5 % with weight draws by those without, less the 0.8 from which "far fewer" begins."""
    rows = load_rows("ours", folder)
    both = paired(*(needed(rows.get(f"{kind}/{score}")) for kind in ("dropout", "softmax")))
    first, second = (row.error for row in both)
    difference = bootstrap_estimate(
        lambda i: crossing_at_least(first)(i) / crossing(second)(i) - 0.8, len(first),
        most=lambda i: crossing(first)(i) / crossing_at_least(second)(i) - 0.8,
    )  # fmt: skip
    return Measured(difference, shifted(difference.interval, 0.8), [record for row in both for record in row.records])


def averaging(folder: Path | None) -> Measured:
    """Return the test error of weight scaling less that of an average over draws, where both were measured."""
    row = needed(load_rows("ours", folder).get("random"))
    averaged = row.stack("mc_error")
    return on_average((row.error - averaged)[:, ~np.isnan(averaged[0])].mean(1), row.records)


def slope(name: str, folder: Path | None) -> Measured:
    """Return by how much the last 100 labels change the test error of a row."""
    row = needed(load_rows("ours", folder).get(name))
    return on_average(rise(row), row.records)


def rise(row: Row) -> Float[np.ndarray, " R"]:
    """Return by how many points a line through the last eleven points of each curve, 900 to 1000 labels, rises."""
    last = row.labels >= row.labels[-1] - 100
    return 100 * np.polyfit(row.labels[last], row.error[:, last].T, 1)[0]


# ------------------------------------------------------------------ audits


def all_tied(name: str, folder: Path | None) -> Measured:
    """Return whether every candidate had the same score in every round of a row."""
    row = needed(load_rows("ours", folder).get(name))
    share = share_tied(row)
    return Measured(audited(share == 1.0).difference, Interval(share, np.nan, np.nan, len(row.seeds)), row.records)


def minima(_: Path | None) -> Measured:
    """Return whether the minimum of the recorded mean curves gives every printed cell to two decimals."""
    lows = {name: float(row.error.mean(0).min()) for name, row in original_rows().items()}
    return audited(all(round(low, 2) == printed(f"table-5.1/{name}") for name, low in lows.items()))


def mixed(field: str, _: Path | None) -> Measured:
    """Return whether the scripts behind the cells differ in a field of their configs."""
    return audited(len({getattr(CONFIGS[f"as-recorded/{name}"], field) for name in CELLS}) > 1)


# ------------------------------------------------------------------ the list

FIGURE_1, FIGURE_2, WORDS = "Figure 5.1", "Figure 5.2", "Section 5.2, text to Figure 5.1"
DRAW, PASS = "dropout/max-entropy", "softmax/max-entropy"

STATEMENTS: list[Statement] = [
    *(of_table(f"AL1{letter}", "table-5.1", name) for letter, name in zip("abcdefg", CELLS, strict=True)),
    *(of_table(f"AL2{letter}", "table-5.2", name) for letter, name in zip("abcdefg", CELLS, strict=True)),
    *(
        compared(
            f"AL3{letter}", f"{SCORES[score]} over weight draws errs less than Softmax {SCORES[score]} {when}.",
            FIGURE_1, "less", f"dropout/{score}", f"softmax/{score}", acquired,
        )
        for letter, score, when, acquired in (
            ("a", "bald", "early", EARLY), ("b", "bald", "at the end", END),
            ("c", "variation-ratios", "early", EARLY), ("d", "variation-ratios", "at the end", END),
        )
    ),
    in_pool(
        "AL3e", "The entropy over weight draws chooses better labels than the entropy of one pass of the network.",
        WORDS, primary=True,
    ),
    compared("AL3f", "The same in the rows of the tables, at the end.", WORDS, "less", DRAW, PASS, END),
    compared("AL3g", "The same in the rows of the tables, early.", WORDS, "less", DRAW, PASS),
    compared(
        "AL4a", "Variation Ratios is ahead of BALD between 150 and 400 acquired points.", WORDS, "less",
        "dropout/variation-ratios", "dropout/bald", (150, 400),
    ),
    compared(
        "AL4b", "BALD is ahead of Variation Ratios before 150 acquired points.", WORDS, "more",
        "dropout/variation-ratios", "dropout/bald", (0, 140),
    ),
    compared("AL5a", "Labels chosen at random are worse than those of BALD, early.", FIGURE_2, "more",
             "random", "dropout/bald"),
    compared("AL5b", "Labels chosen at random are worse than those that Variation Ratios asks for, early.", FIGURE_2,
             "more", "random", "dropout/variation-ratios", primary=True),
    compared("AL5c", "Labels chosen at random are worse than those of Max Entropy, early.", FIGURE_2, "more",
             "random", "dropout/max-entropy"),
    *(
        compared(f"AL5{letter}", f"Labels chosen at random are worse than those of {SCORES[score]}, at the end.",
                 FIGURE_2, "more", "random", f"dropout/{score}", END)
        for letter, score in (("d", "bald"), ("e", "variation-ratios"), ("f", "max-entropy"))
    ),
    *(
        stated(
            f"AL6{letter}", f"{SCORES[score]} over weight draws needs far fewer acquisitions to 5 % than its Softmax "
            "version: less than 0.8 times as many.", "Table 5.2", "less", 0.1, partial(ratio, score), thesis=0.8,
        )
        for letter, score in (("a", "max-entropy"), ("b", "variation-ratios"), ("c", "bald"))
    ),
    fact("AL7a", "Softmax BALD cannot choose: all candidates have the same score in every round.", FIGURE_1,
         partial(all_tied, "softmax/bald")),
    fact("AL7b", "Softmax Variation Ratios cannot choose: all candidates have the same score in every round.",
         FIGURE_1, partial(all_tied, "softmax/variation-ratios")),
    fact("AL8a", "Table 5.1 prints the minima of the recorded mean curves.", "Table 5.1", minima),
    fact("AL8b", "The rows of the tables come from two networks.", "Tables 5.1 and 5.2", partial(mixed, "kernel")),
    fact("AL8c", "They come from two weight decays.", "Tables 5.1 and 5.2", partial(mixed, "decay")),
    fact("AL8d", "They search different parts of the pool.", "Tables 5.1 and 5.2", partial(mixed, "subset")),
    compared("AL9a", "With 20 to 100 labels, dropout in training lowers the test error.", "Section 5.2, paragraph 3",
             "more", "random-without-dropout", "random", (0, 80)),
    compared("AL9b", "With 100 to 400 labels it does so too.", "Section 5.2, paragraph 3", "more",
             "random-without-dropout", "random", (80, 380)),
    stated("AL9c", "An average over weight draws predicts as well as weight scaling.", "Section 5.2, paragraph 4",
           "equality", MARGIN_END, averaging, unit="points"),
    *(
        stated(f"AL10{letter}", f"The test error of {LABELS[name]} has converged at 1000 labels.",
               "Section 5.2, text to Table 5.1", "equality", 0.1, partial(slope, name), unit="points per 100 labels")
        for letter, name in zip("abcd", ("random", *(f"dropout/{score}" for score in SCORES)), strict=True)
    ),
    in_pool("AL11", "Where images are ambiguous, BALD over weight draws chooses better labels than the entropy of one "
            "pass.", WORDS, primary=True),
    *(
        in_pool(name, f"{LABELS[first]} errs less than {LABELS[second]} on the {pool} pool.", WORDS)
        for name, (pool, first, second) in sorted(pools.CONTRASTS.items())
        if name.startswith("AL11") and name != "AL11"
    ),
    in_pool("AL12", "Mean STD is not the best summary: worse than BALD on the ambiguous pool.", "Footnote 1"),
    *(
        compared(f"AL12{letter}", f"Mean STD is worse than {SCORES[score]} in the rows of the tables.", "Footnote 1",
                 "more", "dropout/mean-std", f"dropout/{score}")
        for letter, score in zip("bcd", SCORES, strict=True)
    ),
]  # fmt: skip


def ranges() -> Iterator[tuple[Statement, Callable[..., Any], tuple[str, ...], tuple[int, int]]]:
    """Return which statements read off the curves of rows of the tables, and over which acquired points.

    The statement, a function of the rows that gives a number for each seed, the names of these rows, and the range.
    """
    for statement in STATEMENTS:
        match statement.measure:
            case partial(func=func, args=(first, second, acquired), keywords={**others}) if func is curves:
                if not others:  # else it is about a pool
                    yield statement, partial(apart, methodcaller("mean", acquired)), (first, second), acquired
            case partial(func=func, args=(name,)) if func is slope:
                yield statement, rise, (name,), LAST
