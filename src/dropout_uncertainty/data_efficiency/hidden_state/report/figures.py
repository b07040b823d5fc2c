"""Figures of the page on hidden states: numbers in, a figure out; None where there is nothing."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from dropout_uncertainty.data_efficiency.hidden_state.report.analysis import LANGUAGES, MODELS, SEEN, Run
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.page.plotting import COLOURS, FEW, WIDTH, band, legend_above
from dropout_uncertainty.stats import t_interval

__all__ = ["learning", "over_time", "readings", "scores", "trial"]

DARK = "#333333"
#: Share of a normal distribution within two standard deviations.
NOMINAL = 0.954
STYLES = {
    "last-one": (COLOURS["random"], "o"),
    "last-four": (COLOURS["max-entropy"], "s"),
    "lstm-held": (COLOURS["deep-pilco"], "D"),
    "lstm-fresh": (COLOURS["bald"], "^"),
    "lstm-no-dropout": (COLOURS["least-confidence"], "v"),
    "seen": (DARK, "x"),
}
MASKS = {
    "language-none": COLOURS["least-confidence"],
    "language-fresh": COLOURS["bald"],
    "language-held": COLOURS["deep-pilco"],
}


def readings(found: Sequence[Run]) -> Figure | None:
    """Draw what language models make of their own text and of other text, against how often they have read theirs."""
    if not found:
        return None
    figure, axes = plt.subplots(1, 2, figsize=(WIDTH, 3.2), sharey=True)
    for ax, part, title in zip(axes, ("train", "test"), ("text that it was trained on", "other text"), strict=True):
        for run in found:
            curves = run.arrays[part]
            x = np.arange(1, curves.shape[1] + 1)
            band(ax, x, curves, colour=MASKS[run.name], label=LANGUAGES[run.name])
        ax.set(xlabel="times that the text was read", title=title)
    axes[0].set_ylabel("surprise of a character [nats]")
    legend_above(axes[0])
    return figure


def scores(found: Sequence[Run]) -> Figure | None:
    """Draw, against the trials of data, the log density of a number and how often it lies within two deviations."""
    if not found:
        return None
    figure, (density, covered) = plt.subplots(1, 2, figsize=(WIDTH, 3.6))
    for place, run in enumerate(found):
        colour, marker = STYLES[run.name]
        shift = 1.04 ** (place - (len(found) - 1) / 2)  # side by side on a logarithmic axis
        for ax, values in ((density, run.log_density), (covered, run.covered)):
            limits = [t_interval(column) for column in values.mean((2, 3, 4)).T]
            middle = np.array([i.value for i in limits])
            reach = np.array([[i.value - i.low, i.high - i.value] for i in limits]).T
            x = np.array(run.sizes) * shift
            bars = reach if len(run.seeds) >= FEW else None
            ax.errorbar(x, middle, bars, color=colour, marker=marker, markersize=4, label=MODELS[run.name])
    covered.axhline(NOMINAL, color=DARK, linewidth=0.8, linestyle=":")
    for ax, words in ((density, "log density of a number [nats]"), (covered, "within two predicted std")):
        ax.set_xscale("log")
        ax.set_xticks(found[0].sizes, [str(size) for size in found[0].sizes])
        ax.minorticks_off()
        ax.set(xlabel="trials of data", ylabel=words)
    figure.legend(handles=density.get_legend_handles_labels()[0], loc="outside upper center", ncols=3)
    return figure


def over_time(found: Sequence[Run]) -> Figure | None:
    """Draw the log density of x and of θ against the time that is predicted, mean over sizes of data."""
    if not found:
        return None
    figure, axes = plt.subplots(1, 2, figsize=(WIDTH, 3.4))
    for number, (ax, words) in enumerate(zip(axes, ("x", "θ"), strict=True)):
        for run in found:
            curves = run.log_density[..., number].mean((1, 2))
            t = PAPER.dt * np.arange(1, curves.shape[1] + 1)
            band(ax, t, curves, colour=STYLES[run.name][0], label=MODELS[run.name])
        ax.set(xlabel="time [s]", title=words)
    axes[0].set_ylabel("log density [nats]")
    figure.legend(handles=axes[0].get_legend_handles_labels()[0], loc="outside upper center", ncols=3)
    return figure


def trial(found: Sequence[Run], replica: int = 0) -> Figure | None:
    """Draw the angle of one trial and what the first three models predicted of it, the most data and the next trial."""
    if not found:
        return None
    shown = found[:3]
    figure, axes = plt.subplots(1, len(shown), figsize=(WIDTH, 3), sharey=True, squeeze=False)
    for ax, run in zip(axes[0], shown, strict=True):
        place = replica, -1, 0, slice(None), 1
        observed, mean, std = (run.arrays[name][place] for name in ("observed", "predicted_mean", "predicted_std"))
        t = PAPER.dt * np.arange(1, len(observed) + 1)
        ax.fill_between(t, mean - 2 * std, mean + 2 * std, color=STYLES[run.name][0], alpha=0.2, linewidth=0)
        ax.plot(t, mean, color=STYLES[run.name][0], label="predicted, two std")
        ax.plot(t, observed, ".", color=DARK, label="observed")
        ax.set(xlabel="time [s]", title=MODELS[run.name])
    axes[0, 0].set_ylabel("θ [rad]")
    figure.legend(handles=axes[0, 0].get_legend_handles_labels()[0], loc="outside upper center", ncols=2)
    return figure


def learning(found: Mapping[str, Learning]) -> Figure | None:
    """Draw what each learner's trials cost, and the share of its repetitions that have had a solved one by then."""
    if not found:
        return None
    figure, (costs, ever) = plt.subplots(1, 2, figsize=(WIDTH, 3.6))
    for name, learner in found.items():
        x, colour = learner.tested, STYLES[name][0]
        band(costs, x, learner.trial_costs[:, x], colour=colour, label=MODELS.get(name, SEEN))
        share, low, high = np.array([learner.solved_by(trial)[:3] for trial in x.tolist()]).T
        ever.step(x, share, where="post", color=colour)
        ever.fill_between(x, low, high, step="post", color=colour, alpha=0.12, linewidth=0)
    for ax, words in ((costs, "mean cost per step"), (ever, "share of repetitions solved by then")):
        ax.set(xlabel="trial", ylabel=words, ylim=(0, 1.02))
    figure.legend(handles=costs.get_legend_handles_labels()[0], loc="outside upper center", ncols=2)
    return figure
