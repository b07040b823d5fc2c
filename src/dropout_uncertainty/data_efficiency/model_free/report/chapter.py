"""What the notebook on learners without a model asks for in one call: the runs of a profile, tables and sentences."""

import math
from collections.abc import Sequence
from dataclasses import replace

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.model_free.learner import CONFIGS, start
from dropout_uncertainty.data_efficiency.model_free.report.analysis import ends, search_table
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.data_efficiency.report.statements import times_as_many
from dropout_uncertainty.page.profiles import complete
from dropout_uncertainty.page.tables import Rendered, Table, Words
from dropout_uncertainty.runs.process import finished
from dropout_uncertainty.stats import Interval, in_words

__all__ = ["experience", "known", "more", "other_ends", "runs", "search"]

NAMES = ("ddpg", "naf")
YARDSTICK = "deep-pilco-ours"
#: Live runs: two development seeds, narrow networks and few trials.
SEEDS, TRIALS, WIDTHS = (100, 101), 150, (32, 32)
#: Trials by which repetitions are counted as solved in the table.
BY = (10, 25, 100, 400, 1000, 2500)


def known() -> list[Learning]:
    """Return the stored runs of PILCO and Deep PILCO."""
    return [found for name in ("pilco-paper", YARDSTICK) if (found := analysis.load(name))]


def runs(profile: str) -> list[Learning]:
    """Return the stored runs of DDPG and NAF; in ``quick`` live ones, too narrow and too short to tell anything."""
    complete(profile, [unit for name in NAMES for unit in configs.units(name)])
    if profile == "quick":
        return [_live(name) for name in NAMES]
    return [found for name in NAMES if (found := analysis.load(name))]


def _live(name: str) -> Learning:
    config = replace(CONFIGS[name], trials=TRIALS, hidden=WIDTHS)
    return analysis.from_arrays(name, config.plant, finished(start(config, SEEDS)).result(), SEEDS)


def experience(learnings: Sequence[Learning]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: trials and seconds until half of the repetitions are solved, and shares solved."""
    trials = [trial for trial in BY if trial <= max(learning.trials for learning in learnings)]
    heads = ["", "trials to solve", "seconds of the plant", *(f"solved by {trial}" for trial in trials)]
    cells: list[list[object]] = []
    for learning in learnings:
        length, last, solve = learning.plant.steps * learning.plant.dt, learning.trials, learning.trials_to_solve
        value, low, high = (length * trial for trial in solve[:3])
        cells.append(
            [
                f"{learning.label} ({len(learning.seeds)})",
                in_words(solve, ".0f", unbounded=f"> {last}"),
                in_words(Interval(value, low, high, solve.n), ".0f", unbounded=f"> {last * length:.0f}"),
                *(in_words(learning.solved_by(trial), ".0%") if trial <= last else None for trial in trials),
            ]
        )
    return heads, cells


def more() -> Words:
    """Return how many times the trials of Deep PILCO the stored runs of the learners without a model need."""
    lines = []
    for learning in (found for name in NAMES if (found := analysis.load(name))):
        times = times_as_many(learning.config, YARDSTICK, 0.0, None).ours
        words = f"{in_words(times, '.0f', unbounded='no upper end')} times"
        if math.isinf(times.value):
            words = f"more than {times.low:.0f} times (lower end of the 95 % interval; fewer than half are solved)"
        solved, row = learning.solved[:, learning.tested], CONFIGS[learning.config].solved_tests
        kept = sum("1" * row in "".join(map(str, tests)) for tests in solved.astype(int).tolist())
        lines.append(
            f"- **{learning.label}** needs {words} as many trials as Deep PILCO. "
            f"{kept} of {len(solved)} repetitions had {row} solved tests in a row."
        )
    return Words("\n".join(lines))


def search() -> Rendered:
    """Return the table of every setting of the search."""
    heads, cells = search_table()
    return Table(cells, heads) if cells else Words("Nothing is stored of the search.")


def other_ends() -> Rendered:
    """Return the table of what the stored runs with another end of a trial cost."""
    heads = ["", "repetitions", "cost of a test", "less that of the learner as it is"]
    cells = [[f"`{x.name}`", x.difference.n, in_words(x.cost), in_words(x.difference)] for x in ends()]
    if not cells:
        return Words("*Not run yet.*")
    return Table(cells, heads, "Means over repetitions with 95 % intervals, pairs by seed.")
