"""Learning curves: what counts as solved and kept, verdicts that follow their rules, pictures that show the numbers."""

from dataclasses import asdict

import matplotlib
import numpy as np
import pytest
from scipy import stats

matplotlib.use("agg")
import matplotlib.pyplot as plt

from dropout_uncertainty.data_efficiency.configs import CONFIGS
from dropout_uncertainty.data_efficiency.plant.cartpole import MATLAB, PAPER
from dropout_uncertainty.data_efficiency.report import analysis, figures
from dropout_uncertainty.data_efficiency.report.animation import predictions, swing_up
from dropout_uncertainty.judging.collect import STATEMENTS
from dropout_uncertainty.judging.statements import judge
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_dict, config_hash
from dropout_uncertainty.stats import share_interval

TRIALS, STEPS = 10, PAPER.steps


def arrays(first, *, lost=(), attentive=True):
    """Return the arrays of repetitions that are solved from the trials ``first`` on, but for those in ``lost``."""
    runs, trial = len(first), np.arange(TRIALS + 1)
    good = (trial >= np.array(first)[:, None]) & ~np.isin(trial, lost)
    costs = np.where(good[..., None] & (np.arange(STEPS) >= 10), 0.05, 1.0)
    spread = np.linspace(0.01, 3.0, STEPS + 1) ** 2
    early = np.exp(-np.arange(STEPS) / 6)
    states = np.zeros((runs, TRIALS + 1, STEPS + 1, 4))
    return {
        "costs": costs, "predicted_cost": costs - 0.01, "states": states, "predicted_mean": states,
        "predicted_variance": np.broadcast_to(spread[:, None], states.shape),
        "search_variance": np.broadcast_to(spread[:, None], states.shape),
        "search_gradient": np.broadcast_to(early if attentive else early[::-1], costs.shape),
        "search_gradient_sure": np.ones_like(costs),
    }  # fmt: skip


def learning(first, **options):
    return analysis.from_arrays("pilco-paper", PAPER, arrays(first, **options), range(len(first)))


def write(folder, first, name="pilco-paper", **options):
    config = config_dict(CONFIGS[name])
    header = {
        "experiment": "data_efficiency", "name": name, "seeds": list(range(len(first))), "config": config,
        "config_hash": config_hash(config), "device": "cpu", "precision": "float64",
        "provenance": {f"{part}_cpu_s": [6.0] * (TRIALS + 1) for part in ("model", "policy", "trial")},
    }  # fmt: skip
    arrays32 = {name: value.astype(np.float32) for name, value in arrays(first, **options).items()}
    span = f"000-{len(first) - 1:03d}" if len(first) > 1 else "000"
    records.write(folder / "data_efficiency" / name / f"{span}.npz", arrays32, header)
    return folder


def test_trials_with_noise_do_not_count_and_a_repetition_that_has_ended_keeps_its_last():
    whole = arrays([3, 5, 99])
    whole["costs"][:, 1::2] = np.nan  # every other trial is with noise
    whole["costs"][0, 8:] = np.nan  # the first repetition has ended with its third solved test
    found = analysis.from_arrays("ddpg", PAPER, whole, range(3))
    assert found.tested.tolist() == [2, 4, 6, 8, 10]
    assert found.first_solved.tolist() == [4, 6, np.inf]
    assert found.later.sum(1).tolist() == [1, 2, 0]
    assert found.kept_share[:2].tolist() == [1, 1]
    costs = found.counted(found.trial_costs)
    np.testing.assert_array_equal(costs[0], found.trial_costs[0, [2, 4, 6, 6, 6]])
    np.testing.assert_array_equal(costs[1:], found.trial_costs[1:, 2::2])
    assert found.cost_at(10).value == pytest.approx(costs[:, -1].mean())
    fig, axes = plt.subplots(2)
    figures.cost_curves(axes[0], [found])
    np.testing.assert_allclose(axes[0].lines[0].get_xydata(), np.stack((found.tested, costs.mean(0)), 1))
    figures.solved_over_trials(axes[1], [found], ever=False)
    np.testing.assert_allclose(axes[1].lines[0].get_ydata(), np.array([0, 1, 2, 2, 2]) / 3)
    plt.close(fig)


