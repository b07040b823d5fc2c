"""Figure 5.4 and what stands beside it: curves of agents in, axes out. Figure 5.3 is in ``foraging.drawing``."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from dropout_uncertainty.exploration.report.analysis import BLOCK, BURN_IN, TARGET, Agents, Curves, batches
from dropout_uncertainty.judging.results import thesis_value
from dropout_uncertainty.page.plotting import COLOURS, SMALL, band

__all__ = ["figure_5_4", "habits", "held_out_errors", "learning_curves"]


def learning_curves(ax: Axes, agents: Mapping[str, Curves], *, original: Mapping[str, Curves] | None = None) -> Axes:
    """Draw average reward against batches of 500 ticks from the end of the burn-in; a second axis counts ticks.

    With ``original``, the runs of the original program stand behind as thin lines.
    """
    for curves in (original or {}).values():
        later = curves.ticks > BURN_IN
        x = batches(curves.ticks[later])
        ax.plot(x, curves.average[:, later].T, color=COLOURS[curves.agent], linewidth=0.5, alpha=0.4, zorder=1)
    for curves in agents.values():
        later = curves.ticks > BURN_IN
        x = batches(curves.ticks[later])
        band(ax, x, curves.average[:, later], colour=COLOURS[curves.agent], label=curves.label)
    ax.axhline(TARGET, color="#888888", linewidth=0.8)
    ax.set(xscale="log", xlabel=f"batches of {BLOCK} ticks from the end of the burn-in", ylabel="average reward")
    ax.xaxis.set_major_formatter("{x:g}")
    ticks = ax.secondary_xaxis("top", functions=(from_batches, batches))  # type: ignore[arg-type]
    ticks.set_xscale("log")
    shown = [t for t in (5e3, 1e4, 2e4, 5e4, 1e5, 2e5, 5e5, 1e6) if t <= BURN_IN + BLOCK * ax.get_xlim()[1]]
    ticks.set_xticks(shown, [f"{tick / 1e3:g}k" if tick < 1e6 else f"{tick / 1e6:g}M" for tick in shown])
    ticks.set_xticks([], minor=True)
    ticks.set_xlabel("ticks")
    ax.legend(loc="lower right")
    return ax


def from_batches(x: np.ndarray) -> np.ndarray:
    """Return the tick at which a number of batches from the end of the burn-in ends."""
    return BURN_IN + BLOCK * np.asarray(x)


def figure_5_4(ax: Axes, agents: Mapping[str, Curves], original: Mapping[str, Curves] | None = None) -> Axes:
    """Draw Figure 5.4: both agents, with the thesis's numbers of batches as vertical lines."""
    learning_curves(ax, agents, original=original)
    for agent in agents:
        value = thesis_value(f"figure-5.4/{agent}/first-crossing")
        if value is not None and value <= ax.get_xlim()[1]:
            ax.axvline(value, color=COLOURS[agent], linestyle=":", linewidth=1.2)
            ax.annotate(
                f"thesis: {value:g}", (value, 0.02), xycoords=("data", "axes fraction"), rotation=90,
                xytext=(3, 0), textcoords="offset points", color=COLOURS[agent], fontsize=SMALL,
            )  # fmt: skip
    return ax


#: What agents do, per 1000 ticks: heading and the array that counts it.
HABITS = {
    "moves stopped by a wall": "blocked",
    "food eaten": "food",
    "poison eaten": "poison",
    "moves that are not the best known": "explored",
}


def habits(axes: Sequence[Axes], agents: Agents, *, points: int = 25) -> None:
    """Draw how often agents do what ``HABITS`` lists, averaged over ``points`` ranges of equal length on a log axis."""
    for ax, (title, name) in zip(axes, HABITS.items(), strict=True):
        for curves in agents.values():
            edges = np.unique(np.geomspace(BURN_IN, curves.ticks[-1], points + 1) // BLOCK) * BLOCK
            counts = np.stack([1000 * curves.share(name, *ticks) for ticks in itertools.pairwise(edges)], axis=1)
            middle = np.sqrt(edges[:-1] * edges[1:])
            band(ax, middle, counts, colour=COLOURS[curves.agent], label=curves.label)
        place = ax.get_subplotspec()
        ax.set(xscale="log", title=title)
        if place and place.is_last_row():
            ax.set_xlabel("ticks")
        if place and place.is_first_col():
            ax.set_ylabel("per 1000 ticks")
        ax.set_ylim(bottom=0)
    axes[0].legend()


def held_out_errors(axes: Sequence[Axes], networks: Mapping[str, Curves]) -> None:
    """Draw the squared TD error on learned (left) and on held-out transitions (right) of networks by name."""
    names = (("transitions learned from", "learned_td_error"), ("transitions held out", "held_out_td_error"))
    for ax, (title, name) in zip(axes, names, strict=True):
        for style, (label, curves) in zip(("#6c6c6c", "#E69F00", "#0072B2", "#882255"), networks.items(), strict=False):
            values = curves.arrays[name].astype(float)
            x = curves.ticks[-1] / values.shape[1] * np.arange(1, values.shape[1] + 1)
            band(ax, x, values, colour=style, label=label)
        ax.set(xlabel="ticks", title=title)
    axes[0].set_ylabel("mean squared TD error")
    axes[0].legend()
