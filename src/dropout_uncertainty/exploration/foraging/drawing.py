"""Pictures of the 2D world (Figure 5.3): one state of it on the axes of a figure.

Colours are those of the thesis, red for what rewards and green for what punishes. As many readers see no difference
between the two, food is a filled disc and poison a ring, and eyes that sense poison are dashed.

Only methods of the axes are called, so this module needs no plotting library by itself.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from dropout_uncertainty import rng
from dropout_uncertainty.exploration.foraging import world as w
from dropout_uncertainty.exploration.foraging.world import Outcome, World

if TYPE_CHECKING:
    import matplotlib.axes

__all__ = ["KIND_COLOURS", "NORTH_WEST", "Scene", "Tick", "draw_world", "figure_5_3_scene", "rollout"]

#: Colour of what an eye senses; items have the same.
KIND_COLOURS: dict[int, str] = {w.NOTHING: "#9a9a9a", w.WALL: "#444444", w.FOOD: "#d3302f", w.POISON: "#1f9d55"}
#: Angle [rad] of an agent that faces the upper left corner.
NORTH_WEST = 1.25 * np.pi
#: The lower left part of the maze lies left of the first and below the second of these.
LOWER_LEFT = 250.0, 300.0
#: Vertices of a circle.
CIRCLE = np.linspace(0.0, 2 * np.pi, 49)


@dataclass(frozen=True)
class Scene:
    """One state of the world of one replica: A agents, M item slots. Pixels, y pointing down; angles in radians."""

    x: Float[np.ndarray, " A"]
    y: Float[np.ndarray, " A"]
    angle: Float[np.ndarray, " A"]  #: An agent at angle θ faces (sin θ, cos θ).
    eye_angle: Float[np.ndarray, "A 9"]
    #: Distance at which each eye senses something, 85 for nothing; may exceed the true one, see ``Rules``.
    sensed: Float[np.ndarray, "A 9"]
    sensed_kind: Int[np.ndarray, "A 9"]  #: NOTHING, WALL, FOOD or POISON.
    item_x: Float[np.ndarray, " M"]
    item_y: Float[np.ndarray, " M"]
    item_kind: Int[np.ndarray, " M"]  #: FOOD, POISON, or NOTHING where a slot is empty.

    @classmethod
    def of(cls, world: World, replica: int = 0) -> "Scene":
        """Return the present state of one replica of a world.

        Raises:
            ValueError: if there is no such replica.
        """
        if not 0 <= replica < world.replicas:
            raise ValueError(f"the world has replicas 0 to {world.replicas - 1}, got {replica}")
        readings = world.sense()
        x, y, angle, item_x, item_y, item_kind = (
            values[replica].copy()
            for values in (world.x, world.y, world.angle, world.item_x, world.item_y, world.item_kind)
        )
        eyes = angle[:, None] + world.eye_angles
        return cls(x, y, angle, eyes, readings.distance[replica], readings.kind[replica], item_x, item_y, item_kind)

    def eye_ends(self) -> tuple[Float[np.ndarray, "A 9"], Float[np.ndarray, "A 9"]]:
        """Return where the lines of sight end, x and y: at what they sense, or at the end of their range."""
        reach = np.minimum(self.sensed, w.EYE_RANGE)
        return self.x[:, None] + reach * np.sin(self.eye_angle), self.y[:, None] + reach * np.cos(self.eye_angle)


def draw_world(
    ax: "matplotlib.axes.Axes", world: World | Scene, replica: int = 0, colours: Sequence[str] = ("#0072B2", "#882255")
) -> "matplotlib.axes.Axes":
    """Draw walls, items, agents in ``colours`` (in turn), and their eyes in the colour of what they sense.

    ``world`` is a world, of which one replica is drawn, or a scene taken from one before.
    """
    scene = world if isinstance(world, Scene) else Scene.of(world, replica)
    for x1, y1, x2, y2 in w.WALLS:
        ax.plot([x1, x2], [y1, y2], color=KIND_COLOURS[w.WALL], linewidth=2.5, solid_capstyle="round", zorder=2)
    for x, y, kind in zip(scene.item_x, scene.item_y, scene.item_kind, strict=True):
        if kind != w.NOTHING:
            _disc(ax, x, y, KIND_COLOURS[kind], hollow=bool(kind == w.POISON))
    ends = scene.eye_ends()
    for agent, (x, y, angle) in enumerate(zip(scene.x, scene.y, scene.angle, strict=True)):
        for end_x, end_y, kind in zip(ends[0][agent], ends[1][agent], scene.sensed_kind[agent], strict=True):
            ax.plot(
                [x, end_x], [y, end_y], "--" if kind == w.POISON else "-", color=KIND_COLOURS[kind],
                linewidth=0.8 if kind == w.NOTHING else 1.6, zorder=4,
            )  # fmt: skip
        _body(ax, x, y, angle, colours[agent % len(colours)])
    ax.set(xlim=(0, w.WIDTH), ylim=(w.HEIGHT, 0), aspect="equal")
    ax.set_axis_off()
    return ax


def _disc(ax: "matplotlib.axes.Axes", x: float, y: float, colour: str, hollow: bool) -> None:
    radius = w.ITEM_RADIUS - (2.0 if hollow else 0.0)  # the outline reaches outwards
    outline = x + radius * np.cos(CIRCLE), y + radius * np.sin(CIRCLE)
    ax.fill(*outline, facecolor="white" if hollow else colour, edgecolor=colour, linewidth=3 if hollow else 0, zorder=3)


def _body(ax: "matplotlib.axes.Axes", x: float, y: float, angle: float, colour: str) -> None:
    """Draw an agent as a disc with a pointed front, so that its heading can be seen."""
    around = angle + np.linspace(0.7, 2 * np.pi - 0.7, 40)
    reach = np.append(np.full(len(around), w.AGENT_RADIUS), 1.7 * w.AGENT_RADIUS)
    around = np.append(around, angle)
    ax.fill(x + reach * np.sin(around), y + reach * np.cos(around), facecolor=colour, edgecolor="white", zorder=5)


# ------------------------------------------------------------------ states that the world really reaches


class Tick(NamedTuple):
    """What happened in a tick: the world after it, what the step did, and the rewards [R, A]."""

    world: World
    outcome: Outcome
    reward: NDArray


def rollout(
    seeds: Sequence[int], choose: Callable[[NDArray, int], NDArray], rules: w.Rules | None = None
) -> Iterator[Tick]:
    """Run worlds with one agent each, as in the experiments but without learning, tick after tick without end.

    ``choose`` gets what the agents see [R, 27] and the tick (1, 2, ...) and returns actions [R]. A seed places and
    renews the items as it does in the experiments.
    """
    world = World(w.start_numbers(seeds), rules=rules)
    while True:
        tick = world.clock + 1
        if (tick - 1) % w.CHUNK == 0:
            ageing, spawning = w.coming_numbers(seeds, tick // w.CHUNK, w.CHUNK)
        readings = world.sense()
        actions = choose(world.inputs(readings)[:, 0], tick)[:, None]
        outcome = world.step(actions, ageing, spawning[:, (tick - 1) % w.CHUNK // w.SPAWN_PERIOD])
        yield Tick(world, outcome, world.reward(readings, actions, outcome))


def figure_5_3_scene(first_seed: int = 100, seeds: int = 20, ticks: int = 3000) -> Scene:
    """Return the first state that looks like Figure 5.3: the agent in the lower left, facing north-west, and seeing.

    Agents take random actions in ``seeds`` worlds, until one of them stands there with eyes on a wall, on food and on
    poison at once.

    Raises:
        ValueError: if that does not happen within ``ticks``.
    """
    names = range(first_seed, first_seed + seeds)
    uniform = rng.uniform(names, (ticks,), "policy").numpy()
    moves = rollout(names, lambda _inputs, tick: (uniform[:, tick - 1] * len(w.ACTIONS)).astype(np.int64))
    for _, (world, _outcome, _reward) in zip(range(ticks), moves, strict=False):
        there = (world.x < LOWER_LEFT[0]) & (world.y > LOWER_LEFT[1]) & (np.abs(world.angle - NORTH_WEST) < 0.2)
        for replica in there[:, 0].nonzero()[0]:
            scene = Scene.of(world, int(replica))
            if {w.WALL, w.FOOD, w.POISON} <= set(scene.sensed_kind[0].tolist()):
                return scene
    raise ValueError(f"no state like Figure 5.3 within {ticks} ticks of {seeds} worlds: allow more of either")
