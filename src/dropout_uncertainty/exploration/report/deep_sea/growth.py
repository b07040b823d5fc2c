"""How the episodes that an agent needs grow with the size of the sea: log-normal regression with censoring.

A sea of size N takes exp(a + k f(N) + σ ε) episodes, ε standard normal, with f(N) = N log 2 (exponential) or log N
(power). An unsolved sea says that it takes longer than its run. The likelihood is concave in (a/σ, k/σ, 1/σ)
(Olsen, 1978), so that Newton's method finds its maximum, here for all bootstrap samples at once.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import erfcx

from dropout_uncertainty.exploration.report.deep_sea.dives import Seas
from dropout_uncertainty.stats import Interval, bootstrap_interval

__all__ = ["FORMS", "censored_slopes", "growth"]

#: How episodes to solve may grow with N: as 2^(kN) or as N^k.
FORMS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "exponential": lambda size: np.log(2.0) * size,
    "power": lambda size: np.log(size),
}
#: Newton steps at most, the decrement above which they are shortened, and the one at which they end.
STEPS, FAR, NEAR = 30, 0.25, 1e-10
#: Keeps the information invertible where samples fit a line exactly.
RIDGE = 1e-9


def growth(dives: Seas, agent: str, form: str) -> Interval:
    """Return the exponent k over the sizes at hand, with a bootstrap interval over seas; NaN with fewer than two."""
    mine = [d for (name, _), d in dives.items() if name == agent]
    if len(mine) < 2:
        return Interval(np.nan, np.nan, np.nan, 0)
    size = np.concatenate([np.full(len(d.solved), float(d.size)) for d in mine])
    solved, last = (np.concatenate([getattr(d, name) for d in mine]) for name in ("solved", "last"))
    done = np.isfinite(solved)
    x, y = FORMS[form](size), np.log(np.where(done, solved, last))
    return bootstrap_interval(lambda i: censored_slopes(x, y, done, i), len(x))


def censored_slopes(
    x: Float[np.ndarray, " n"],
    y: Float[np.ndarray, " n"],
    exact: Bool[np.ndarray, " n"],
    indices: Int[np.ndarray, "*B m"],
) -> Float[np.ndarray, "*B"]:
    """Return the slope of y on x with normal errors in each resample, where inexact y are lower bounds.

    It is infinite where all exact points lie at the smallest x, so that nothing bounds it from above, and NaN where
    there are fewer than three of them, or points of one x only.
    """
    x = x - x.mean()
    places = indices.reshape(-1, indices.shape[-1])
    places = places + len(x) * np.arange(len(places))[:, None]  # all resamples are counted at once
    counts = np.bincount(places.ravel(), minlength=len(places) * len(x))
    weights = counts.reshape(*indices.shape[:-1], len(x)).astype(float)
    drawn = weights > 0
    known = drawn & exact
    smallest = np.where(drawn, x, np.inf).min(-1)
    enough = (known.sum(-1) >= 3) & (np.where(drawn, x, -np.inf).max(-1) > smallest)
    bounded = enough & (np.where(known, x, -np.inf).max(-1) > smallest)
    slopes = np.where(enough, np.inf, np.nan)
    slopes[bounded] = _slopes(x, y, exact, weights[bounded])
    return slopes


def _slopes(x: np.ndarray, y: np.ndarray, exact: np.ndarray, weights: np.ndarray) -> Float[np.ndarray, " B"]:
    """Return the slopes of weighted points [B, n]; residuals are ``rows`` times (a/σ, k/σ, 1/σ)."""
    rows = np.stack([-np.ones_like(x), -x, y], axis=1)
    fitted = (weights[:, exact] @ _squares(rows[exact])).reshape(-1, 3, 3)
    bounds, same = np.unique(rows[~exact], axis=0, return_inverse=True)  # runs end after the same episode: few differ
    of_bounds, squares = weights[:, ~exact] @ np.eye(len(bounds))[same], _squares(bounds)
    count = weights[:, exact].sum(1)
    theta = np.tile([y.mean() / y.std(), 0.0, 1.0 / y.std()], (len(weights), 1))
    for _ in range(STEPS):
        z = theta @ bounds.T
        hazard = np.sqrt(2 / np.pi) / erfcx(z / np.sqrt(2))
        gradient = -np.einsum("bij,bj->bi", fitted, theta) - (of_bounds * hazard) @ bounds
        gradient[:, 2] += count / theta[:, 2]
        information = fitted + ((of_bounds * hazard * (hazard - z)) @ squares).reshape(-1, 3, 3)
        information = information + RIDGE * np.eye(3)
        information[:, 2, 2] += count / theta[:, 2] ** 2
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        decrement = np.sqrt(np.maximum((gradient * step).sum(1), 0))
        theta += step / np.where(decrement > FAR, 1 + decrement, 1.0)[:, None]
        if decrement.max(initial=0.0) < NEAR:
            break
    return theta[:, 1] / theta[:, 2]


def _squares(rows: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 9"]:
    return (rows[:, :, None] * rows[:, None, :]).reshape(-1, 9)