def test_first_solved_and_kept_are_read_off_the_trials():
    found = learning([3, 5, 99], lost=(7,))
    assert found.first_solved.tolist() == [3, 5, np.inf]
    np.testing.assert_allclose(found.kept_share, [6 / 7, 4 / 5, np.nan])
    assert found.kept[0] == 1.0
    assert learning([3, 5], lost=(7, 8)).kept[0] == 0.0
    assert learning([10]).kept.n == 0  # no trial is left to keep it in


def test_trials_to_solve_is_when_half_are_solved():
    assert learning([2, 3, 4, 99]).trials_to_solve.value == 3
    assert learning([2, 99, 99, 99]).trials_to_solve.value == np.inf
    assert learning([2, 3, 4, 99]).solved_by(3).value == 0.5
    np.testing.assert_allclose(learning([99]).cost_at(4).value, 1.0)


def test_repetitions_to_show_lie_evenly_in_the_order_of_their_first_solved_trials():
    found = learning([9, 1, 8, 2, 7, 3, 6, 4, 5, 10])
    assert [int(found.first_solved[i]) for i in found.spread()] == [1, 3, 5, 7, 9]
    assert found.typical in found.spread()
    assert learning([3, 2]).spread() == [1]  # in the middle, as few as there are


def test_share_has_wilsons_interval():
    value, low, high, n = share_interval([True] * 10)
    assert (value, n) == (1.0, 10)
    assert high == 1.0
    np.testing.assert_allclose(low, 10 / (10 + 1.959964**2), rtol=1e-6)
    assert share_interval([]).n == 0


def test_results_carry_the_ids_that_other_programs_rely_on(tmp_path):
    found = {r.id: r for r in analysis.results(write(tmp_path, [3, 4, 5, 6, 7, 8]))}
    assert found["figure-5.7/pilco/trials-to-solve"].ours == 5
    assert found["figure-5.7/pilco/trials-to-solve"].thesis == 6.5
    assert found["figure-5.7/pilco/solved-by-7"].ours == pytest.approx(5 / 6)
    assert found["figure-5.7/pilco/cost-at-1"].ours == pytest.approx(1.0)
    assert found["figure-5.7/pilco/cost-at-1"].records == ["data_efficiency/pilco-paper/000-005.npz"]
    assert "figure-5.7/pilco/cost-at-15" not in found
    (tmp_path / "empty").mkdir()
    assert analysis.results(tmp_path / "empty") == []


def test_pilcos_own_code_solved_the_recorded_run_at_trial_3():
    found = analysis.original()
    assert (found.costs.shape, found.first_solved.tolist()) == ((1, 6, 40), [3])
    np.testing.assert_allclose(found.trial_costs[0, :2], [0.999767, 0.874103], atol=1e-6)  # the file's own means
    _, cells = analysis.solved_table([found], [3, 7])
    assert cells == [["PILCO's own code (1)", None, "3", "100% [21%, 100%]", None, "100% [21%, 100%]"]]


def test_development_seeds_are_left_out(tmp_path):
    write(tmp_path, [3, 4])
    assert analysis.load("pilco-paper", tmp_path).seeds == (0, 1)
    assert analysis.load("pilco-matlab", tmp_path) is None


def test_longer_runs_stand_for_shorter_ones_only_if_they_hold_all_repetitions(tmp_path):
    write(tmp_path, [3, 4])
    write(tmp_path, [5], name="pilco-paper-40")
    assert analysis.load("pilco-paper", tmp_path).first_solved.tolist() == [3, 4]
    assert analysis.load("pilco-paper-40", tmp_path).first_solved.tolist() == [5]
    write(tmp_path, [6, 7], name="pilco-paper-15")
    found = analysis.load("pilco-paper", tmp_path)
    assert (found.config, found.first_solved.tolist()) == ("pilco-paper", [6, 7])


