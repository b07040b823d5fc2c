"""Figures of what doubt is worth: numbers in, a figure as large as what there is out; None where there is nothing."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import digamma

from dropout_uncertainty.data_efficiency.ablations.gradients import ESTIMATES
from dropout_uncertainty.data_efficiency.ablations.literal import CHANGES
from dropout_uncertainty.data_efficiency.ablations.report.analysis import NOMINAL, Comparison
from dropout_uncertainty.data_efficiency.ablations.report.figures import whisker
from dropout_uncertainty.data_efficiency.ablations.report.worth.analysis import (
    PAIRS,
    PARTICLES,
    Cloud,
    Estimates,
    coverage,
)
from dropout_uncertainty.data_efficiency.plant.drawing import DARK
from dropout_uncertainty.data_efficiency.report.statements import MARGIN_COST
from dropout_uncertainty.page.plotting import COLOURS, WIDTH, band, legend_above
from dropout_uncertainty.stats import t_interval

__all__ = ["both_ways", "covered", "estimates", "first_trials", "forest", "left", "particles", "walk"]

#: With doubt and without.
DOUBT, SURE = COLOURS["deep-pilco"], COLOURS["bald"]
NOISE_STYLES = {"plain": ("plain noise", COLOURS["bald"]), "standardised": ("standardised noise", "#0072B2")}
ESTIMATE_STYLES = {"pathwise": "#0072B2", "likelihood-ratio": "#D55E00", "total-propagation": "#009E73"}


def _rows(ax: Axes, names: Sequence[str]) -> None:
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.grid(axis="y", visible=False)


def forest(pairs: Sequence[Comparison]) -> Figure | None:
    """Draw what learning costs more than for the other of each pair, and by how much each breaks its promises."""
    if not pairs:
        return None
    figure, (dearer, broken) = plt.subplots(1, 2, figsize=(WIDTH, 1.6 + 0.42 * len(pairs)), sharey=True)
    dearer.axvspan(-MARGIN_COST, MARGIN_COST, color="#eeeeee")
    for row, found in enumerate(pairs):
        whisker(dearer, row, found.cost_difference, DARK)
        for shift, learning, colour, words in (
            (-0.14, found.second, DOUBT, "what it is held against"), (0.14, found.first, SURE, "the learner named"),
        ):  # fmt: skip
            whisker(broken, row + shift, t_interval(learning.broken_promise), colour, None if row else words)
    for ax in (dearer, broken):
        ax.axvline(0, color=DARK, linewidth=0.9)
        _rows(ax, [_wrapped(f"{PAIRS[found.name]} ({len(found.first.seeds)})") for found in pairs])
    dearer.set_xlabel("cost per step, difference")
    broken.set_xlabel("realised less predicted cost")
    legend_above(broken)
    return figure


def _wrapped(words: str) -> str:
    return words.replace(", ", ",\n", 1).replace(" in the place", "\nin the place", 1)


def first_trials(found: Comparison | None, trials: int = 5) -> Figure | None:
    """Draw predicted and realised cost of the first trials, on the left of the sure learner, then with doubt."""
    if found is None:
        return None
    figure, axes = plt.subplots(1, 2, figsize=(WIDTH, 3.2), sharey=True)
    for ax, learning, title in zip(axes, (found.first, found.second), ("on its mean", "with its doubt"), strict=True):
        x = np.arange(1, min(trials, learning.trials) + 1)
        for curves, colour, label in (
            (learning.predicted_costs, DOUBT, "predicted"), (learning.trial_costs, SURE, "realised"),
        ):  # fmt: skip
            band(ax, x, curves[:, x], colour=colour, label=label, marker="o", markersize=4)
        ax.set(xlabel="trial", title=title, ylim=(0, 1.05), xticks=x)
    axes[0].set_ylabel("mean cost per step")
    legend_above(axes[0])
    return figure


def covered(pairs: Sequence[Comparison]) -> Figure | None:
    """Draw how often the truth is within two predicted deviations over the trial, one panel per pair that tells."""
    telling = [(p, coverage(p.first), coverage(p.second)) for p in pairs]
    shown = [(p, one, two) for p, one, two in telling if one is not None and two is not None]
    if not shown:
        return None
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure, grid = plt.subplots(rows, columns, figsize=(WIDTH, 0.6 + 2.4 * rows), sharey=True, squeeze=False)
    for ax in grid.flat[len(shown) :]:
        ax.remove()
    for ax, (found, first, second) in zip(grid.flat, shown, strict=False):
        for learning, curves, colour, words in (
            (found.second, second, DOUBT, "what it is held against"), (found.first, first, SURE, "the learner named"),
        ):  # fmt: skip
            t = learning.plant.dt * np.arange(1, curves.shape[1] + 1)
            band(ax, t, curves, colour=colour, label=words)
        ax.axhline(NOMINAL, color=DARK, linewidth=0.8, linestyle=":")
        ax.set(title=textwrap.fill(PAIRS[found.name], 24), xlabel="time [s]", ylim=(0, 1.02))
    grid[0, 0].set_ylabel("true states within two std")
    legend_above(grid[0, 0])
    return figure


def both_ways(groups: Mapping[str, Sequence[Comparison]]) -> Figure | None:
    """Draw each choice added to the text's learner, on the left, and taken from ours, on the right: cost, paired."""
    run = {comparison.name for those in groups.values() for comparison in those}
    names = [name for name in CHANGES if name in run]
    if not names:
        return None
    figure, axes = plt.subplots(1, 2, figsize=(WIDTH, 1.4 + 0.28 * len(names)), sharex=True, sharey=True)
    for ax, (way, words) in zip(axes, (("add", "added to the text's"), ("drop", "taken from ours")), strict=True):
        ax.axvspan(-MARGIN_COST, MARGIN_COST, color="#eeeeee")
        ax.axvline(0, color=DARK, linewidth=0.9)
        for found in groups[way]:
            whisker(ax, names.index(found.name), found.cost_difference, DARK)
        _rows(ax, [name.replace("-", " ") for name in names])
        if not groups[way]:
            ax.text(0.5, 0.5, "not run yet", transform=ax.transAxes, ha="center", va="center")
        ax.set(title=words, xlabel="cost per step, difference")
        ax.locator_params(axis="x", nbins=5)
    return figure


