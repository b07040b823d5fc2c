"""From records to the numbers of Figure 5.4 and of statements EX1-EX6. Nothing is run and nothing is drawn here."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.experiment import BLOCK, CONFIGS, EXPERIMENT, Config
from dropout_uncertainty.judging.results import Result, measured, thesis_value
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import (
    Interval,
    bootstrap_interval,
    common,
    first_crossings,
    in_words,
    median_interval,
    paired_difference,
    smaller_median,
    t_interval,
)

__all__ = [
    "BLOCKS", "BURN_IN", "EARLY", "LABELS", "LATE", "TARGET", "Agents", "Curves", "advantage", "batches", "block_table",
    "check_quick", "compare", "crossing_table", "difference_table", "from_arrays", "from_records", "held_out_gap",
    "held_out_table", "load", "mean_crossing", "original", "paired", "results", "smoothed",
]  # fmt: skip

#: How each agent is called in figures and tables.
LABELS: dict[str, str] = {
    "thompson": "Thompson sampling",
    "epsilon-greedy": "ε-greedy",
    "boltzmann": "Boltzmann",
    "annealed-thompson": "Annealed Thompson",
    "greedy": "No exploration",
}
#: Average reward that the text to Figure 5.4 counts batches to.
TARGET = 1.0
#: Ticks of random moves at the start, of all configs.
BURN_IN = CONFIGS["as-demo"].burn_in
#: Ranges of ticks, open below, over which curves are averaged to compare them with those of the original program.
BLOCKS = ((3_000, 15_500), (15_500, 50_000), (50_000, 90_500), (90_500, 200_000))
#: Ranges of ticks over which policies are compared (statement EX5).
EARLY, LATE = (BURN_IN, 50_000), BLOCKS[-1]


@dataclass(frozen=True)
class Curves:
    """What one agent did in R runs."""

    agent: str  #: its policy, e.g. "thompson".
    config: str  #: name of the config, or "original".
    #: [R, T] mean reward of the last 1000 ticks, at every 500th tick: the curve of Figure 5.4.
    average: Float[np.ndarray, "R T"]
    seeds: tuple[int, ...]  #: one per run.
    #: [R, T] per block of 500 ticks, as in ``experiment.Foraging``: reward, food, poison, blocked, ...
    arrays: Mapping[str, np.ndarray]
    records: tuple[Record, ...] = ()  #: where they come from; none for the original program's curves.

    @property
    def record(self) -> Record | None:
        """The first of the records."""
        return self.records[0] if self.records else None

    @property
    def label(self) -> str:
        """Name of the agent in words."""
        return LABELS.get(self.agent, self.agent)

    @property
    def ticks(self) -> Int[np.ndarray, " T"]:
        """Tick at which each point of the curve is taken."""
        return BLOCK * np.arange(1, self.average.shape[1] + 1)

    def crossings(self, target: float = TARGET) -> Float[np.ndarray, " R"]:
        """Return the tick of the first point after the burn-in at which each run reaches ``target``; inf if none."""
        later = self.ticks > BURN_IN
        first = first_crossings(self.average[:, later], target, above=True)
        return BURN_IN + BLOCK * (np.array(first) + 1)

    def mean(self, start: int, stop: int, name: str | None = None) -> Float[np.ndarray, " R"]:
        """Return each run's mean over the points with start < tick <= stop: of the curve, or of an array by name.

        Runs that end before ``stop`` count as far as they go, and are NaN if they end before ``start``.
        """
        values = self.average if name is None else self.arrays[name]
        wanted = values[:, (self.ticks > start) & (self.ticks <= stop)].astype(float)
        counted = ~np.isnan(wanted)
        total = np.where(counted, wanted, 0.0).sum(1)
        return np.divide(total, counted.sum(1), out=np.full(len(values), np.nan), where=counted.any(1))

    def share(self, name: str, start: int, stop: int) -> Float[np.ndarray, " R"]:
        """Return the share of ticks in which something counted happened ("blocked", "explored", "food", "poison")."""
        return self.mean(start, stop, name) / BLOCK

    def later(self, name: str) -> Float[np.ndarray, " R"]:
        """Return each run's mean of an array over the second half of its points."""
        values = self.arrays[name]
        return values[:, values.shape[1] // 2 :].astype(float).mean(1)

    def only(self, places: Sequence[int]) -> "Curves":
        """Return some of the runs, by their places."""
        arrays = {name: values[places] for name, values in self.arrays.items() if name != "weights"}
        seeds = tuple(self.seeds[place] for place in places)
        return replace(self, average=self.average[places], seeds=seeds, arrays=arrays)


#: The agents of one config, by policy.
Agents = dict[str, Curves]


class Stored(Agents):
    """Agents whose runs are stored; asking for another says so."""

    def __missing__(self, name: str) -> Curves:
        """Raise UserError."""
        raise UserError(
            f"expected stored runs of the agent {name!r} in {records.root()}, got those of {list(self) or 'none'}: "
            f"git restores records that were deleted, `dropout-uncertainty run {EXPERIMENT} --config NAME --seeds 0-9` "
            "computes what is missing"
        )


def load(name: str, folder: Path | None = None, *, published: bool = True) -> Agents:
    """Return the recorded agents of a config, or of all configs of a family ("ours"); empty without records.

    Published seeds lie below 100; with ``published=False`` those of development, 100 and above, are read instead.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    names = [name] if name in CONFIGS else [config for config in CONFIGS if config.startswith(f"{name}-")]
    agents = Stored()
    for config in names:
        found = records.find(EXPERIMENT, name=config, folder=folder, published=published)
        if found:
            agents |= from_records(config, found)
    return agents


def from_records(name: str, found: Sequence[Record]) -> Agents:
    """Return the agents whose runs some records of one config hold, all seeds together, but for final weights."""
    seeds, arrays = records.joined(found, [key for key in found[0].arrays if key != "weights"])
    return from_arrays(name, CONFIGS[name], arrays, seeds, found)


def from_arrays(
    name: str, config: Config, arrays: Mapping[str, np.ndarray], seeds: Sequence[int], found: Sequence[Record] = ()
) -> Agents:
    """Return the agents of a run by policy, from the arrays that ``experiment.Foraging.result`` gives.

    Raises:
        ValueError: if two agents have one policy.
    """
    if len({agent.policy for agent in config.agents}) < len(config.agents):
        raise ValueError(f"expected agents of different policies, got {[agent.policy for agent in config.agents]}")
    agents = {}
    for index, agent in enumerate(config.agents):
        mine = {key: values[:, index] for key, values in arrays.items()}
        average = mine["average_reward"].astype(float)
        agents[agent.policy] = Curves(agent.policy, name, average, tuple(seeds), mine, tuple(found))
    return agents


@functools.cache
def original(variant: str = "as-demo") -> Agents:
    """Return the curves of the original program (``records/original``), runs of unequal length padded with NaN.

    ``variant``: "as-demo", six runs of the demo as published; or "as-written", five runs of its Thompson agent with the
    text's dropout.
    """
    name = {"as-demo": "rl2d_original_js_curves", "as-written": "rl2d_original_js_curves_dropout01_all"}[variant]
    lines = records.table(f"original/{name}")
    length = max(int(line["batch"]) for line in lines)
    agents = {}
    for agent, theirs in (("thompson", "thompson"), ("epsilon-greedy", "greedy")):
        mine = [line for line in lines if line["agent"] == theirs]
        seeds = sorted({int(line["seed"]) for line in mine})
        if seeds:
            average = np.full((len(seeds), length), np.nan)
            for line in mine:
                average[seeds.index(int(line["seed"])), int(line["batch"]) - 1] = float(line["average_reward"])
            agents[agent] = Curves(agent, "original", average, tuple(seeds), {})
    return agents


def batches(ticks: np.ndarray, unit: int = BLOCK) -> np.ndarray:
    """Return ticks as batches of ``unit`` ticks from the end of the burn-in, as the thesis counts."""
    return (np.asarray(ticks, float) - BURN_IN) / unit


def smoothed(curves: Curves, points: int = 40) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "R n"]]:
    """Return each run's curve averaged over ranges of equal length on a logarithmic axis of batches, and their middles.

    There are at most ``points``, fewer where a range would be shorter than one batch. Runs that end within a range
    count as far as they go, and are NaN after that.
    """
    last = batches(curves.ticks)[-1]
    ends = np.unique(np.geomspace(1, last, points).round()).astype(int)
    starts = np.concatenate(([0], ends[:-1]))
    ticks = BURN_IN + BLOCK * np.stack([starts, ends], 1)
    return np.sqrt((starts + 1) * ends), np.stack([curves.mean(*edges) for edges in ticks.tolist()], 1)


def mean_crossing(curves: Curves, target: float = TARGET) -> float:
    """Return the batch after the burn-in at which the mean curve of all runs first reaches ``target``; inf if never."""
    later = curves.ticks > BURN_IN
    return float(first_crossings(curves.average[:, later].mean(0), target, above=True)) + 1


def paired(*curves: Curves) -> tuple[Curves, ...]:
    """Return the runs of the seeds that all of some curves have, in one order."""
    places = common(*(one.seeds for one in curves))
    return tuple(one.only(mine) for one, mine in zip(curves, places, strict=True))


def advantage(agents: Agents, first: str, second: str, target: float = TARGET) -> Interval:
    """Return how many times as many batches from the burn-in to a reward the second agent needs, at the median.

    Of the seeds that both have; agents of one seed stay together.
    """
    slow, fast = (batches(curves.crossings(target)) for curves in paired(agents[second], agents[first]))
    return bootstrap_interval(lambda i: ratio(slow[i], fast[i]), len(slow))


def ratio(slow: np.ndarray, fast: np.ndarray) -> np.ndarray:
    """Return the median of ``slow`` [..., n] by that of ``fast``; 1 also where neither arrives."""
    late, early = smaller_median(slow), smaller_median(fast)
    return np.divide(late, early, out=np.ones_like(late), where=late != early)


def compare(first: Curves, second: Curves, start: int, stop: int) -> Interval:
    """Return the difference first - second of the mean reward over a range of ticks, paired over seeds."""
    return paired_difference(*(curves.mean(start, stop) for curves in paired(first, second)))


def held_out_gap(curves: Curves) -> Float[np.ndarray, " R"]:
    """Return the squared TD error of held-out transitions minus that of learned ones, over the second half."""
    return curves.later("held_out_td_error") - curves.later("learned_td_error")


def check_quick(agents: Agents) -> None:
    """Check a short run of the demo, 10,000 ticks or more, against wide bands that were set before its first run.

    Raises:
        ValueError: naming the band that they leave.
    """
    end = int(agents["thompson"].ticks[-1])
    for curves in agents.values():
        reward = float(curves.mean(BURN_IN, end).mean())
        if not 0.3 <= reward <= 1.2:
            raise ValueError(f"{curves.label}: mean reward {reward:.2f} after the burn-in is outside 0.3 to 1.2")
    early = compare(agents["thompson"], agents["epsilon-greedy"], BURN_IN, end).value
    if not 0.03 <= early <= 0.45:
        raise ValueError(f"Thompson sampling is ahead of ε-greedy by {early:.3f}, outside 0.03 to 0.45")


def results(folder: Path | None = None) -> list[Result]:
    """Return the numbers of Figure 5.4; the agents of the four separate worlds carry the plain ids."""
    found = []
    for name in ("ours", "as-demo", "as-written"):
        for curves in load(name, folder).values():
            found += _results(curves, "" if name == "ours" else f"/{name}")
    return found


def _results(curves: Curves, suffix: str) -> list[Result]:
    """Return the statistics of one agent."""
    identifier, found = f"figure-5.4/{curves.agent}", curves.records
    crossing = "median over runs of the first point of the curve at or above 1, from the end of the burn-in"
    ticks = curves.crossings()
    statistics = [
        ("/first-crossing", median_interval(batches(ticks)), f"batches of {BLOCK} ticks", crossing),
        ("/first-crossing/unit-200", median_interval(batches(ticks, 200)), "batches of 200 ticks", crossing),
    ]
    for start, stop in BLOCKS:
        block = t_interval(curves.mean(start, stop))
        statistics.append((f"/block-{start}-{stop}", block, "reward", f"mean of the curve over ticks {start}-{stop}"))
    return [
        measured(
            identifier + kind + suffix, interval, found, unit=unit, statistic=statistic, config=curves.config,
            thesis=f"{identifier}/first-crossing" if "first" in kind else None,
        )
        for kind, interval, unit, statistic in statistics
    ]  # fmt: skip


def crossing_table(groups: Mapping[str, Agents], target: float = TARGET) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: when the median run of each agent reaches ``target``, in ticks and in both units.

    Ticks count from the start, batches from the end of the burn-in.
    """
    heads = ["", "worlds", "thesis, batches", "batches of 500", "batches of 200", "ticks", "runs that get there"]
    cells: list[list[object]] = []
    for group, agents in groups.items():
        for curves in agents.values():
            ticks, printed = curves.crossings(target), thesis_value(f"figure-5.4/{curves.agent}/first-crossing")
            numbers = [in_words(median_interval(batches(ticks, unit)), ".0f") for unit in (500, 200)]
            reached = f"{np.isfinite(ticks).sum()} of {len(ticks)}"
            numbers.append(in_words(median_interval(ticks), ".0f"))
            cells.append([curves.label, group, printed and f"{printed:.0f}", *numbers, reached])
    return heads, cells


def block_table(groups: Mapping[str, Agents]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: mean reward over ranges of ticks; a run that ends within one counts as far as it goes."""
    heads = ["", "worlds", *(f"{start / 1000:g}k–{stop / 1000:g}k" for start, stop in BLOCKS)]
    cells: list[list[object]] = []
    for group, agents in groups.items():
        for curves in agents.values():
            means = [curves.mean(*block) for block in BLOCKS]
            shown = [in_words(t_interval(m[~np.isnan(m)]), ".3f") if not np.isnan(m).all() else None for m in means]
            cells.append([curves.label, group, *shown])
    return heads, cells


def difference_table(agents: Agents, reference: str) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: mean reward of each agent minus that of a reference, early and late, paired by seed."""
    last = int(agents[reference].ticks[-1])
    ranges = [ticks for ticks in (EARLY, LATE) if ticks[0] < last]
    heads = ["", *(f"ticks {start:,} to {min(stop, last):,}" for start, stop in ranges)]
    others = [curves for name, curves in agents.items() if name != reference]
    return heads, [
        [c.label, *(in_words(compare(c, agents[reference], *ticks), ".3f") for ticks in ranges)] for c in others
    ]


def held_out_table(networks: Mapping[str, Curves]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: squared TD errors and reward of networks by name, over the second half of their runs."""
    heads = ["", "learned", "held out", "held out - learned", "reward"]
    cells: list[list[object]] = []
    for name, curves in networks.items():
        parts = [curves.later("learned_td_error"), curves.later("held_out_td_error"), held_out_gap(curves)]
        cells.append([name, *(in_words(t_interval(part), ".3f") for part in [*parts, curves.later("reward")])])
    return heads, cells
