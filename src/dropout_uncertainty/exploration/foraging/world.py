"""The 2D foraging world of section 5.3 (Figure 5.3), R replicas at once, in double precision.

The rules are those of the demo behind the thesis (``rldemo_comparison.js`` in yaringal/DropoutUncertaintyDemos, itself
derived from Karpathy's ``rldemo.js``), quirks included; where the thesis text says something else, or the original has
what looks like a slip, there is a switch in ``Rules``. Lengths are in pixels of a 700 x 500 canvas with y pointing
down, angles in radians, and an agent at angle θ faces (sin θ, cos θ). One tick: ``sense``, choose actions, ``step``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from dropout_uncertainty import rng
from dropout_uncertainty.settings import of_type, tidy

__all__ = [
    "ACTIONS", "EYES", "FOOD", "INPUTS", "NOTHING", "POISON", "WALL", "WALLS", "Outcome", "Readings", "Rules", "World",
    "coming_numbers", "start_numbers",
]  # fmt: skip

WIDTH, HEIGHT = 700.0, 500.0
#: Wall segments (x1, y1, x2, y2): the outer box, then two cups that are open on their left side.
WALLS = np.array(
    [
        *[(10, 10, 690, 10), (690, 10, 690, 490), (690, 490, 10, 490), (10, 490, 10, 10)],
        *[(100, 100, 300, 100), (300, 100, 300, 400), (300, 400, 100, 400)],
        *[(400, 100, 600, 100), (600, 100, 600, 400), (600, 400, 400, 400)],
    ],
    dtype=np.float64,
)
WALL_SEGMENTS = np.array([WALLS[:, 0], WALLS[:, 1], WALLS[:, 2] - WALLS[:, 0], WALLS[:, 3] - WALLS[:, 1]])
#: Rotation of the two wheels [rad] per action: straight on, two gentle turns, two turns almost on the spot.
ACTIONS = np.array([(1.0, 1.0), (0.8, 1.0), (1.0, 0.8), (0.5, 0.0), (0.0, 0.5)])
WHEEL_BASE = 2.5  # scales wheel rotations to displacements
EYES, EYE_RANGE, EYE_SPACING = 9, 85.0, 0.25
ITEMS, ITEM_RADIUS, AGENT_RADIUS = 30, 10.0, 10.0
START = (50.0, 50.0, 0.0)  # x, y, angle of every agent

NOTHING, WALL, FOOD, POISON = -1, 0, 1, 2
#: Numbers an agent sees per tick: wall, food and poison channel of each eye.
INPUTS = 3 * EYES
#: Digestion signal by kind of item.
DIGESTION = {FOOD: 5.0, POISON: -6.0}
OLD_AGE, AGEING_PERIOD, AGEING_CHANCE = 5000, 100, 0.1
SPAWN_PERIOD, SPAWN_CHANCE, MARGIN = 10, 0.25, 20.0
#: Ticks for which random numbers are drawn ahead.
CHUNK = 100
FAR = 1e6  # where the empty item slots wait, out of everyone's sight


@dataclass(frozen=True)
class Rules:
    """Where the demo does something one would not guess; the defaults are the demo."""

    #: Angle of the first eye to the heading [rad]; the demo's fan is not symmetric, a symmetric one starts at -1.
    first_eye: float = -0.75
    #: An item on one side of an eye's ray is sensed at a point moved away from the ray by twice its distance to it.
    displaced_hits: bool = True
    #: Whether the reward for keeping walls at a distance saturates at half the range, as in Karpathy's original.
    doubled_proximity: bool = False

    def __post_init__(self) -> None:
        """Raise ValueError where a rule is of another type."""
        tidy(self)


class Readings(NamedTuple):
    """What the eyes sense: distance [px], 85 for nothing, and kind (NOTHING, WALL, FOOD, POISON); both [R, A, 9]."""

    distance: NDArray
    kind: NDArray


class Outcome(NamedTuple):
    """What a step did to each agent [R, A]: items eaten, and whether a wall undid the move; to items [R, 30]: fates."""

    food: NDArray
    poison: NDArray
    blocked: NDArray
    eater: NDArray  #: [R, 30] index of the agent that ate the item in each slot, -1 for none.
    withered: NDArray  #: [R, 30] whether the item of the slot was taken away for its age.
    spawned: NDArray  #: [R] slot of the new item, -1 for none.


def start_numbers(seeds: Sequence[int]) -> Float[np.ndarray, "R 30 3"]:
    """Return the uniform numbers that lay out the world of each seed."""
    return rng.uniform(seeds, (ITEMS, 3), "environment", "start").numpy()


def coming_numbers(seeds: Sequence[int], chunk: int, ticks: int) -> tuple[NDArray, NDArray]:
    """Return the uniform numbers of so many ticks: of ageing [R, 30], due at their end, and of new items [R, n, 4]."""
    spawns = ticks // SPAWN_PERIOD
    uniform = rng.uniform(seeds, (ITEMS + 4 * spawns,), "environment", chunk).numpy()
    return uniform[:, :ITEMS], uniform[:, ITEMS:].reshape(-1, spawns, 4)


class World:
    """R replicas of the world with A agents each; agents neither see nor touch one another but share the items.

    Args:
        layout: uniform numbers [R, 30, 3] in [0, 1) that place the first items: x, y, kind.
        agents: A; two as in the demo, or one per world.
        rules: see ``Rules``.

    Items live in 30 slots. The original keeps a list; order in it decides nothing but the order of its random numbers.

    Raises:
        ValueError: if ``agents`` < 1, or the layout has another shape or numbers outside [0, 1).
    """

    def __init__(self, layout: Float[np.ndarray, "R M 3"], agents: int = 1, rules: Rules | None = None) -> None:
        if not isinstance(agents, int | np.integer) or agents < 1:
            raise ValueError(f"a world needs a whole number of agents, at least one, got {agents!r}")
        layout = _uniform_numbers("the first items", layout, (-1, ITEMS, 3))
        if np.isnan(layout).any():
            raise ValueError("expected numbers in [0, 1) for the first items, got NaN")
        self.rules = Rules() if rules is None else of_type(Rules, rules, "rules")
        self.replicas, self.agents = len(layout), agents
        self.clock = 0
        shape = (self.replicas, agents)
        self.x, self.y, self.angle = (np.full(shape, value) for value in START)
        self.item_x, self.item_y, self.item_kind = _place(layout)
        self.item_born = np.zeros((self.replicas, ITEMS), dtype=np.int64)
        self.eye_angles = self.rules.first_eye + EYE_SPACING * np.arange(EYES)

    # ------------------------------------------------------------------ sensing

    def sense(self) -> Readings:
        """Return what every eye senses at the current poses: the nearest of walls and items along its ray."""
        heading = self.angle[..., None] + self.eye_angles
        sin, cos = np.sin(heading), np.cos(heading)  # [R, A, 9]
        walls = _wall_hits(self.x[..., None], self.y[..., None], EYE_RANGE * sin, EYE_RANGE * cos)
        right, down = self._items_from(self.x, self.y)  # [R, A, 30]
        across, items = self._item_hits(right[:, :, None], down[:, :, None], sin[..., None], cos[..., None])
        hits = np.concatenate((walls, items), axis=-1)  # fractions of the range [R, A, 9, 10 + 30]
        nearest = hits.argmin(-1)
        fraction = _pick(hits, nearest)
        item = np.maximum(nearest - len(WALLS), 0)
        slot = item + ITEMS * np.arange(self.replicas)[:, None, None]
        seen = item + ITEMS * np.arange(self.x.size).reshape(*self.x.shape, 1)
        along = sin * right.reshape(-1)[seen] + cos * down.reshape(-1)[seen]
        aside = _pick(across, item)
        offset = aside + self._shift(aside)
        is_item, nothing = nearest >= len(WALLS), fraction == np.inf
        distance = np.where(is_item, np.sqrt(along * along + offset * offset), EYE_RANGE * fraction)
        kind = np.where(is_item, self.item_kind.reshape(-1)[slot], WALL)
        return Readings(np.where(nothing, EYE_RANGE, distance), np.where(nothing, NOTHING, kind))

    def _items_from(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        return self.item_x[:, None] - x[..., None], self.item_y[:, None] - y[..., None]

    def _shift(self, across: NDArray) -> NDArray:
        """Return how far the original moves an item's centre, in the direction of ``across``, to reach the ray.

        The true foot of the perpendicular is at -across. The demo uses the distance without its sign.
        """
        return np.abs(across) if self.rules.displaced_hits else -across

    def _item_hits(self, right: NDArray, down: NDArray, sin: NDArray, cos: NDArray) -> tuple[NDArray, NDArray]:
        """Return the signed distances of item centres from the rays, and the fractions of the range at which rays hit.

        The fraction is read off the dominant axis of the ray; a miss is infinite.
        """
        across = right * cos - down * sin
        horizontal = np.abs(sin) > np.abs(cos)
        scale = 1.0 / (EYE_RANGE * np.where(horizontal, sin, cos))
        by_right, by_down = np.where(horizontal, scale, 0.0), np.where(horizontal, 0.0, scale)
        fraction = right * by_right + down * by_down + self._shift(across) * (cos * by_right - sin * by_down)
        hit = (np.abs(across) <= ITEM_RADIUS) & (fraction > 0) & (fraction < 1)
        return across, np.where(hit, fraction, np.inf)

    def inputs(self, readings: Readings) -> Float[np.ndarray, "R A 27"]:
        """Return the numbers the agents see: per eye three channels, 1 or, in the channel sensed, distance / 85."""
        sensed = readings.kind[..., None] == np.arange(3)
        values = np.where(sensed, readings.distance[..., None] / EYE_RANGE, 1.0)
        return values.reshape(*values.shape[:2], INPUTS)

    # ------------------------------------------------------------------ acting

    def step(
        self,
        actions: Int[np.ndarray, "R A"],
        ageing: Float[np.ndarray, "R M"] | None = None,
        spawning: Float[np.ndarray, "R 4"] | None = None,
    ) -> Outcome:
        """Move all agents, let them eat, and renew the items; one tick.

        ``ageing`` holds the uniform numbers that decide over old items, needed when the new clock is a multiple of 100;
        ``spawning`` those of a new item (whether, x, y, kind), needed at multiples of 10.

        Raises:
            ValueError: if actions are not whole numbers [R, A] from 0 to 4, or numbers that are due are missing or of
                another shape; the world is then as it was.
        """
        actions = self._checked(actions)
        clock = self.clock + 1
        if clock % AGEING_PERIOD == 0:
            ageing = _uniform_numbers(f"old items, due at clock {clock}", ageing, (self.replicas, ITEMS))
        if clock % SPAWN_PERIOD == 0:
            spawning = _uniform_numbers(f"a new item, due at clock {clock}", spawning, (self.replicas, 4))
        self.clock = clock
        blocked = self._move(actions)
        eater = self._eat()
        food, poison = self._count(eater)
        withered = self._wither(ageing)
        gone = (eater >= 0) | withered
        if gone.any():
            self.item_x[gone] = self.item_y[gone] = FAR
            self.item_kind[gone] = NOTHING
        return Outcome(food, poison, blocked, eater, withered, self._spawn(spawning))

    def reward(self, readings: Readings, actions: NDArray, outcome: Outcome) -> Float[np.ndarray, "R A"]:
        """Return the rewards of the tick: open view, a bonus for going straight in it, and what was eaten.

        The readings are those before the move, what was eaten that of the move itself.
        """
        view = np.where(readings.kind == WALL, readings.distance / EYE_RANGE, 1.0).sum(-1) / EYES
        if self.rules.doubled_proximity:
            view = np.minimum(1.0, 2.0 * view)
        straight = 0.1 * view * ((np.asarray(actions) == 0) & (view > 0.75))
        return view + straight + DIGESTION[FOOD] * outcome.food + DIGESTION[POISON] * outcome.poison

    def _checked(self, actions: Int[np.ndarray, "R A"]) -> Int[np.ndarray, "R A"]:
        actions = np.asarray(actions)
        if actions.shape != self.x.shape or actions.dtype.kind not in "iu":
            wanted = f"whole numbers of shape {self.x.shape}"
            raise ValueError(f"expected actions as {wanted}, got {actions.dtype} of shape {actions.shape}")
        if actions.min() < 0 or actions.max() >= len(ACTIONS):
            raise ValueError(f"expected actions from 0 to {len(ACTIONS) - 1}, got {actions.min()} to {actions.max()}")
        return actions

    def _move(self, actions: NDArray) -> Bool[np.ndarray, "R A"]:
        """Turn and move the agents; a move through a wall leaves the agent where it was, but turned."""
        left, right = ACTIONS[actions, 0], ACTIONS[actions, 1]
        before, after = self.angle - left, self.angle + right
        dx = WHEEL_BASE * (np.cos(before) - np.cos(after))
        dy = WHEEL_BASE * (np.sin(after) - np.sin(before))
        turned = np.where(before < 0, before + 2 * np.pi, before) + right
        self.angle = np.where(turned > 2 * np.pi, turned - 2 * np.pi, turned)
        new_x, new_y = self.x + dx, self.y + dy
        blocked = _wall_hits(self.x, self.y, new_x - self.x, new_y - self.y).min(-1) < np.inf
        self.x = np.minimum(np.maximum(np.where(blocked, self.x, new_x), 0.0), WIDTH)
        self.y = np.minimum(np.maximum(np.where(blocked, self.y, new_y), 0.0), HEIGHT)
        return blocked

    def _eat(self) -> Int[np.ndarray, "R M"]:
        """Return which agent eats the item of each slot (-1: nobody): one that touches it with no wall between."""
        eater = np.full((self.replicas, ITEMS), -1)
        right, down = self._items_from(self.x, self.y)
        near = right * right + down * down < (ITEM_RADIUS + AGENT_RADIUS) ** 2
        if near.any():
            replica, agent, slot = near.nonzero()
            to_item = right[replica, agent, slot], down[replica, agent, slot]
            open_way = (_wall_hits(self.x[replica, agent], self.y[replica, agent], *to_item) == np.inf).all(-1)
            for agent_index in reversed(range(self.agents)):  # the first agent wins a tie
                mine = open_way & (agent == agent_index)
                eater[replica[mine], slot[mine]] = agent_index
        return eater

    def _count(self, eater: NDArray) -> Int[np.ndarray, "2 R A"]:
        """Return how many items, of food and of poison, each agent eats."""
        counts = np.zeros((2, self.replicas, self.agents), dtype=np.int64)
        replica, slot = (eater >= 0).nonzero()
        np.add.at(counts, (self.item_kind[replica, slot] - FOOD, replica, eater[replica, slot]), 1)
        return counts

    def _wither(self, ageing: NDArray | None) -> Bool[np.ndarray, "R M"]:
        if self.clock % AGEING_PERIOD:
            return np.zeros((self.replicas, ITEMS), dtype=bool)
        assert ageing is not None
        old = (self.item_kind != NOTHING) & (self.clock - self.item_born > OLD_AGE)
        return old & (ageing < AGEING_CHANCE)

    def _spawn(self, spawning: NDArray | None) -> Int[np.ndarray, " R"]:
        """Put at most one new item per replica into its first empty slot; return the slots, -1 for none."""
        slots = np.full(self.replicas, -1)
        if self.clock % SPAWN_PERIOD:
            return slots
        assert spawning is not None
        empty = self.item_kind == NOTHING
        spawn = (empty.any(-1) & (spawning[:, 0] < SPAWN_CHANCE)).nonzero()[0]
        if len(spawn):
            slots[spawn] = empty[spawn].argmax(-1)
            where = spawn, slots[spawn]
            self.item_x[where], self.item_y[where], self.item_kind[where] = _place(spawning[spawn, 1:])
            self.item_born[where] = self.clock
        return slots

    # ------------------------------------------------------------------ checkpoints

    def state(self) -> dict:
        """Return everything needed to continue."""
        return {name: getattr(self, name).copy() for name in self._ARRAYS} | {"clock": self.clock}

    def restore(self, state: dict) -> None:
        """Continue from ``state()``."""
        for name in self._ARRAYS:
            setattr(self, name, np.asarray(state[name]).copy())
        self.clock = int(state["clock"])

    _ARRAYS = ("x", "y", "angle", "item_x", "item_y", "item_kind", "item_born")


def _uniform_numbers(what: str, values: NDArray | None, shape: tuple[int, ...]) -> NDArray:
    """Return uniform numbers as an array, after checking their shape (-1: any) and range; NaN where none is needed."""
    numbers = np.asarray([] if values is None else values, dtype=np.float64)
    if numbers.ndim != len(shape) or any(want not in (-1, got) for want, got in zip(shape, numbers.shape, strict=True)):
        wanted = str(list(shape)).replace("-1", "R")
        came = "none" if values is None else f"shape {list(numbers.shape)}"
        raise ValueError(f"expected uniform numbers {wanted} for {what}, got {came}")
    if ((numbers < 0) | (numbers >= 1)).any():
        raise ValueError(f"expected numbers in [0, 1) for {what}, got {np.nanmin(numbers)} to {np.nanmax(numbers)}")
    return numbers


def _place(uniform: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return x, y and kind of new items from uniform numbers [..., 3]; nothing keeps an item out of a wall."""
    x = MARGIN + (WIDTH - 2 * MARGIN) * uniform[..., 0]
    y = MARGIN + (HEIGHT - 2 * MARGIN) * uniform[..., 1]
    return x, y, np.floor(2 * uniform[..., 2]).astype(np.int64) + FOOD


def _wall_hits(x: NDArray, y: NDArray, dx: NDArray, dy: NDArray) -> NDArray:
    """Return where segments (x, y) to (x + dx, y + dy) cross the walls: fractions [..., 10] of each segment, or inf.

    Both segments are open: touching an end point is no crossing, and parallel segments never cross.
    """
    wall_x, wall_y, wall_dx, wall_dy = WALL_SEGMENTS
    dx, dy = dx[..., None], dy[..., None]
    from_x, from_y = x[..., None] - wall_x, y[..., None] - wall_y
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel to the wall
        scale = wall_dy * dx - wall_dx * dy
        along_ray = (wall_dx * from_y - wall_dy * from_x) / scale
        along_wall = (dx * from_y - dy * from_x) / scale
    hit = (along_ray > 0) & (along_ray < 1) & (along_wall > 0) & (along_wall < 1)
    return np.where(hit, along_ray, np.inf)


def _pick(values: NDArray, index: NDArray) -> NDArray:
    """Return values[..., index] for values [..., N] and one index per leading position."""
    rows = values.shape[-1] * np.arange(index.size).reshape(index.shape)
    return values.reshape(-1)[rows + index]
