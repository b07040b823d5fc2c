"""Intervals, estimates, paired differences and crossings of curves: thin over ``scipy.stats`` and ``scipy.ndimage``.

An `Interval` describes; an `Estimate` carries what a verdict needs (``judging.rules``).
What is not one number, or not true or false, for each repetition raises ValueError.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy import stats as scipy_stats
from scipy.special import gammaln

__all__ = [
    "CONFIDENCE", "Estimate", "Interval", "Statistic", "apart", "bootstrap_estimate", "bootstrap_interval", "common",
    "crossing_interval", "difference_of_shares", "first_crossings", "in_digits", "in_words", "mean_estimate",
    "median_filter", "median_interval", "paired_difference", "share_estimate", "share_interval", "smaller_median",
    "t_interval", "told",
]  # fmt: skip

CONFIDENCE = 0.95
#: Resamples of a bootstrap: all that there are, if these are at most so many, else so many drawn at random.
MOST, RESAMPLES = 10_000, 5_000
#: Takes indices of repetitions [..., n], one array a sample, and gives [...].
Statistic = Callable[..., Any]


class Interval(NamedTuple):
    """An estimate with the limits of its 95 % interval over ``n`` repetitions; NaN limits where n < 2."""

    value: float
    low: float
    high: float
    n: int


class Estimate(NamedTuple):
    """A difference from what is claimed, as rules judge it; NaN where ``n`` repetitions are too few to tell.

    ``value`` is the estimate; ``low`` and ``high`` are its 95 % interval, against which a difference is judged, and
    ``low90`` and ``high90`` its 90 % interval, against which equivalence is judged (two one-sided tests at 5 %); ``p``
    is the two-sided p-value of "the difference is 0", and ``n`` counts the repetitions, of two samples those of the
    smaller.
    """

    value: float
    low: float
    high: float
    low90: float
    high90: float
    p: float
    n: int

    @property
    def interval(self) -> Interval:
        """The estimate with its 95 % interval."""
        return Interval(self.value, self.low, self.high, self.n)


def in_digits(value: float, spec: str = ".2f", unbounded: str = "not reached") -> str:
    """Return a number by a format, with a minus sign, never a negative 0 and no power of ten for a large one.

    ``unbounded`` stands for infinity.
    """
    if math.isinf(value):
        return unbounded
    digits = f"{value:{spec.replace('.', 'z.', 1)}}"
    if "e+" in digits:
        digits = f"{float(digits):{'+' * spec.startswith('+')}.0f}"
    return digits.replace("-", "−")


def in_words(found: Interval | Estimate, spec: str = ".2f", unbounded: str = "not reached") -> str:
    """Return an interval such as "0.35 [0.21, 0.49]", its numbers as ``in_digits`` writes them.

    Limits are left out where there are none, or where both are infinite.
    """
    value, low, high = (in_digits(number, spec, unbounded) for number in found[:3])
    none = math.isnan(found.low) or (math.isinf(found.low) and math.isinf(found.high))
    return value if none else f"{value} [{low}, {high}]"


def told(difference: Interval, above: str, below: str, between: str) -> str:
    """Return the words for an interval that lies above 0, below it, or on both sides."""
    return above if difference.low > 0 else below if difference.high < 0 else between


def _unknown(value: float, n: int) -> Estimate:
    return Estimate(value, np.nan, np.nan, np.nan, np.nan, np.nan, n)


def _student(value: float, error: float, freedom: float | int, n: int) -> Estimate:
    half95, half90 = (float(error * scipy_stats.t.ppf(q, freedom)) for q in (0.975, 0.95))
    if not math.isfinite(error):
        return _unknown(value, n)
    p = 2 * scipy_stats.t.sf(abs(value) / error, freedom) if error > 0 else float(value == 0)
    return Estimate(value, value - half95, value + half95, value - half90, value + half90, float(p), n)


def _row(values: Sequence[float] | np.ndarray) -> Float[np.ndarray, " n"]:
    """Return one number for each repetition; raises ValueError for another shape."""
    values = np.asarray(values, float)
    if values.ndim != 1:
        raise ValueError(f"expected one number for each repetition, got shape {list(values.shape)}")
    return values


def _flags(flags: Sequence[bool] | np.ndarray) -> Bool[np.ndarray, " n"]:
    """Return whether each repetition has a property; raises ValueError for NaN and other numbers than 0 and 1."""
    values = _row(np.asarray(flags, float))
    if not np.isin(values, (0, 1)).all():
        raise ValueError(f"expected true or false for each repetition, got {values.tolist()}")
    return values == 1


def mean_estimate(values: Sequence[float] | np.ndarray) -> Estimate:
    """Return the mean of independent repetitions, such as paired differences, by Student's t."""
    values = _row(values)
    n = len(values)
    if n < 2:
        return _unknown(float(values.mean()) if n else np.nan, n)
    return _student(float(values.mean()), float(scipy_stats.sem(values)), n - 1, n)


