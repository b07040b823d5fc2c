"""BFGS with the careful steps of the original PILCO code: no line search begins further than one unit away.

The predicted cost of a trial has many valleys; a policy that spins the pole for ever lies in one of them. Which
is reached depends on the steps of the optimiser, so these follow the rules of pilco-matlab, util/minimize.m, and give
the same sequence of values.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

Function = Callable[[np.ndarray], tuple[float, np.ndarray]]

# A search ends where the slope has fallen to this share of the first, and the value not risen.
CURVATURE = 0.5
LONGEST, SHORTEST = 1.0, 1e-7  # length of a search's first step, in units of the parameters
# Extrapolation goes at most so many times as far; interpolation stays this share of the bracket away from its ends.
EXTRAPOLATION, MARGIN = 5.0, 0.1
TOLERANCE = 1e-4  # the largest entry of a gradient that counts as zero


class Point(NamedTuple):
    """A point on the line of a search: how far along the direction, with value, slope along it and gradient."""

    step: float
    value: float
    slope: float
    gradient: np.ndarray

    @property
    def finite(self) -> bool:
        """Whether the function could be evaluated."""
        return math.isfinite(self.value + self.slope)


class Outcome(NamedTuple):
    """Where a minimisation ended: the point, its value and gradient, line searches done and how many of them failed."""

    x: np.ndarray
    value: float
    gradient: np.ndarray
    searches: int
    failures: int


def minimise(function: Function, x: np.ndarray, searches: int, evaluations: int = 30) -> Outcome:
    """Return a point of lower value, after at most so many line searches of so many evaluations each.

    Ends early where two line searches in a row fail, or where no entry of the gradient is above ``TOLERANCE``.

    Args:
        function: value and gradient at a point; values that are not finite turn a search back.
        x: where to begin; returned as it is if the function is not finite there.
        searches: the limit on line searches.
        evaluations: the limit on evaluations per line search.
    """
    value, gradient = function(x)
    inverse = np.eye(len(x))
    step, done, failures, failed = 1 / (1 + float(gradient @ gradient)), 0, 0, False
    while done < searches and math.isfinite(value) and np.abs(gradient).max() > TOLERANCE:
        direction = -inverse @ gradient
        length = float(np.linalg.norm(direction))
        step = min(max(step, SHORTEST / length), LONGEST / length)
        origin = Point(0.0, value, float(direction @ gradient), gradient)
        found, good = line_search(partial(_point, function, x, direction), origin, step, evaluations)
        done, failures = done + 1, failures + (not good)
        if good:
            inverse = _updated(inverse, found.step * direction, found.gradient - gradient)
        elif failed:
            break
        x, value, gradient, step, failed = x + found.step * direction, found.value, found.gradient, found.step, not good
    return Outcome(x, value, gradient, done, failures)


def _point(function: Function, x: np.ndarray, direction: np.ndarray, step: float) -> Point:
    value, gradient = function(x + step * direction)
    return Point(step, value, float(gradient @ direction), gradient)


def _updated(inverse: np.ndarray, moved: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return the inverse Hessian after a step ``moved`` that changed the gradient by ``change``."""
    curvature = moved @ change
    if not curvature > 0:
        return inverse
    bent = inverse @ change
    both = np.outer(bent, moved)
    return inverse + (curvature + change @ bent) / curvature**2 * np.outer(moved, moved) - (both + both.T) / curvature


def line_search(at: Callable[[float], Point], origin: Point, step: float, evaluations: int) -> tuple[Point, bool]:
    """Return the best point found along a line, and whether it meets the conditions (lower, and flatter by half).

    Extrapolates by cubics until the minimum is passed, then interpolates between the ends of the bracket.
    """
    before = low = origin
    while True:
        high, evaluations = _evaluate(at, step, low.step, evaluations)
        if _place(high, origin) != "left" or evaluations <= 0:
            break
        before, low = low, high
        step = before.step + _cubic_minimum(before, low, beyond=True)
    while True:
        if not high.finite:
            best = low
            break
        best = high if low.value > high.value else low
        if _place(best, origin) == "good" or evaluations <= 0:
            break
        middle, evaluations = _evaluate(at, low.step + _cubic_minimum(low, high, beyond=False), low.step, evaluations)
        if not middle.finite:
            middle = low
        place = _place(middle, origin)
        if place == "high" or (place != "left" and middle.slope > 0):
            high = middle
        else:
            low = middle
    return best, _place(best, origin) == "good"


def _evaluate(at: Callable[[float], Point], step: float, back: float, evaluations: int) -> tuple[Point, int]:
    """Return the point at ``step``, halving its distance to ``back`` while it cannot be evaluated; and what is left."""
    while True:
        point, evaluations = at(step), evaluations - 1
        if point.finite or evaluations <= 0:
            return point, evaluations
        step = (back + step) / 2


def _place(point: Point, origin: Point) -> str:
    """Say where a point of a line is: "left" of a minimum, "right" of it, "high" above the start, or "good"."""
    if not point.value <= origin.value:
        return "high"
    if abs(point.slope) <= -CURVATURE * origin.slope:
        return "good"
    return "left" if point.slope < 0 else "right"


def _cubic_minimum(first: Point, second: Point, *, beyond: bool) -> float:
    """Return the distance from the first point to the minimum of the cubic through both, kept within bounds."""
    width, rise = second.step - first.step, second.value - first.value
    a = -6 * rise + 3 * (first.slope + second.slope) * width
    b = 3 * rise - (2 * first.slope + second.slope) * width
    inside = b * b - a * first.slope * width
    divisor = b + math.sqrt(inside) if inside >= 0 else 0.0
    z = -first.slope * width**2 / divisor if divisor else math.nan
    if beyond:
        if not width <= z <= EXTRAPOLATION * width:
            z = EXTRAPOLATION * width
        return max(z, (1 + MARGIN) * width)
    if not 0 <= z <= width:
        z = width / 2
    return min(max(z, MARGIN * width), (1 - MARGIN) * width)
