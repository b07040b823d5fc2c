"""Figure 5.4 and what stands beside it: curves of agents in, axes out. Figure 5.3 is in ``foraging.drawing``."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from dropout_uncertainty.exploration.report import two_by_two
from dropout_uncertainty.exploration.report.analysis import (
    BLOCK,
    BURN_IN,
    TARGET,
    Agents,
    Curves,
    batches,
    mean_crossing,
    smoothed,
)
from dropout_uncertainty.judging.results import thesis_value
from dropout_uncertainty.page.plotting import COLOURS, SMALL, band, missing
from dropout_uncertainty.stats import t_interval

__all__ = [
    "contrasts", "curves_of_cells", "figure_5_4", "habits", "held_draws", "held_out_errors", "interaction",
    "learning_curves", "masks_off",
]  # fmt: skip


def learning_curves(ax: Axes, agents: Mapping[str, Curves], *, original: Mapping[str, Curves] | None = None) -> Axes:
    """Draw average reward against batches of 500 ticks from the end of the burn-in; a second axis counts ticks.

    Curves are averaged over ranges of equal length on this axis. With ``original``, the mean of the runs of the
    original program stands behind as a thin line, as far as all of them go.
    """
    for curves in (original or {}).values():
        x, values = smoothed(curves)
        ax.plot(x, values.mean(0), color=COLOURS[curves.agent], linewidth=0.7, zorder=1)
    for curves in agents.values():
        band(ax, *smoothed(curves), colour=COLOURS[curves.agent], label=curves.label)
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
    """Draw Figure 5.4: both agents, and when each reaches 1: by the thesis (dotted), and our mean curve (a dot)."""
    learning_curves(ax, agents, original=original)
    for agent, curves in agents.items():
        ours, printed = mean_crossing(curves), thesis_value(f"figure-5.4/{agent}/first-crossing")
        for words, value, line in (("thesis", printed, ":"), ("ours", ours, "-")):
            if value is not None and value <= ax.get_xlim()[1]:
                ax.plot([value, value], [0, TARGET], line, color=COLOURS[agent], linewidth=1.2)
                ax.annotate(
                    f"{words}: {value:g}", (value, 0.02), xycoords=("data", "axes fraction"), rotation=90,
                    xytext=(3, 0), textcoords="offset points", color=COLOURS[agent], fontsize=SMALL,
                )  # fmt: skip
        ax.plot(ours, TARGET, "o", color=COLOURS[agent])
    ax.set_ylim(bottom=0.2)  # room for the words
    ax.legend(loc="lower left")
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
            ranges = itertools.pairwise(edges.astype(int).tolist())
            counts = np.stack([1000 * curves.share(name, *ticks) for ticks in ranges], axis=1)
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


#: Colours of the agents ``two-by-two/...``: blue acts on draws, grey on the mean; orange learns without dropout.
CELL_COLOURS = {
    "dropout-draw": COLOURS["thompson"], "dropout-mean": "#882255", "plain-draw": "#E69F00",
    "plain-mean": COLOURS["greedy"], "masks-off-late": "#D55E00", "epsilon-greedy": COLOURS["epsilon-greedy"],
    "epsilon-greedy-short": "#44AA99",
}  # fmt: skip


def interaction(ax: Axes, cells: Mapping[str, Curves]) -> Axes:
    """Draw the mean reward of the four agents: acting on x, one line per way to learn, seeds as dots beside."""
    for learns, colour, shift in (("dropout", COLOURS["thompson"], -0.04), ("plain", "#E69F00", 0.04)):
        place, means = [], []
        for x, acts in enumerate(("mean", "draw")):
            if f"{learns}-{acts}" in cells:
                place.append(x + shift)
                means.append(cells[f"{learns}-{acts}"].mean(*two_by_two.EARLY, "reward"))
                ax.plot(np.full(len(means[-1]), place[-1] + shift), means[-1], ".", color=colour, alpha=0.35)
        found = np.array([t_interval(values)[:3] for values in means]).reshape(-1, 3)
        errors = np.abs(found[:, 1:] - found[:, :1]).T
        label = "learns with dropout" if learns == "dropout" else "learns without dropout"
        ax.errorbar(place, found[:, 0], errors, color=colour, marker="o", capsize=4, label=label)
    ax.set(xlim=(-0.4, 1.4), ylabel="reward per move")
    ax.set_xticks((0, 1), ("acts on the mean", "acts on a draw"))
    ax.legend(loc="upper right")
    missing(ax, [two_by_two.LABELS[name] for name in two_by_two.SQUARE if name not in cells])
    return ax


def contrasts(ax: Axes, cells: Mapping[str, Curves]) -> Axes:
    """Draw the differences between agents with 95 % intervals and single seeds; the grey strip is the margin."""
    ax.axvspan(-two_by_two.MARGIN, two_by_two.MARGIN, color="#eeeeee")
    ax.axvline(0, color="black", linewidth=0.8)
    for height, contrast in enumerate(two_by_two.CONTRASTS.values()):
        found = two_by_two.interval(cells, contrast)
        if found is None:
            words, across = two_by_two.missing(cells, contrast), ax.get_yaxis_transform()
            ax.text(0.98, height, words, ha="right", va="center", transform=across, fontsize=SMALL, color="#6c6c6c")
            continue
        seeds = two_by_two.differences(cells, contrast)
        ax.plot(seeds, np.full(len(seeds), height), "|", color=COLOURS["thompson"], alpha=0.35)
        ax.plot([found.low, found.high], [height, height], color=COLOURS["thompson"])
        ax.plot(found.value, height, "o", color=COLOURS["thompson"])
    ax.set_yticks(range(len(two_by_two.CONTRASTS)), [contrast.text for contrast in two_by_two.CONTRASTS.values()])
    ax.set(ylim=(len(two_by_two.CONTRASTS) - 0.5, -0.5), xlabel="difference in reward per move")
    return ax


def held_draws(ax: Axes, cells: Mapping[str, Curves]) -> Axes:
    """Draw the mean reward against the ticks for which a draw is held; grey: the agent that acts on the mean."""
    held = {ticks: cells[name] for ticks, name in two_by_two.HELD.items() if name in cells}
    if held:
        found = np.array([t_interval(curves.mean(*two_by_two.EARLY, "reward"))[:3] for curves in held.values()])
        errors = np.abs(found[:, 1:] - found[:, :1]).T
        ax.errorbar(list(held), found[:, 0], errors, color=COLOURS["thompson"], marker="o", capsize=4,
                    label="acts on a draw")  # fmt: skip
    if "dropout-mean" in cells:
        value, low, high, _ = t_interval(cells["dropout-mean"].mean(*two_by_two.EARLY, "reward"))
        ax.axhline(value, color=COLOURS["greedy"], label="acts on the mean")
        ax.axhspan(low, high, color=COLOURS["greedy"], alpha=0.18, linewidth=0)
    ax.set(xscale="log", xlabel="ticks for which a draw is held", ylabel="reward per move")
    ax.xaxis.set_major_formatter("{x:,g}")
    ax.set_xlim(0.7, 1400)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower left")
    absent = [name for name in (*two_by_two.HELD.values(), "dropout-mean") if name not in cells]
    missing(ax, [two_by_two.LABELS[name] for name in absent])
    return ax


def curves_of_cells(ax: Axes, cells: Mapping[str, Curves], names: Sequence[str], *, points: int = 40) -> Axes:
    """Draw the reward of some agents against ticks, averaged over ``points`` ranges of equal length."""
    for name in names:
        if name in cells:
            edges = np.unique(np.linspace(BURN_IN, cells[name].ticks[-1], points + 1) // BLOCK) * BLOCK
            ranges = list(itertools.pairwise(edges.astype(int).tolist()))
            rewards = np.stack([cells[name].mean(*ticks, "reward") for ticks in ranges], axis=1)
            band(ax, np.mean(ranges, axis=1), rewards, colour=CELL_COLOURS[name], label=two_by_two.LABELS[name])
    ax.set(xlabel="ticks", ylabel="reward per move")
    ax.xaxis.set_major_formatter("{x:,.0f}")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower right")
    missing(ax, [two_by_two.LABELS[name] for name in names if name not in cells])
    return ax


def masks_off(ax: Axes, cells: Mapping[str, Curves]) -> Axes:
    """Draw what becomes of the Thompson agent when its masks are switched off while it acts, beside ε-greedy."""
    curves_of_cells(ax, cells, ("dropout-draw", "masks-off-late", "epsilon-greedy"))
    switched = two_by_two.LATE[0]
    if any(curves.ticks[-1] > switched for curves in cells.values()):
        ax.axvline(switched, color="#888888", linewidth=0.8)
    return ax
