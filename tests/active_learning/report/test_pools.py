"""The numbers of the noisy pools from runs made up by hand."""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch

from dropout_uncertainty.active_learning.experiment import CONFIGS
from dropout_uncertainty.active_learning.noisy_pools import Task
from dropout_uncertainty.active_learning.pools import Split
from dropout_uncertainty.active_learning.report import chapter, figures, pools
from dropout_uncertainty.active_learning.report.analysis import LABELS, Row
from dropout_uncertainty.page.plotting import COLOURS
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import mean_estimate


def row(name, level, seeds, kind="ambiguous"):
    """A curve that lies at ``level`` + seed from 100 acquired points on, and at 90 % before."""
    labels = np.arange(20, 321, 10)
    error = np.where(labels - 20 < 100, 90.0, level) + np.array(seeds)[:, None] * (labels >= 120)
    return Row(name, f"pools/{kind}/{name}", labels, error, tuple(seeds))


@pytest.fixture
def found():
    rows = [row("dropout/bald", 10.0, (0, 1, 2)), row("softmax/max-entropy", 15.0, (2, 0))]
    return {**{kind: {} for kind in pools.NOISE}, "clean": {}, "ambiguous": {r.name: r for r in rows}}


def test_the_mean_error_is_over_100_to_300_acquired_points(found):
    assert pools.mean_error(found["ambiguous"]["dropout/bald"]).tolist() == [10, 11, 12]


def test_a_contrast_pairs_the_seeds_that_both_rows_have(found):
    pair = pools.contrast(found, "ambiguous", "dropout/bald", "softmax/max-entropy")
    assert pair.errors[0].tolist() == [10, 12]
    assert pair.difference.tolist() == [-5, -5]


def test_what_has_not_been_run_is_said_and_not_judged(found):
    heads, cells = chapter.verdicts(found)
    assert {line[0]: line[-1] for line in cells}["AL11"] == "untested"  # two seeds are too few
    assert {line[0]: line[4] for line in cells}["AL3e"] == "not run yet"
    assert all(len(line) == len(heads) for line in cells)
    heads, cells = pools.which_for_which({kind: {} for kind in found})
    assert {cell for line in cells for cell in line[1:]} == {"not run yet", None}


def test_a_primary_statement_waits_for_as_many_seeds_as_on_the_scoreboard(found):
    levels = {"dropout/bald": 10.0, "softmax/max-entropy": 15.0, "random": 14.0}
    ambiguous = {name: row(name, level, tuple(range(10))) for name, level in levels.items()}
    verdict = {line[0]: line[-1] for line in chapter.verdicts({**found, "ambiguous": ambiguous})[1]}
    assert verdict["AL11"] == "untested"
    assert verdict["AL11b"] == "supported"


def with_points(row, points):
    """Return the row with a record of the points that it asked for."""
    header = {"experiment": "x", "name": row.config, "config_hash": "x", "precision": "x", "seeds": list(row.seeds)}
    return replace(row, records=(Record(header, {"points": points}, Path("x.npz")),))


def test_curves_and_differences_of_pools_are_drawn(found):
    fig, (clean, ambiguous, ax) = plt.subplots(1, 3)
    rows = found["ambiguous"]
    figures.pool_curves([clean, ambiguous], {"clean": {}, "ambiguous": rows})
    assert [ax.get_title() for ax in (clean, ambiguous)] == ["clean", "ambiguous"]
    assert [text.get_text() for text in clean.texts] == ["not run yet"]
    lines = {line.get_label(): line.get_xydata() for line in ambiguous.lines}
    for name, end in (("dropout/bald", 11), ("softmax/max-entropy", 16)):
        np.testing.assert_allclose(lines[LABELS[name]][[0, 9, 10, 30]], [(0, 90), (90, 90), (100, end), (300, end)])
    pairs = [pools.contrast(found, "ambiguous", *names) for names in (list(rows), list(rows)[::-1])]
    figures.forest(ax, pairs)
    dots = [line for line in ax.lines if line.get_marker() == "o"]
    assert [(*dot.get_xydata()[0], dot.get_color()) for dot in dots] == [
        (-5, 0, COLOURS["bald"]), (5, 1, COLOURS["max-entropy"]),
    ]  # fmt: skip
    seeds = [line.get_xydata().tolist() for line in ax.lines if line.get_marker() == "|"]
    assert seeds == [[[-5, 0], [-5, 0]], [[5, 1], [5, 1]]]
    first, second = (LABELS[name] for name in rows)
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        f"ambiguous: {first} − {second} (2)", f"ambiguous: {second} − {first} (2)",
    ]  # fmt: skip
    plt.close(fig)


