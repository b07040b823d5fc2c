"""Deep Sea's numbers, by hand: bsuite's rule, censoring, growth."""

import numpy as np
import pytest
from scipy import stats as scipy_stats
from scipy.optimize import minimize

from dropout_uncertainty.exploration.report.deep_sea.analysis import (
    Dives,
    censored_slope,
    difference,
    growth,
    score,
    solved_episode,
    table,
)


def dives(agent, size, solved, last):
    solved, last = np.array(solved, float), np.array(last, float)
    first = np.full((len(solved), size, size), -1, dtype=np.int16)
    first[:, 0, 0] = 0
    first[0, 1, 1] = 5
    return Dives(agent, size, tuple(range(len(solved))), solved, last, first)


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
    assert cells[0][:3] == ["No exploration", None, "3 of 4, 355"]


@pytest.mark.slow  # two thousand fits
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


@pytest.mark.parametrize("until", [np.inf, 1.0])
def test_a_censored_slope_is_the_most_likely(until):
    """By a general minimiser; without censoring it is that of least squares."""
    numbers = np.random.default_rng(100)
    x = numbers.standard_normal(50)
    y = 2 * x + numbers.standard_normal(50)
    exact, y = y < until, np.minimum(y, until)
    sets = numbers.integers(50, size=(3, 50))

    def most_likely(i):
        def loss(theta):
            z = (y[i] - theta[0] - theta[1] * x[i]) / np.exp(theta[2])
            norm = scipy_stats.norm
            return -(norm.logpdf(z[exact[i]]) - theta[2]).sum() - norm.logsf(z[~exact[i]]).sum()

        return minimize(loss, [0.0, 0.0, 0.0]).x[1]

    assert censored_slope(x, y, exact)(sets) == pytest.approx([most_likely(i) for i in sets], abs=1e-4)
    if until == np.inf:
        assert censored_slope(x, y, exact)(np.arange(50)) == pytest.approx(np.polyfit(x, y, 1)[0])
    assert np.isnan(censored_slope(x, y, np.zeros(50, dtype=bool))(sets)).all()
