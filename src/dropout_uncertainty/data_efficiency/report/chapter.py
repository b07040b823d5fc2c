"""What the notebook of section 5.4 asks for in one call: the runs of a profile, and what they come to in words."""

from collections.abc import Iterator, Sequence

import numpy as np

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.deep_pilco import learner as deep
from dropout_uncertainty.data_efficiency.deep_pilco.learner import DeepPilcoConfig
from dropout_uncertainty.data_efficiency.pilco import learner
from dropout_uncertainty.data_efficiency.pilco.learner import PilcoConfig
from dropout_uncertainty.data_efficiency.plant.cartpole import PRESETS
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import PANELS, Learning
from dropout_uncertainty.judging.results import thesis_value
from dropout_uncertainty.page.profiles import complete
from dropout_uncertainty.page.tables import Folded, Rendered, Table, Words

__all__ = [
    "DEEP_LIVE", "PILCO_LIVE", "WITHOUT_A_MODEL", "computing_time", "deep_pilco", "in_words", "learn", "longest",
    "panels", "pilco", "plants", "shown", "solved", "telling", "times", "unsolved", "watch", "without_a_model",
]  # fmt: skip

#: Live runs by profile: repetitions, trials, and line searches of PILCO, or a share of the steps of Deep PILCO.
PILCO_LIVE = {"recorded": (1, 2, 100), "quick": (2, 5, 60), "full": (1, 2, 100)}
DEEP_LIVE = {"recorded": (1, 3, 0.4), "quick": (2, 5, 0.5), "full": (1, 3, 0.4)}
#: Stored runs of PILCO, each after those that it goes on from, with their seeds; None: as many as are published.
STORED: dict[str, Sequence[int] | None] = {
    "pilco-paper": None, "pilco-matlab": None, "pilco-paper-15": None, "pilco-paper-40": [0],
}  # fmt: skip
WITHOUT_A_MODEL = ("ddpg", "naf")
LATER = "The times of the stored runs are shown when there are some."


def watch(name: str, config: PilcoConfig | DeepPilcoConfig, seeds: Sequence[int]) -> Iterator[tuple[int, Learning]]:
    """Run a learner before the reader's eyes: give the number of each controlled trial, and the run up to there."""
    start = deep.start if isinstance(config, DeepPilcoConfig) else learner.start
    process = start(config, seeds)  # type: ignore[arg-type]
    for trial in range(process.total):
        print(f"trial {trial}: {process.advance()}")
        if trial:
            yield trial, analysis.from_arrays(name, config.plant, process.result(), process.seeds)


def learn(name: str, config: PilcoConfig | DeepPilcoConfig, seeds: Sequence[int]) -> Learning:
    """Run a learner before the reader's eyes, and return what it did."""
    *_, (_, learning) = watch(name, config, seeds)
    return learning


def pilco(profile: str, live: Learning) -> tuple[Learning, Learning | None]:
    """Return the stored runs of PILCO on both cart-poles; the live run and none in ``quick``, where that is checked."""
    complete(profile, *(configs.units(name, seeds) for name, seeds in STORED.items()))
    if profile == "quick":
        analysis.check_quick(live)
        return live, None
    return analysis.load("pilco-paper") or live, analysis.load("pilco-matlab")


def deep_pilco(profile: str, live: Learning) -> list[Learning]:
    """Return the stored runs of Deep PILCO, ours and as written; the live one in ``quick``, where it is checked."""
    names = ("deep-pilco-ours", "deep-pilco-as-written")
    complete(profile, [unit for name in names for unit in configs.units(name)])
    if profile == "quick":
        analysis.check_quick_deep(live)
        return [live]
    return [found for name in names if (found := analysis.load(name))] or [live]


def longest(profile: str) -> list[Learning]:
    """Return the one repetition of PILCO that goes on for 40 trials, if it is stored; none in ``quick``."""
    found = None if profile == "quick" else analysis.load("pilco-paper-40")
    return [found] if found else []


def without_a_model(profile: str) -> list[Learning]:
    """Return the stored runs of DDPG and NAF, which have a chapter of their own; none in ``quick``."""
    found = [] if profile == "quick" else [analysis.load(name) for name in WITHOUT_A_MODEL]
    return [learning for learning in found if learning]


def shown(learning: Learning) -> str:
    """Return which runs a page shows."""
    what = f"{len(learning.seeds)} stored repetitions" if learning.records else "the live run above"
    return f"Everything below shows {what} of {learning.trials} trials."


