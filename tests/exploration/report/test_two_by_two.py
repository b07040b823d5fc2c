"""The two-by-two agents: contrasts by hand, what is missing, results and pictures."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from dropout_uncertainty.exploration.experiment import TWO_BY_TWO
from dropout_uncertainty.exploration.report import figures, two_by_two
from dropout_uncertainty.exploration.report.analysis import Curves
from dropout_uncertainty.exploration.report.two_by_two import CONTRASTS, LABELS, Contrast

#: Reward of every agent before and after tick 100,000; each seed adds a hundredth of its number.
LEVELS = {
    "dropout-draw": (0.9, 0.9), "dropout-mean": (0.95, 0.95), "plain-draw": (0.8, 0.8), "plain-mean": (1.0, 1.0),
    "masks-off-late": (0.9, 1.05),
}  # fmt: skip


def curves(name, seeds=(0, 1, 2), blocks=400, explored=50):
    early, late = LEVELS[name]
    reward = np.where(np.arange(blocks) < 200, early, late) + 0.01 * np.array(seeds)[:, None]
    reward[:, :6] = 99.0  # the burn-in does not count
    arrays = {"reward": reward, "explored": np.full(reward.shape, explored)}
    return Curves("thompson", f"two-by-two/{name}", reward, tuple(seeds), arrays)


@pytest.fixture
def cells():
    return {name: curves(name) for name in LEVELS}


def test_every_agent_has_a_label_and_every_contrast_agents():
    assert {f"two-by-two/{name}" for name in LABELS} == set(TWO_BY_TWO)
    for contrast in CONTRASTS.values():
        assert set(contrast.weights) <= set(LABELS)
        assert sum(contrast.weights.values()) == pytest.approx(0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("acting", -0.05), ("learning", -0.05), ("both", -0.1), ("acting-plain", -0.2), ("learning-draw", 0.1),
        ("acting-average", -0.125), ("learning-average", 0.025), ("masks-off", 0.15),
    ],
)  # fmt: skip
def test_contrasts_by_hand(cells, name, value):
    found = two_by_two.interval(cells, CONTRASTS[name])
    assert found.value == pytest.approx(value)
    assert found.n == 3
    assert found.high - found.low == pytest.approx(0, abs=1e-12)  # seeds cancel: the same ones stand on both sides


def test_agents_are_paired_by_seed_not_by_place(cells):
    cells["dropout-mean"] = curves("dropout-mean", seeds=(5, 2, 0, 1))
    other = two_by_two.differences(cells, CONTRASTS["acting"])
    np.testing.assert_allclose(other, -0.05)
    assert len(other) == 3
    lone = two_by_two.differences(cells, Contrast("itself", {"dropout-mean": 1.0}))
    np.testing.assert_allclose(lone, [0.95, 0.96, 0.97, 1.0])


def test_what_is_not_run_yet_is_said(cells):
    del cells["plain-draw"]
    assert two_by_two.interval(cells, CONTRASTS["acting-plain"]) is None
    assert two_by_two.interval({name: curves(name, blocks=20) for name in LEVELS}, CONTRASTS["masks-off"]) is None
    lines = {line[0]: line for line in two_by_two.contrast_table(cells)[1]}
    assert lines[CONTRASTS["acting-plain"].text][2] == "not run yet"
    assert lines[CONTRASTS["acting"].text][2].startswith("−0.050 [")
    lines = {line[0]: line for line in two_by_two.cell_table(cells)[1]}
    assert lines[LABELS["plain-draw"]][1] == "not run yet"
    assert lines[LABELS["dropout-draw"]][2:] == ["10 %", 3]


def test_results_carry_the_ids_that_other_programs_rely_on(cells, monkeypatch):
    monkeypatch.setattr(two_by_two, "load", lambda folder: cells)
    found = {result.id: result for result in two_by_two.results()}
    assert found["two-by-two/dropout-draw/reward"].ours == pytest.approx(0.91)
    assert found["two-by-two/masks-off-late/reward-late"].ours == pytest.approx(1.06)
    assert found["two-by-two/contrast/acting"].ours == pytest.approx(-0.05)
    assert all(result.verdict is None for result in found.values())
    assert "two-by-two/contrast/hold-10" not in found


def test_without_records_there_are_no_results(tmp_path):
    assert two_by_two.results(tmp_path) == []
    assert two_by_two.load(tmp_path) == {}


def test_what_an_agent_does_otherwise_is_read_from_its_config():
    lines = two_by_two.changes()[1]
    assert [LABELS["hold-10"], "hold", 1, 10] in lines
    assert LABELS["dropout-draw"] not in {line[0] for line in lines}
    assert {line[0] for line in lines} == set(LABELS.values()) - {LABELS["dropout-draw"]}


@pytest.mark.parametrize("some", [True, False])
def test_pictures_show_what_there_is(cells, some):
    fig, axes = plt.subplots(1, 5)
    shown = cells if some else {}
    figures.interaction(axes[0], shown)
    figures.held_draws(axes[1], shown)
    figures.curves_of_cells(axes[2], shown, list(LEVELS))
    figures.contrasts(axes[3], shown)
    figures.masks_off(axes[4], shown)
    above = [ax.get_title(loc="left") for ax in axes]
    absent = [text.get_text() for text in axes[3].texts]
    if some:
        line = axes[0].containers[0].lines[0]
        np.testing.assert_allclose(line.get_ydata(), [0.96, 0.91])
        assert len(axes[2].lines) == 4 * len(LEVELS)  # mean and three seeds of each
        for line, (name, (early, late)) in zip(axes[2].lines[::4], LEVELS.items(), strict=True):
            assert line.get_label() == LABELS[name]
            np.testing.assert_allclose(line.get_ydata()[[0, -1]], [early + 0.01, late + 0.01])
        assert [words.startswith("Not run") for words in above] == [False, True, False, False, True]
        assert absent == ["not run yet"] * 6  # held draws, schedules, and the masks beside ε-greedy
        dots = [line.get_xdata()[0] for line in axes[3].lines if line.get_marker() == "o"]
        np.testing.assert_allclose(dots, [-0.05, -0.05, -0.1, -0.2, 0.1, -0.125, 0.025, 0.15])
    else:
        assert [words.startswith("Not run") for words in above] == [True, True, True, False, True]
        assert absent == ["not run yet"] * len(CONTRASTS)
    plt.close(fig)


def test_held_draws_stand_beside_the_mean_up_to_tick_50_000():
    reward = np.array([99.0] * 6 + [0.0] * 94 + [9.0] * 300)
    levels = {"dropout-draw": 0.5, "hold-10": 0.4, "hold-100": 0.3, "hold-1000": 0.2, "dropout-mean": 0.6}
    cells = {
        name: Curves("thompson", f"two-by-two/{name}", reward[None], (0,), {"reward": reward[None] + level})
        for name, level in levels.items()
    }
    fig, (ax, square) = plt.subplots(1, 2)
    figures.held_draws(ax, cells)
    line = ax.containers[0].lines[0]
    np.testing.assert_allclose(line.get_xydata(), [(1, 0.5), (10, 0.4), (100, 0.3), (1000, 0.2)])
    assert ax.containers[0].get_label() == "acts on a draw"
    (grey,) = [line for line in ax.lines if line.get_label() == "acts on the mean"]
    np.testing.assert_allclose(grey.get_ydata(), 0.6)
    figures.interaction(square, cells)
    np.testing.assert_allclose(square.containers[0].lines[0].get_ydata(), [0.6, 0.5])
    plt.close(fig)
