"""What the notebook on learners without a model asks for in one call: the runs of a profile, tables and sentences."""

import math
from dataclasses import replace

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.model_free.learner import CONFIGS, start
from dropout_uncertainty.data_efficiency.model_free.report.analysis import ends, search_table
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.data_efficiency.report.chapter import WITHOUT_A_MODEL, without_a_model
from dropout_uncertainty.data_efficiency.report.statements import DEEPER, times_as_many
from dropout_uncertainty.page.profiles import complete
from dropout_uncertainty.page.tables import Rendered, Table, Words
from dropout_uncertainty.runs.process import finished
from dropout_uncertainty.stats import in_words

__all__ = ["known", "more", "other_ends", "runs", "search"]

#: Live runs: two development seeds, narrow networks and few trials.
SEEDS, TRIALS, WIDTHS = (100, 101), 150, (32, 32)


def known() -> list[Learning]:
    """Return the stored runs of PILCO and Deep PILCO."""
    return [found for name in reversed(DEEPER) if (found := analysis.load(name))]


def runs(profile: str) -> list[Learning]:
    """Return the stored runs of DDPG and NAF; in ``quick`` live ones, too narrow and too short to tell anything."""
    complete(profile, [unit for name in WITHOUT_A_MODEL for unit in configs.units(name)])
    return [_live(name) for name in WITHOUT_A_MODEL] if profile == "quick" else without_a_model(profile)


def _live(name: str) -> Learning:
    config = replace(CONFIGS[name], trials=TRIALS, hidden=WIDTHS)
    return analysis.from_arrays(name, config.plant, finished(start(config, SEEDS)).result(), SEEDS)


def more() -> Words:
    """Return how many times the trials of Deep PILCO the stored runs of the learners without a model need."""
    lines = []
    for learning in without_a_model("recorded"):
        times = times_as_many(learning.config, DEEPER[0], 0.0, None).ours
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
