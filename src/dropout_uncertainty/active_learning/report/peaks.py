"""The peaks of the curves of section 5.2, where the last minibatch of an epoch is left with a few images."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from dropout_uncertainty.active_learning.experiment import OURS
from dropout_uncertainty.active_learning.report import statements
from dropout_uncertainty.active_learning.report.analysis import THRESHOLD, Row, load_rows, original_rows, paired_curves
from dropout_uncertainty.judging.statements import Statement
from dropout_uncertainty.stats import first_crossings, in_words, mean_estimate

__all__ = ["EVEN", "TAIL", "at_peaks", "excess", "flattened", "in_tables", "last_minibatch", "runs", "table", "touched"]

#: At a peak the last minibatch of an epoch holds at most so many images.
FEW = 4
#: Two runs on the same labels, which differ in what the last minibatch of an epoch is.
TAIL, EVEN = "the last minibatch is what is left", "minibatches of equal size"

Curves = Float[np.ndarray, "R T"]


def last_minibatch(labels: Int[np.ndarray, " T"]) -> Int[np.ndarray, " T"]:
    """Return how many images the last minibatch of an epoch holds if it is what is left."""
    return (np.asarray(labels) - 1) % OURS.batch + 1


def at_peaks(labels: Int[np.ndarray, " T"]) -> Bool[np.ndarray, " T"]:
    """Return at which numbers of labels the last minibatch would hold at most ``FEW`` images; not at either end."""
    found = last_minibatch(labels) <= FEW
    found[[0, -1]] = False
    return found


def excess(labels: Int[np.ndarray, " T"], curves: Curves) -> dict[int, Float[np.ndarray, " R"]]:
    """Return how far each curve lies above the mean of its two neighbours, by the numbers of labels at peaks."""
    return {int(labels[t]): curves[:, t] - curves[:, [t - 1, t + 1]].mean(1) for t in np.flatnonzero(at_peaks(labels))}


def flattened(row: Row) -> Row:
    """Return a row whose error at each peak is the mean of its two neighbours."""
    error = row.error.copy()
    for labels, height in excess(row.labels, row.error).items():
        error[:, row.labels == labels] -= height[:, None]
    return replace(row, error=error)


def runs(folder: Path | None = None) -> dict[str, Row]:
    """Return the two runs of random acquisition, as far as there are records."""
    families = {TAIL: "ours", EVEN: "pools/clean"}
    rows = {words: load_rows(family, folder).get("random") for words, family in families.items()}
    return {words: row for words, row in rows.items() if row}


def table(found: Mapping[str, Row]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: how far the error of random acquisition at each peak lies above its neighbours."""
    original = original_rows()["random"]
    heights = {"original program": excess(original.labels, original.error)}
    heights |= {words: excess(row.labels, row.error) for words, row in found.items()}
    difference = "the first less the second, same seeds"
    if {TAIL, EVEN} <= found.keys():
        acquired, curves = paired_curves(found[TAIL], found[EVEN])
        heights[difference] = excess(acquired + found[TAIL].labels[0], curves)
    peaks = list(heights["original program"])
    cells: list[list[object]] = [["images in the last minibatch", *last_minibatch(np.array(peaks)).tolist()]]
    for words in ("original program", TAIL, EVEN, difference):
        there = heights.get(words)
        cells.append([words, *("not run yet" if there is None else _cell(there.get(labels)) for labels in peaks)])
    return ["", *(f"{labels} labels" for labels in peaks)], cells


def _cell(heights: Float[np.ndarray, " R"] | None) -> str | None:
    return None if heights is None else f"{in_words(mean_estimate(heights), '.1f')} ({len(heights)})"


def touched(folder: Path | None = None) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: the ranges that statements rest on, the peaks in each, and what these change.

    That is the largest change of a statement's number when each peak is replaced by the mean of its neighbours.
    """
    rows = load_rows("ours", folder)
    flat = {name: flattened(row) for name, row in rows.items()}
    found: dict[tuple[int, int], list[tuple[float, Statement]]] = {}
    for statement, measure, names, reach in statements.ranges():
        if set(names) <= rows.keys():
            before, after = (float(np.mean(measure(*(curves[name] for name in names)))) for curves in (rows, flat))
            found.setdefault(reach, []).append((abs(before - after), statement))
    cells: list[list[object]] = []
    for (start, stop), changes in sorted(found.items()):
        labels = np.arange(start, stop + 1, OURS.acquired) + 10 * OURS.per_class
        few = labels[last_minibatch(labels) <= FEW]
        change, most = max(changes, key=lambda one: one[0])
        cells.append([
            f"{start} to {stop}", " ".join(statement.id for _, statement in changes),
            ", ".join(map(str, few)) or "none", f"{change:.2f} ({most.id})" if len(few) else None, most.margin,
        ])  # fmt: skip
    return ["acquired", "statements", "peaks, at labels", "largest change without them [points]", "margin"], cells


def in_tables(folder: Path | None = None) -> str:
    """Return how high the peaks are, and which numbers of Tables 5.1 and 5.2 would change without them."""
    rows = {f"{row.label}, original": row for row in original_rows().values()}
    rows |= {f"{row.label}, ours": row for row in load_rows("ours", folder).values()}
    highest, where = max((float(row.error[:, at_peaks(row.labels)].max()), name) for name, row in rows.items())
    changed = [name for name, row in rows.items() if _printed(row) != _printed(flattened(row))]
    return (
        f"The highest error of a repetition at a peak is {highest:.0f} % ({where}). If every peak is replaced by the "
        "mean of its neighbours, the minima of Table 5.1 and the crossings of Table 5.2 "
        + (f"change for {'; '.join(changed)}." if changed else "stay as they are, in every row, ours and the original.")
    )


def _printed(row: Row) -> tuple[float, float]:
    """Return the minimum of the mean curve and its first crossing."""
    mean = row.error.mean(0)
    return float(mean.min()), float(first_crossings(mean, THRESHOLD))
