"""The statements of section 5.4 about both learners and their figures: what the thesis says, and how it is judged."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dropout_uncertainty.data_efficiency.report.analysis import (
    LATER,
    Learning,
    angles,
    at_equal_times,
    excess_on_predictable,
    load,
    share_solved,
    steps_held,
    steps_predicted,
)
from dropout_uncertainty.judging.results import printed
from dropout_uncertainty.judging.statements import NEAR, Measured, Statement, from_range, needed, on_average, shifted
from dropout_uncertainty.stats import (
    Statistic,
    apart,
    bootstrap_estimate,
    difference_of_shares,
    share_estimate,
    smaller_median,
    t_interval,
)

__all__ = [
    "DEEPER", "DEEP_TEXT", "DOUBT", "INTRODUCTION", "MARGIN_COST", "MARGIN_LOG", "MARGIN_SHARE", "RESULT", "STATEMENTS",
    "cost_of_learning", "dearer", "stated", "times_as_many",
]  # fmt: skip

CHAPTER, DOUBT = "5_4_data_efficiency", "5_4_what_doubt_is_worth"
#: Margins: of the mean cost per step of first trials, of shares, of trials to solve, and of logarithms of deviations.
MARGIN_COST, MARGIN_SHARE, MARGIN_TRIALS, MARGIN_LOG = 0.05, 0.1, 3.0, math.log(1.1)

stated = partial(Statement, chapter=CHAPTER)


def cost_of_learning(learning: Learning, trials: int = 25) -> Float[np.ndarray, " R"]:
    """Return the mean cost per step of the controlled trials of each repetition, up to a trial or to the last."""
    return learning.trial_costs[:, 1 : trials + 1].mean(1)


# ------------------------------------------------------------------ trials to solve


def half(flags: np.ndarray, learning: Learning) -> Measured:
    """Return the share of repetitions of which something is true, less one half: "most"."""
    estimate = share_estimate(flags, 0.5)
    return Measured(estimate, shifted(estimate.interval, 0.5), learning.records)


def solved_by(config: str, trial: int, folder: Path | None) -> Measured:
    """Return the share of repetitions solved by a trial, less one half."""
    learning = needed(load(config, folder))
    return half(learning.first_solved <= trial, learning)


def trials_to_solve(config: str, low: float, high: float, folder: Path | None) -> Measured:
    """Return how far the trial by which half of the repetitions are solved lies outside a printed range."""
    learning = needed(load(config, folder))
    least, most = _least(learning), learning.first_solved
    trial = bootstrap_estimate(lambda i: smaller_median(least[i]), len(most), most=lambda i: smaller_median(most[i]))
    return Measured(from_range(trial, low, high), trial.interval, learning.records)


def _least(learning: Learning) -> Float[np.ndarray, " R"]:
    """Return the least that each repetition's trials to solve can be: unsolved, one more than it had."""
    return np.minimum(learning.first_solved, learning.trials + 1)


def times_as_many(first: str, second: str, claimed: float, folder: Path | None) -> Measured:
    """Return a learner's trials to solve by those of another, both at the median, less what is claimed."""
    one, two = (needed(load(name, folder)) for name in (first, second))

    def ratio(above: np.ndarray, below: np.ndarray) -> Statistic:
        return lambda i, j: smaller_median(above[i]) / smaller_median(below[j]) - claimed

    difference = bootstrap_estimate(
        ratio(_least(one), two.first_solved), len(one.seeds), len(two.seeds),
        most=ratio(one.first_solved, _least(two)),
    )  # fmt: skip
    return Measured(difference, shifted(difference.interval, claimed), [*one.records, *two.records])


#: Deep PILCO's configs: as the text has it and nothing else, with what the paper and we added, and our own.
DEEP = {
    "as-text": ("deep-pilco-as-text", "Deep PILCO, as the text has it"),
    "as-paper": ("deep-pilco-as-written", "Deep PILCO, with features and a memory of ten trials"),
    "ours": ("deep-pilco-ours", "Deep PILCO, our setting"),
}
WAITS = "40 runs of Deep PILCO as the text has it, with nothing added"
RESULT, CAPTION = "Section 5.4.3", "Figure 5.7, caption"


def of_deep(letters: str, name: str) -> list[Statement]:
    """Return the three statements about the trials that one config of Deep PILCO needs."""
    config, words = DEEP[name]
    reason = WAITS if name == "as-text" else ""
    ranges = {"20 to 25": (20.0, 25.0, RESULT), "42": (42.0, 42.0, CAPTION)}
    return [
        stated(f"DE2{letters[0]}", f"{words}: most runs have balanced the pole by trial 25.", RESULT, "more",
               MARGIN_SHARE, partial(solved_by, config, 25), unit="share", thesis=0.5, would_test=reason),
        *(
            stated(f"DE2{letter}", f"{words}: half of the runs have done so after {count} trials.", where, "value",
                   MARGIN_TRIALS, partial(trials_to_solve, config, low, high), unit="trials",
                   thesis=(low + high) / 2, would_test=reason)
            for letter, (count, (low, high, where)) in zip(letters[1:], ranges.items(), strict=True)
        ),
    ]  # fmt: skip


