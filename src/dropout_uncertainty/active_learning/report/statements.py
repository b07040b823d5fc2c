"""Claims AL1-AL9 of section 5.2 as code: quantity, rule, verdict. The rules were fixed before the published runs."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from dropout_uncertainty.active_learning.report.analysis import (
    EARLY,
    END,
    LABELS,
    Row,
    load_rows,
    original_rows,
    paired_error,
    share_tied,
)
from dropout_uncertainty.judging.results import (
    MIN_REPETITIONS,
    Claim,
    Part,
    Sign,
    Verdict,
    direction,
    missing,
    same_value,
    thesis_value,
)
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Interval, bootstrap_interval, first_crossing, t_interval

__all__ = ["CLAIMS"]

#: Acquired points from where the curves part to the last.
ALL = (100, 980)
NAMES = {"max-entropy": "Max Entropy", "variation-ratios": "Variation Ratios", "bald": "BALD"}

Parts = tuple[list[Part], list[Record]]


def claim(identifier: str, where: str, text: str, rule: str) -> Callable[[Callable[["UsedRows"], list[Part]]], Claim]:
    """Turn a function from the rows of config "ours" to parts into a claim; rows it asks for may be missing."""

    def decorate(function: Callable[["UsedRows"], list[Part]]) -> Claim:
        def measure(folder: Path | None) -> Parts:
            rows = load_rows("ours", folder)
            used = UsedRows(rows)
            return function(used), [record for name in used.used for record in rows[name].records]

        return Claim(identifier, text, where, rule, "5_2_active_learning", measure)

    return decorate


class UsedRows(dict[str, Row]):
    """The rows, remembering which were asked for; the records of those stand behind the verdict."""

    def __init__(self, rows: Mapping[str, Row]) -> None:
        super().__init__(rows)
        self.used: list[str] = []

    def having(self, *names: str) -> bool:
        """Return whether all the named rows exist, and note them."""
        if all(name in self for name in names):
            self.used += [name for name in names if name not in self.used]
            return True
        return False


def difference(
    rows: UsedRows, first: str, second: str, acquired: tuple[int, int], what: str, expected: Sign
) -> list[Part]:
    """Return the part "test error of first minus second over a range of acquired points"."""
    if not rows.having(first, second):
        return [missing(what)]
    interval = paired_error(rows[first], rows[second], *acquired)
    return [Part(what, interval, "points", direction(interval, expected=expected))]


def same(rows: UsedRows, table: str, quantity: Callable[[Row], Interval], unit: str) -> list[Part]:
    """Return one part for each cell that the table prints and we have."""
    parts = []
    for name, label in LABELS.items():
        printed = thesis_value(f"{table}/{name}")
        if printed is None:
            continue
        if not rows.having(name):
            parts.append(missing(label))
        else:
            interval = quantity(rows[name])
            parts.append(
                Part(f"{rows[name].label} (thesis {printed:g})", interval, unit, same_value(interval, printed))
            )
    return parts


@claim(
    "AL1", "Table 5.1",
    "Test error at 1000 labels: 4.57 % for Random, 2.18, 4.02 and 3.83 % for Softmax Max Entropy, Variation Ratios and "
    "BALD, 1.74, 1.64 and 1.72 % for their Dropout versions.",
    "cell by cell, at the last point: the printed value lies in our 95 % interval",
)  # fmt: skip
def al1(rows: UsedRows) -> list[Part]:
    return same(rows, "table-5.1", lambda row: row.last, "%")


@claim(
    "AL2", "Table 5.2",
    "Acquisitions until a test error of 5 %: 90 for Random; 53, 76 and 68 for Softmax Max Entropy, Variation Ratios "
    "and BALD; 35, 32 and 36 for their Dropout versions.",
    "cell by cell, plain first crossing of the mean curve: the printed value lies in our 95 % interval",
)  # fmt: skip
def al2(rows: UsedRows) -> list[Part]:
    return same(rows, "table-5.2", lambda row: row.crossing(), "acquisitions")


@claim(
    "AL3", "Figure 5.1",
    "BALD and Variation Ratios computed with MC dropout have a lower test error than their Softmax versions, early on "
    "and at the end.",
    "paired difference Dropout - Softmax is negative, over 100-400 and over 960-980 acquired points",
)  # fmt: skip
def al3(rows: UsedRows) -> list[Part]:
    return [
        part
        for name in ("bald", "variation-ratios")
        for when, acquired in (("early", EARLY), ("end", END))
        for part in difference(
            rows, f"dropout/{name}", f"softmax/{name}", acquired, f"Dropout - Softmax {NAMES[name]}, {when}", "negative"
        )
    ]


@claim(
    "AL4", "Section 5.2, text to Figure 5.1",
    "With MC dropout, Variation Ratios is ahead of BALD between about 150 and 400 acquired points, and BALD ahead of "
    "Variation Ratios before 150.",
    "paired difference Variation Ratios - BALD is negative over 150-400 and positive over 0-140 acquired points",
)  # fmt: skip
def al4(rows: UsedRows) -> list[Part]:
    pair = ("dropout/variation-ratios", "dropout/bald")
    return [
        *difference(rows, *pair, (150, 400), "Variation Ratios - BALD, 150-400", "negative"),
        *difference(rows, *pair, (0, 140), "Variation Ratios - BALD, 0-140", "positive"),
    ]


@claim(
    "AL5", "Figure 5.2",
    "Random acquisition is worse than BALD, Variation Ratios and Max Entropy with MC dropout.",
    "paired difference Random - Dropout is positive, over 100-400 and over 960-980 acquired points",
)  # fmt: skip
def al5(rows: UsedRows) -> list[Part]:
    return [
        part
        for name in NAMES
        for when, acquired in (("early", EARLY), ("end", END))
        for part in difference(
            rows, "random", f"dropout/{name}", acquired, f"Random - {NAMES[name]}, {when}", "positive"
        )
    ]


@claim(
    "AL6", "Table 5.2",
    "The Dropout versions reach 5 % test error in far fewer acquisitions than the Softmax versions.",
    "ratio of the first crossings of the mean curves, Dropout / Softmax, is below 1",
)  # fmt: skip
def al6(rows: UsedRows) -> list[Part]:
    parts = []
    for name in NAMES:
        if rows.having(f"dropout/{name}", f"softmax/{name}"):
            interval = crossing_ratio(rows[f"dropout/{name}"], rows[f"softmax/{name}"])
            verdict = direction(interval, expected="negative", null=1.0)
            parts.append(Part(f"Dropout / Softmax {NAMES[name]}", interval, "", verdict))
        else:
            parts.append(missing(f"Dropout / Softmax {NAMES[name]}"))
    return parts


def crossing_ratio(first: Row, second: Row, threshold: float = 5.0) -> Interval:
    """Return the ratio of the first crossings of two mean curves, with a bootstrap over common seeds.

    It is 0 if only the second never crosses, and NaN if the first does not.
    """
    common = [seed for seed in first.seeds if seed in second.seeds]
    curves = [row.error[[row.seeds.index(seed) for seed in common]] for row in (first, second)]

    def ratio(indices: np.ndarray) -> float:
        numerator, denominator = (first_crossing(c[indices].mean(0), threshold) for c in curves)
        return float(numerator / denominator) if np.isfinite(numerator) else np.nan

    return bootstrap_interval(ratio, len(common))


@claim(
    "AL7", "our finding; original code and data",
    "A deterministic network gives every point the same Variation Ratios and BALD score, so these two Softmax rows are "
    "random acquisition; a fair deterministic competitor is Least Confidence.",
    "all scores tie in every round; difference to Random over 100-980 acquired points has an interval that holds 0; "
    "Least Confidence is better than both, over the same range",
)  # fmt: skip
def al7(rows: UsedRows) -> list[Part]:
    parts = []
    for name in ("variation-ratios", "bald"):
        row = f"softmax/{name}"
        if rows.having(row, "random"):
            share = share_tied(rows[row])
            tied: Verdict = "replicated" if share == 1.0 else "not replicated"
            parts.append(
                Part(
                    f"Softmax {NAMES[name]}, rounds that tie",
                    Interval(100 * share, np.nan, np.nan, len(rows[row].seeds)),
                    "%",
                    tied,
                )
            )
            interval = paired_error(rows[row], rows["random"], *ALL)
            parts.append(Part(f"Softmax {NAMES[name]} - Random", interval, "points", same_value(interval, 0.0)))
        parts += difference(
            rows, "softmax/least-confidence", row, ALL, f"Least Confidence - Softmax {NAMES[name]}", "negative"
        )  # fmt: skip
    return parts


@claim(
    "AL8", "our finding; original code and data",
    "Table 5.1 prints the minimum of the mean curve, and mixes two networks, two weight decays and two pool sizes.",
    "the minimum of the recorded mean curves gives every printed cell to two decimals; the Random row as its script "
    "ran it ends higher than in the common setting",
)  # fmt: skip
def al8(rows: UsedRows) -> list[Part]:
    parts = []
    for name, row in original_rows().items():
        printed = thesis_value(f"table-5.1/{name}")
        equal: Verdict = "replicated" if round(row.minimum.value, 2) == printed else "not replicated"
        parts.append(Part(f"recorded {row.label} (thesis {printed})", row.minimum, "%", equal))
    recorded = load_rows("as-recorded")
    what = "Random as recorded - common setting, end"
    if "random" not in recorded or not rows.having("random"):
        parts.append(missing(what))
    else:
        interval = paired_error(recorded["random"], rows["random"], *END)
        parts.append(Part(what, interval, "points", direction(interval, expected="positive")))
    return parts


@claim(
    "AL9", "Section 5.2, third paragraph",
    "Bayesian CNNs work well with small amounts of data.",
    "along the labels of the Random row: the network without dropout has a higher test error; averaging over weight "
    "draws has not a higher one than weight scaling",
)  # fmt: skip
def al9(rows: UsedRows) -> list[Part]:
    parts = difference(rows, "random-without-dropout", "random", (0, 980), "without dropout - with dropout", "positive")
    if rows.having("random"):
        averaged = rows["random"].stack("mc_error")
        measured = ~np.isnan(averaged[0])
        interval = t_interval((rows["random"].error - averaged)[:, measured].mean(1))
        parts.append(Part("weight scaling - MC average", interval, "points", _not_negative(interval)))
    return parts


def _not_negative(interval: Interval) -> Verdict:
    if interval.n < MIN_REPETITIONS:
        return "undecided"
    return "replicated" if interval.high >= 0 else "not replicated"


CLAIMS: list[Claim] = [al1, al2, al3, al4, al5, al6, al7, al8, al9]