def plants() -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: the two cart-poles side by side."""
    fields = {
        "pole length l [m]": "pole_length",
        "steps of a trial": "steps",
        "step [s]": "dt",
        "spread of the start": "start_std",
        "observation noise": "observation_noise",
        "largest force [N]": "force_limit",
        "width of the cost [m]": "cost_width",
    }
    heads = ["", "`paper`: as re-implementations of Deep PILCO, with noise", "`matlab`: as in PILCO's own code"]
    return heads, [[words, *(getattr(plant, name) for plant in PRESETS.values())] for words, name in fields.items()]


def telling(learning: Learning) -> tuple[int, list[int]]:
    """Return the repetition that is solved first, and trials of it: the first, one between, the first solved."""
    replica = int(np.argmin(learning.first_solved))
    last = int(min(learning.first_solved[replica], learning.trials))
    return replica, sorted({1, max(1, (1 + last) // 2), last})


def panels(learning: Learning) -> Sequence[int]:
    """Return the trials of Figure 5.8, or the first four that a shorter run has kept."""
    kept = learning.arrays["shown"].tolist()
    return PANELS if set(PANELS) <= set(kept) else kept[:4]


def solved(learnings: Sequence[Learning], trials: Sequence[int]) -> Table:
    """Return the table of trials to solve, and of the shares solved by some trials, as far as there are any."""
    longest = max(learning.trials for learning in learnings)
    heads, cells = analysis.solved_table(learnings, [trial for trial in trials if trial <= longest])
    return Table(cells, heads, "Trials until half of the repetitions (their number in brackets) are solved; shares.")


def times(learning: Learning, trials: Sequence[int]) -> Rendered:
    """Return the table of computing times of some trials."""
    if not learning.records:
        return Words(LATER)
    heads, cells = analysis.time_table(learning, trials)
    return Table(cells, heads)


def computing_time(profile: str, first: Learning, others: Sequence[Learning]) -> list[Rendered]:
    """Return the tables of what all trials take, learner by learner, and of single trials, folded."""
    stored = [x for x in (first, *longest(profile), *others) if x.records]
    if not stored:
        return [Words(LATER)]
    heads, cells = analysis.run_time_table(stored)
    single = {x.label: times(x, (1, 2, 5, 10, 15, 20, 30, 40)) for x in stored}
    return [
        Table(cells, heads),
        *(Folded(f"{name}, CPU seconds per trial and repetition", table) for name, table in single.items()),
    ]


def unsolved(learning: Learning) -> Words:
    """Return how many repetitions are solved by trial 7, and how those ended that are not solved at all."""
    by, stuck = min(7, learning.trials), np.isinf(learning.first_solved)
    share = 100 * learning.solved_by(by).value
    text = f"By trial {by}, {share:.0f} % of the {len(stuck)} repetitions had been solved."
    if stuck.any():
        realised = learning.trial_costs[stuck, -1]
        error = np.abs(realised - learning.predicted_costs[stuck, -1]).mean()
        turns = np.abs(learning.arrays["states"][stuck, -1, -1, 3] - np.pi) / (2 * np.pi)
        text += (
            f" {stuck.sum()} were not in all {learning.trials} trials; look at their last one. It cost "
            f"{realised.mean():.2f} a step, and PILCO had predicted that to within {error:.2f}; "
            f"in {(turns > 1.5).sum()} of them the pole had gone round more than once."
        )
    return Words(text)


def in_words(pilco: Learning, ours: Learning, written: Learning | None = None) -> Words:
    """Return how many trials Deep PILCO takes beside PILCO, and how it does as written."""
    needed = [x.trials_to_solve.value for x in (pilco, ours)]
    if not np.isfinite(needed).all():
        return Words("Too few trials to say how many it takes.")
    printed = [thesis_value(f"figure-5.7/{name}/trials-to-solve") or np.nan for name in ("pilco", "deep-pilco")]
    text = (
        f"Deep PILCO works, but it takes {needed[1] / needed[0]:.1f} times as many trials as PILCO until half of the "
        f"repetitions are solved; by the thesis's counts it is {printed[1] / printed[0]:.1f} times."
    )
    if written:
        text += (
            f" As written half are solved by trial {written.trials_to_solve.value:g} (thesis: 20 to 25) and "
            f"{written.solved_by(40).value:.0%} by trial 40. But only just: of the trials after the first solved one "
            f"{written.solved[written.later].mean():.0%} are solved (ours: {ours.solved[ours.later].mean():.0%}), at a "
            f"cost of {written.trial_costs[written.later].mean():.2f} a step (ours: "
            f"{ours.trial_costs[ours.later].mean():.2f}). The model had said "
            f"{written.predicted_costs[written.later].mean():.2f}, so it does not promise too much; the policy "
            "improves slowly, as the curve shows, and has the pole up when the trial is nearly over."
        )
    return Words(text)