def test_a_last_row_of_images_need_not_be_full(digits):
    everything = torch.arange(40)
    task = Task(digits, Split(everything[:4], everything[:0], everything[4:]), everything == 13, everything, everything)
    fig, ax = plt.subplots()
    figures.picked(ax, task, np.arange(4, 17), "thirteen")
    sheet = ax.images[0].get_array().reshape(2, 28, 10, 28).swapaxes(1, 2).reshape(20, 28, 28)
    np.testing.assert_array_equal(sheet[:13], digits.train_images[4:17])
    assert not sheet[13:].any()
    assert [patch.get_xy() for patch in ax.patches] == [(9 * 28, 0)]
    plt.close(fig)


def test_what_was_bought_is_drawn_in_the_order_of_acquisition(found, digits, monkeypatch):
    order = np.random.default_rng(100).permutation(len(digits.train_labels))
    everything = torch.arange(len(order))
    task = Task(
        digits, Split(everything[:20], everything[:0], everything[20:]), everything % 3 == 0, everything, everything
    )
    monkeypatch.setattr(pools, "task_of", lambda *_: task)
    rows = {
        name: with_points(row, np.stack([np.roll(order, shift)[:100]] * len(row.seeds)))
        for shift, (name, row) in enumerate(found["ambiguous"].items())
    }
    fig, axes = plt.subplots(1, 2)
    names = ["softmax/max-entropy", "random", "dropout/bald"]
    with pytest.raises(ValueError, match=r"unknown row 'dropout/bold'.*did you mean dropout/bald"):
        figures.bought(list(axes), "ambiguous", rows, ["dropout/bold"])
    figures.bought(list(axes), "ambiguous", rows, names)
    assert fig.get_suptitle() == "ambiguous"
    for ax, name in zip(axes, names[::2], strict=True):
        points = rows[name].stack("points")[0, 20:80]
        assert ax.get_title() == LABELS[name]
        tiles = ax.images[0].get_array().reshape(6, 28, 10, 28).swapaxes(1, 2).reshape(60, 28, 28)
        np.testing.assert_array_equal(tiles, digits.train_images[points])
        framed = {round(frame.get_y() / 28) * 10 + round(frame.get_x() / 28) for frame in ax.patches}
        assert framed == set(np.flatnonzero(points % 3 == 0))
    plt.close(fig)


def test_shares_of_classes_are_of_what_was_acquired(found):
    labels = np.repeat(np.arange(10), 10)
    start, (bald, entropy) = np.full(20, 99), found["ambiguous"].values()  # a nine at first
    asked = {"bald": [[5, 15, 25, 25]] * 3, "entropy": [[35, 35, 35, 35], [35, 35, 45, 45]]}
    rows = {
        row.name: with_points(row, np.array([[*start, *points] for points in of]))
        for row, of in zip((bald, entropy), asked.values(), strict=True)
    }
    fig, ax = plt.subplots()
    shares = figures.class_shares(ax, rows, labels)
    expected = np.zeros((2, 10))
    expected[0, :3], expected[1, 3:5] = (25, 25, 50), (75, 25)
    np.testing.assert_allclose(shares, expected)
    np.testing.assert_allclose(ax.images[0].get_array(), expected)
    assert [label.get_text() for label in ax.get_yticklabels()] == [bald.label, entropy.label]
    numbers = {text.get_position(): text.get_text() for text in ax.texts}
    assert numbers == {(j, i): f"{share:.0f}" for (i, j), share in np.ndenumerate(expected)}
    plt.close(fig)