# ------------------------------------------------------------------ Figure 5.8

PANEL = "deep-pilco-as-written"


def panel(quantity: Callable[[Learning], np.ndarray], claimed: float, folder: Path | None) -> Measured:
    """Return a quantity of each repetition less what is claimed; that of our setting is shown beside."""
    learning = needed(load(PANEL, folder))
    ours = load("deep-pilco-ours", folder)
    beside = {"our setting": t_interval(quantity(ours))} if ours else {}
    return on_average(quantity(learning), learning.records, claimed, beside)


def failed(folder: Path | None) -> Measured:
    """Return the share of repetitions whose policy, after one trial, fails in most trials; less one half."""
    learning = needed(load(PANEL, folder))
    return half(share_solved(learning, 1) < 0.5, learning)


def _grown(quantity: Callable[[Learning, int], np.ndarray], to: int, since: int) -> Callable[[Learning], np.ndarray]:
    return lambda learning: quantity(learning, to) - quantity(learning, since)


STEPS, HELD = (printed(f"figure-5.8/deep-pilco/{name}-after-10") for name in ("steps-predicted", "steps-held"))
AFTER = "Figure 5.8"

FIGURE_5_8 = [
    stated("DE3a", "After one trial the model predicts fewer steps than after ten.", f"{AFTER} (a)", "more",
           NEAR * STEPS, partial(panel, _grown(steps_predicted, 10, 1), 0.0), unit="steps"),
    stated("DE3b", "After one trial the policy of most runs fails in most of its trials.", f"{AFTER} (a)", "more",
           MARGIN_SHARE, failed, unit="share", thesis=0.5),
    stated("DE3c", "After ten trials the model predicts the first 13 steps.", f"{AFTER} (b)", "value", NEAR * STEPS,
           partial(panel, lambda x: steps_predicted(x, 10), STEPS), unit="steps", thesis=STEPS),
    stated("DE3d", "After ten trials the pole is held for ten steps.", f"{AFTER} (b)", "value", NEAR * HELD,
           partial(panel, lambda x: steps_held(x, 10), HELD), unit="steps", thesis=HELD),
    stated("DE3e", "After twenty trials the model is better than after ten.", f"{AFTER} (c)", "more", NEAR * STEPS,
           partial(panel, _grown(steps_predicted, 20, 10), 0.0), unit="steps"),
    stated("DE3f", "After twenty trials the pole is held for longer than after ten.", f"{AFTER} (c)", "more",
           NEAR * HELD, partial(panel, _grown(steps_held, 20, 10), 0.0), unit="steps"),
    stated("DE3g", "After 26 trials the model predicts more steps than after ten.", f"{AFTER} (d)", "more",
           NEAR * STEPS, partial(panel, _grown(steps_predicted, 26, 10), 0.0), unit="steps"),
    stated("DE3h", "From trial 26 on most trials succeed.", f"{AFTER} (d)", "more", MARGIN_SHARE,
           partial(panel, lambda x: x.solved[:, 26:].mean(1), 0.5), unit="share", thesis=0.5),
]  # fmt: skip


# ------------------------------------------------------------------ doubt


def dearer(first: tuple[str, ...], second: str, trials: int, folder: Path | None) -> Measured:
    """Return the cost of learning of the first config that has records less that of another, paired by seed."""
    one = needed(next(filter(None, (load(name, folder) for name in first)), None))
    two = needed(load(second, folder))
    until = min(trials, one.trials, two.trials)
    return on_average(apart(lambda x: cost_of_learning(x, until), one, two), [*one.records, *two.records])


def promised(folder: Path | None) -> Measured:
    """Return by how much the trials of Deep PILCO without dropout cost more than its model said."""
    learning = needed(load("doubt/no-dropout", folder) or load("what-matters/no-dropout", folder))
    return on_average(learning.broken_promise, learning.records)


def fades(config: str, folder: Path | None) -> Measured:
    """Return by how much a model's predictions are right more often in the first fifth of a trial than in the last.

    Right is a predicted mean angle that puts the tip within the width of the cost of where it then was; of trials 1-5.
    """
    learning = needed(load(config, folder))
    trials = [trial for trial in LATER if trial <= learning.trials]
    true, mean = (angles(learning.arrays[name], trials) for name in ("states", "predicted_mean"))
    right = np.abs(true - mean) * learning.plant.pole_length < learning.plant.cost_width
    fifth = right.shape[-1] // 5
    return on_average(right[..., :fifth].mean((1, 2)) - right[..., -fifth:].mean((1, 2)), learning.records)


