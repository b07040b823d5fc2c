"""When do weight draws save labels? From the records of the four pools to errors, noise and paired differences."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from dropout_uncertainty.active_learning import mnist
from dropout_uncertainty.active_learning.experiment import CONFIGS, POOL_ROWS, SENSITIVITY, task_of
from dropout_uncertainty.active_learning.noisy_pools import Task
from dropout_uncertainty.active_learning.report.analysis import LABELS, Row, load_rows, paired
from dropout_uncertainty.judging.results import Result, listed
from dropout_uncertainty.judging.rules import Side
from dropout_uncertainty.judging.statements import Statement
from dropout_uncertainty.stats import in_words, mean_estimate, t_interval

__all__ = [
    "CONTRASTS", "MARGIN", "NOISE", "RANGE", "Contrast", "acquired", "contrast", "contrasts", "load", "mean_error",
    "noise", "results", "sensitivity", "side_of", "verdicts", "which_for_which",
]  # fmt: skip

#: Acquired points over which the test error is averaged.
RANGE = (100, 300)
#: What is wasted in each kind of pool.
NOISE = {"ambiguous": "ambiguous images", "repeated": "repetitions", "irrelevant": "irrelevant images"}
#: The comparisons of the chapter by the ids of their statements: pool, row, row that it is compared with.
CONTRASTS: dict[str, tuple[str, str, str]] = {
    "AL11": ("ambiguous", "dropout/bald", "softmax/max-entropy"),
    "AL11b": ("ambiguous", "dropout/bald", "random"),
    "AL11c": ("ambiguous", "dropout/max-entropy", "softmax/max-entropy"),
    # written down when its first five pairs had been seen
    "AL11m": ("ambiguous", "dropout/bald", "dropout/max-entropy"),
    "AL11d": ("ambiguous", "softmax/max-entropy", "random"),
    "AL11e": ("ambiguous", "dropout/variation-ratios", "softmax/least-confidence"),
    "AL12": ("ambiguous", "dropout/mean-std", "dropout/bald"),
    "AL11f": ("ambiguous", "dropout/bald", "ensemble/bald"),
    "AL3e": ("clean", "dropout/max-entropy", "softmax/max-entropy"),
    "AL11g": ("clean", "dropout/bald", "softmax/max-entropy"),
    "AL11h": ("clean", "dropout/bald", "ensemble/bald"),
    "AL11i": ("repeated", "dropout/bald", "softmax/max-entropy"),
    "AL11j": ("repeated", "dropout/batch-bald", "dropout/bald"),
    "AL11k": ("repeated", "dropout/power-bald", "dropout/bald"),
    "AL11l": ("irrelevant", "dropout/bald", "softmax/max-entropy"),
}
#: Those that claim a larger error; the others claim a smaller one.
LARGER = ("AL12",)
#: Differences of the test error below this are too small to matter [points].
MARGIN = 1.0


class Contrast(NamedTuple):
    """The test error in % of two rows on one pool, paired over the seeds that both have."""

    kind: str
    first: str
    second: str
    errors: tuple[Float[np.ndarray, " R"], Float[np.ndarray, " R"]]

    @property
    def difference(self) -> Float[np.ndarray, " R"]:
        """First minus second in points of %, one value per seed."""
        return self.errors[0] - self.errors[1]

    @property
    def label(self) -> str:
        """The two rows in words."""
        return f"{LABELS[self.first]} − {LABELS[self.second]}"


def load(family: str = "pools", folder: Path | None = None, *, published: bool = True) -> dict[str, dict[str, Row]]:
    """Return the recorded rows of each kind of pool; see ``analysis.load_rows``."""
    return {kind: load_rows(f"{family}/{kind}", folder, published=published) for kind in POOL_ROWS}


def mean_error(row: Row, points: tuple[int, int] = RANGE) -> Float[np.ndarray, " R"]:
    """Return each run's mean test error in % over a range of acquired points, or over all that a shorter run has."""
    return row.mean(points) if points[0] <= row.labels[-1] - row.labels[0] else row.error.mean(1)


def noise(row: Row) -> Float[np.ndarray, " R"]:
    """Return the share of what each run acquired that was noise or a repetition; not a number in a clean pool."""
    if any("wasted" not in record.arrays for record in row.records):
        return np.full(len(row.seeds), np.nan)
    return row.stack("wasted").astype(float).mean(1)