def deep_arrays(first, *, followed=15, held=12, better=1, runs=8, trials=40):
    """Return arrays of Deep PILCO whose true angle leaves the prediction after ``followed`` steps from trial 10 on,
    ``better`` later from trial 20 on.
    """
    shown = [1, 5, 10, 20, 26, 40]
    trial = np.arange(trials + 1)
    good = np.broadcast_to(trial >= first, (runs, trials + 1))
    costs = np.where(good[..., None] & (np.arange(STEPS) >= STEPS - held), 0.05, 1.0)
    mean = np.zeros((runs, trials + 1, STEPS + 1, 4))
    states = np.zeros((runs, trials + 1, STEPS + 1, 4))
    states[..., : STEPS + 1 - held, 3] = np.pi
    mean[..., 3] = states[..., 3]
    for t in trial:
        followed_now = 2 if t < 10 else followed + better * (t >= 20)
        mean[:, t, followed_now + 1 :, 3] += 1.0
    noise = 0.01 * np.arange(runs)[:, None, None, None] / runs
    return {
        "costs": costs, "predicted_cost": costs, "states": states, "predicted_mean": mean + noise,
        "predicted_std": np.full_like(mean, 0.1), "shown": np.array(shown),
        "repeats": np.repeat(states[:, shown, None], 5, 2),
    }  # fmt: skip


def write_deep(folder, config="deep-pilco-ours", **options):
    settings = config_dict(CONFIGS[config])
    found = deep_arrays(**options)
    header = {
        "experiment": "data_efficiency", "name": config, "seeds": list(range(len(found["costs"]))),
        "config": settings, "config_hash": config_hash(settings), "device": "cpu",
        "precision": "float32",
        "provenance": {
            "model_cpu_s": [3000.0], "policy_cpu_s": [4000.0], "trial_cpu_s": [200.0], "processor": "a processor",
        },
    }  # fmt: skip
    records.write(folder / "data_efficiency" / config / "000-007.npz", found, header)
    return folder


def test_figure_5_8_in_numbers():
    found = analysis.from_arrays("deep-pilco-ours", PAPER, deep_arrays(12, followed=13, held=9), range(8))
    assert analysis.steps_predicted(found, 1).tolist() == [2.0] * 8
    assert analysis.steps_predicted(found, 10).tolist() == [13.0] * 8
    assert analysis.steps_held(found, 10).tolist() == [9.0] * 8
    assert analysis.share_solved(found, 26).tolist() == [1.0] * 8
    found.arrays["predicted_std"][..., 5:, 3] = 2.0  # a prediction that says nothing is none
    assert analysis.steps_predicted(found, 10).tolist() == [4.0] * 8
    with pytest.raises(ValueError, match="repeated are"):
        analysis.repeats(found, 2)


def test_tables_of_deep_pilco(tmp_path):
    found = analysis.load("deep-pilco-ours", write_deep(tmp_path, first=8, followed=13))
    heads, cells = analysis.fitting_table([found])
    assert heads[-1] == "Deep PILCO"
    assert [row[0] for row in cells[::3]] == [1, 10, 20, 26]
    assert cells[3][2:] == ["13", "13 [13, 13]"]
    _, cells = analysis.run_time_table([found])
    assert cells == [["Deep PILCO", "5.85", 40, "0.250", "8", "one core, a processor"]]
    ids = {r.id: r for r in analysis.results(tmp_path)}
    assert ids["figure-5.8/deep-pilco/steps-predicted-after-10"].thesis == 13
    assert ids["figure-5.8/deep-pilco/steps-predicted-after-10"].ours == 13


