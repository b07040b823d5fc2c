"""Verdicts walked through by hand: where the interval lies decides, and noise is never rewarded."""

import inspect
import math

import pytest

from dropout_uncertainty.judging import rules
from dropout_uncertainty.stats import Estimate


def estimate(low, high, n=10):
    """Return an estimate with this 95 % interval; the 90 % interval is 0.84 as wide."""
    middle, half = (low + high) / 2, 0.42 * (high - low)
    return Estimate(middle, low, high, middle - half, middle + half, 0.04 if low > 0 or high < 0 else 0.5, n)


NARROW, ACROSS_MARGIN = estimate(-0.2, 0.3), estimate(-0.2, 1.6)
SMALL_ABOVE, ABOVE, FAR_ABOVE = estimate(0.1, 0.6), estimate(0.5, 1.5), estimate(1.2, 3.0)
FEW = estimate(1.2, 3.0, n=4)


@pytest.mark.parametrize(
    ("difference", "verdict"),
    [
        (NARROW, "agrees"),
        (SMALL_ABOVE, "agrees"),  # a difference that is sure and too little to matter
        (ABOVE, "differs"),
        (FAR_ABOVE, "differs"),
        (ACROSS_MARGIN, "imprecise"),  # wide: neither
        (FEW, "untested"),
    ],
)
def test_a_printed_value(difference, verdict):
    assert rules.value(difference, 1.0) == verdict


@pytest.mark.parametrize(
    ("difference", "less", "more"),
    [
        (estimate(-3.0, -1.0), "supported", "contradicted"),
        (FAR_ABOVE, "contradicted", "supported"),
        (NARROW, "no difference", "no difference"),
        (ACROSS_MARGIN, "inconclusive", "inconclusive"),
        (FEW, "untested", "untested"),
    ],
)
def test_a_comparison(difference, less, more):
    assert rules.comparison(difference, "less", 1.0) == less
    assert rules.comparison(difference, "more", 1.0) == more


@pytest.mark.parametrize(
    ("difference", "verdict"),
    [
        (NARROW, "supported"),
        (SMALL_ABOVE, "supported"),
        (FAR_ABOVE, "contradicted"),
        (ABOVE, "inconclusive"),  # not 0, perhaps within the margin
        (ACROSS_MARGIN, "inconclusive"),
        (FEW, "untested"),
    ],
)
def test_an_equality(difference, verdict):
    assert rules.equality(difference, 1.0) == verdict


def test_more_noise_never_helps_a_claim():
    """Widening an interval about its middle can take a verdict away, not give one."""
    decided = {"agrees", "differs", "supported", "contradicted", "no difference"}
    for judge in (
        lambda e: rules.value(e, 1.0), lambda e: rules.comparison(e, "less", 1.0), lambda e: rules.equality(e, 1.0),
    ):  # fmt: skip
        for middle in (-2.0, -0.5, 0.0, 0.5, 2.0):
            verdicts = [judge(estimate(middle - half, middle + half)) for half in (0.1, 0.3, 1.0, 3.0, 10.0)]
            open_from = next((i for i, v in enumerate(verdicts) if v not in decided), len(verdicts))
            assert all(v not in decided for v in verdicts[open_from:]), (middle, verdicts)
            assert verdicts[-1] not in decided


def test_a_small_difference_says_so():
    assert rules.small("supported", SMALL_ABOVE, 1.0)
    assert not rules.small("supported", ABOVE, 1.0)
    assert not rules.small("no difference", NARROW, 1.0)


def test_a_side_is_less_or_more():
    with pytest.raises(ValueError, match="claims less or more, got 'lower'"):
        inspect.unwrap(rules.comparison)(Estimate(-1, -2, -0.5, -1.8, -0.6, 0.01, 10), "lower", 0.1)


def test_nan_is_untested():
    unknown = Estimate(1.0, *[math.nan] * 5, 10)
    assert (
        rules.value(unknown, 1.0)
        == rules.comparison(unknown, "less", 1.0)
        == rules.equality(unknown, 1.0)
        == "untested"
    )


def test_holm_by_hand():
    found = rules.holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": math.nan})
    assert found["a"] == pytest.approx(0.04)
    assert found["c"] == pytest.approx(0.09)
    assert found["b"] == pytest.approx(0.09), "never below that of a smaller p"
    assert math.isnan(found["d"])
    assert rules.adjusted("supported", found["a"]) == "supported"
    assert rules.adjusted("contradicted", found["c"]) == "inconclusive"
    assert rules.adjusted("no difference", found["b"]) == "no difference"
