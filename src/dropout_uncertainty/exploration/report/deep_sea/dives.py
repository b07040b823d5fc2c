"""What agents did in Deep Sea, from its records: when they first found the treasure, and when they had solved a sea.

A run that ends without a solution is censored at its last episode, not dropped: ``Dives.curve`` is the estimate of
Kaplan and Meier.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy import stats as scipy_stats

from dropout_uncertainty.exploration.deep_sea.experiment import AGENTS, CONFIGS, EXPERIMENT, REGRET, start, units
from dropout_uncertainty.page.profiles import complete
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.process import finished
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import CONFIDENCE, Interval, share_interval

__all__ = ["HORIZON", "LABELS", "SEEDS", "Dives", "Seas", "live", "load", "obtain", "shown", "solved_episode"]

FAMILY = "deep-sea"
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
#: Seas of each size that every agent dives in; larger ones are for agents that solve these.
SEEDS = {5: 20, 8: 20, 10: 40}


def solved_episode(found: Bool[np.ndarray, "R T"]) -> Float[np.ndarray, " R"]:
    """Return the first episode (1, 2, ...) after which the mean regret is below 0.9, bsuite's rule; inf if none is."""
    episodes = np.arange(1, found.shape[1] + 1)
    below = np.cumsum(~found, axis=1) / episodes < REGRET
    return np.where(below.any(1), below.argmax(1) + 1.0, np.inf)


@dataclass(frozen=True)
class Dives:
    """What one agent did in R seas of one size."""

    agent: str  #: a key of ``LABELS``.
    size: int  #: their side N [cells].
    seeds: tuple[int, ...]  #: one per sea.
    found: Float[np.ndarray, " R"]  #: [R] first episode (1, 2, ...) in which the treasure was found; inf if it was not.
    #: [R] share of the later episodes in which it was found again; NaN if there are none.
    again: Float[np.ndarray, " R"]
    solved: Float[np.ndarray, " R"]  #: [R] episode by which each was solved; inf if it was not.
    last: Float[np.ndarray, " R"]  #: [R] episodes played, after which an unsolved sea is censored.
    first_visit: np.ndarray  #: [R, N, N] episode (0, 1, ...) that first entered a cell, -1: never.
    records: tuple[Record, ...] = ()  #: where they come from.

    @property
    def label(self) -> str:
        """Name of the agent in words."""
        return LABELS[self.agent]

    @property
    def config(self) -> str:
        """Name of the config."""
        return f"{FAMILY}/{self.agent}/{self.size}"

    def within(self, episodes: int = HORIZON) -> Bool[np.ndarray, " R"]:
        """Return which seas were solved within so many episodes; raises ValueError beyond those that were played."""
        if episodes > (played := self.last[~np.isfinite(self.solved)].min(initial=np.inf)):
            raise ValueError(
                f"{self.config}: unsolved seas were played for {played:,.0f} episodes, "
                f"so nothing is known of {episodes:,}"
            )
        return self.solved <= episodes

    def share(self, episodes: int = HORIZON) -> Interval:
        """Return the share solved within so many episodes, with Wilson's interval."""
        return share_interval(self.within(episodes))

    def curve(self) -> Any:
        """Return the estimate of the share still unsolved, with ``quantiles`` (episodes) and ``probabilities``."""
        return scipy_stats.ecdf(self.censored()).sf

    def median(self) -> Interval:
        """Return the median of episodes to solve, inf if fewer solve, with the interval of Brookmeyer and Crowley.

        Its ends are where the limits of the curve (Greenwood's, of log(-log)) come down to a half.
        """
        curve = self.curve()
        with warnings.catch_warnings():  # no limits where all or none are unsolved
            warnings.simplefilter("ignore", RuntimeWarning)
            limits = curve.confidence_interval(CONFIDENCE, method="log-log")
        lower = np.where(curve.probabilities > 0, limits.low.probabilities, 0.0)
        value, low, high = (
            float(np.min(curve.quantiles[unsolved <= 0.5], initial=np.inf))
            for unsolved in (curve.probabilities, lower, limits.high.probabilities)
        )
        return Interval(value, low, high, len(self.solved))

    def censored(self) -> scipy_stats.CensoredData:
        """Return episodes to solve, censored where a run ended before."""
        done = np.isfinite(self.solved)
        return scipy_stats.CensoredData(uncensored=self.solved[done], right=self.last[~done])

    def reached(self, episode: int) -> Float[np.ndarray, "N N"]:
        """Return the share of seas in which each cell has been entered by the end of so many episodes."""
        return ((self.first_visit >= 0) & (self.first_visit < episode)).mean(0)


#: Dives by agent and size.
Seas = dict[tuple[str, int], Dives]


def load(folder: Path | None = None, *, published: bool = True) -> Seas:
    """Return the recorded dives by agent and size; of seeds below 100, or with ``published=False`` of the others.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    found = {}
    for name in CONFIGS:
        mine = records.find(EXPERIMENT, CONFIGS[name], name=name, folder=folder, published=published)
        if mine:
            dives = from_records(name, mine)
            found[dives.agent, dives.size] = dives
    return found


def from_records(name: str, mine: list[Record]) -> Dives:
    """Return the dives of one config whose units are in several records."""
    seeds, arrays = records.joined(mine, ("found", "episodes", "first_visit"))
    return from_arrays(name.split("/")[-2], CONFIGS[name].size, arrays, seeds, tuple(mine))


def from_arrays(
    agent: str, size: int, arrays: Mapping[str, np.ndarray], seeds: tuple[int, ...], records_of: tuple[Record, ...] = ()
) -> Dives:
    """Return the dives of a run, from the arrays that ``experiment.Diving.result`` gives."""
    found, last = arrays["found"], arrays["episodes"].astype(int)
    first = np.where(found.any(1), found.argmax(1) + 1.0, np.inf)
    later, times = last - first, found.sum(1) - 1.0
    again = np.divide(times, later, out=np.full(len(found), np.nan), where=later > 0)
    return Dives(
        agent, size, seeds, first, again, solved_episode(found), last.astype(float), arrays["first_visit"], records_of
    )


def live(size: int, *, seeds: Sequence[int], episodes: int) -> Seas:
    """Return dives of all agents, computed now."""
    dives = {}
    for agent in AGENTS:
        run = finished(start(replace(CONFIGS[f"deep-sea/{agent}/{size}"], episodes=episodes), seeds))
        dives[agent, size] = from_arrays(agent, size, run.result(), tuple(seeds))
    return dives


def shown(profile: str) -> tuple[int, tuple[int, ...]]:
    """Return the size of the seas that the pictures of a profile show, and after how many episodes; last of all."""
    return (5, (10, 30, 150)) if profile == "quick" else (10, (30, 100, 300, 1000, HORIZON))


def obtain(profile: str) -> Seas:
    """Return the dives that a profile shows: recorded, small ones computed now, or recorded and what is missing."""
    if profile == "quick":
        size, times = shown(profile)
        return live(size, seeds=range(100, 103), episodes=times[-1])
    planned = [(f"{FAMILY}/{agent}/{size}", range(n)) for agent in AGENTS for size, n in SEEDS.items()]
    complete(profile, [unit for name, seeds in planned for unit in units(name, seeds)])
    return load()