def test_every_setting_that_was_tried_is_in_the_table(tmp_path):
    for name in ("search/start", "search/rate-decay"):
        settings = config_dict(CONFIGS[name])
        header = {
            "experiment": "data_efficiency", "name": name, "seeds": list(range(100, 108)), "config": settings,
            "config_hash": config_hash(settings), "device": "cpu", "precision": "float32", "provenance": {},
        }  # fmt: skip
        arrays = {"costs": deep_arrays(12)["costs"]}
        records.write(tmp_path / "data_efficiency" / name / "100-107.npz", arrays, header)
    _, cells = analysis.search_table(tmp_path)
    assert {row[0]: row[1] for row in cells} == {
        "start": "the settings it began with", "rate-decay": "`policy_final_rate` 1.0 → 0.1",
    }  # fmt: skip
    assert analysis.load("search/start", tmp_path) is None  # development seeds


def test_a_step_predicted_well_is_one_whose_tip_is_within_the_width_of_the_cost():
    found = learning([3] * 2)
    doubt, with_doubt, sure = analysis.doubt_and_gradient(found, 2)
    np.testing.assert_allclose(with_doubt.sum(1), 1)
    well = doubt[0] < PAPER.cost_width / PAPER.pole_length
    _, difference = analysis.excess_on_predictable(found, [2])
    np.testing.assert_allclose(difference[0], with_doubt[0, well].sum() - sure[0, well].sum())
    assert 0 < well.sum() < STEPS


def test_at_equal_times_the_ranks_have_lost_what_time_says_of_them(monkeypatch):
    generator, steps = np.random.default_rng(0), np.arange(1.0, STEPS + 1)
    doubt = np.stack([generator.random(STEPS) + steps / STEPS, steps])  # the second only grows
    shares = 20 * generator.random((2, 2, STEPS)) + steps
    monkeypatch.setattr(analysis, "doubt_and_gradient", lambda *_: (doubt, shares[0], shares[1]))
    found = analysis.at_equal_times(learning([3] * 2), [2])
    for name, share in (("share itself", shares[0, 0]), ("share against that without uncertainty", None)):
        ranks = [stats.rankdata(x) for x in (doubt[0], shares[0, 0] / shares[1, 0] if share is None else share)]
        left = [r - np.polyval(np.polyfit(steps, r, 1), steps) for r in ranks]
        assert found[name][0] == pytest.approx(np.corrcoef(*left)[0, 1])
        assert np.isnan(found[name][1])


def test_tables_have_a_cell_for_every_head(tmp_path):
    found = analysis.load("pilco-paper", write(tmp_path, [3, 99, 99]))
    for heads, cells in (analysis.solved_table([found], (5, 15)), analysis.time_table(found, (1, 5, 15))):
        assert all(len(row) == len(heads) for row in cells)
    assert analysis.solved_table([found], (5,))[1][0][2].startswith("> 10")
    assert analysis.time_table(found, (5,))[1] == [[5, 125, "2.00", "2.00", "2.00"]]


def test_quick_run_is_held_to_its_bands():
    good = learning([3, 3])
    analysis.check_quick(good)
    with pytest.raises(ValueError, match=r"outside 0\.2 to 0\.9"):
        analysis.check_quick(learning([99, 99]))
    analysis.check_quick_deep(good)
    with pytest.raises(ValueError, match=r"outside 0\.2 to 0\.98"):
        analysis.check_quick_deep(learning([99, 99]))
    with pytest.raises(ValueError, match="random trials cost"):
        analysis.check_quick_deep(learning([0, 0]))


