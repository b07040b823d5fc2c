"""The cells that agents have reached in Deep Sea, as an animation for a page (see ``page.svg_animation``)."""

from collections.abc import Sequence

import numpy as np

from dropout_uncertainty.exploration.report.deep_sea.dives import HORIZON, LABELS, Dives, Seas
from dropout_uncertainty.exploration.report.deep_sea.figures import AGENT_COLOURS, in_lines
from dropout_uncertainty.page.svg import Shape, circle, letters, polygon, text
from dropout_uncertainty.page.svg_animation import Player

__all__ = ["AGENTS", "animation"]

#: Who is shown: coins, draws of dropout, and draws of an ensemble.
AGENTS = ("epsilon-greedy", "dropout-per-move", "dropout-per-episode", "ensemble-priors")
#: Sides of a sea, room between two and above for a title [units of the drawing].
SEA, GAP, HEAD = 150, 24, 44
#: Moments, at equal steps of log(episode).
FRAMES = 60


def animation(dives: Seas, size: int, episodes: int = HORIZON, agents: Sequence[str] = AGENTS) -> Player:
    """Return an animation of the share of seas in which each cell has been entered, agents side by side.

    The sea of an agent that has not been run stays empty, and the text below says so.
    """
    shown = [(agent, dives.get((agent, size)), GAP / 2 + n * (SEA + GAP)) for n, agent in enumerate(agents)]
    box = GAP / 2 + len(agents) * (SEA + GAP), HEAD + SEA + 6
    times = np.unique(np.geomspace(1, episodes, FRAMES).round().astype(int)).tolist()
    never = np.zeros((size, size))
    frames = [
        [cell for agent, d, left in shown for cell in _cells(agent, d.reached(t) if d else never, left)] for t in times
    ]
    background = [shape for agent, _, left in shown for shape in _title(agent, size, left, letters(box[0]))]
    description = (
        f"Seas of size {size} side by side, of {'; '.join(LABELS[agent] for agent in agents)}: a triangle of cells "
        "that darken as they are reached, with the treasure as a yellow dot in the lower right corner"
    )
    labels = ["\n".join([f"Episodes: {t:,}", *(_tally(agent, d, t) for agent, d, _ in shown)]) for t in times]
    return Player(frames, box, description, labels, background=background, rate=8)


def _cells(agent: str, reached: np.ndarray, left: float) -> list[Shape]:
    """Return the cells of a sea; the share of runs that have entered one is its opacity."""
    side = SEA / len(reached)
    return [
        polygon(
            _corners(left + side * column, HEAD + side * row, side), fill=AGENT_COLOURS[agent],
            fill_opacity=round(float(reached[row, column]), 2), stroke="currentColor", stroke_width=0.4,
            stroke_opacity=0.5,
        )
        for row in range(len(reached))
        for column in range(row + 1)
    ]  # fmt: skip


def _corners(x: float, y: float, side: float) -> list[tuple[float, float]]:
    return [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]


def _title(agent: str, size: int, left: float, font_size: float) -> list[Shape]:
    """Return the agent's name in two lines, and the treasure."""
    lines = in_lines(LABELS[agent]).split("\n")
    words = [text(left, 16 + 16 * number, line, font_size=font_size) for number, line in enumerate(lines)]
    place = left + SEA + 0.45 * GAP, HEAD + SEA - SEA / size / 2
    return [*words, circle(*place, 4, fill="#e0b000", stroke="currentColor", stroke_width=0.6)]


def _tally(agent: str, d: Dives | None, episode: int) -> str:
    if d is None:
        return f"{LABELS[agent]}: not run yet"
    found, solved, n = int((d.found <= episode).sum()), int(d.within(episode).sum()), len(d.seeds)
    return f"{LABELS[agent]}: treasure found in {found} of {n} seas, {solved} solved"
