"""Is it exploration? From the records of the configs ``two-by-two/...`` to numbers. Nothing is run or drawn here.

Every comparison is a contrast: a weighted sum of the mean rewards of some agents over a range of ticks, for each seed
that all of them have. The contrasts and their ranges were fixed before the published seeds were run.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dropout_uncertainty.exploration.experiment import TWO_BY_TWO, units
from dropout_uncertainty.exploration.report import analysis
from dropout_uncertainty.exploration.report.analysis import EARLY, Curves
from dropout_uncertainty.judging.results import Result, measured
from dropout_uncertainty.page.profiles import computed
from dropout_uncertainty.settings import config_diff
from dropout_uncertainty.stats import Interval, in_words, t_interval

__all__ = [
    "CONTRASTS", "HELD", "LABELS", "LATE", "MARGIN", "SQUARE", "Cells", "Contrast", "cell_table", "changes",
    "contrast_table", "differences", "interval", "load", "missing", "obtain", "results",
]  # fmt: skip

FAMILY = "two-by-two"
#: Differences in reward per move below this are too small to matter.
MARGIN = 0.02
#: The agents, as tables and figures name them.
LABELS: dict[str, str] = {
    "dropout-draw": "learns with dropout, acts on a draw",
    "dropout-mean": "learns with dropout, acts on the mean",
    "plain-draw": "learns without, acts on a draw",
    "plain-mean": "learns without, acts on the mean",
    "masks-off-late": "dropout, acts on a draw up to tick 100,000",
    "hold-10": "dropout, a draw held for 10 ticks",
    "hold-100": "dropout, a draw held for 100 ticks",
    "hold-1000": "dropout, a draw held for 1,000 ticks",
    "epsilon-greedy": "ε-greedy",
    "epsilon-greedy-short": "ε-greedy, schedule ten times shorter",
}
#: Those of the square, which stands at the start.
SQUARE = ("dropout-draw", "dropout-mean", "plain-draw", "plain-mean")
#: Agents by the ticks for which they hold a draw.
HELD = {1: "dropout-draw", 10: "hold-10", 100: "hold-100", 1000: "hold-1000"}
#: Ticks in which one agent's masks are off, and the last ones, when ε has come to its floor.
LATE, LAST = (100_000, 200_000), (190_000, 200_000)


@dataclass(frozen=True)
class Contrast:
    """A comparison of agents: ``weights`` of their mean rewards over ``ticks`` (open below), by agent."""

    text: str
    weights: Mapping[str, float]
    ticks: tuple[int, int] = EARLY


def minus(text: str, first: str, second: str, ticks: tuple[int, int] = EARLY) -> Contrast:
    """Return the contrast first - second."""
    return Contrast(text, {first: 1.0, second: -1.0}, ticks)


#: The Thompson agent is dropout-draw. Statement EX7a is "acting", EX7b "learning": from it to an agent without either,
#: one change at a time. EX3c is "masks-off".
CONTRASTS: dict[str, Contrast] = {
    "acting": minus("a draw - the mean, learning with dropout", "dropout-draw", "dropout-mean"),
    "learning": minus("learning with dropout - without, acting on the mean", "dropout-mean", "plain-mean"),
    "both": minus("the Thompson agent - the one without either", "dropout-draw", "plain-mean"),
    "acting-plain": minus("a draw - the mean, learning without dropout", "plain-draw", "plain-mean"),
    "learning-draw": minus("learning with dropout - without, acting on a draw", "dropout-draw", "plain-draw"),
    "acting-average": Contrast(
        "a draw - the mean, average of both ways to learn",
        {"dropout-draw": 0.5, "plain-draw": 0.5, "dropout-mean": -0.5, "plain-mean": -0.5},
    ),
    "learning-average": Contrast(
        "learning with dropout - without, average of both ways to act",
        {"dropout-draw": 0.5, "dropout-mean": 0.5, "plain-draw": -0.5, "plain-mean": -0.5},
    ),
    **{f"hold-{h}": minus(f"a draw held for {h:,} ticks - for one", HELD[h], "dropout-draw") for h in (10, 100, 1000)},
    "long-schedule": minus("the Thompson agent - ε-greedy", "dropout-draw", "epsilon-greedy"),
    "short-schedule": minus("the Thompson agent - ε-greedy, short schedule", "dropout-draw", "epsilon-greedy-short"),
    "masks-off": minus("masks off while acting - on", "masks-off-late", "dropout-draw", LATE),
    "masks-off-epsilon-greedy": minus("masks off while acting - ε-greedy", "masks-off-late", "epsilon-greedy", LAST),
}
#: Curves by agent.
Cells = dict[str, Curves]


def load(folder: Path | None = None, *, quick: bool = False) -> Cells:
    """Return the recorded agents; those without a record are left out.

    With ``quick``, the short runs of development seeds are read.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    prefix, cells = "quick/" if quick else "", {}
    for config in TWO_BY_TWO:
        for curves in analysis.load(prefix + config, folder, published=not quick).values():
            cells[config.removeprefix(f"{FAMILY}/")] = curves
    return cells


