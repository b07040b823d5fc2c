import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats as scipy_stats

from dropout_uncertainty import stats


def test_t_interval_is_scipys():
    values = [1.0, 2.0, 4.0, 4.5]
    expected = scipy_stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert stats.t_interval(values) == pytest.approx((np.mean(values), expected.low, expected.high, 4))
    assert np.isnan(stats.t_interval([3.0]).low)


def test_first_crossings():
    assert stats.first_crossings(np.array([[9, 5, 7, 4], [9, 8, 8, 8]]), 5.0).tolist() == [1, np.inf]
    assert stats.first_crossings(np.array([0, 2, 1]), 2.0, above=True) == 1


@pytest.mark.filterwarnings("ignore:invalid value")
def test_what_is_not_known_is_no_finding():
    for values in ([0.1, 0.2, np.nan, 0.3, 0.4], [0.1, 0.2, np.inf, 0.3, 0.4]):
        assert np.isnan(stats.mean_estimate(values).p)
    curves = np.linspace(9, 1, 9) + np.zeros((6, 1))
    curves[0, 2] = np.nan
    assert np.isnan(stats.first_crossings(curves, 5.0)).tolist() == [True] + 5 * [False]
    assert np.isnan(stats.crossing_interval(curves, 5.0).value)
    assert np.isnan(stats.crossing_interval(np.empty((0, 9)), 5.0).value)
    assert stats.median_interval([1.0, 2.0, 3.0]).value == 2
    assert np.isnan(stats.median_interval([]).value)
    with pytest.raises(ValueError, match="true or false for each repetition"):
        stats.share_interval(np.array([np.nan, 0.0, 1.0]))
    with pytest.raises(ValueError, match=r"one number for each repetition, got shape \[2, 3\]"):
        stats.t_interval(np.zeros((2, 3)))


def test_what_was_not_measured_before_a_crossing_stays_unknown():
    curves = np.array([[9, np.nan, 9, 4, 3, 2.0]] * 5)
    assert [np.isnan(stats.crossing_interval(curves, 5.0, width=width).value) for width in (1, 3)] == [True, True]