def contrast(pools: Mapping[str, Mapping[str, Row]], kind: str, first: str, second: str,
             points: tuple[int, int] = RANGE) -> Contrast:  # fmt: skip
    """Return a comparison over the seeds that both rows have; none of them where a row has not been run."""
    rows = [pools[kind][name] for name in (first, second) if name in pools[kind]]
    one, two = (mean_error(row, points) for row in paired(*rows)) if len(rows) == 2 else (np.zeros(0), np.zeros(0))
    return Contrast(kind, first, second, (one, two))


def contrasts(pools: Mapping[str, Mapping[str, Row]]) -> list[Contrast]:
    """Return the chapter's comparisons of rows that have been run."""
    found = (contrast(pools, *names) for names in CONTRASTS.values())
    return [pair for pair in found if len(pair.difference)]


def side_of(name: str) -> Side:
    """Return the side that a statement about a difference claims."""
    return "more" if name in LARGER else "less"


def verdicts(
    pools: Mapping[str, Mapping[str, Row]], statements: Mapping[str, Statement]
) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells of the statements about pools, by id; plain verdicts, not adjusted for their number."""
    cells: list[list[object]] = []
    for name, names in CONTRASTS.items():
        pair = contrast(pools, *names)
        found = mean_estimate(pair.difference)
        difference = in_words(found, ".1f") if found.n else "not run yet"
        verdict = statements[name].verdict(found)
        cells.append([name, pair.kind, pair.label, side_of(name), difference, found.n, verdict])
    points = f"points, {RANGE[0]} to {RANGE[1]} acquired [95 %]"
    return ["", "pool", "difference", "claimed", points, "seeds", "verdict"], cells


def which_for_which(pools: Mapping[str, Mapping[str, Row]]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells of the table: one line per row, its error and its share of noise on each pool."""
    heads = ["", *(f"{kind}: error [%]{', noise' if kind in NOISE else ''}" for kind in POOL_ROWS)]
    planned = {kind: ("random", *rows) for kind, rows in POOL_ROWS.items()}
    names = [name for name in LABELS if any(name in rows for rows in planned.values())]

    def cell(kind: str, name: str) -> str | None:
        if name not in planned[kind]:
            return None
        return "not run yet" if name not in pools[kind] else _cell(pools[kind][name])

    return heads, [[LABELS[name], *(cell(kind, name) for kind in POOL_ROWS)] for name in names]


def _cell(row: Row) -> str:
    interval, share = t_interval(mean_error(row)), noise(row).mean()
    return f"{in_words(interval, '.1f')} ({interval.n})" + ("" if np.isnan(share) else f", {share:.0%}")


def sensitivity(folder: Path | None = None) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: BALD over draws minus Max Entropy of one pass on ambiguous pools, setting by setting."""
    main = load_rows("pools/ambiguous", folder)
    settings = {"as above": main}
    for change, (_, names) in SENSITIVITY.items():
        # A row that the change does not concern is that of the main runs.
        same = {name: row for name, row in main.items() if name not in names}
        settings[change] = same | load_rows(f"pools-sensitivity/{change}", folder)
    cells: list[list[object]] = []
    for setting, rows in settings.items():
        pair = contrast({"ambiguous": rows}, *CONTRASTS["AL11"])
        found = mean_estimate(pair.difference)
        difference = in_words(found, ".1f") if found.n else "not run yet"
        cells.append([setting, difference, found.n])
    return ["", "difference [points]", "seeds"], cells


def acquired(kind: str, row: Row) -> tuple[Task, Int[np.ndarray, " n"]]:
    """Return what the first run of a row had to choose from, and what it asked for after the initial points."""
    task = task_of(CONFIGS[row.config], row.seeds[0], mnist.load())
    return task, row.stack("points")[0, len(task.split.initial) :]


def results(folder: Path | None = None) -> list[Result]:
    """Return ``pools/<pool>/<row>/error`` and ``/noise``."""
    found = []
    for kind, rows in load(folder=folder).items():
        for row in rows.values():
            error = f"mean test error over {RANGE[0]} to {RANGE[1]} acquired points"
            numbers = [("error", t_interval(mean_error(row)), "%", error)]
            if kind in NOISE:
                share = t_interval(100 * noise(row))
                numbers.append(("noise", share, "%", f"share of {NOISE[kind]} among the acquired points"))
            found += listed(f"pools/{kind}/{row.name}", numbers, row.records, row.config)
    return found
