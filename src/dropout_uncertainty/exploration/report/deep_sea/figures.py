"""Pictures of Deep Sea: the cells that agents have reached, who finds and solves, when, and how that grows.

Every picture has room for all agents and says which of them have not been run.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from dropout_uncertainty.exploration.report.deep_sea.analysis import coin
from dropout_uncertainty.exploration.report.deep_sea.dives import HORIZON, LABELS, Dives, Seas
from dropout_uncertainty.page.plotting import COLOURS, SMALL, missing
from dropout_uncertainty.stats import share_interval

AGENT_COLOURS = {
    "epsilon-greedy": COLOURS["epsilon-greedy"],
    "greedy": COLOURS["greedy"],
    "boltzmann": COLOURS["boltzmann"],
    "dropout-per-move": COLOURS["thompson"],
    "dropout-per-episode": "#D55E00",
    "annealed-thompson": COLOURS["annealed-thompson"],
    "ensemble": "#56B4E9",
    "ensemble-priors": "#CC79A7",
}


def reached(axes: np.ndarray, dives: Seas, size: int, episodes: Sequence[int]) -> None:
    """Draw the share of seas in which each cell has been entered: agents in rows, episodes in columns."""
    for row, (agent, label) in zip(axes, LABELS.items(), strict=True):
        mine = dives.get((agent, size))
        for ax, episode in zip(row, episodes, strict=True):
            ax.set(xticks=[], yticks=[], xlim=(-0.5, size - 0.5), ylim=(size - 0.5, -0.5), aspect="equal")
            ax.grid(visible=False)
            ax.spines[:].set_visible(False)
            if mine:
                above = np.triu(np.ones((size, size), dtype=bool), 1)
                ax.imshow(np.ma.array(mine.reached(episode), mask=above), cmap="Blues", vmin=0, vmax=1)
            ax.plot(*_shore(size), color="#888888", linewidth=0.5, clip_on=False)
        if not mine:
            row[0].text(0.35, 0.3, "not run yet", transform=row[0].transAxes, fontsize=SMALL)
        row[0].set_ylabel(in_lines(label), rotation=0, ha="right", va="center")
    for ax, episode in zip(axes[0], episodes, strict=True):
        ax.set_title(f"{episode:,} episodes", fontsize=SMALL)


def in_lines(label: str) -> str:
    """Return the name of an agent in two lines where it is long."""
    return label.replace(", ", ",\n").replace(" with", "\nwith")


def _shore(size: int) -> np.ndarray:
    """Return the outline [x or y, points] of the cells that can be reached."""
    step = np.arange(size + 1) - 0.5
    stairs = np.stack((np.repeat(step, 2)[1:], np.repeat(step, 2)[:-1]))
    return np.concatenate((stairs, [[-0.5, -0.5], [size - 0.5, -0.5]]), axis=1)


def shares(ax: Axes, dives: Seas, size: int, episodes: int = HORIZON) -> Axes:
    """Draw the shares of seas whose treasure was found (open) and that were solved (full), with Wilson's intervals.

    The dotted line is the share in which tossing a coin at every move finds it.
    """
    for place, agent in enumerate(LABELS):
        mine = dives.get((agent, size))
        if mine is None:
            ax.text(0.01, place, "not run yet", va="center", fontsize=SMALL)
            continue
        for shift, face, values in ((-0.15, "white", mine.found <= episodes), (0.15, None, mine.within(episodes))):
            value, low, high, _ = share_interval(values)
            colour = AGENT_COLOURS[agent]
            ax.plot([low, high], [place + shift] * 2, color=colour)
            ax.plot(value, place + shift, "o", color=colour, markerfacecolor=face or colour)
    ax.plot([], [], "o", color="#444444", markerfacecolor="white", label="treasure found")
    ax.plot([], [], "o", color="#444444", label="sea solved")
    ax.axvline(coin(size, episodes), color="#444444", linestyle=":", linewidth=1, label="a coin finds the treasure")
    ax.set_yticks(range(len(LABELS)), LABELS.values())
    ax.invert_yaxis()
    ax.set(xlim=(-0.02, 1.02), xlabel=f"share of seas of size {size}, within {episodes:,} episodes")
    ax.figure.legend(loc="outside upper center", ncols=3)
    return ax


def survival(ax: Axes, dives: Seas, size: int) -> Axes:
    """Draw the share of seas not yet solved against episodes; a tick marks where unsolved runs ended."""
    shown = [dives[agent, size] for agent in LABELS if (agent, size) in dives]
    for mine in shown:
        curve, colour = mine.curve(), AGENT_COLOURS[mine.agent]
        x = np.concatenate(([1.0], curve.quantiles, [mine.last.max()]))
        y = np.concatenate(([1.0], curve.probabilities, curve.probabilities[-1:]))
        ax.step(x, y, where="post", color=colour, label=mine.label)
        ended = np.unique(mine.last[np.isinf(mine.solved)])
        ax.plot(ended, curve.evaluate(ended), "|", color=colour, markersize=9)
    ax.set(xlabel="episodes", ylabel="share of seas not yet solved", ylim=(-0.02, 1.02))
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:,g}")
    if shown:
        ax.legend(loc="lower left")
    missing(ax, [label for agent, label in LABELS.items() if (agent, size) not in dives])
    return ax


def growth(ax: Axes, dives: Seas) -> Axes:
    """Draw the median of episodes to solve against the size of the sea, with its interval, and 2^N behind.

    Where fewer than half of the seas were solved, an arrow starts at the length of the run.
    """
    sizes = sorted({size for _, size in dives})
    for number, agent in enumerate(LABELS):
        mine = [dives[agent, size] for size in sizes if (agent, size) in dives]
        if mine:
            _medians(ax, mine, 0.08 * (number - len(LABELS) / 2))
    if sizes:
        ax.plot(sizes, 2.0 ** np.array(sizes), color="#888888", linestyle=":", label="$2^N$")
        ax.set(xlim=(sizes[0] - 1, sizes[-1] + 1), xticks=sizes)
        ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
    ax.set(yscale="log", xlabel="size of the sea", ylabel="episodes to solve, median")
    ax.yaxis.set_major_formatter("{x:,g}")
    missing(ax, [label for agent, label in LABELS.items() if not any(name == agent for name, _ in dives)])
    return ax


def _medians(ax: Axes, mine: Sequence[Dives], shift: float) -> None:
    """Draw the medians of one agent, moved sideways, so that those of several can be told apart."""
    colour, found = AGENT_COLOURS[mine[0].agent], [d.median() for d in mine]
    x = np.array([d.size for d in mine]) + shift
    ends = np.array([d.last.max() for d in mine])
    value, low, high = np.array([interval[:3] for interval in found]).T
    known = np.isfinite(value)
    ax.plot(x, np.where(known, value, np.nan), "o-", color=colour, label=mine[0].label)
    ax.vlines(x[known], low[known], np.minimum(high, ends)[known], color=colour)
    ax.plot(x[~known], ends[~known], marker="$\\uparrow$", markersize=10, linestyle="none", color=colour)