def share_estimate(flags: Sequence[bool] | np.ndarray, claimed: float) -> Estimate:
    """Return a share less a claimed one, with Wilson's intervals; the p-value is that of the exact binomial test."""
    flags = _flags(flags)
    n = len(flags)
    if n == 0:
        return _unknown(np.nan, 0)
    test = scipy_stats.binomtest(int(flags.sum()), n, claimed)
    wide, narrow = (test.proportion_ci(level, method="wilson") for level in (0.95, 0.90))
    low, high, low90, high90 = (float(end - claimed) for end in (wide.low, wide.high, narrow.low, narrow.high))
    return Estimate(float(flags.mean() - claimed), low, high, low90, high90, float(test.pvalue), n)


def difference_of_shares(first: Sequence[bool] | np.ndarray, second: Sequence[bool] | np.ndarray) -> Estimate:
    """Return share(first) - share(second) of two samples, with Newcombe's intervals from Wilson's (1998, method 10).

    The p-value is that of Fisher's exact test. Of samples that share their seeds this is the more careful answer.
    """
    first, second = _flags(first), _flags(second)
    n = min(len(first), len(second))
    if n == 0:
        return _unknown(np.nan, 0)
    a, b = float(first.mean()), float(second.mean())

    def limits(level: float) -> tuple[float, float]:
        one, two = (
            scipy_stats.binomtest(int(s.sum()), len(s)).proportion_ci(level, method="wilson") for s in (first, second)
        )
        return a - b - math.hypot(a - one.low, two.high - b), a - b + math.hypot(one.high - a, b - two.low)

    (low, high), (low90, high90) = limits(0.95), limits(0.90)
    table = [[int(s.sum()), int((~s).sum())] for s in (first, second)]
    return Estimate(a - b, low, high, low90, high90, float(scipy_stats.fisher_exact(table).pvalue), n)


def bootstrap_estimate(statistic: Statistic, *sizes: int, most: Statistic | None = None) -> Estimate:
    """Return ``statistic(indices, ...)`` of samples of the given sizes, with expanded percentile intervals.

    The statistic is as in ``bootstrap_interval``, with indices for each sample. Samples are resampled independently; a
    paired statistic has one. Plain percentiles are too narrow for few repetitions: the levels are widened as Student's
    t widens those of a normal mean, for the smallest sample (Hesterberg, 2015). The p-value is the level at which the
    interval first touches 0; it is NaN where a sample has fewer than five repetitions, since no resample shows that.

    A crossing that runs never reach is censored: it lies beyond their end, nobody knows where. Then the statistic is
    the least that the quantity can be, ``most`` the most, often infinite. Lower ends of the intervals come from the
    one, the value and upper ends from the other.
    """
    n = min(sizes)
    value = float((most or statistic)(*map(np.arange, sizes)))
    if n < 2 or np.isnan(value) or (most is None and np.isinf(value)):
        return _unknown(value, n)
    least_draws, weights = _draws(statistic, sizes)
    most_draws = least_draws if most is None else _draws(most, sizes)[0]
    low, high, low90, high90 = (
        _quantile(draws, weights, level, n)
        for draws, level in ((least_draws, 0.025), (most_draws, 0.975), (least_draws, 0.05), (most_draws, 0.95))
    )
    if np.isnan(least_draws).any() or np.isnan(most_draws).any():
        return _unknown(value, n)
    tail = max(min(weights[least_draws <= 0].sum(), weights[most_draws >= 0].sum()), weights.min() / 2)
    p = 2 * scipy_stats.t.cdf(scipy_stats.norm.ppf(tail) * ((n - 1) / n) ** 0.5, n - 1)
    return Estimate(value, low, high, low90, high90, min(1.0, float(p)) if n >= 5 else np.nan, n)


@cache
def _resamples(*sizes: int) -> tuple[tuple[np.ndarray, ...], Float[np.ndarray, " B"]]:
    """Return the indices [B, n] that each resample takes of samples of these sizes, and the resamples' weights."""
    if math.prod(math.comb(2 * n - 1, n) for n in sizes) <= MOST:
        every = [_every_resample(n) for n in sizes]
        places = np.meshgrid(*(np.arange(len(weights)) for _, weights in every), indexing="ij")
        chosen = [place.ravel() for place in places]
        resamples = tuple(indices[place] for (indices, _), place in zip(every, chosen, strict=True))
        weights = np.prod([weights[place] for (_, weights), place in zip(every, chosen, strict=True)], axis=0)
    else:
        generator = np.random.default_rng(0)
        resamples = tuple(generator.integers(n, size=(RESAMPLES, n)) for n in sizes)
        weights = np.full(RESAMPLES, 1 / RESAMPLES)
    for array in (*resamples, weights):
        array.flags.writeable = False
    return resamples, weights


def _every_resample(n: int) -> tuple[Int[np.ndarray, "B n"], Float[np.ndarray, " B"]]:
    """Return all resamples of n repetitions, whatever their order, and the probability of each."""
    indices = np.array(list(itertools.combinations_with_replacement(range(n), n)))
    counts = (indices[:, None] == np.arange(n)[:, None]).sum(-1)
    return indices, np.exp(math.lgamma(n + 1) - gammaln(counts + 1).sum(-1) - n * math.log(n))


