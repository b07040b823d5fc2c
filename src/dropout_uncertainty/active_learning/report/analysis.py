"""From records to the numbers of Tables 5.1 and 5.2 and of statements. Nothing is run and nothing is drawn here."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from dropout_uncertainty.active_learning.experiment import EXPERIMENT, ROWS
from dropout_uncertainty.judging.results import Result, measured, thesis_value
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import (
    Interval,
    bootstrap_interval,
    common,
    crossing_interval,
    first_crossings,
    in_words,
    t_interval,
)

__all__ = [
    "EARLY", "END", "LABELS", "Row", "against_deterministic", "check_quick", "early_rows", "from_records",
    "load_rows", "original_rows", "paired", "paired_curves", "paired_error", "results", "share_tied", "table_5_1",
    "table_5_2", "table_settings",
]  # fmt: skip

#: How each row is called in tables and figures.
LABELS: dict[str, str] = {
    "random": "Random",
    "softmax/max-entropy": "Softmax Max Entropy",
    "softmax/variation-ratios": "Softmax Variation Ratios",
    "softmax/bald": "Softmax BALD",
    "softmax/least-confidence": "Softmax Least Confidence",
    "dropout/max-entropy": "Dropout Max Entropy",
    "dropout/variation-ratios": "Dropout Variation Ratios",
    "dropout/bald": "Dropout BALD",
    "dropout/mean-std": "Dropout Mean STD",
    "softmax/margin": "Softmax Margin",
    "ensemble/bald": "Ensemble BALD",
    "ensemble/max-entropy": "Ensemble Max Entropy",
    "dropout/batch-bald": "Dropout BatchBALD",
    "dropout/power-bald": "Dropout power-BALD",
}
#: How each family of configs that runs the rows of the tables is called.
SETTINGS = {"ours": "common", "as-recorded": "as its script ran it", "as-written": "as the text has it"}
#: Test error in % that Table 5.2 counts acquisitions to.
THRESHOLD = 5.0
#: Ranges of acquired points: where the curves part, and the last three points.
EARLY, END = (100, 400), (960, 980)


@dataclass(frozen=True)
class Row:
    """The runs of one row of the tables."""

    name: str  #: e.g. "dropout/bald".
    config: str  #: name of the config, e.g. "ours/dropout/bald".
    labels: Int[np.ndarray, " T"]  #: [T] number of labels at each point of the curve.
    error: Float[np.ndarray, "R T"]  #: [R, T] test error in %, one curve per repetition.
    seeds: tuple[int, ...]  #: one per repetition.
    records: tuple[Record, ...] = ()  #: the records they come from (none for the original program's curves).

    @property
    def label(self) -> str:
        """Name of the row in words."""
        return LABELS.get(self.name, self.name)

    @property
    def last(self) -> Interval:
        """Test error in % at the last number of labels."""
        return t_interval(self.error[:, -1])

    @property
    def minimum(self) -> Interval:
        """Minimum of the mean curve in %, the statistic that Table 5.1 prints."""
        return bootstrap_interval(lambda i: self.error[i].mean(-2).min(-1), len(self.error))

    def mean(self, acquired: tuple[int, int]) -> Float[np.ndarray, " R"]:
        """Return the mean test error in % of each repetition over a range of acquired points, both ends included."""
        points = self.labels - self.labels[0]
        return self.error[:, (points >= acquired[0]) & (points <= acquired[1])].mean(1)

    def crossing(self, threshold: float = THRESHOLD, *, width: int = 1) -> Interval:
        """Acquisitions until the mean curve, after a median of ``width`` points, is at ``threshold`` % or below."""
        return crossing_interval(self.error, threshold, width=width)

    def crossings(self, threshold: float = THRESHOLD) -> list[float]:
        """Acquisitions until each repetition is at ``threshold`` % or below; inf if it never is."""
        return first_crossings(self.error, threshold).tolist()

    def stack(self, name: str) -> np.ndarray:
        """Return the array ``name`` of all records, replicas first."""
        return records.joined(self.records, [name])[1][name]


def load_rows(family: str = "ours", folder: Path | None = None, *, published: bool = True) -> dict[str, Row]:
    """Return the recorded rows of a family of configs ("ours", "as-recorded", ...), in the order of ``LABELS``.

    A row is there if at least one repetition is. Published seeds lie below 100; with ``published=False`` those of
    development, 100 and above, are read instead.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    rows = {}
    for name in [*LABELS, *(["random-without-dropout"] if family == "ours" else [])]:
        config = f"{family}/{name}"
        found = records.find(EXPERIMENT, name=config, folder=folder, published=published)
        if found:
            rows[name] = from_records(name, config, found)
    return rows