def solved_more(first: str, second: str, trial: int, folder: Path | None) -> Measured:
    """Return the share of a learner's repetitions that are solved by a trial less that of another learner."""
    one, two = (needed(load(name, folder)) for name in (first, second))
    difference = difference_of_shares(one.first_solved <= trial, two.first_solved <= trial)
    return Measured(difference, difference.interval, [*one.records, *two.records])


def gradient(which: int, folder: Path | None) -> Measured:
    """Return one of the two statistics of ``analysis.excess_on_predictable``; beside the first, at equal time steps."""
    learning = needed(load("pilco-paper", folder))
    needed(learning.arrays.get("search_variance"))
    fixed = {} if which else {name: x[~np.isnan(x)] for name, x in at_equal_times(learning).items()}
    beside = {f"{name}, at equal time steps": t_interval(values) for name, values in fixed.items() if len(values)}
    return on_average(excess_on_predictable(learning)[which], learning.records, beside=beside)


#: The learner that the thesis holds against others, and PILCO.
DEEPER = ("deep-pilco-ours", "pilco-paper")
INTRODUCTION, PILCO_TEXT, DEEP_TEXT = "Section 5.4", "Section 5.4.1", "Section 5.4.2"

STATEMENTS: list[Statement] = [
    stated("DE1a", "By trial 7 PILCO has balanced the pole in more than half of its runs.", RESULT, "more",
           MARGIN_SHARE, partial(solved_by, "pilco-paper", 7), unit="share", thesis=0.5),
    stated("DE1b", "Half of PILCO's runs have done so after 6 to 7 trials.", RESULT, "value", MARGIN_TRIALS,
           partial(trials_to_solve, "pilco-paper", 6.0, 7.0), unit="trials", thesis=6.5),
    stated("DE1c", "Half of PILCO's runs have done so after 5 trials.", CAPTION, "value", MARGIN_TRIALS,
           partial(trials_to_solve, "pilco-paper", 5.0, 5.0), unit="trials", thesis=5.0),
    *of_deep("abc", "as-text"),
    *of_deep("def", "as-paper"),
    *of_deep("ghi", "ours"),
    *FIGURE_5_8,
    stated("DE7a", "The uncertainty in Deep PILCO's model makes learning cheaper: without dropout trials 1 to 25 "
           "cost more.", PILCO_TEXT, "more", MARGIN_COST,
           partial(dearer, ("doubt/no-dropout", "what-matters/no-dropout"), "deep-pilco-ours", 25),
           unit="cost per step", chapter=DOUBT, primary=True),
    stated("DE7b", "Without dropout the model promises less cost than the trials then have.", PILCO_TEXT, "more",
           MARGIN_COST, promised, unit="cost per step", chapter=DOUBT),
    stated("DE7c", "The uncertainty in PILCO's model makes learning cheaper: planned on its mean alone, trials 1 to "
           "15 cost more.", PILCO_TEXT, "more", MARGIN_COST,
           partial(dearer, ("doubt/pilco-mean",), "pilco-paper-15", 15),
           unit="cost per step", chapter=DOUBT, primary=True,
           would_test="40 runs of PILCO that plan on the mean of its model"),
    stated("DE7d", "Planning on its mean alone, PILCO predicts the first steps of trials 1 to 5 better than the last "
           "ones.", PILCO_TEXT, "more", MARGIN_SHARE, partial(fades, "doubt/pilco-mean"), unit="share", chapter=DOUBT,
           would_test="predicted states step by step of runs without doubt, which are to be made"),
    stated("DE11a", "The less PILCO can predict a step, the less it counts in the gradient, against a model without "
           "uncertainty (rank correlation, trials 1 to 5).", PILCO_TEXT, "less", MARGIN_SHARE, partial(gradient, 0)),
    stated("DE11b", "Steps that PILCO predicts well have a larger share of its gradient than without uncertainty "
           "(trials 1 to 5).", PILCO_TEXT, "more", MARGIN_SHARE, partial(gradient, 1), unit="share"),
    stated("DE14a", "Deep PILCO needs more trials than PILCO.", INTRODUCTION, "more", NEAR,
           partial(times_as_many, *DEEPER, 1.0), unit="times", thesis=1.0),
    stated("DE14b", "It needs slightly more: less than twice as many.", INTRODUCTION, "less", 2 * NEAR,
           partial(times_as_many, *DEEPER, 2.0), unit="times", thesis=2.0),
    stated("DE15", "From observations of many dimensions Deep PILCO solves more runs by trial 25 than PILCO.",
           f"{INTRODUCTION}, {DEEP_TEXT}", "more", MARGIN_SHARE,
           partial(solved_more, "many-dimensions/deep-pilco", "many-dimensions/pilco", 25), unit="share",
           would_test="both on observations of many dimensions"),
]  # fmt: skip
