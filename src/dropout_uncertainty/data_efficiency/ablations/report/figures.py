"""Figures of what matters in Deep PILCO: numbers in, axes out."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter
from torch import Tensor

from dropout_uncertainty.data_efficiency.ablations.report.analysis import NOMINAL, Comparison, Inside, Times
from dropout_uncertainty.data_efficiency.ablations.scaling import AXES, METHODS
from dropout_uncertainty.data_efficiency.ablations.variants import VARIANTS
from dropout_uncertainty.data_efficiency.deep_pilco.particles import MATCHING
from dropout_uncertainty.data_efficiency.plant.drawing import DARK
from dropout_uncertainty.data_efficiency.report.analysis import Learning, angles
from dropout_uncertainty.page.plotting import COLOURS, SMALL, band, legend_above
from dropout_uncertainty.stats import Interval, t_interval

__all__ = [
    "clouds",
    "curves",
    "forest",
    "gradients",
    "objective",
    "optimisers",
    "parting",
    "scaling",
    "splitting",
    "whisker",
]

#: Statements in the forest plot, in the order of the table.
CLAIM_COLOURS = {"DE4": "#0072B2", "DE5": "#D55E00", "DE6": "#009E73", "DE7": "#882255", "DE10": "#6c6c6c"}
CLOUD_STYLES = {
    "held-free": ("masks held, no matching", "#0072B2", "-"),
    "held-matched": ("masks held, matching", "#56B4E9", "-"),
    "redrawn-free": ("masks redrawn, no matching", "#D55E00", "--"),
    "redrawn-matched": ("masks redrawn, matching", "#E69F00", "--"),
}
MATCHING_STYLES = {
    "full": ("all dimensions together", "#0072B2"),
    "diagonal": ("each alone (algorithm 4)", "#E69F00"),
    "off": ("no matching", "#D55E00"),
}
OPTIMISER_WORDS = {"fresh-adam": "fresh, Adam", "fixed-adam": "fixed, Adam", "fixed-bfgs": "fixed, BFGS"}
METHOD_STYLES = {
    "pilco": ("PILCO", COLOURS["pilco"]),
    "deep-pilco": ("Deep PILCO", COLOURS["deep-pilco"]),
    "deep-pilco-diagonal": ("Deep PILCO, moments of each dimension alone", COLOURS["deep-pilco-as-written"]),
}
AXIS_WORDS = {"transitions": "transitions N", "inputs": "inputs Q", "outputs": "outputs D"}


def forest(axes: Sequence[Axes], comparisons: Sequence[Comparison]) -> None:
    """Draw, variant by variant, by how much success and cost differ from ours, with 95 % intervals.

    The two axes share their vertical one. A number beside the name says how many repetitions were solved.
    """
    success, cost = axes
    names = []
    for row, comparison in enumerate(comparisons):
        variant = VARIANTS[comparison.name]
        colour = CLAIM_COLOURS[variant.claim]
        whisker(success, row, comparison.solved_difference, colour)
        whisker(cost, row, comparison.cost_difference, colour)
        share = comparison.solved
        names.append(f"{variant.words}  ({round(share.value * share.n)}/{share.n})")
    for ax in axes:
        ax.axvline(0, color=DARK, linewidth=0.9)
        ax.grid(axis="y", visible=False)
    claims = [VARIANTS[comparison.name].claim for comparison in comparisons]
    for row, (before, after) in enumerate(itertools.pairwise(claims)):
        if before != after:
            for ax in axes:
                ax.axhline(row + 0.5, color="#bbbbbb", linewidth=0.7)
    for claim in dict.fromkeys(claims):
        place = claims.index(claim), len(claims) - 1 - claims[::-1].index(claim)
        style: dict[str, Any] = {"color": CLAIM_COLOURS[claim], "va": "center", "fontsize": SMALL, "rotation": 270}
        cost.text(1.02, sum(place) / 2, claim, transform=cost.get_yaxis_transform(), **style)
    success.set_yticks(range(len(names)), names)
    success.set(ylim=(len(names) - 0.5, -0.5), xlabel="share solved,\nvariant - ours")
    cost.set(xlabel="mean cost per step,\nvariant - ours")


def splitting(
    axes: Sequence[Axes],
    psi: Float[Tensor, " N"],
    paths: Mapping[bool, Float[Tensor, "T K"]],
    found: Mapping[bool, tuple[Float[Tensor, " N"], Float[Tensor, " N"]]],
) -> None:
    """Draw the toy of a cloud that splits, for free and for matched particles.

    Paths of one draw of particles; then, against where they start, the objective and the spread of its gradient.
    """
    for matched, words, colour in ((False, "free", COLOURS["bald"]), (True, "matched", "#0072B2")):
        axes[0].plot(paths[matched], color=colour, lw=0.8, alpha=0.8)
        for ax, values in zip(axes[1:], found[matched], strict=True):
            ax.plot(psi, values, color=colour, label=words)
    axes[0].set(xlabel="time", ylabel="place", xticks=range(len(paths[False])))
    axes[1].set(xlabel=r"$\psi$", ylabel="expected cost", title="objective")
    axes[2].set(xlabel=r"$\psi$", ylabel="std over draws", title="gradient estimate")
    axes[1].legend()


def whisker(ax: Axes, row: float | int, interval: Interval, colour: str, label: str | None = None) -> None:
    """Draw an interval on a row of a forest plot."""
    ax.plot([interval.low, interval.high], [row, row], color=colour, linewidth=1.6)
    ax.plot(interval.value, row, "o", color=colour, markersize=5, label=label)


def parting(axes: Sequence[Axes], seen: Inside) -> None:
    """Draw how often particles have parted over the predicted trial, and what a Gaussian adds to the cost then."""
    over_time, price = axes
    t = seen.plant.dt * np.arange(1, seen.plant.steps + 1)
    for cloud in ("held-free", "held-matched"):
        words, colour, dash = CLOUD_STYLES[cloud]
        band(over_time, t, seen.parted(cloud).mean(1), colour=colour, label=words, linestyle=dash)
    over_time.set(xlabel="time [s]", ylabel="share of clouds that parted", ylim=(0, None))
    over_time.legend()
    depth = seen.arrays["cloud_valley"][:, :, 1].ravel()
    penalty = seen.arrays["penalty"].ravel()
    price.plot(depth, penalty, ".", color=DARK, markersize=3, alpha=0.25)
    edges = np.linspace(0, 1, 6)
    for low, high in itertools.pairwise(edges):
        inside = penalty[(depth >= low) & ((depth < high) | (high == 1))]
        if len(inside) > 1:
            price.plot([low, high], [inside.mean()] * 2, color=COLOURS["bald"], linewidth=2.5)
    price.axhline(0, color=DARK, linewidth=0.8)
    price.set(xlabel="depth of the valley between groups", ylabel="cost with a Gaussian - without")


def gradients(axes: Sequence[Axes], seen: Inside) -> None:
    """Draw variance of the policy gradient, and its noise beside the mean, against the length of the trial."""
    horizon = seen.plant.dt * np.array(seen.horizons)
    for matching in MATCHING:
        words, colour = MATCHING_STYLES[matching]
        for ax, values in zip(axes, (seen.gradient_variance, seen.gradient_noise), strict=True):
            curves = np.log10(values(matching)).mean(1)
            band(ax, horizon, curves, colour=colour, label=words, marker="o", markersize=4)
    axes[0].set(xlabel="length of the predicted trial [s]", ylabel="log10 of the gradient's variance")
    axes[1].set(xlabel="length of the predicted trial [s]", ylabel="log10 of its std by its mean's norm")
    axes[0].legend(title="moments matched")


def objective(ax: Axes, seen: Inside) -> Axes:
    """Draw the bias of the objective at few particles, against that at the largest number, with 95 % intervals."""
    shifts = np.linspace(0.96, 1.04, len(MATCHING))
    for matching, shift in zip(MATCHING, shifts, strict=True):
        words, colour = MATCHING_STYLES[matching]
        found = [t_interval(column) for column in seen.bias(matching).T[:-1]]
        x = shift * np.array(seen.counts[:-1])
        ax.plot(x, [i.value for i in found], "o-", color=colour, label=words, markersize=5)
        ax.vlines(x, [i.low for i in found], [i.high for i in found], color=colour)
    ax.axhline(0, color=DARK, linewidth=0.8)
    ax.set(xscale="log", xlabel="particles K", ylabel=f"objective - that with K = {seen.counts[-1]}")
    ax.set_xticks(seen.counts[:-1], [str(count) for count in seen.counts[:-1]])
    ax.xaxis.set_minor_formatter(NullFormatter())
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.5 * (high - low))  # room for the legend
    ax.legend(title="moments matched", loc="upper right")
    return ax


def optimisers(ax: Axes, seen: Inside) -> Axes:
    """Draw what each search said it had reached, and what its policies cost on particles it has not seen."""
    for row, (optimiser, words) in enumerate(OPTIMISER_WORDS.items()):
        said, fresh = (t_interval(seen.objective(optimiser, fresh=f).mean(1)) for f in (False, True))
        ax.annotate("", (fresh.value, row), (said.value, row), arrowprops={"arrowstyle": "->", "color": "#999999"})
        for interval, colour, marker in ((said, COLOURS["bald"], "s"), (fresh, COLOURS["deep-pilco"], "o")):
            label = {"s": "by its own account", "o": "on fresh particles"}[marker] if row == 0 else None
            ax.plot(interval.value, row, marker, color=colour, markersize=7, label=label)
        ax.text(fresh.value, row - 0.18, words, fontsize=SMALL, ha="center")
    ax.set(ylim=(len(OPTIMISER_WORDS) - 0.2, -0.6), yticks=[], xlabel="objective (mean cost per step)")
    ax.margins(x=0.25)
    ax.legend(loc="lower right")
    return ax


def clouds(axes: Sequence[Axes], seen: Inside, pilco: Learning | None = None) -> None:
    """Draw predicted standard deviation of the angle, and coverage of the true trials, over the predicted trial.

    Means over measured trials (of the logarithm for the first), with 95 % intervals over repetitions; PILCO beside
    them, at the same trials.
    """
    width, hits = axes
    t = seen.plant.dt * np.arange(1, seen.plant.steps + 1)
    for cloud, (words, colour, dash) in CLOUD_STYLES.items():
        spread = np.log10(seen.std(cloud)[..., 3]).mean(1)
        band(width, t, spread, colour=colour, label=words, linestyle=dash)
        band(hits, t, seen.covered(cloud).mean((1, 3)), colour=colour, label=words, linestyle=dash)
    if pilco is not None:
        trials = [trial for trial in seen.measured if trial <= pilco.trials]
        spread, style = np.log10(angles(pilco.predicted_std, trials)).mean(1), {"label": "PILCO", "linestyle": ":"}
        band(width, t, spread, colour=COLOURS["pilco"], **style)
        band(hits, t, pilco.covered[:, trials].mean((1, 3)), colour=COLOURS["pilco"], **style)
    hits.axhline(NOMINAL, color=DARK, linewidth=0.8, linestyle=":")
    width.set(xlabel="time [s]", ylabel="log10 of predicted std of the angle [rad]")
    hits.set(xlabel="time [s]", ylabel="true states within two std", ylim=(0, 1.02))
    hits.legend(loc="lower left")


def curves(axes: Sequence[Axes], groups: Mapping[str, Sequence[Comparison]]) -> None:
    """Draw mean cost per trial of the variants of each hyper-parameter, and ours, one panel each."""
    for ax, (title, comparisons) in zip(axes, groups.items(), strict=True):
        for comparison, colour in zip(comparisons, ("#E69F00", "#009E73"), strict=False):
            learning = comparison.first
            words = VARIANTS[comparison.name].words.split(": ")[-1].removeprefix("… ").split(" of ")[0]
            trials = np.arange(1, learning.trials + 1)
            band(ax, trials, learning.trial_costs[:, 1:], colour=colour, label=words)
        if comparisons:
            ours = comparisons[0].second
            ax.plot(np.arange(1, ours.trials + 1), ours.trial_costs[:, 1:].mean(0), color=DARK, label="ours")
            ax.legend()
        ax.set_title(title)
        ax.set(xlabel="trial", ylim=(0, 1.05))
    axes[0].set_ylabel("mean cost per step")


def scaling(axes: Sequence[Axes], taken: Times) -> None:
    """Draw CPU seconds per trial against N, Q and D on log-log axes; numbers are the slopes between two sizes."""
    for ax, axis in zip(axes, AXES, strict=True):
        for method in METHODS:
            words, colour = METHOD_STYLES[method]
            sizes, seconds = taken.sizes(method, axis), taken.seconds(method, axis)
            mean = np.exp(np.log(seconds).mean(0))
            ax.plot(sizes, mean, "o-", color=colour, label=words, markersize=4)
            if method == "deep-pilco-diagonal":
                continue
            slopes = taken.local_exponents(method, axis).mean(0)
            for i, slope in enumerate(slopes):
                middle = np.sqrt(sizes[i] * sizes[i + 1]), 1.12 * np.sqrt(mean[i] * mean[i + 1])
                side = "right" if slope > 0.45 else "center"  # beside a steep line, above a flat one
                ax.text(*middle, f"{round(slope, 1) + 0.0:.1f}", color=colour, fontsize=SMALL, ha=side, va="bottom")
        ax.set(xscale="log", yscale="log", xlabel=AXIS_WORDS[axis])
        ax.margins(x=0.15)  # room for the first number
    axes[0].set_ylabel("CPU seconds per trial")
    legend_above(axes[0])