def _draws(statistic: Statistic, sizes: Sequence[int]) -> tuple[Float[np.ndarray, " B"], Float[np.ndarray, " B"]]:
    """Return the statistic of every resample, and the resamples' weights."""
    resamples, weights = _resamples(*sizes)
    draws = np.asarray(statistic(*resamples), float)
    if draws.shape != weights.shape:
        raise ValueError(f"a statistic gives one number per resample, {len(weights)} in all, got shape {draws.shape}")
    return draws, weights


def _quantile(draws: np.ndarray, weights: np.ndarray, level: float, n: int) -> float:
    """Return the quantile that stands for ``level`` at n repetitions.

    "Not reached" is infinite: without interpolation a quantile never averages it with a number.
    """
    level = scipy_stats.norm.cdf((n / (n - 1)) ** 0.5 * scipy_stats.t.ppf(level, n - 1))
    return float(np.quantile(draws, level, weights=weights, method="inverted_cdf"))


def t_interval(values: Sequence[float] | np.ndarray) -> Interval:
    """Return the mean of independent repetitions with Student's t interval."""
    return mean_estimate(values).interval


def share_interval(flags: Sequence[bool] | np.ndarray) -> Interval:
    """Return the share of true flags with Wilson's interval, which stays within [0, 1] and is not empty at its ends."""
    return share_estimate(flags, 0.0).interval


def common(*seeds: Sequence[int]) -> list[list[int]]:
    """Return for each sample the places of the seeds that all of them have, in the order of the first."""
    shared = [seed for seed in seeds[0] if all(seed in own for own in seeds)]
    return [[own.index(seed) for seed in shared] for own in seeds]


def apart(quantity: Callable[[Any], np.ndarray], first: Any, second: Any) -> Float[np.ndarray, "R ..."]:
    """Return a quantity of some repetitions less that of others, for the ``seeds`` that both have."""
    one, two = common(first.seeds, second.seeds)
    return quantity(first)[one] - quantity(second)[two]


def paired_difference(first: Sequence[float] | np.ndarray, second: Sequence[float] | np.ndarray) -> Interval:
    """Return the mean of first - second over repetitions that share a seed; raises ValueError unless they pair up."""
    first, second = np.asarray(first, float), np.asarray(second, float)
    if first.shape != second.shape:
        raise ValueError(f"paired samples need one value per seed in both, got {first.shape} and {second.shape}")
    return t_interval(first - second)


def bootstrap_interval(statistic: Statistic, n: int) -> Interval:
    """Return ``statistic(indices)`` at all n repetitions, with its interval by expanded percentiles.

    The statistic receives indices of repetitions, so it can be anything computed from whole runs: the crossing of a
    mean curve, a ratio. It may be infinite ("not reached"). It takes many sets of indices at once, [..., n], and gives
    [...].

    Raises:
        ValueError: if it does not.
    """
    value = float(statistic(np.arange(n))) if n else np.nan
    if n < 2 or np.isnan(value):
        return Interval(value, np.nan, np.nan, n)
    draws, weights = _draws(statistic, (n,))
    low, high = (_quantile(draws, weights, level, n) for level in ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2))
    return Interval(value, low, high, n)


def first_crossings(curves: np.ndarray, threshold: float, *, above: bool = False) -> np.ndarray:
    """Return the index [...] of the first point of curves [..., T] at or below ``threshold``; inf if there is none.

    With ``above``: at or above. NaN for a curve with NaN before it is reached.
    """
    reached = (curves >= threshold if above else curves <= threshold) | np.isnan(curves)
    first = np.where(reached.any(-1), reached.argmax(-1), np.inf)
    unknown = np.isnan(np.take_along_axis(curves, reached.argmax(-1)[..., None], -1)[..., 0])
    return np.where(unknown, np.nan, first)


def median_filter(curve: np.ndarray, width: int) -> np.ndarray:
    """Return the centred running median over ``width`` points along the last axis; the ends repeat their value.

    NaN stays NaN, and counts as larger than any number for the points beside it.
    """
    curve = np.asarray(curve, float)
    unknown, size = np.isnan(curve), (1,) * (curve.ndim - 1) + (width,)
    return np.where(unknown, np.nan, ndimage.median_filter(np.where(unknown, np.inf, curve), size, mode="nearest"))


def crossing_interval(curves: np.ndarray, threshold: float, *, width: int = 1) -> Interval:
    """Return the first crossing of the mean of ``curves`` [R, T], smoothed by a median of ``width`` points."""

    def crossing(indices: np.ndarray) -> np.ndarray:
        return first_crossings(median_filter(curves[indices].mean(-2), width), threshold)

    return bootstrap_interval(crossing, len(curves))


def median_interval(values: Sequence[float] | np.ndarray) -> Interval:
    """Return the smaller median (at least half are no larger) with a bootstrap interval; values may be infinite."""
    values = _row(values)
    return bootstrap_interval(lambda i: smaller_median(values[i]), len(values))


def smaller_median(values: np.ndarray) -> np.ndarray:
    """Return the smaller median [...] of values [..., n]: one of them, also where some are infinite."""
    return np.asarray(np.quantile(values, 0.5, axis=-1, method="inverted_cdf"))
