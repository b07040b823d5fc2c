"""Deep Sea: what each agent is, and the runs of all its seeds. Sources of the settings beside them.

A replica runs until it has solved its sea, or to the last episode. Solved is bsuite's rule: the mean regret over all
episodes so far is below 0.9, so the treasure was found in more than a tenth of them. As luck can do that within the
first few, a replica goes on until it holds over at least ``WINDOW`` episodes, and over the last ``WINDOW`` of them.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float

from dropout_uncertainty import rng
from dropout_uncertainty.exploration.config import check_precision
from dropout_uncertainty.exploration.deep_sea.agent import Agent
from dropout_uncertainty.exploration.deep_sea.config import EPISODES, Config
from dropout_uncertainty.runs import sweep
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.runs.unit import precision_dtype
from dropout_uncertainty.settings import of_type

__all__ = [
    "AGENTS", "CONFIGS", "REGRET", "SIZES", "TIMES", "WINDOW", "Config", "Diving", "mean_regret", "start",
    "units",
]  # fmt: skip

EXPERIMENT = "exploration"
#: A sea is solved when the mean regret of an episode is below this (bsuite 0.3.6).
REGRET = 0.9
#: Episodes over which the treasure must be found as often before a run ends early; ours.
WINDOW = 100
#: Episodes after which the visits to every cell are noted.
TIMES = (30, 100, 300, 1000, 3000, 10_000)
#: The agents. What the chapter does not give was chosen once for all of them, on seeds 100-109 in seas of 8 and 10:
#:
#: - ε-greedy, in a sea of 8: step size 0.01 solves 0 of 10 by episode 600, 0.03 solves 3 of 6 by 500, 0.1 5 of 6. In a
#:   sea of 10, 0.05 and 0.1 both solve 5 of 6; at 0.1 networks with a prior of weight 10 diverged, hence 0.05.
#: - One-hot inputs of mean square 1 do better at 0.1 (5 of 6) than plain ones at 0.3 (3 of 6), ε-greedy, size 8.
#: - ε and the temperatures fall over 1000 episodes; over 300, ε-greedy solves 2 of 6 seas of 10 rather than 5.
#: - Dropout is the demo's. Behind the first hidden layer with 0.1, 0.2 and 0.5, and with 0.1 behind both, a draw per
#:   episode solves 1, 0, 0 and 0 of 6 seas of 10 by episode 600, at step size 0.1.
#: - Priors of weight 1 and 3 (Osband et al. 2018) both solve 2 of 2 seas of 10 by episode 190, at step size 0.1.
AGENTS: dict[str, dict[str, Any]] = {
    "epsilon-greedy": {"policy": "epsilon-greedy"},
    "greedy": {"policy": "greedy"},
    "boltzmann": {"policy": "boltzmann"},
    "dropout-per-move": {"policy": "thompson", "drop": (0.0, 0.2, 0.0)},
    "dropout-per-episode": {"policy": "thompson", "drop": (0.0, 0.2, 0.0), "held": "episode"},
    "annealed-thompson": {"policy": "annealed-thompson", "drop": (0.0, 0.2, 0.0)},
    "ensemble": {"policy": "greedy", "members": 10, "share": 0.5},
    "ensemble-priors": {"policy": "greedy", "members": 10, "share": 0.5, "prior_scale": 3.0},
}
SIZES = (5, 8, 10, 13, 16)


CONFIGS: dict[str, Config] = {
    f"deep-sea/{name}/{size}": Config(size=size, **settings) for name, settings in AGENTS.items() for size in SIZES
}


def mean_regret(found: Bool[np.ndarray, "R T"]) -> Float[np.ndarray, " R"]:
    """Return the share of episodes without the treasure; bsuite leaves out the costs of moves too."""
    return (~found).mean(1)


class Diving:
    """R replicas of an agent in Deep Sea; one step of work is ten episodes of those that go on."""

    LOGS = ("active", "found", "first", "count", "visits", "length")
    PER_STEP = EPISODES  # entries of ``found``

    def __init__(
        self, config: Config, seeds: Sequence[int], *, device: str = "cpu", precision: str = "float32"
    ) -> None:
        check_precision(precision)
        self.config, self.seeds = of_type(Config, config, "config"), rng.check_seeds(seeds)
        self.device, self.dtype = device, precision_dtype(precision)
        self.total, self.done = config.episodes // EPISODES, 0
        shape = len(self.seeds), config.size, config.size
        self.found = np.zeros((len(self.seeds), config.episodes), dtype=bool)
        self.first = np.full(shape, -1, dtype=np.int16)
        self.count = np.zeros(shape, dtype=np.int16)
        self.visits = np.zeros((shape[0], len(TIMES), *shape[1:]), dtype=np.int16)
        self.length = np.full(len(self.seeds), config.episodes)
        self.active = np.arange(len(self.seeds))
        self.agent = self._agent()

    def _agent(self) -> Agent:
        """Return the agent of the replicas that go on, as at the start."""
        seeds = [self.seeds[index] for index in self.active]
        return Agent(self.config, seeds, dtype=self.dtype, device=self.device)

    def advance(self) -> str:
        """Run a block of episodes."""
        self.agent.prepare(self.done)
        for number in range(EPISODES):
            episode = self.done * EPISODES + number

            def visit(cell: np.ndarray, episode: int = episode) -> None:
                self._visit(episode)

            self.found[self.active, episode] = self.agent.episode(number, visit)
            if episode + 1 in TIMES:
                self.visits[self.active, TIMES.index(episode + 1)] = self.count[self.active]
        self.agent.network.check_finite()
        self.done += 1
        self._retire()
        return f"{len(self.active)} go on"

    def _visit(self, episode: int) -> None:
        sea = self.agent.sea
        place = self.active, np.full(len(self.active), sea.row), sea.column
        self.count[place] += 1
        self.first[place] = np.where(self.first[place] < 0, episode, self.first[place])

    def _retire(self) -> None:
        """Let the replicas go that have solved their sea for good."""
        episodes = self.done * EPISODES
        found = self.found[self.active, :episodes]
        solved = (mean_regret(found) < REGRET) & (mean_regret(found[:, -WINDOW:]) < REGRET) & (episodes >= WINDOW)
        if not solved.any():
            return
        self.length[self.active[solved]] = episodes
        state, going_on = self.agent.state(), np.flatnonzero(~solved)
        self.active = self.active[going_on]
        if len(self.active):
            self.agent = self._agent()
            self.agent.restore(state, going_on)
        else:
            self.done = self.total

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue."""
        logs = {name: torch.tensor(getattr(self, name)) for name in self.LOGS}
        return {"done": self.done, "logs": logs, "agent": self.agent.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from ``state()`` of a process made with the same arguments."""
        self.done = state["done"]
        for name, values in state["logs"].items():
            setattr(self, name, values.numpy().copy())
        self.agent = self._agent()
        self.agent.restore(state["agent"])

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the record, R first; cells by row and column."""
        return {
            "found": self.found,  # [R, episodes] whether the treasure was found; False after the last episode
            "episodes": self.length.astype(np.int16),  # [R] how many were played
            "first_visit": self.first,  # [R, N, N] episode (0, 1, ...) that first entered a cell, -1: never
            "visits": self.visits,  # [R, times, N, N] to every cell in so many episodes (``TIMES``), 0 behind the last
        }


#: Makes the process of one unit.
start = Diving


def bytes_per_seed(config: Config) -> float:
    """Return the memory that a replica takes: its replay memories, of two rows of three numbers a transition."""
    return config.members * config.memory * 24.0


def _sweep(single: bool, seeds: int) -> Sweep:
    configs = {name: config for name, config in CONFIGS.items() if (config.members == 1) == single}
    # a GPU would add up the gradients of one cell in an order of its own
    return Sweep(
        EXPERIMENT, configs, start, ("float32", "float64"), {"cpu": seeds}, repetitions=20, memory=bytes_per_seed
    )


#: A unit has so many networks that calls cost little beside arithmetic.
SWEEPS = _sweep(single=True, seeds=40), _sweep(single=False, seeds=10)


#: The units of a named config.
units = partial(sweep.units, SWEEPS)