def obtain(profile: str) -> Cells:
    """Return the agents that a profile shows: recorded, short runs computed now, or recorded and what is missing."""
    quick = [unit for name in TWO_BY_TWO for unit in units(f"quick/{name}", range(100, 103))]
    full = [unit for name in TWO_BY_TWO for unit in units(name, range(20))]
    with computed(profile, quick, full) as folder:
        return load(folder, quick=folder is not None)


def differences(cells: Mapping[str, Curves], contrast: Contrast) -> Float[np.ndarray, " R"]:
    """Return the contrast for each seed that all of its agents have, in order of the seeds.

    Raises:
        KeyError: if an agent is missing.
    """
    agents = analysis.paired(*(cells[name] for name in contrast.weights))
    weighted = zip(contrast.weights.values(), agents, strict=True)
    found = np.sum([weight * curves.mean(*contrast.ticks, "reward") for weight, curves in weighted], axis=0)
    return found[np.argsort(agents[0].seeds)]


def interval(cells: Mapping[str, Curves], contrast: Contrast) -> Interval | None:
    """Return the mean of a contrast with its 95 % interval, None if an agent is missing or its runs end before."""
    if not all(name in cells and cells[name].ticks[-1] > contrast.ticks[0] for name in contrast.weights):
        return None
    return t_interval(differences(cells, contrast))


def results(folder: Path | None = None) -> list[Result]:
    """Return the mean rewards of every agent and the contrasts, as far as there are records."""
    cells, found = load(folder), []
    for name, curves in cells.items():
        for what, (start, stop) in (("reward", EARLY), ("reward-late", LATE)):
            found.append(
                measured(
                    f"{FAMILY}/{name}/{what}", t_interval(curves.mean(start, stop, "reward")), _records(curves),
                    unit="reward per move", statistic=f"mean over ticks {start}-{stop}", config=curves.config,
                )
            )  # fmt: skip
    for name, contrast in CONTRASTS.items():
        value = interval(cells, contrast)
        if value is not None:
            agents = [cells[agent] for agent in contrast.weights]
            found.append(
                measured(
                    f"{FAMILY}/contrast/{name}", value, _records(*agents), unit="reward per move",
                    statistic=f"{contrast.text}, ticks {contrast.ticks[0]}-{contrast.ticks[1]}, paired by seed",
                    config=", ".join(curves.config for curves in agents),
                )
            )  # fmt: skip
    return found


def _records(*agents: Curves) -> list:
    return [record for curves in agents for record in curves.records]


# ------------------------------------------------------------------ tables


def changes() -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: what each agent does that the thesis's does not, from the configs."""
    base, lines = TWO_BY_TWO[f"{FAMILY}/dropout-draw"], list[list[object]]()
    for name, config in TWO_BY_TWO.items():
        own = config_diff(base.agents[0], config.agents[0])
        shared = [line for line in config_diff(base, config) if line[0] != "agents"]
        lines += [[LABELS[name.removeprefix(f"{FAMILY}/")], *line] for line in [*own, *shared]]
    return ["agent", "field", "Thompson agent", "here"], lines


def cell_table(cells: Mapping[str, Curves]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: mean reward of every agent, and how often it does not what the mean weights advise."""
    start, stop = EARLY
    heads = ["agent", f"reward, ticks {start:,} to {stop:,}", "other moves than the mean's", "seeds"]
    lines: list[list[object]] = []
    for name, label in LABELS.items():
        if name not in cells:
            lines.append([label, "not run yet", None, None])
            continue
        curves = cells[name]
        explored = 100 * curves.share("explored", start, stop).mean()
        reward = in_words(t_interval(curves.mean(start, stop, "reward")), ".3f")
        lines.append([label, reward, f"{explored:.0f} %", len(curves.seeds)])
    return heads, lines


def contrast_table(cells: Mapping[str, Curves]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: every contrast with its interval."""
    lines: list[list[object]] = []
    for contrast in CONTRASTS.values():
        value = interval(cells, contrast)
        lines.append([
            contrast.text, "{:,} to {:,}".format(*contrast.ticks),
            missing(cells, contrast) if value is None else in_words(value, ".3f"), None if value is None else value.n,
        ])  # fmt: skip
    return ["difference", "ticks", "reward per move", "pairs"], lines


def missing(cells: Mapping[str, Curves], contrast: Contrast) -> str:
    """Return why a contrast has no interval."""
    return "runs are shorter" if all(name in cells for name in contrast.weights) else "not run yet"