def early_rows(folder: Path | None = None) -> dict[str, Row]:
    """Return the rows of "ours" up to 400 acquired points, with the repetitions that ended there ("early")."""
    rows, ended = load_rows("ours", folder), load_rows("early", folder)
    return {name: _ended(row, ended.get(name)) for name, row in rows.items()}


def _ended(row: Row, short: Row | None) -> Row:
    last = int((row.labels <= row.labels[0] + EARLY[1]).sum())
    begun = replace(row, labels=row.labels[:last], error=row.error[:, :last])
    if short is None:
        return begun
    new = [place for place, seed in enumerate(short.seeds) if seed not in row.seeds]
    return replace(
        begun,
        error=np.concatenate([begun.error, short.error[new]]),
        seeds=(*row.seeds, *(short.seeds[place] for place in new)),
        records=(*row.records, *(record for record in short.records if not {*record.seeds} <= {*row.seeds})),
    )


def from_records(name: str, config: str, found: Sequence[Record]) -> Row:
    """Return the row that some records of one config make up."""
    seeds, arrays = records.joined(found, ["error"])
    return Row(name, config, found[0].arrays["labels"], arrays["error"].astype(float), seeds, tuple(found))


#: The names of the rows in the original program's files.
_ORIGINAL = {
    ("Random", "none"): "random",
    **{
        (method, approximation): f"{approximation.lower()}/{name}"
        for method, name in (("MaxEntropy", "max-entropy"), ("VariationRatios", "variation-ratios"), ("BALD", "bald"))
        for approximation in ("Softmax", "Dropout")
    },
}


@functools.cache
def original_rows() -> dict[str, Row]:
    """Return the curves that the original program recorded, three repetitions a row (``records/original``)."""
    lines = [line for line in records.table("original/active_learning_recorded_curves") if line["repeat"] != "mean"]
    rows = {}
    for key, name in _ORIGINAL.items():
        mine = [line for line in lines if (line["method"], line["approximation"]) == key]
        labels = np.array(sorted({int(line["n_labels"]) for line in mine}))
        repeats = sorted({line["repeat"] for line in mine})
        error = [[float(line["test_error_percent"]) for line in mine if line["repeat"] == repeat] for repeat in repeats]
        rows[name] = Row(name, "original", labels, np.array(error), tuple(range(len(repeats))))
    return {name: rows[name] for name in LABELS if name in rows}


def paired(first: Row, second: Row) -> tuple[Row, ...]:
    """Return the repetitions of the seeds that both rows have, in one order."""
    rows = zip((first, second), common(first.seeds, second.seeds), strict=True)
    return tuple(
        replace(row, error=row.error[places], seeds=tuple(row.seeds[place] for place in places)) for row, places in rows
    )


def paired_curves(first: Row, second: Row) -> tuple[Int[np.ndarray, " T"], Float[np.ndarray, "R T"]]:
    """Return acquired points, and there the test error of one row less that of another, in points of %.

    One curve per seed that both have, as far as both rows go.
    """
    length = min(len(first.labels), len(second.labels))
    one, two = (row.error[:, :length] for row in paired(first, second))
    return first.labels[:length] - first.labels[0], one - two


def paired_error(first: Row, second: Row, acquired_from: int, acquired_to: int) -> Interval:
    """Return the mean difference first - second of the test error, in points of %, paired over common seeds.

    The mean is over the points of the curve with ``acquired_from`` to ``acquired_to`` acquired points, both included.
    """
    acquired, differences = paired_curves(first, second)
    return t_interval(differences[:, (acquired >= acquired_from) & (acquired <= acquired_to)].mean(1))


def share_tied(row: Row) -> float:
    """Return the share of acquisition rounds in which every candidate had the same score (statement AL7)."""
    return float(row.stack("all_tied").mean())


def check_quick(rows: dict[str, Row]) -> None:
    """Check that the rows of config "quick" lie in wide bands, set before they were first run.

    Raises:
        ValueError: naming the row and the band that it leaves.
    """
    for name, row in rows.items():
        for when, error, (low, high) in (("start", row.error[:, 0], (20, 80)), ("end", row.error[:, -1], (4, 30))):
            if not ((low <= error) & (error <= high)).all():
                raise ValueError(f"{row.label}: test error {error} % at the {when} is outside {low} to {high} %")
        constant = name in ("random", "softmax/variation-ratios", "softmax/bald")
        if (share_tied(row) == 1.0) != constant:
            raise ValueError(f"{row.label}: scores tie in {share_tied(row):.0%} of the rounds, expected {constant:d}")