def particles(pairs: Sequence[Comparison]) -> Figure | None:
    """Draw the mean cost per step of particles through a Gaussian process, fixed and fresh, by how they match."""
    if not pairs:
        return None
    figure, ax = plt.subplots(figsize=(WIDTH, 1.4 + 0.5 * len(pairs)))
    words = {"full": "all dimensions together", "diagonal": "each alone", "off": "no matching"}
    for row, found in enumerate(pairs):
        for shift, learning, colour, way in (
            (-0.14, found.second, DOUBT, "fresh-adam"), (0.14, found.first, SURE, "fixed-bfgs"),
        ):  # fmt: skip
            label = None if row else PARTICLES[way]
            whisker(ax, row + shift, t_interval(learning.trial_costs[:, 1:].mean(1)), colour, label)
    _rows(ax, [words[found.name] for found in pairs])
    ax.set_xlabel("mean cost per step")
    legend_above(ax)
    return figure


def walk(ax: Axes, variances: Mapping[str, Float[Any, "T N"]], count: int) -> Axes:
    """Draw mean and median of simulated variances over steps, and by theory (dots), for "1/K" and "1/(K - 1)"."""
    for (words, values), less, colour in zip(variances.items(), (0, 1), (SURE, DOUBT), strict=True):
        found, t = np.asarray(values), np.arange(len(values))
        ax.plot(t, found.mean(1), color=colour, label=f"{words}, mean")
        ax.plot(t, np.median(found, 1), color=colour, linestyle="--", label=f"{words}, median")
        rate = digamma((count - 1) / 2) + np.log(2 / (count - less))
        ax.plot(t[::4], ((count - 1) / (count - less)) ** t[::4], ".", color=colour)
        ax.plot(t[::4], np.exp(rate * t[::4]), ".", color=colour)
    ax.set(yscale="log", xlabel="step", ylabel="variance, of the first")
    ax.legend(loc="lower left")
    return ax


def left(found: Sequence[Cloud]) -> Figure | None:
    """Draw the share of the angle's variance that few particles keep, learner by learner: mean and median of draws."""
    if not found:
        return None
    figure, axes = plt.subplots(1, len(found), figsize=(WIDTH, 3), sharey=True, squeeze=False)
    for ax, cloud in zip(axes[0], found, strict=True):
        for noise, (words, colour) in NOISE_STYLES.items():
            for shares, style, kind in ((cloud.left, "-", "mean"), (cloud.typical, "--", "median")):
                curve = np.exp(np.log(shares[noise]).mean((0, 1)))
                ax.plot(np.arange(1, len(curve) + 1), curve, style, color=colour, label=f"{words}, {kind}")
        steps = np.arange(1, len(curve) + 1)
        ax.plot(steps, (1 - 1 / cloud.particles) ** steps, ":", color=DARK, label="a walk that does nothing")
        ax.set(xlabel="step", title=f"{cloud.name}, K = {cloud.particles}", yscale="log")
    axes[0, 0].set_ylabel("share of the variance")
    figure.legend(handles=axes[0, 0].get_legend_handles_labels()[0], loc="outside upper center", ncols=3)
    return figure


def estimates(found: Estimates | None) -> Figure | None:
    """Draw the variance of three estimates of the gradient against the length of the predicted trial."""
    if found is None:
        return None
    figure, ax = plt.subplots(figsize=(WIDTH, 3.4))
    for name in ESTIMATES:
        label, colour = name.replace("-", " "), ESTIMATE_STYLES[name]
        band(ax, np.array(found.horizons), found.log(name), colour=colour, label=label, marker="o", markersize=4)
    ax.set(xlabel="length of the predicted trial [steps]", ylabel="log10 of the gradient's variance")
    ax.set_xticks(found.horizons)
    ax.legend()
    return figure