def test_pictures_show_the_numbers():
    found = learning([2, 3, 5, 99])
    _, axes = plt.subplots(1, 2)
    figures.figure_5_7(list(axes), [found])
    np.testing.assert_allclose(axes[0].lines[-1].get_ydata(), found.trial_costs[:, 1:].mean(0))
    np.testing.assert_allclose(axes[1].lines[-1].get_ydata(), np.median(found.trial_costs[:3, 1:], 0))  # the solved
    assert axes[1].get_legend().get_texts()[0].get_text() == "PILCO (3)"
    assert axes[0].get_xscale() == "log"
    for ax in axes:
        positions = [line.get_xdata()[0] for line in ax.lines[:-1]]
        assert positions == [3, 5, 42, 400, 2500]  # ours, then the printed ones
    (seconds,) = axes[1].child_axes
    axes[1].figure.canvas.draw()
    assert seconds.get_xlim() == pytest.approx([2.5 * trial for trial in axes[1].get_xlim()])
    _, axes = plt.subplots(1, 2)
    figures.figure_5_7(list(axes), [learning([99, 99])])
    assert [text.get_text() for text in axes[1].texts] == ["fewer than two repetitions are solved"]
    _, axes = plt.subplots(1, 2)
    figures.gradient_shares(list(axes), found, 2)
    np.testing.assert_allclose(axes[1].lines[0].get_ydata(), analysis.doubt_and_gradient(found, 2)[1][0])
    _, axes = plt.subplots(1, 2)
    figures.predicted_and_realised(axes, found, (2,))
    np.testing.assert_allclose(
        axes[0].collections[0].get_offsets(), np.stack([found.predicted_costs[:, 2], found.trial_costs[:, 2]], 1)
    )
    assert not axes[1].axison  # no trial is left for it
    figures.predicted_trial(list(axes), found, (1, 2))
    plt.close("all")


def test_pictures_of_deep_pilco_show_the_numbers():
    found = analysis.from_arrays("deep-pilco-ours", PAPER, deep_arrays(12), range(8))
    assert found.typical == 3
    _, axes = plt.subplots(1, 4)
    figures.figure_5_8(list(axes), found, analysis.PANELS, [found.typical, 0])
    assert [ax.get_title().split("\n") for ax in axes] == [
        [f"({k}) after trial {t}", f"predicted: {n} steps", "stands: 12 steps"]
        for k, t, n in zip("abcd", (1, 10, 20, 26), (2, 15, 16, 16), strict=True)
    ]
    np.testing.assert_allclose(axes[1].lines[0].get_ydata(), found.arrays["predicted_mean"][3, 10, :, 3])
    np.testing.assert_allclose(axes[1].lines[1].get_ydata(), found.arrays["states"][3, 10, :, 3])
    assert len(axes[1].get_lines()) > 14  # two predictions, each with the trial and five more, upright
    lost = learning([2, 3, 5, 99], lost=(7,))
    figures.solved_over_trials(axes[0], [lost], ever=True)
    figures.solved_over_trials(axes[1], [lost], ever=False)
    assert axes[0].lines[-1].get_ydata()[6] == 0.75
    assert axes[1].lines[-1].get_ydata()[6] == 0
    plt.close("all")


@pytest.mark.parametrize("plant", [PAPER, MATLAB])
def test_the_drawn_pole_is_to_scale(plant):
    _, ax = plt.subplots()
    figures.figure_5_6(ax, plant)
    (pole,) = [line for line in ax.lines if line.get_linewidth() == 4 and line.get_alpha() == 1.0]
    assert np.hypot(*np.diff(pole.get_xydata(), axis=0)[0]) == pytest.approx(plant.pole_length)
    figures.figure_5_5(ax)
    plt.close("all")


def test_plant_of_a_record_is_that_of_its_config(tmp_path):
    plant = analysis.load("pilco-paper", write(tmp_path, [3])).plant
    assert asdict(plant) == asdict(PAPER)


