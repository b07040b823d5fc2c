"""Intervals, paired differences and crossings of curves: thin over ``scipy.stats`` and ``scipy.ndimage``."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy import stats as scipy_stats

__all__ = [
    "CONFIDENCE", "Interval", "bootstrap_interval", "crossing_interval", "first_crossing", "median_filter",
    "paired_difference", "ratio_interval", "t_interval",
]  # fmt: skip

CONFIDENCE = 0.95
RESAMPLES = 2_000


class Interval(NamedTuple):
    """An estimate with the limits of its 95 % interval over ``n`` repetitions; NaN limits where n < 2."""

    value: float
    low: float
    high: float
    n: int


def t_interval(values: Sequence[float] | np.ndarray) -> Interval:
    """Return the mean of independent repetitions with Student's t interval."""
    values = np.asarray(values, float)
    n = len(values)
    if n < 2:
        return Interval(float(values.mean()) if n else np.nan, np.nan, np.nan, n)
    half = scipy_stats.sem(values) * scipy_stats.t.ppf((1 + CONFIDENCE) / 2, n - 1)
    return Interval(float(values.mean()), float(values.mean() - half), float(values.mean() + half), n)


def paired_difference(first: Sequence[float] | np.ndarray, second: Sequence[float] | np.ndarray) -> Interval:
    """Return the mean of first - second over repetitions that share a seed; raises ValueError unless they pair up."""
    first, second = np.asarray(first, float), np.asarray(second, float)
    if first.shape != second.shape:
        raise ValueError(f"paired samples need one value per seed in both, got {first.shape} and {second.shape}")
    return t_interval(first - second)


def bootstrap_interval(statistic: Callable[[np.ndarray], float], n: int) -> Interval:
    """Return ``statistic(indices)`` at all n repetitions, with its percentile bootstrap interval.

    The statistic receives indices of repetitions, so it can be anything computed from whole runs: the crossing of a
    mean curve, a ratio. It may be infinite ("not reached").
    """
    value = float(statistic(np.arange(n)))
    if n < 2:
        return Interval(value, np.nan, np.nan, n)
    generator = np.random.default_rng(0)
    draws = [statistic(generator.integers(n, size=n)) for _ in range(RESAMPLES)]
    # "Not reached" is infinite: quantiles without interpolation never average it with a number.
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], method="inverted_cdf")
    return Interval(value, float(low), float(high), n)


def ratio_interval(numerator: np.ndarray, denominator: np.ndarray) -> Interval:
    """Return mean(numerator) / mean(denominator) with a bootstrap interval, paired over repetitions."""
    return bootstrap_interval(lambda i: float(np.mean(numerator[i]) / np.mean(denominator[i])), len(numerator))


def first_crossing(curve: np.ndarray, threshold: float, *, above: bool = False) -> float:
    """Return the index of the first point at or below ``threshold`` (``above``: at or above); inf if there is none."""
    curve = np.asarray(curve)
    reached = np.flatnonzero(curve >= threshold if above else curve <= threshold)
    return float(reached[0]) if len(reached) else np.inf


def median_filter(curve: np.ndarray, width: int) -> np.ndarray:
    """Return the centred running median over ``width`` points along the last axis; the ends repeat their value."""
    return ndimage.median_filter(np.asarray(curve, float), size=width, axes=-1, mode="nearest")


def crossing_interval(curves: np.ndarray, threshold: float, *, width: int = 1, above: bool = False) -> Interval:
    """Return the first crossing of the mean of ``curves`` [R, T], smoothed by a median of ``width`` points."""

    def crossing(indices: np.ndarray) -> float:
        return first_crossing(median_filter(curves[indices].mean(0), width), threshold, above=above)

    return bootstrap_interval(crossing, len(curves))