def test_published_pools_are_what_the_page_was_written_for():
    """Where this fails, read the page *When do weight draws save labels?* and the line on pools in *What to use*."""
    found = pools.load()
    assert {name: len(rows) for name, rows in found.items()} == {
        "clean": 4, "ambiguous": 7, "repeated": 0, "irrelevant": 3
    }  # fmt: skip
    verdict = {line[0]: (line[5], line[-1]) for line in chapter.verdicts(found)[1] if line[5]}
    assert verdict == {
        "AL11": (20, "supported"), "AL11b": (20, "supported"), "AL11c": (9, "inconclusive"), "AL11m": (9, "supported"),
        "AL11d": (20, "contradicted"), "AL3e": (20, "no difference"), "AL11g": (5, "inconclusive"),
        "AL11e": (5, "supported"), "AL11l": (5, "inconclusive"), "AL12": (5, "inconclusive"),
    }  # fmt: skip
    assert -9 < pools.contrast(found, *pools.CONTRASTS["AL11"]).difference.mean() < -7.5  # "eight points"
    assert pools.contrast(found, "ambiguous", "dropout/bald", "softmax/max-entropy").difference.max() < 0
    names = "dropout/bald", "dropout/max-entropy", "softmax/max-entropy"
    bald, drawn, entropy = (pools.noise(found["ambiguous"][name]).mean() for name in names)
    assert bald < 0.1 < 0.8 < drawn < entropy
    by_draws, by_score = (
        mean_estimate(pools.contrast(found, *pools.CONTRASTS[name]).difference) for name in ("AL11c", "AL11m")
    )
    assert by_score.high < by_draws.low - 1  # the disagreement gains more than the draws do
    assert pools.noise(found["ambiguous"]["dropout/mean-std"]).mean() < 0.1
    assert pools.noise(found["ambiguous"]["dropout/variation-ratios"]).min() > 0.5
    foreign = [pools.noise(found["irrelevant"][name]) for name in ("dropout/bald", "softmax/max-entropy")]
    assert 0.85 < foreign[0].min() < foreign[1].max() < 0.95
    worse = pools.contrast(found, "irrelevant", "dropout/bald", "random").difference
    assert len(worse) == 5
    assert worse.min() > 0
    assert (pools.contrast(found, "irrelevant", "softmax/max-entropy", "random").difference > 0).sum() == 4
    assert pools.contrast(found, "ambiguous", "dropout/mean-std", "random").difference.max() < 0


def test_every_comparison_is_of_rows_that_are_run():
    for kind, *names in pools.CONTRASTS.values():
        assert all(f"pools/{kind}/{name}" in CONFIGS for name in names)


def test_results_come_from_records_of_a_run(tmp_path, digits, monkeypatch):
    from dropout_uncertainty.active_learning import experiment
    from dropout_uncertainty.active_learning import pools as pool
    from dropout_uncertainty.runs import execute

    monkeypatch.setattr(experiment, "split", lambda *a, **k: pool.split(*a, **k, source=400))
    monkeypatch.setattr(experiment.mnist, "load", lambda: digits)
    name = "pools/ambiguous/softmax/margin"
    tiny = replace(CONFIGS[name], epochs=1, rounds=2, subset=50, pool=500, validation=100)
    monkeypatch.setitem(experiment.CONFIGS, name, tiny)
    unit = execute.Unit("active_learning", name, experiment.start, tiny, (0,))
    execute.run([unit], folder=tmp_path, progress=False)
    results = {result.id: result for result in pools.results(tmp_path)}
    assert results.keys() == {f"{name}/error", f"{name}/noise"}
    assert 0 <= results[f"{name}/noise"].ours <= 100
    task, points = pools.acquired("ambiguous", pools.load(folder=tmp_path)["ambiguous"]["softmax/margin"])
    assert results[f"{name}/noise"].ours == pytest.approx(100 * task.noise[points].float().mean().item())