@pytest.mark.parametrize("width", [1, 3, 4, 5])
def test_median_filter_is_the_middle_of_a_sorted_window_and_puts_nan_last(width):
    curves = np.random.default_rng(0).normal(size=(5, 30))
    unknown = np.random.default_rng(1).random(curves.shape) < 0.2
    padded = np.pad(np.where(unknown, np.inf, curves), [(0, 0), (width // 2, (width - 1) // 2)], mode="edge")
    expected = np.sort(np.lib.stride_tricks.sliding_window_view(padded, width, -1), -1)[..., width // 2]
    found = stats.median_filter(np.where(unknown, np.nan, curves), width)
    np.testing.assert_array_equal(found, np.where(unknown, np.nan, expected))


def test_median_filter_removes_a_single_dip():
    curve = np.array([9.0, 8, 2, 8, 7, 6, 6, 6])
    assert stats.median_filter(curve, 5).min() >= 6
    np.testing.assert_array_equal(stats.median_filter(curve, 1), curve)


def test_a_crossing_that_some_resamples_never_reach_has_an_infinite_limit():
    never, at_once = np.full(5, 9.0), np.zeros(5)
    interval = stats.crossing_interval(np.stack([never, at_once, at_once, at_once]), 5.0)
    assert interval.value == 0
    assert interval.high == np.inf


def test_bootstrap_interval_covers_the_mean_as_often_as_it_says():
    generator = np.random.default_rng(100)
    hits = 0
    for _ in range(100):
        sample = generator.normal(size=30)
        interval = stats.bootstrap_interval(lambda i, s=sample: s[i].mean(-1), 30)
        hits += interval.low <= 0 <= interval.high
    assert 85 <= hits <= 99


@pytest.mark.parametrize("width", [1, 5])
def test_all_resamples_at_once_give_the_numbers_of_one_by_one(width):
    curves = np.random.default_rng(100).normal(5.2, 0.3, (6, 40))

    def one_by_one(statistic):
        return lambda *sets: np.array(
            [statistic(*s) for s in zip(*sets, strict=True)] if sets[0].ndim > 1 else statistic(*sets)
        )

    def crossing(i):
        return stats.first_crossings(stats.median_filter(curves[i].mean(0), width), 5.0)

    assert stats.bootstrap_interval(one_by_one(crossing), 6) == stats.crossing_interval(curves, 5.0, width=width)
    first = np.array([3.0, np.inf, 1, 2, 2])
    middle = one_by_one(lambda i: np.sort(first[i])[2])
    assert stats.median_interval(first) == stats.bootstrap_interval(middle, 5)
    pair, plain = ((lambda i, j, axis=axis: curves[i, 0].mean(axis) - curves[j, 1].mean(axis)) for axis in (-1, None))
    assert stats.bootstrap_estimate(pair, 6, 5) == stats.bootstrap_estimate(one_by_one(plain), 6, 5)


def test_a_crossing_that_is_never_reached_has_a_lower_limit():
    reached, never = np.full(6, 7.0), np.full(6, np.inf)
    found = stats.bootstrap_estimate(lambda i: np.minimum(never, 9)[i].max(-1) - 5, 6, most=lambda i: never[i].max(-1))
    assert (found.value, found.low, found.high, found.low90) == (np.inf, 4, np.inf, 4)
    assert found.p < 0.05
    plain = stats.bootstrap_estimate(lambda i: reached[i].max(-1), 6)
    assert stats.bootstrap_estimate(lambda i: reached[i].max(-1), 6, most=lambda i: reached[i].max(-1)) == plain
    assert np.isnan(stats.bootstrap_estimate(lambda i: never[i].max(-1), 6).low)


def test_a_statistic_that_mixes_resamples_is_refused():
    with pytest.raises(ValueError, match="one number per resample, 35 in all, got shape \\(\\)"):
        stats.bootstrap_interval(lambda i: i.mean(), 4)
    with pytest.raises(ValueError, match="one number per resample, 5000 in all, got shape \\(\\)"):
        stats.bootstrap_interval(lambda i: i.mean(), 40)


def test_few_repetitions_have_all_their_resamples():
    first, second = np.array([0.0, 1, 3]), np.array([0.0, 10])
    (i, j), weights = stats._resamples(3, 2)
    assert weights.sum() == pytest.approx(1)
    every = [first[list(a)].mean() - second[list(b)].mean()
             for a in itertools.product(range(3), repeat=3) for b in itertools.product(range(2), repeat=2)]  # fmt: skip
    mine = first[i].mean(-1) - second[j].mean(-1)
    for value in np.unique(np.round(every, 9)):
        assert weights[np.isclose(mine, value)].sum() == pytest.approx(np.isclose(every, value).mean())


def test_an_interval_in_words_has_the_limits_that_there_are():
    assert stats.in_words(stats.t_interval([1.0, 2.0, 3.0])) == "2.00 [−0.48, 4.48]"
    assert stats.in_words(stats.mean_estimate([1.0, 2.0, 3.0]), ".1f") == "2.0 [−0.5, 4.5]"
    assert stats.in_words(stats.mean_estimate([-10.5]), ".1f") == "−10.5"
    assert stats.in_words(stats.t_interval([-0.001, -0.001]), ".2f") == "0.00 [0.00, 0.00]"


def test_what_runs_do_not_reach_is_said():
    assert stats.in_words(stats.median_interval(np.array([9.0, 10.0, np.inf] * 3)), ".0f") == "10 [9, not reached]"
    assert stats.in_words(stats.Interval(np.inf, 30.0, np.inf, 5), ".0f", unbounded="> 98") == "> 98 [30, > 98]"
    assert stats.in_words(stats.Interval(np.inf, np.inf, np.inf, 5)) == "not reached"
    assert stats.in_words(stats.Interval(1.0, -np.inf, 2.0, 5), unbounded="…") == "1.00 […, 2.00]"
    assert stats.in_digits(-0.0004, "+.3f") == "+0.000"
    assert stats.in_digits(-np.inf, unbounded="…") == "…"
    assert [stats.in_digits(x, ".2g") for x in (122.5, -1760.0, 99.4, 0.00012)] == ["120", "−1800", "99", "0.00012"]
    assert stats.in_digits(1760.0, "+.2g") == "+1800"


def test_paired_samples_must_pair_up():
    with pytest.raises(ValueError, match="one value per seed"):
        stats.paired_difference([1.0, 2.0], [1.0, 2.0, 3.0])
    assert stats.paired_difference([2.0, 3.0, 5.0], [1.0, 2.0, 4.0]).value == 1


def test_seeds_that_all_samples_have():
    assert stats.common((3, 1, 2), [2, 3]) == [[0, 2], [1, 0]]
    assert stats.common([0, 1], [2]) == [[], []]


def test_repetitions_are_compared_by_seed():
    one = SimpleNamespace(seeds=(3, 1, 2), x=np.array([3.0, 1.0, 2.0]))
    two = SimpleNamespace(seeds=[2, 3], x=np.array([20.0, 30.0]))
    assert stats.apart(lambda sample: sample.x, one, two).tolist() == [-27, -18]


def test_an_interval_is_told_by_its_side_of_0():
    words = [stats.told(stats.Interval(0.0, *ends, 5), "more", "less", "open") for ends in ((1, 2), (-2, -1), (-1, 1))]
    assert words == ["more", "less", "open"]


def test_estimates_by_hand():
    values = [1.0, 2.0, 3.0, 4.0, 5.0]
    found = stats.mean_estimate(values)
    reference = scipy_stats.ttest_1samp(values, 0.0)
    assert found.value == 3.0
    assert found.p == pytest.approx(reference.pvalue)
    assert (found.low, found.high) == pytest.approx(tuple(reference.confidence_interval(0.95)))
    assert (found.low90, found.high90) == pytest.approx(tuple(reference.confidence_interval(0.90)))
    assert np.isnan(stats.mean_estimate([1.0]).low)
    assert stats.mean_estimate([2.0] * 5).low == 2.0, "no spread, no width"


def test_shares_by_newcombe_s_own_example():
    """Newcombe (1998), table II, method 10: 56/70 - 48/80 gives 0.2 [0.0524, 0.3339]."""
    first, second = np.arange(70) < 56, np.arange(80) < 48
    found = stats.difference_of_shares(first, second)
    assert (found.value, found.low, found.high) == pytest.approx((0.2, 0.0524, 0.3339), abs=5e-5)
    assert found.p == pytest.approx(scipy_stats.fisher_exact([[56, 14], [48, 32]]).pvalue)


@pytest.mark.parametrize("n", [5, 6, 10, 40])
def test_intervals_cover_what_they_promise(n):
    """95 % intervals of a mean hold the truth in at least 92 % of samples, however few repetitions there are."""
    generator = np.random.default_rng(1)
    tries = 200
    means = generator.normal(size=(tries, n))
    student = np.mean([e.low <= 0 <= e.high for e in map(stats.mean_estimate, means)])
    boot = np.mean(
        [e.low <= 0 <= e.high for e in (stats.bootstrap_estimate(lambda i, s=s: s[i].mean(-1), n) for s in means)]
    )
    assert student >= 0.92
    assert boot >= 0.92


def test_intervals_of_two_samples_cover_what_they_promise():
    """As above; the second sample is as small as the original program's."""
    generator = np.random.default_rng(1)
    pairs = [(generator.normal(size=6), generator.normal(size=3)) for _ in range(200)]
    found = [stats.bootstrap_estimate(lambda i, j, a=a, b=b: a[i].mean(-1) - b[j].mean(-1), 6, 3) for a, b in pairs]
    assert np.mean([e.low <= 0 <= e.high for e in found]) >= 0.92
    assert all(np.isnan(e.p) for e in found), "three repetitions cannot show a small p"
