"""The learners without a model, from records: how a setting of the search did, and what they need beside others.

Nothing is run and nothing is drawn here.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dropout_uncertainty.data_efficiency.learning import EXPERIMENT
from dropout_uncertainty.data_efficiency.model_free.config import ENDS, SEARCH
from dropout_uncertainty.data_efficiency.model_free.learner import CONFIGS
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.judging.results import Result, listed
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.settings import config_dict, config_diff
from dropout_uncertainty.stats import Interval, apart, in_words, t_interval

__all__ = ["End", "end_cost", "ends", "results", "search_table", "searched"]

#: Trials at the end of a run of the search over whose tests its cost is taken.
LAST = 100


def end_cost(learning: Learning) -> Float[np.ndarray, " R"]:
    """Return the mean cost per step of the tests of the last hundred trials, which the search goes by."""
    late = learning.tested > learning.trials - LAST
    return learning.counted(learning.trial_costs)[:, late].mean(1)


def searched(folder: Path | None = None) -> dict[str, Learning]:
    """Return the runs of the search that there are, by name."""
    runs = {name: records.find(EXPERIMENT, config, name=name, folder=folder) for name, config in SEARCH.items()}
    return {name: analysis.from_records(name, found) for name, found in runs.items() if found}


def search_table(folder: Path | None = None) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: every setting of the search, what it changes of what is printed, and how it did."""
    heads = ["tried", "changed", "seeds", "cost in the last hundred trials", "solved in 400 trials"]
    cells: list[list[object]] = []
    for name, learning in searched(folder).items():
        config = SEARCH[name]
        printed = replace(CONFIGS[f"{config.method}-as-printed"], trials=config.trials)
        changes = config_diff(config_dict(printed), config_dict(config))
        words = ", ".join(f"`{key}` {old} → {new}" for key, old, new in changes) or "nothing"
        seeds, solved = learning.seeds, int(np.isfinite(learning.first_solved).sum())
        cost = in_words(t_interval(end_cost(learning)))
        cells.append([f"`{name}`", words, f"{min(seeds)}-{max(seeds)}", cost, f"{solved} of {len(seeds)}"])
    return heads, cells


@dataclass(frozen=True)
class End:
    """What another end of a trial does to a learner: `ENDS` beside the config that it changes."""

    name: str
    cost: Interval  #: Mean cost per step of the tests, of the runs with this end.
    difference: Interval  #: That, less the cost of the learner as it is over the same trials, paired by seed.
    records: tuple[Record, ...]


def test_cost(learning: Learning, trials: int) -> Float[np.ndarray, " R"]:
    """Return the mean cost per step of the tests up to a trial."""
    return learning.counted(learning.trial_costs)[:, learning.tested <= trials].mean(1)


def ends(folder: Path | None = None) -> list[End]:
    """Return what has been run with another end, where the learner as it is has been run too."""
    found = []
    for name, config in ENDS.items():
        changed, usual = (analysis.load(x, folder) for x in (name, config.method))
        if changed and usual:
            cost = partial(test_cost, trials=config.trials)
            difference = t_interval(apart(cost, changed, usual))
            found.append(End(name, t_interval(cost(changed)), difference, (*changed.records, *usual.records)))
    return found


def results(folder: Path | None = None) -> list[Result]:
    """Return the numbers of this page that are not those of Figure 5.7."""
    found = []
    for end in ends(folder):
        rows = (
            ("cost", end.cost, "cost per step", "mean cost of the tests of 400 trials"),
            ("difference", end.difference, "cost per step", "that, less the learner's with no end at all"),
        )
        found += listed(end.name, rows, end.records, end.name)
    return found