def results(folder: Path | None = None) -> list[Result]:
    """Return the numbers of Tables 5.1 and 5.2, with ids as in ``python -m dropout_uncertainty results``."""
    found = []
    for family in SETTINGS:
        for name, row in load_rows(family, folder).items():
            if name in ROWS:
                found += _row_results(row, "" if family == "ours" else f"/{family}")
    return found


def _row_results(row: Row, suffix: str) -> list[Result]:
    """Return the statistics of one row in both tables."""
    error, steps = f"table-5.1/{row.name}", f"table-5.2/{row.name}"
    statistics = [
        (error, "", row.last, "%", f"test error at {row.labels[-1]} labels"),
        (error, "/minimum", row.minimum, "%", "minimum of the mean curve"),
        (steps, "", row.crossing(), "acquisitions", f"first point of the mean curve at or below {THRESHOLD:g} %"),
        (steps, "/median-5", row.crossing(width=5), "acquisitions", "the same after a centred median of five points"),
    ]
    return [
        measured(
            identifier + kind + suffix,
            interval,
            row.records,
            unit=unit,
            statistic=statistic,
            config=row.config,
            thesis=identifier,
        )
        for identifier, kind, interval, unit, statistic in statistics
    ]


def _steps(row: Row, threshold: float = THRESHOLD, *, width: int = 1) -> str:
    """Return the acquisitions to a test error in words."""
    return in_words(row.crossing(threshold, width=width), ".0f", unbounded=f"> {row.error.shape[1] - 1}")


def table_5_1(rows: dict[str, Row]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells of Table 5.1: test error in % of thesis, original curves and ``rows``."""
    heads = ["", "thesis", "original, minimum", "original, last", "ours, minimum", "ours, last", "repetitions"]
    cells: list[list[object]] = []
    for name, row in rows.items():
        old = original_rows().get(name)
        before = [in_words(old.minimum), in_words(old.last)] if old else [None, None]
        now = [in_words(row.minimum), in_words(row.last)]
        cells.append([row.label, thesis_value(f"table-5.1/{name}"), *before, *now, len(row.error)])
    return heads, cells


def table_5_2(rows: dict[str, Row], threshold: float = THRESHOLD) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells of Table 5.2: acquisitions to ``threshold`` % (thesis and original curves: 5 %)."""
    heads = ["", "thesis", "original", "original, median-5", "ours", "ours, median-5", "repetitions"]
    cells: list[list[object]] = []
    for name, row in rows.items():
        old, printed = original_rows().get(name), thesis_value(f"table-5.2/{name}")
        before = [_steps(old, width=width) if old else None for width in (1, 5)]
        now = [_steps(row, threshold, width=width) for width in (1, 5)]
        cells.append([row.label, printed and f"{printed:.0f}", *before, *now, len(row.error)])
    return heads, cells


def table_settings(folder: Path | None = None) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells of the thesis's rows that have been run in more than one setting, in each of them."""
    heads = ["", "setting", "minimum [%]", "last [%]", f"acquisitions to {THRESHOLD:g} %", "repetitions"]
    runs = {words: load_rows(family, folder) for family, words in SETTINGS.items()}
    cells: list[list[object]] = []
    for name, original in original_rows().items():
        here = {words: rows[name] for words, rows in runs.items() if name in rows}
        if len(here) < 2:
            continue
        printed = [thesis_value(f"table-5.1/{name}"), None, f"{thesis_value(f'table-5.2/{name}'):.0f}"]
        cells.append([LABELS[name], "thesis, printed", *printed, len(original.error)])
        for words, row in here.items():
            cells.append([row.label, words, *map(in_words, (row.minimum, row.last)), _steps(row), len(row.error)])
    return heads, cells


def against_deterministic(rows: dict[str, Row]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells of the test error of each Dropout row minus that of the scores of one pass, in points.

    Those of one pass are Max Entropy and Least Confidence; the ranges are EARLY and END, or all of shorter curves.
    """
    fair = [name for name in ("softmax/max-entropy", "softmax/least-confidence") if name in rows]
    reach = min((int(row.labels[-1] - row.labels[0]) for row in rows.values()), default=0)
    ranges = [points for points in (EARLY, END) if points[1] <= reach] or [(0, reach)]
    heads = ["", *(f"minus {LABELS[name]}, {low} to {high}" for name in fair for low, high in ranges)]
    cells: list[list[object]] = [
        [row.label, *(in_words(paired_error(row, rows[other], *points)) for other in fair for points in ranges)]
        for name, row in rows.items()
        if name.startswith("dropout/")
    ]
    return heads, cells
