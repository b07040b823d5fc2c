"""Pictures of Deep Sea: the cells that agents have reached, and how many seas are still unsolved."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from dropout_uncertainty.exploration.report.deep_sea.analysis import LABELS, Dives
from dropout_uncertainty.page.plotting import COLOURS

__all__ = ["reached", "survival"]

#: Colours of agents that section 5.3 has not met before.
OURS = {
    "dropout-per-move": COLOURS["thompson"],
    "dropout-per-episode": "#D55E00",
    "ensemble": "#56B4E9",
    "ensemble-priors": "#222222",
}


def reached(axes: np.ndarray, dives: Sequence[Dives], episodes: Sequence[int]) -> None:
    """Draw the share of seas in which each cell has been entered, agents in rows, episodes in columns."""
    for row, mine in zip(axes, dives, strict=True):
        for ax, episode in zip(row, episodes, strict=True):
            above = np.triu(np.ones((mine.size, mine.size), dtype=bool), 1)
            ax.imshow(np.ma.array(mine.reached(episode), mask=above), cmap="Blues", vmin=0, vmax=1)
            ax.set(xticks=[], yticks=[])
            ax.grid(visible=False)
            for spine in ax.spines.values():
                spine.set_visible(False)
        row[0].set_ylabel(LABELS[mine.agent].replace(", ", ",\n"), rotation=0, ha="right", va="center")
    for ax, episode in zip(axes[0], episodes, strict=True):
        ax.set_title(f"episode {episode:,}")


def survival(ax: Axes, dives: Sequence[Dives]) -> Axes:
    """Draw the share of seas not yet solved against episodes; a tick marks where unsolved runs ended."""
    for mine in dives:
        curve = mine.curve()
        colour = OURS.get(mine.agent, COLOURS.get(mine.agent, "#888888"))
        x = np.concatenate(([1.0], curve.quantiles, [mine.last.max()]))
        y = np.concatenate(([1.0], curve.probabilities, curve.probabilities[-1:]))
        ax.step(x, y, where="post", color=colour, label=mine.label)
        ended = np.unique(mine.last[np.isinf(mine.solved)])
        ax.plot(ended, curve.evaluate(ended), "|", color=colour, markersize=9)
    ax.set(xscale="log", xlabel="episodes", ylabel="share of seas not yet solved", ylim=(-0.02, 1.02))
    ax.legend(loc="lower left")
    return ax
