"""The peaks of the curves: where they are, how high, and which published numbers rest on them, by hand."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest

matplotlib.use("agg")
import matplotlib.pyplot as plt

from dropout_uncertainty.active_learning import experiment
from dropout_uncertainty.active_learning import pools as pool
from dropout_uncertainty.active_learning.experiment import CONFIGS
from dropout_uncertainty.active_learning.report import analysis, figures, peaks, statements
from dropout_uncertainty.active_learning.report.analysis import Row
from dropout_uncertainty.settings import config_diff

LABELS = np.arange(20, 1001, 10)


def row(name="random", level=10.0, seeds=(0, 1), high=0.0, last=1000):
    """A flat curve for each seed, at ``level`` + seed, and ``high`` above that at 130 labels."""
    labels = np.arange(20, last + 1, 10)
    error = level + np.array(seeds, float)[:, None] + high * (labels == 130)
    return Row(name, f"ours/{name}", labels, error, tuple(seeds))


def test_the_last_minibatch_is_what_is_left():
    assert peaks.last_minibatch(np.array([20, 128, 129, 130, 260, 640, 770])).tolist() == [20, 128, 1, 2, 4, 128, 2]
    assert LABELS[peaks.at_peaks(LABELS)].tolist() == [130, 260, 770, 900]
    assert not peaks.at_peaks(np.array([130, 140, 260])).any()  # a peak has a neighbour on either side


def test_a_peak_is_measured_from_its_neighbours():
    labels, curves = np.array([120, 130, 140]), np.array([[10.0, 16.0, 8.0], [1.0, 1.0, 1.0]])
    assert {k: v.tolist() for k, v in peaks.excess(labels, curves).items()} == {130: [7, 0]}
    flat = peaks.flattened(Row("random", "ours/random", labels, curves, (0, 1)))
    assert flat.error.tolist() == [[10, 9, 8], [1, 1, 1]]


def test_the_run_beside_differs_in_its_minibatches_only(monkeypatch, digits):
    changes = config_diff(CONFIGS["ours/random"], CONFIGS["pools/clean/random"])
    assert {name for name, *_ in changes} == {"even_minibatches", "rounds", "mc_test_every"}
    monkeypatch.setattr(experiment, "split", lambda *a, **k: pool.split(*a, **k, source=400))
    monkeypatch.setattr(experiment.mnist, "load", lambda: digits)
    monkeypatch.setattr(experiment.CNNLearner, "test_error", lambda *_: np.zeros(1))
    tiny, labelled = {"epochs": 1, "rounds": 2, "pool": 300, "validation": 50, "draws": 2}, []
    for name in ("ours/random", "pools/clean/random"):
        run = experiment.start(replace(CONFIGS[name], **tiny), (0,), precision="float32")
        for _ in range(run.total):
            run.advance()
        labelled.append(run.result()["points"].tolist())
    assert labelled[0] == labelled[1]


def test_both_runs_are_compared_on_the_seeds_that_they_share():
    found = {peaks.TAIL: row(high=6.0, seeds=(0, 1, 2)), peaks.EVEN: row(high=1.0, seeds=(1, 0), last=320)}
    heads, cells = peaks.table(found)
    assert heads == ["", "130 labels", "260 labels", "770 labels", "900 labels"]
    lines = {line[0]: line[1:] for line in cells}
    assert lines["images in the last minibatch"] == [2, 4, 2, 4]
    assert lines[peaks.TAIL] == ["6.0 [6.0, 6.0] (3)", *["0.0 [0.0, 0.0] (3)"] * 3]
    assert lines[peaks.EVEN] == ["1.0 [1.0, 1.0] (2)", "0.0 [0.0, 0.0] (2)", None, None]
    assert lines["the first less the second, same seeds"] == ["5.0 [5.0, 5.0] (2)", "0.0 [0.0, 0.0] (2)", None, None]
    _, cells = peaks.table({peaks.TAIL: found[peaks.TAIL]})
    assert cells[-1][1:] == ["not run yet"] * 4
    _, axes = plt.subplots(1, 2)
    figures.minibatches(list(axes), found)
    difference = next(line for line in axes[1].lines if len(line.get_xdata()) > 2)
    assert list(difference.get_ydata()) == [5.0 * (labels == 130) for labels in range(20, 321, 10)]
    figures.minibatches(list(axes), {peaks.TAIL: found[peaks.TAIL]})
    assert axes[1].get_title(loc="left").split() == f"Not run yet: {peaks.EVEN}".split()
    plt.close("all")


def test_statements_name_the_ranges_that_they_average_over():
    found = {statement.id: (names, reach) for statement, _, names, reach in statements.ranges()}
    assert found["AL5b"] == (("random", "dropout/variation-ratios"), (100, 400))
    assert found["AL10a"] == (("random",), (880, 980))
    assert "AL11" not in found  # on the pools minibatches are of equal size
    assert not {config.even_minibatches for name, config in CONFIGS.items() if name.startswith("pools/")} - {True}


def test_what_a_peak_changes_in_a_mean_is_its_height_by_the_number_of_points(monkeypatch):
    rows = {"random": row(high=31.0), "dropout/bald": row("dropout/bald", 9.0)}
    monkeypatch.setattr(peaks, "load_rows", lambda *_: rows)
    _, cells = peaks.touched()
    lines = {line[0]: line[1:] for line in cells}
    assert lines["100 to 400"] == ["AL5a", "130, 260", "1.00 (AL5a)", 0.5]  # 31 points in the range
    assert lines["960 to 980"] == ["AL5d", "none", None, 0.25]
    assert lines["880 to 980"] == ["AL10a AL10b", "900", "0.00 (AL10a)", 0.1]


def test_a_number_of_the_tables_that_rests_on_a_peak_is_named(monkeypatch):
    monkeypatch.setattr(peaks, "load_rows", lambda *_: {"random": row(high=60.0, level=9.0)})
    text = peaks.in_tables()
    assert "70 % (Random, ours)" in text
    assert "stay as they are" in text
    monkeypatch.setattr(peaks, "load_rows", lambda *_: {"random": row(high=-6.0)})  # a minimum, below 5 %
    assert "change for Random, ours." in peaks.in_tables()


def test_differences_to_random_are_paired_by_seed():
    rows = {"random": row(seeds=(0, 1, 2)), "dropout/bald": row("dropout/bald", 8.0, seeds=(2, 1))}
    acquired, curves = analysis.paired_curves(rows["dropout/bald"], rows["random"])
    assert (acquired[0], acquired[-1]) == (0, 980)
    assert curves.tolist() == [[-2.0] * len(LABELS)] * 2
    assert analysis.paired_error(rows["dropout/bald"], rows["random"], 100, 400) == pytest.approx((-2, -2, -2, 2))
    _, axes = plt.subplots(2, 2)
    figures.figure_5_1(axes, rows, {"random": row(level=20.0)})
    assert list(axes[0, 0].lines[0].get_ydata()) == [20.5] * len(LABELS)  # the mean of the original, one line
    assert list(axes[1, 0].lines[1].get_ydata()) == [-2.0] * len(LABELS)
    figures.figure_5_2(list(axes[0]), rows)
    plt.close("all")