def test_the_moving_picture_shows_every_state_in_real_time():
    states = np.zeros((STEPS + 1, 4))
    states[:, 0], states[:, 3] = np.linspace(0, 0.5, STEPS + 1), np.linspace(np.pi, 0, STEPS + 1)
    player = swing_up(PAPER, {"trial 1": states, "a < b": states})
    assert len(player.frames) / player.rate == pytest.approx(PAPER.steps * PAPER.dt, abs=0.06)
    middle = player.size[0] / 4
    first, last = (player.frames[i][1].attributes for i in (0, -1))  # the pole of the first panel
    assert (first["x1"], first["x2"]) == pytest.approx((middle, middle), abs=0.1)
    assert first["y2"] - first["y1"] == pytest.approx(60, abs=0.1)  # hangs: y points down
    assert (last["x1"], last["x2"]) == pytest.approx((middle + 50, middle + 50), abs=0.1)
    assert last["y2"] - last["y1"] == pytest.approx(-60, abs=0.1)
    assert player.labels[-1] == "2.50 s"
    assert "a &lt; b" in player._repr_html_()
    with pytest.raises(ValueError, match=r"expected states of shape \(26, 4\)"):
        swing_up(PAPER, {"short": states[:3]})


def test_the_slider_has_every_trial_with_its_prediction():
    found = analysis.from_arrays("deep-pilco-ours", PAPER, deep_arrays(12), range(8))
    player = predictions(found, 0)
    assert len(player.frames) == 40
    assert player.labels[4] == "Trial 5: cost 1.00 per step, 1.00 predicted; not solved"
    assert player.labels[11].endswith("solved")
    assert "not" not in player.labels[11]
    band, mean, true = (shape.attributes["points"].split() for shape in player.frames[11])
    assert (len(band), len(mean), len(true)) == (52, 26, 26)
    assert true[0] == mean[0]  # hanging
    assert true[-1] != mean[-1]  # the prediction is off at the end


def verdicts(folder, *names):
    return [judge([STATEMENTS[name]], folder)[0].verdict for name in names]


@pytest.mark.parametrize(
    ("first", "expected"),
    [
        ([6, 6, 6, 7, 7, 7, 6, 7], ["supported", "agrees", "agrees"]),
        ([4] * 8, ["supported", "agrees", "agrees"]),  # two below the nearer end of 6 to 7, within the margin of 3
        ([12] * 8, ["contradicted", "differs", "differs"]),  # not within the trials that were run
        ([3, 4], ["untested"] * 3),
    ],
)
def test_trials_of_pilco(tmp_path, first, expected):
    assert verdicts(write(tmp_path, first), "DE1a", "DE1b", "DE1c") == expected


def test_the_gradient_of_predicted_steps(tmp_path):
    assert verdicts(write(tmp_path / "1", [3] * 6), "DE11a", "DE11b") == ["supported"] * 2
    assert verdicts(write(tmp_path / "2", [3] * 6, attentive=False), "DE11a") == ["contradicted"]


def test_trials_and_panels_of_deep_pilco(tmp_path):
    as_said = {"first": 22, "followed": 13, "held": 10}
    assert verdicts(write_deep(tmp_path / "1", **as_said), "DE2g", "DE2h", "DE2d") == [
        "supported",
        "agrees",
        "untested",
    ]
    panels = ("DE3a", "DE3c", "DE3d", "DE3e", "DE3h")
    held = write_deep(tmp_path / "2", "deep-pilco-as-written", first=9, followed=13, held=10)
    assert verdicts(held, *panels) == ["supported", "agrees", "agrees", "supported", "supported"]
    lost = write_deep(tmp_path / "3", "deep-pilco-as-written", first=99, followed=1, held=0, better=0)
    assert verdicts(lost, "DE2d", "DE3c", "DE3d", "DE3h") == ["contradicted", "differs", "differs", "contradicted"]


def test_printed_trials_of_others_decide_nothing(tmp_path):
    write_deep(tmp_path, first=8)
    assert verdicts(tmp_path, "DE9a", "DE9b") == ["untested"] * 2
