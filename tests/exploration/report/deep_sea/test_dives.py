"""Deep Sea's numbers and pictures: bsuite's rule, censoring, growth, and what has not been run."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm

from dropout_uncertainty.exploration.deep_sea.experiment import AGENTS
from dropout_uncertainty.exploration.report.deep_sea import analysis, figures
from dropout_uncertainty.exploration.report.deep_sea.analysis import (
    CONTRASTS,
    coin,
    difference,
    growth_table,
    not_run,
    results,
    score,
    table,
)
from dropout_uncertainty.exploration.report.deep_sea.animation import animation
from dropout_uncertainty.exploration.report.deep_sea.dives import LABELS, Dives, from_arrays, load, solved_episode
from dropout_uncertainty.exploration.report.deep_sea.growth import censored_slopes, growth


def dives(agent, size, solved, last, again=0.5):
    solved, last = np.array(solved, float), np.array(last, float)
    first = np.full((len(solved), size, size), -1, dtype=np.int16)
    first[:, 0, 0] = 0
    first[0, 1, 1] = 5
    share = np.where(np.isfinite(solved), again, np.nan)
    return Dives(agent, size, tuple(range(len(solved))), solved - 1, share, solved, last, first)


def test_solved_is_more_than_a_tenth_of_all_episodes():
    found = np.zeros((4, 30), dtype=bool)
    found[0, 9] = True  # one of ten: regret 0.9
    found[1, [9, 10]] = True  # two of eleven
    found[2, 4] = True  # luck early on counts, as in bsuite
    np.testing.assert_array_equal(solved_episode(found), [np.inf, 11, 5, np.inf])


def test_unsolved_seas_are_censored_not_dropped():
    mine = dives("greedy", 5, [10, 20, np.inf, 40], [100, 100, 30, 100])
    curve = mine.curve()
    np.testing.assert_allclose(curve.evaluate([9, 10, 20, 35, 40]), [1, 0.75, 0.5, 0.5, 0])
    assert mine.share(25).value == 0.5
    assert mine.share(25).low < 0.5 < mine.share(25).high
    with pytest.raises(ValueError, match="played for 30 episodes, so nothing is known of 31"):
        mine.within(31)
    np.testing.assert_array_equal(mine.reached(5)[:2, :2], [[1, 0], [0, 0]])
    assert mine.reached(6)[1, 1] == 0.25


def test_shares_are_compared_and_scored():
    first, second = dives("greedy", 5, [10] * 20, [100] * 20), dives("boltzmann", 5, [np.inf] * 20, [3000] * 20)
    estimate = difference(first, second)
    assert estimate.value == 1
    assert estimate.low > 0.5
    # 2^5 + 100 = 132
    late = dives("greedy", 8, [131, 400, np.inf, 355], [500] * 4)
    assert score({("greedy", 8): late, ("boltzmann", 5): second}, "greedy").value == 0.5
    heads, cells = table({("greedy", 8): late}, (5, 8))
    assert len(heads) == len(cells[0])
    assert cells[1][:2] == ["No exploration", "not run yet"]
    assert cells[1][2].startswith("3 of 4, 355 [")


def test_a_run_says_when_the_treasure_was_found_and_how_often_again():
    found = np.zeros((3, 20), dtype=bool)
    found[0, [4, 9]] = True  # found in episode 5, once more in the 15 that follow
    found[1, 7] = True  # in its last episode
    arrays = {"found": found, "episodes": np.array([20, 8, 20]), "first_visit": np.zeros((3, 5, 5), int)}
    mine = from_arrays("greedy", 5, arrays, (0, 1, 2))
    np.testing.assert_array_equal(mine.found, [5, 8, np.inf])
    np.testing.assert_allclose(mine.again, [1 / 15, np.nan, np.nan])
    assert mine.config == "deep-sea/greedy/5"


def test_the_median_counts_what_is_censored_and_is_inside_its_interval():
    half = dives("greedy", 5, [10, 20, 30, np.inf, np.inf, np.inf], [100] * 6)
    assert half.median().value == 30
    assert half.median().low <= 30 <= half.median().high
    few = dives("greedy", 5, [10, *[np.inf] * 9], [100] * 10)
    assert np.isinf(few.median().value)
    all_at_once = dives("greedy", 5, [10] * 5, [100] * 5)
    assert all_at_once.median() == (10, 10, np.inf, 5)  # five of one time say little about later ones


def test_a_coin():
    assert coin(1, 1) == 0.5
    assert coin(2, 2) == pytest.approx(1 - 0.75**2)


def test_growth_is_found_again_and_needs_no_solution_everywhere():
    noise = np.random.default_rng(100)
    known = {}
    for size in (5, 8, 10, 13):
        episodes = 3 * size**2.5 * np.exp(0.1 * noise.standard_normal(30))
        known["greedy", size] = dives("greedy", size, np.where(episodes < 1500, episodes, np.inf), [1500] * 30)
    assert np.isinf(known["greedy", 13].solved).any()
    power = growth(known, "greedy", "power")
    assert power.low < 2.5 < power.high
    assert power.high - power.low < 0.4
    assert np.isnan(growth(known, "boltzmann", "power").value)


def test_a_censored_slope_without_censoring_is_least_squares():
    numbers = np.random.default_rng(100)
    x = numbers.standard_normal(50)
    y = 2 * x + numbers.standard_normal(50)
    exact, all_of_them = np.ones(50, dtype=bool), np.arange(50)
    assert censored_slopes(x, y, exact, all_of_them) == pytest.approx(np.polyfit(x, y, 1)[0], abs=1e-6)
    assert np.isnan(censored_slopes(x, y, ~exact, all_of_them))


def test_censored_slopes_are_the_maxima_of_the_likelihood():
    numbers = np.random.default_rng(100)
    x = np.repeat(np.log([5.0, 8.0, 10.0]), 20)
    whole = 1 + 2.5 * x + numbers.standard_normal(60)
    exact, y = whole < 6, np.minimum(whole, 6)
    assert 0.2 < exact.mean() < 0.6
    resamples = numbers.integers(60, size=(4, 60))

    def slope(i):
        def loss(theta):
            z = (y[i] - theta[0] - theta[1] * (x[i] - 2)) / np.exp(theta[2])
            return -np.where(exact[i], norm.logpdf(z) - theta[2], norm.logsf(z)).sum()

        return minimize(loss, [5.0, 1.0, 0.0], options={"gtol": 1e-7}).x[1]

    np.testing.assert_allclose(censored_slopes(x, y, exact, resamples), [slope(i) for i in resamples], rtol=1e-4)


def test_a_slope_that_nothing_bounds_is_infinite():
    x, y = np.repeat([1.0, 2.0], 4), np.array([1.0, 1.1, 1.2, 1.3, 5, 5, 5, 5])
    assert censored_slopes(x, y, x < 1.5, np.arange(8)) == np.inf
    two = censored_slopes(x, y, x < 1.5, np.array([[0, 0, 1, 1, 4, 5, 6, 7], [0, 1, 2, 3, 0, 1, 2, 3]]))
    assert np.isnan(two).all()  # two points, and one size


@pytest.fixture
def some():
    return {
        ("epsilon-greedy", 5): dives("epsilon-greedy", 5, [50, 60, 70, 80], [200] * 4),
        ("epsilon-greedy", 10): dives("epsilon-greedy", 10, [900, 950, 1000, np.inf], [10_000] * 4),
        ("dropout-per-episode", 10): dives("dropout-per-episode", 10, [np.inf] * 4, [10_000] * 4),
    }


def test_what_is_not_run_is_said_everywhere(some):
    assert not_run(some, 10).startswith("Not run yet in seas of size 10: No exploration; Boltzmann")
    assert not_run({(agent, 5): some["epsilon-greedy", 5] for agent in LABELS}, 5) == ""
    cells = table(some, (5, 10))[1]
    assert len(cells) == len(LABELS)
    assert cells[0][1].startswith("4 of 4, 60 [")
    assert cells[0][2].startswith("3 of 4, 950 [")
    assert cells[1] == ["No exploration", "not run yet", "not run yet", None]
    lines = {line[0]: line for line in growth_table(some)[1]}
    assert lines[LABELS["dropout-per-episode"]][2:] == ["one size only"] * 2
    assert len(lines) == 2


def test_pictures_show_what_there_is(some):
    for shown in (some, {}):
        fig, axes = plt.subplots(len(LABELS), 2)
        figures.reached(axes, shown, 10, (10, 100))
        words = [text.get_text() for ax in axes.flat for text in ax.texts]
        assert words == ["not run yet"] * (len(LABELS) - (2 if shown else 0))
        other, (left, middle, right) = plt.subplots(1, 3)
        figures.shares(left, shown, 10)
        assert len(left.texts) == len(words)
        figures.survival(middle, shown, 10)
        figures.growth(right, shown)
        for ax in (middle, right):
            assert ax.get_title(loc="left").startswith("Not run yet:")
        plt.close(fig)
        plt.close(other)


def test_pictures_show_the_numbers():
    mine = dives("epsilon-greedy", 10, [500, 1500, 2500, np.inf], [3000] * 4)
    mine = replace(mine, found=np.array([400, 900, 1700, np.inf]))
    known = {("epsilon-greedy", 10): mine, ("greedy", 10): dives("greedy", 10, [np.inf] * 4, [3000] * 4)}
    fig, axes = plt.subplots(len(LABELS), 2)
    figures.reached(axes, known, 10, (5, 6))
    assert [ax.get_title() for ax in axes[0]] == ["5 episodes", "6 episodes"]
    assert [ax.images[0].get_array()[1, 1] for ax in axes[0]] == [0, 0.25]  # one sea of four, in its sixth episode
    other, (left, middle, right) = plt.subplots(1, 3)
    figures.shares(left, known, 10)
    dots = [line for line in left.lines if line.get_marker() == "o"]
    shown = {(round(*dot.get_ydata()), dot.get_markerfacecolor() == "white"): dot.get_xdata()[0] for dot in dots[:4]}
    assert shown == {(0, True): 0.75, (0, False): 0.5, (1, True): 0, (1, False): 0}
    assert {line.get_label(): line.get_markerfacecolor() == "white" for line in dots[4:]} == {
        "treasure found": True, "sea solved": False,
    }  # fmt: skip
    (line,) = [line for line in left.lines if line.get_linestyle() == ":"]
    np.testing.assert_allclose(line.get_xdata(), 1 - (1 - 2.0**-10) ** 2000)
    figures.survival(middle, known, 10)
    for label, unsolved in (("ε-greedy", [1, 0.75, 0.5, 0.5, 0.25]), ("No exploration", [1] * 5)):
        x, y = next(line for line in middle.lines if line.get_label() == label).get_data()
        np.testing.assert_allclose(y[np.searchsorted(x, [499, 500, 1500, 2499, 2999], "right") - 1], unsolved)
    figures.growth(right, known)
    (median,) = [line for line in right.lines if line.get_label() == "ε-greedy"]
    assert median.get_ydata().tolist() == [1500]
    ((_, low), (_, high)) = right.collections[0].get_segments()[0]
    assert (low, high) == (mine.median().low, min(mine.median().high, 3000))
    assert [line.get_ydata().tolist() for line in right.lines if "arrow" in str(line.get_marker())] == [[], [3000]]
    plt.close(fig)
    plt.close(other)


def test_the_animation_darkens_what_is_reached(some):
    player = animation(some, 10, 100, ("epsilon-greedy", "greedy"))
    cells = 10 * 11 // 2
    opacity = [shape.attributes["fill-opacity"] for shape in player.frames[-1]]
    assert len(opacity) == 2 * cells
    assert opacity[:3] == [1, 0, 0.25]  # row by row: (0, 0), (1, 0), (1, 1)
    assert player.frames[0][2].attributes["fill-opacity"] == 0  # not in the first episode
    assert sum(opacity[cells:]) == 0
    assert player.labels[-1].split("\n")[1:] == [
        "ε-greedy: treasure found in 0 of 4 seas, 0 solved",
        "No exploration: not run yet",
    ]


def test_results_carry_the_ids_that_other_programs_rely_on(some, monkeypatch):
    monkeypatch.setattr(analysis, "load", lambda folder: some)
    found = {result.id: result for result in results()}
    assert found["deep-sea/epsilon-greedy/10/solved-by-2000"].ours == 0.75
    assert found["deep-sea/epsilon-greedy/10/share-solved"].ours == 0.75
    assert found["deep-sea/epsilon-greedy/10/episodes-to-solve"].ours == 950
    assert found["deep-sea/dropout-per-episode/10/episodes-to-solve"].ours is None
    assert found["deep-sea/epsilon-greedy/score"].ours == 7 / 8
    assert found["deep-sea/epsilon-greedy/growth-power"].ours > 1
    assert "deep-sea/dropout-per-episode/growth-power" not in found
    assert found["deep-sea/contrast/dropout-per-episode/epsilon-greedy/10"].ours == -0.75
    assert len([name for name in found if "contrast" in name]) == 1 < len(CONTRASTS)


def test_without_records_there_are_no_results(tmp_path):
    assert results(tmp_path) == []
    assert load(tmp_path) == {}


def test_every_agent_has_a_label_and_a_colour():
    assert list(LABELS) == list(AGENTS)
    assert set(figures.AGENT_COLOURS) == set(AGENTS)
