"""From the records of Deep Sea to its numbers: who solves it, when, and how that grows with its size.

A run that ends without a solution is censored at its last episode, not dropped: ``Dives.curve`` is the estimate of
Kaplan and Meier.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy import stats as scipy_stats

from dropout_uncertainty.exploration.deep_sea.experiment import AGENTS, CONFIGS, EXPERIMENT, REGRET, start
from dropout_uncertainty.judging.results import Result, measured
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import (
    CONFIDENCE,
    Estimate,
    Interval,
    Statistic,
    bootstrap_interval,
    difference_of_shares,
)

__all__ = [
    "GROWTH", "HORIZON", "LABELS", "Dives", "difference", "growth", "live", "load", "results", "score",
    "solved_episode", "table",
]  # fmt: skip

LABELS = {
    "epsilon-greedy": "ε-greedy",
    "greedy": "No exploration",
    "boltzmann": "Boltzmann",
    "dropout-per-move": "Dropout, a draw per move",
    "dropout-per-episode": "Dropout, a draw per episode",
    "annealed-thompson": "Annealed Thompson",
    "ensemble": "Ensemble",
    "ensemble-priors": "Ensemble with priors",
}
#: Episodes within which statement EX9 counts seas that are solved.
HORIZON = 2000
#: bsuite forgives this many episodes beyond 2^N.
FORGIVEN = 100


def solved_episode(found: Bool[np.ndarray, "R T"]) -> Float[np.ndarray, " R"]:
    """Return the first episode (1, 2, ...) after which the mean regret is below 0.9, bsuite's rule; inf if none is."""
    episodes = np.arange(1, found.shape[1] + 1)
    below = np.cumsum(~found, axis=1) / episodes < REGRET
    return np.where(below.any(1), below.argmax(1) + 1.0, np.inf)


@dataclass(frozen=True)
class Dives:
    """What one agent did in R seas of one size.

    Attributes:
        agent: a key of ``LABELS``.
        size: N.
        seeds: one per sea.
        solved: [R] episode by which each was solved; inf if it was not.
        last: [R] episodes played, after which an unsolved sea is censored.
        first_visit: [R, N, N] episode (0, 1, ...) that first entered a cell, -1: never.
        records: where they come from.
    """

    agent: str
    size: int
    seeds: tuple[int, ...]
    solved: Float[np.ndarray, " R"]
    last: Float[np.ndarray, " R"]
    first_visit: np.ndarray
    records: tuple[Record, ...] = ()

    @property
    def label(self) -> str:
        """Name of the agent in words."""
        return LABELS[self.agent]

    def within(self, episodes: int = HORIZON) -> Bool[np.ndarray, " R"]:
        """Return which seas were solved within so many episodes."""
        return self.solved <= episodes

    def share(self, episodes: int = HORIZON) -> Interval:
        """Return the share solved within so many episodes, with Wilson's interval."""
        return share_interval(self.within(episodes))

    def curve(self) -> Any:
        """Return the estimate of the share still unsolved, with ``quantiles`` (episodes) and ``probabilities``."""
        return scipy_stats.ecdf(self.censored()).sf

    def censored(self) -> scipy_stats.CensoredData:
        """Return episodes to solve, censored where a run ended before."""
        done = np.isfinite(self.solved)
        return scipy_stats.CensoredData(uncensored=self.solved[done], right=self.last[~done])

    def reached(self, episode: int) -> Float[np.ndarray, "N N"]:
        """Return the share of seas in which each cell has been entered by the end of so many episodes."""
        return ((self.first_visit >= 0) & (self.first_visit < episode)).mean(0)


def share_interval(succeeded: np.ndarray) -> Interval:
    """Return a share with Wilson's interval."""
    n = len(succeeded)
    if n == 0:
        return Interval(np.nan, np.nan, np.nan, 0)
    outcome = scipy_stats.binomtest(int(np.sum(succeeded)), n).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(float(np.mean(succeeded)), float(outcome.low), float(outcome.high), n)


