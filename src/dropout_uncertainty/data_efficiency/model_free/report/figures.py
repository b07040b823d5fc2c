"""Figures of the page on learners without a model: numbers in, a figure out."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.data_efficiency.report.figures import colour_of, log_trials
from dropout_uncertainty.page.plotting import COLOURS, WIDTH, legend_above


def values(seconds: np.ndarray, worth: Mapping[str, np.ndarray]) -> Figure:
    """Draw what standing is worth [T] against the time that has gone [T], by the way to treat a trial's end."""
    figure, ax = plt.subplots(figsize=(WIDTH, 2.8))
    for name, (label, value) in zip(("naf", "deep-pilco", "bald"), worth.items(), strict=True):
        ax.plot(seconds, value, color=COLOURS[name], label=label)
    ax.set(xlabel="time in the trial [s]", ylabel="value of standing")
    ax.set_ylim(bottom=0)
    legend_above(ax)
    return figure


def unsolved(learnings: Sequence[Learning]) -> Figure:
    """Draw the share of repetitions that are not solved yet after each trial, with its 95 % interval.

    A curve ends with the last trial that its learner was given: whatever is left there is unsolved.
    """
    figure, ax = plt.subplots(figsize=(WIDTH, 3.4))
    for learning in learnings:
        trials, colour = learning.tested, colour_of(learning)
        share, low, high = 1 - np.array([learning.solved_by(trial)[:3] for trial in trials.tolist()]).T
        ax.step(trials, share, where="post", color=colour, label=f"{learning.label} ({len(learning.seeds)})")
        ax.fill_between(trials, low, high, step="post", color=colour, alpha=0.15, linewidth=0)
    log_trials(ax, "share not solved yet")
    legend_above(ax)
    return figure
