"""From records to numbers, statements and curves of section 5.3."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.experiment import CONFIGS
from dropout_uncertainty.exploration.report import analysis, chapter, figures
from dropout_uncertainty.judging.collect import STATEMENTS
from dropout_uncertainty.judging.statements import judge
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_dict, config_hash
from dropout_uncertainty.stats import median_interval

RUNS = 10
TWO = ("thompson", "epsilon-greedy")
#: Configs with a level that the reward approaches and the tick at which it has come two thirds of the way, per agent:
#: such that all claims hold.
HOLDING = {
    "as-demo": [(0.985, 4_000), (1.03, 20_600)],
    "as-written": [(0.985, 4_000), (1.03, 20_600)],
    "ours-thompson": [(1.02, 4_000)],
    "ours-epsilon-greedy": [(1.02, 22_000)],
    "ours-boltzmann": [(1.03, 3_000)],
    "ours-annealed-thompson": [(1.03, 3_000)],
    "narrow": [(0.9, 5_000)],
    "narrow-dropout": [(0.9, 5_000)],
    "wide": [(0.9, 5_000)],
    "wide-dropout": [(1.0, 5_000)],
}
#: Squared TD errors on learned and on held-out transitions.
ERRORS = {"narrow": (0.2, 0.3), "narrow-dropout": (0.25, 0.3), "wide": (0.05, 0.4), "wide-dropout": (0.15, 0.2)}


def curves(average, agent="thompson", **arrays):
    average = np.asarray(average, float)
    return analysis.Curves(agent, "test", average, tuple(range(len(average))), arrays)


def test_each_live_agent_is_drawn_in_a_colour_of_its_own():
    agents = {name: curves(np.ones((2, 8)), name) for name in ("thompson", "five-percent", "greedy")}
    fig, ax = plt.subplots()
    chapter.live_rewards(ax, agents, burn_in=1000)
    legend = ax.get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["Thompson sampling", "five-percent", "No exploration"]
    assert len({handle.get_color() for handle in legend.legend_handles}) == 3
    assert list(ax.lines[-1].get_xdata()) == [1000, 1000]
    plt.close(fig)


def write(folder, name, shapes, seeds=range(RUNS)):
    config = CONFIGS[name]
    blocks = config.ticks // analysis.BLOCK
    ticks = analysis.BLOCK * np.arange(1, blocks + 1)
    noise = 0.004 * np.random.default_rng(len(name)).standard_normal((len(seeds), len(shapes), blocks))
    reward = np.stack([level - 0.5 * np.exp(-ticks / scale) for level, scale in shapes]) + noise
    arrays = {"average_reward": reward, "reward": reward}
    # the Thompson agent keeps deviating from the network without dropout, the other one stops to
    arrays["explored"] = np.stack([np.full(reward[:, 0].shape, 80 * (index == 0)) for index in range(len(shapes))], 1)
    if name in ERRORS:
        wiggle = 1 + noise[..., :10]
        arrays["learned_td_error"], arrays["held_out_td_error"] = (error * wiggle for error in ERRORS[name])
    plain = config_dict(config)
    header = {
        "experiment": "exploration", "name": name, "seeds": list(seeds), "config": plain,
        "config_hash": config_hash(plain), "device": "cpu", "precision": "float32", "provenance": {},
    }  # fmt: skip
    records.write(folder / "exploration" / name / f"{min(seeds):03d}-{max(seeds):03d}.npz", arrays, header)


def world(folder, **changes):
    """Write records in which the claims hold, but for the named changes."""
    for name, shapes in (HOLDING | changes).items():
        write(folder, name, shapes)
    return folder


def test_crossings_count_from_the_first_point_after_the_burn_in():
    rising = np.zeros((3, 20))
    rising[0, 2] = 2.0  # tick 1500, in the burn-in
    rising[0, 9] = rising[1, 6] = 1.0  # ticks 5000 and 3500
    ticks = curves(rising).crossings()
    assert ticks.tolist() == [5000, 3500, np.inf]
    assert analysis.batches(ticks).tolist() == [4, 1, np.inf]
    assert analysis.batches(ticks, 200).tolist() == [10, 2.5, np.inf]


def test_the_median_counts_runs_that_never_arrive():
    assert median_interval(np.array([1.0, 2.0, np.inf])).value == 2.0
    assert median_interval(np.array([1.0, np.inf, np.inf])).value == np.inf


def test_means_are_open_below_and_end_where_a_run_ends():
    short = curves([[1.0, 2.0, 3.0, np.nan], [1.0, 2.0, 3.0, 4.0]])
    assert short.mean(500, 1500).tolist() == [2.5, 2.5]
    assert short.mean(1000, 2000).tolist() == [3.0, 3.5]
    assert np.isnan(short.mean(1500, 2000)[0])


def test_block_means_of_the_original_are_those_its_notes_print():
    printed = {"thompson": (0.747, 0.949, 0.975), "epsilon-greedy": (0.612, 0.779, 0.927)}
    for agent, means in printed.items():
        ours = [analysis.original()[agent].mean(*block).mean() for block in analysis.BLOCKS[:3]]
        np.testing.assert_allclose(ours, means, atol=6e-4)
    np.testing.assert_array_equal(
        analysis.original()["thompson"].crossings(), [30_000, 33_000, 10_500, 11_500, 26_000, 13_000]
    )


@pytest.mark.parametrize("agent", ["thompson", "epsilon-greedy"])
@pytest.mark.parametrize("family", ["as-demo", "ours"])
def test_recorded_block_means_lie_beside_the_original_ones(family, agent):
    ours, theirs = analysis.load(family)[agent], analysis.original()[agent]
    for block in analysis.BLOCKS:
        assert abs(ours.mean(*block).mean() - theirs.mean(*block).mean()) < 0.05, block


def test_what_the_chapter_says_of_the_control_holds_in_the_records():
    agents = analysis.load("ours")
    for ticks in (analysis.EARLY, analysis.LATE):
        assert analysis.compare(agents["greedy"], agents["thompson"], *ticks).low > 0


def test_what_the_chapter_says_of_annealing_holds_in_the_records():
    agents = analysis.load("ours")
    explored = {name: curves.share("explored", *analysis.LATE).mean() for name, curves in agents.items()}
    assert explored["boltzmann"] < 0.5 * explored["thompson"]
    assert explored["annealed-thompson"] >= explored["thompson"]
    assert abs(analysis.compare(agents["greedy"], agents["boltzmann"], *analysis.LATE).value) < 0.01
    assert analysis.compare(agents["annealed-thompson"], agents["thompson"], *analysis.LATE).low > 0


def test_what_the_chapter_says_of_footnote_4_holds_in_the_records():
    agents = analysis.load("as-demo")
    explored = {name: curves.share("explored", 200_000, 1_000_000) for name, curves in agents.items()}
    assert (explored["thompson"] > 0.06).all()
    np.testing.assert_allclose(explored["epsilon-greedy"], 0.05 * 4 / 5, atol=0.001)


def test_what_the_chapter_says_of_over_fitting_holds_in_the_records():
    for name in ("narrow", "narrow-dropout", "wide", "wide-dropout"):
        assert analysis.held_out_gap(analysis.load(name)["epsilon-greedy"]).mean() < 0.02


def test_results_have_the_agreed_ids(tmp_path):
    found = {result.id: result for result in analysis.results(world(tmp_path))}
    agents = ("thompson", "epsilon-greedy", "boltzmann", "annealed-thompson")
    assert {f"figure-5.4/{agent}/first-crossing" for agent in agents} <= set(found)
    assert found["figure-5.4/thompson/first-crossing"].thesis == 25
    assert found["figure-5.4/epsilon-greedy/block-3000-15500"].ours == pytest.approx(0.68, abs=0.02)
    assert len(found["figure-5.4/thompson/first-crossing/as-demo"].seeds) == RUNS


def test_a_config_without_records_has_no_agents(tmp_path):
    assert analysis.load("as-demo", tmp_path) == {}
    assert analysis.results(tmp_path) == []


def test_development_seeds_do_not_count(tmp_path):
    write(tmp_path, "narrow", HOLDING["narrow"], seeds=range(100, 103))
    assert analysis.load("narrow", tmp_path) == {}
    assert len(analysis.load("narrow", tmp_path, published=False)["epsilon-greedy"].seeds) == 3


def test_quick_runs_are_checked_against_their_bands():
    far, near = np.full((2, 20), 0.8), np.full((2, 20), 0.6)
    analysis.check_quick({"thompson": curves(far), "epsilon-greedy": curves(near, "epsilon-greedy")})
    with pytest.raises(ValueError, match="ahead"):
        analysis.check_quick({"thompson": curves(near), "epsilon-greedy": curves(far, "epsilon-greedy")})
    with pytest.raises(ValueError, match="mean reward 0"):
        analysis.check_quick({"thompson": curves(0.1 * far / 0.8), "epsilon-greedy": curves(near, "epsilon-greedy")})


def test_figure_5_4_leaves_the_burn_in_out(tmp_path):
    figure, ax = plt.subplots()
    figures.figure_5_4(ax, analysis.load("as-demo", world(tmp_path)), analysis.original())
    assert ax.get_xscale() == "log"
    assert min(line.get_xdata()[0] for line in ax.lines if len(line.get_xdata()) > 2) == 1
    assert {"thesis: 25", "thesis: 175"} < {text.get_text() for text in ax.texts}
    plt.close(figure)


def test_figure_5_4_is_averaged_on_the_logarithmic_axis_and_marks_where_mean_curves_first_reach_1():
    after = [[1.0, 2.0, 3.0, 4.0], [0.0, 0.5, 0.0, 0.0]]
    found = curves(np.concatenate((np.full((2, analysis.BURN_IN // analysis.BLOCK), 9.0), after), 1))
    x, values = analysis.smoothed(found, 3)  # batches 1, 2, and 3 to 4
    np.testing.assert_allclose(x, [1, 2, np.sqrt(12)])
    np.testing.assert_allclose(values, [[1, 2, 3.5], [0, 0.5, 0]])
    assert analysis.mean_crossing(found) == 2  # the mean is 0.5, 1.25, 1.5, 2
    assert analysis.mean_crossing(found, 3.0) == np.inf
    figure, ax = plt.subplots()
    figures.figure_5_4(ax, {"thompson": found})
    assert "ours: 2" in {text.get_text() for text in ax.texts}
    (dot,) = [line for line in ax.lines if line.get_marker() == "o"]
    assert (dot.get_xdata()[0], dot.get_ydata()[0]) == (2, 1)
    plt.close(figure)


def test_habits_are_counted_per_1000_ticks_over_ranges_of_a_logarithmic_axis():
    step = np.array([99.0] * 6 + [1.0] * 6 + [2.0] * 12)  # per 500 ticks: of the burn-in, to tick 6000, to 12,000
    agents = {}
    for agent, more in (("thompson", 1), ("epsilon-greedy", 10)):
        counts = {name: np.outer([more, more], place * step) for place, name in enumerate(figures.HABITS.values(), 1)}
        agents[agent] = curves(counts["food"], agent, **counts)
    figure, axes = plt.subplots(1, 4)
    figures.habits(list(axes), agents, points=2)
    assert [ax.get_title() for ax in axes] == list(figures.HABITS)
    for place, ax in enumerate(axes, 1):
        for line, (agent, more) in zip(ax.lines[::3], (("thompson", 1), ("epsilon-greedy", 10)), strict=True):
            assert line.get_label() == analysis.LABELS[agent]
            np.testing.assert_allclose(line.get_xdata(), np.sqrt([3000 * 6000, 6000 * 12_000]))
            np.testing.assert_allclose(line.get_ydata(), 2 * more * place * np.array([1, 2]))
    assert list(figures.HABITS.values()) == ["blocked", "food", "poison", "explored"]
    plt.close(figure)


def test_errors_on_what_was_learned_are_left_of_those_on_what_was_held_out(tmp_path):
    world(tmp_path)
    networks = {name: analysis.load(name, tmp_path)["epsilon-greedy"] for name in ERRORS}
    figure, axes = plt.subplots(1, 2)
    figures.held_out_errors(list(axes), networks)
    assert [ax.get_title() for ax in axes] == ["transitions learned from", "transitions held out"]
    for ax, errors in zip(axes, zip(*ERRORS.values(), strict=True), strict=True):
        assert [line.get_label() for line in ax.lines] == list(ERRORS)
        for line, error, network in zip(ax.lines, errors, networks.values(), strict=True):
            np.testing.assert_allclose(line.get_ydata(), error, rtol=0.01)
            np.testing.assert_allclose(line.get_xdata(), network.ticks[-1] * np.arange(0.1, 1.05, 0.1))
    plt.close(figure)


def test_late_in_the_runs_epsilon_greedy_eats_twice_as_much_and_no_more_poison():
    """The chapter says so, under "Where it breaks"."""
    agents = analysis.load("as-demo")
    food, poison = (
        [agents[name].share(what, 500_000, 1_000_000).mean() for name in ("epsilon-greedy", "thompson")]
        for what in ("food", "poison")
    )
    assert 1.7 < food[0] / food[1] < 2.5
    assert poison[0] < 1.05 * poison[1]


def test_a_second_record_adds_its_seeds_and_comparisons_pair_by_seed(tmp_path):
    """What each run earns is its seed, and 1 more with no exploration; the records hold the seeds in other orders."""
    config, blocks = CONFIGS["ours-thompson"], CONFIGS["ours-thompson"].ticks // analysis.BLOCK

    def store(name, seeds, more):
        reward = np.broadcast_to(np.array(seeds)[:, None, None] + more, (len(seeds), 1, blocks)).astype(float)
        plain = config_dict(CONFIGS[name])
        header = {
            "experiment": "exploration", "name": name, "seeds": list(seeds), "config": plain,
            "config_hash": config_hash(plain), "device": "cpu", "precision": "float32", "provenance": {},
        }  # fmt: skip
        arrays = {"average_reward": reward, "reward": reward, "weights": np.zeros((min(2, len(seeds)), 1, 7))}
        path = tmp_path / "exploration" / name / f"{records.file_name(seeds, 'cpu')}.npz"
        records.write(path, arrays, header)

    assert config.agents[0].policy == "thompson"
    for seeds in ((0, 1, 2), (5, 7)):
        store("ours-thompson", seeds, 0.0)
    for seeds in ((7, 2), (0, 1, 9)):
        store("ours-greedy", seeds, 1.0 + 0.01 * seeds[0])
    agents = analysis.load("ours", tmp_path)
    thompson, greedy = agents["thompson"], agents["greedy"]
    assert thompson.seeds == (0, 1, 2, 5, 7)
    assert thompson.mean(0, 5000).tolist() == [0, 1, 2, 5, 7]
    assert [r.path.name for r in thompson.records] == ["000-002.npz", "005+007.npz"]
    assert [one.seeds for one in analysis.paired(greedy, thompson)] == [(0, 1, 7, 2)] * 2
    value, low, high, n = analysis.compare(greedy, thompson, *analysis.LATE)
    assert n == 4
    assert value == pytest.approx((1 + 1 + 1.07 + 1.07) / 4)
    assert low > 0.9
    assert high < 1.2
    crossing = next(r for r in analysis.results(tmp_path) if r.id == "figure-5.4/greedy/first-crossing")
    assert crossing.seeds == [0, 1, 2, 7, 9]


def verdicts(folder, *names):
    return [judge([STATEMENTS[name]], folder)[0].verdict for name in names]


def test_what_holds_is_supported_and_what_fails_contradicted(tmp_path):
    assert verdicts(world(tmp_path / "1"), "EX5a", "EX5b", "EX5c", "EX5d", "EX6c") == ["supported"] * 5
    slow = {"ours-boltzmann": [(0.8, 9_000)], "ours-annealed-thompson": [(0.8, 9_000)]}
    assert verdicts(world(tmp_path / "2", **slow), "EX5b", "EX5d") == ["contradicted"] * 2
    late = {"ours-thompson": [(0.9, 4_000)], "as-demo": [(0.9, 4_000), (1.03, 20_600)]}
    assert verdicts(world(tmp_path / "3", **late), "EX1a", "EX1c") == ["contradicted"] * 2


def test_where_dropout_stands_needs_no_runs(tmp_path):
    assert verdicts(tmp_path, "EX4", "EX5a") == ["refuted", "untested"]


def test_an_agent_that_is_not_stored_is_said_to_be_missing(tmp_path):
    with pytest.raises(UserError, match=r"stored runs of the agent 'thompson' .* got those of none: git restores"):
        analysis.load("ours-thompson", tmp_path)["thompson"]


def test_two_agents_of_one_policy_are_refused():
    config = CONFIGS["as-demo"]
    twice = replace(config, agents=(config.agents[0], replace(config.agents[0], drop=(0.0, 0.1, 0.0))))
    with pytest.raises(ValueError, match=r"different policies, got \['thompson', 'thompson'\]"):
        analysis.from_arrays("mine", twice, {}, (100,))


def test_where_neither_agent_arrives_no_ratio_is_given():
    low = np.full((5, 30), 0.5)
    never = {name: analysis.Curves(name, "mine", low, (100, 101, 102, 103, 104), {}) for name in TWO}
    rising = np.minimum(low + 0.02 * np.arange(30), 1.1)
    arrives = {name: replace(curves, average=rising) for name, curves in never.items()}
    said = chapter.advantage("recorded", one_world=never, separate_worlds=arrives).markdown
    neither = "not known, since fewer than half of the runs of Thompson sampling and of ε-greedy arrive"
    assert f"in one world **{neither}**; in separate worlds **1.0 [1.0, 1.0]** (95 % intervals)" in said
    one = {"thompson": arrives["thompson"], "epsilon-greedy": never["epsilon-greedy"]}
    assert (
        "since fewer than half of the runs of ε-greedy arrive" in chapter.advantage("recorded", one_world=one).markdown
    )