def load(folder: Path | None = None, *, published: bool = True) -> dict[tuple[str, int], Dives]:
    """Return the recorded dives by agent and size; of seeds below 100, or with ``published=False`` of the others.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    found = {}
    for name in CONFIGS:
        mine = [
            record
            for record in records.find(EXPERIMENT, CONFIGS[name], name=name, folder=folder)
            if (max(record.seeds) < 100) == published
        ]
        if mine:
            dives = from_records(name, mine)
            found[dives.agent, dives.size] = dives
    return found


def from_records(name: str, mine: list[Record]) -> Dives:
    """Return the dives of one config whose units are in several records."""
    arrays = {key: np.concatenate([r.arrays[key] for r in mine]) for key in ("found", "episodes", "first_visit")}
    seeds = tuple(seed for r in mine for seed in r.seeds)
    return from_arrays(name.split("/")[-2], CONFIGS[name].size, arrays, seeds, tuple(mine))


def from_arrays(
    agent: str, size: int, arrays: Mapping[str, np.ndarray], seeds: tuple[int, ...], found: tuple[Record, ...] = ()
) -> Dives:
    """Return the dives of a run, from the arrays that ``experiment.Diving.result`` gives."""
    solved, last = solved_episode(arrays["found"]), arrays["episodes"].astype(float)
    return Dives(agent, size, seeds, solved, last, arrays["first_visit"], found)


def live(size: int, *, seeds: Sequence[int], episodes: int) -> dict[tuple[str, int], Dives]:
    """Return dives of all agents, computed now."""
    dives = {}
    for agent in AGENTS:
        process = start(replace(CONFIGS[f"deep-sea/{agent}/{size}"], episodes=episodes), seeds)
        while process.done < process.total:
            process.advance()
        dives[agent, size] = from_arrays(agent, size, process.result(), tuple(seeds))
    return dives


def difference(first: Dives, second: Dives, episodes: int = HORIZON) -> Estimate:
    """Return the share solved by the first agent minus that by the second (statements EX9, EX9b)."""
    return difference_of_shares(first.within(episodes), second.within(episodes))


def score(dives: Mapping[tuple[str, int], Dives], agent: str) -> Interval:
    """Return bsuite's score over the sizes at hand: the share of seas solved before episode 2^N + 100."""
    mine = [d for (name, _), d in dives.items() if name == agent]
    return share_interval(np.concatenate([d.solved < 2**d.size + FORGIVEN for d in mine]))


#: How episodes to solve may grow with N: as 2^(kN) or as N^k.
GROWTH: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "exponential": lambda size: np.log(2.0) * size,
    "power": lambda size: np.log(size),
}


def growth(dives: Mapping[tuple[str, int], Dives], agent: str, form: str) -> Interval:
    """Return the exponent k of episodes to solve over the sizes at hand, with a bootstrap interval over seas.

    Log-normal regression by maximum likelihood; a sea that was not solved says that it takes longer than its run.
    """
    mine = [d for (name, _), d in dives.items() if name == agent]
    if len(mine) < 2:
        return Interval(np.nan, np.nan, np.nan, 0)
    size = np.concatenate([np.full(len(d.solved), float(d.size)) for d in mine])
    done = np.concatenate([np.isfinite(d.solved) for d in mine])
    episodes = np.concatenate([np.where(np.isfinite(d.solved), d.solved, d.last) for d in mine])
    slope = censored_slope(GROWTH[form](size), np.log(episodes), done)
    return bootstrap_interval(slope, len(size))


def censored_slope(x: np.ndarray, y: np.ndarray, exact: np.ndarray) -> Statistic:
    """Return a statistic: the slope of y on x with normal errors, where inexact y are lower bounds.

    Of points chosen by their indices [..., n] it gives [...]; NaN where too few are exact. In slope and intercept by
    the standard deviation, and one by it, the likelihood is concave (Olsen, 1978): Newton's steps, for all sets of
    indices at once, shortened while they are long.
    """
    centre, scale = np.array([x.mean(), y.mean()]), np.array([np.ptp(x) or 1.0, np.ptp(y) or 1.0])
    inputs, outputs = (x - centre[0]) / scale[0], (y - centre[1]) / scale[1]
    rows = np.stack([-np.ones_like(inputs), -inputs, outputs], -1)  # residuals are rows @ (intercept, slope, 1) / std
    squares = (rows[:, :, None] * rows[:, None]).reshape(len(x), 9)
    last = np.array([0.0, 0.0, 1.0])

    def maximum(counts: np.ndarray) -> np.ndarray:
        theta = np.tile([0.0, 0.0, 1.0], (len(counts), 1))
        for _ in range(200):
            residual = theta @ rows.T
            hazard = np.exp(scipy_stats.norm.logpdf(residual) - scipy_stats.norm.logsf(residual))
            pull, weight = np.where(exact, (residual, np.ones_like(residual)), (hazard, hazard * (hazard - residual)))
            known = counts[:, exact].sum(1)[:, None]
            gradient = known / theta[:, 2:] * last - (counts * pull) @ rows
            curvature = ((counts * weight) @ squares).reshape(-1, 3, 3)
            curvature += (known / theta[:, 2:] ** 2)[..., None] * np.outer(last, last)
            step = np.linalg.solve(curvature, gradient[..., None])[..., 0]
            length = np.sqrt((step * gradient).sum(-1, keepdims=True))
            theta = theta + step / np.where(length > 0.25, 1 + length, 1.0)
            if length.max() < 1e-8:
                break
        return theta[:, 1] / theta[:, 2] * scale[1] / scale[0]

    def statistic(indices: np.ndarray) -> np.ndarray:
        chosen = indices.reshape(-1, indices.shape[-1])
        counts = np.stack([np.bincount(one, minlength=len(x)) for one in chosen])
        present = (counts > 0) & exact
        spread = np.where(present, x, -np.inf).max(1) - np.where(present, x, np.inf).min(1)
        enough = ((counts * exact).sum(1) >= 3) & (spread > 0)
        slopes = np.full(len(chosen), np.nan)
        if enough.any():
            slopes[enough] = maximum(counts[enough].astype(float))
        return slopes.reshape(indices.shape[:-1])

    return statistic


def results(folder: Path | None = None) -> list[Result]:
    """Return the shares solved, bsuite's scores and the differences of EX9."""
    dives = load(folder)
    found = [
        measured(
            f"deep-sea/{agent}/{size}/solved-by-{HORIZON}", d.share(), list(d.records), unit="share",
            statistic=f"share of seas solved within {HORIZON} episodes", config=f"deep-sea/{agent}/{size}",
        )
        for (agent, size), d in dives.items()
    ]  # fmt: skip
    statistic = "bsuite's score: share of seas solved before episode 2^N + 100"
    for agent in AGENTS:
        used = [record for (name, _), d in dives.items() if name == agent for record in d.records]
        if used:
            scored, config = score(dives, agent), f"deep-sea/{agent}"
            found.append(measured(f"{config}/score", scored, used, unit="share", statistic=statistic, config=config))
    return found


def table(dives: Mapping[tuple[str, int], Dives], sizes: tuple[int, ...]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: seas of each size that each agent solved, their median episode, and bsuite's score."""
    cells: list[list[object]] = []
    for agent in AGENTS:
        row: list[object] = []
        for size in sizes:
            d = dives.get((agent, size))
            if d is None:
                row.append(None)
                continue
            done = d.solved[np.isfinite(d.solved)]
            row.append(f"{len(done)} of {len(d.solved)}" + (f", {np.median(done):.0f}" if len(done) else ""))
        if any(row):
            value, low, high, _ = score(dives, agent)
            cells.append([LABELS[agent], *row, f"{value:.2f} [{low:.2f}, {high:.2f}]"])
    return ["", *(f"N = {size}" for size in sizes), "bsuite's score"], cells
