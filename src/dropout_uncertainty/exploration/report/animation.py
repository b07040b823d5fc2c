"""Trained agents in the 2D world, as an animation for a page (see ``page.svg_animation``)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray

from dropout_uncertainty import rng
from dropout_uncertainty.exploration.agent import ACTION_SCALE, ONE_HOT, STATE_SIZE
from dropout_uncertainty.exploration.config import make_policy
from dropout_uncertainty.exploration.experiment import CONFIGS, EXPERIMENT
from dropout_uncertainty.exploration.foraging import world as w
from dropout_uncertainty.exploration.foraging.drawing import KIND_COLOURS, Scene, rollout
from dropout_uncertainty.exploration.policies import Chance, gumbel
from dropout_uncertainty.exploration.q_network import MaskStream, QNetwork
from dropout_uncertainty.exploration.report.analysis import LABELS
from dropout_uncertainty.page.plotting import COLOURS
from dropout_uncertainty.page.svg import Shape, circle, letters, line, polygon, text
from dropout_uncertainty.page.svg_animation import Player
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record, RecordError
from dropout_uncertainty.settings import config_hash

__all__ = ["Moment", "TrainedAgent", "animation", "compare", "run"]

C = len(w.ACTIONS)
#: Space around a drawing of the world and above it [px], for its title.
GAP, HEAD = 30, 50


class TrainedAgent:
    """One agent of a record, which acts as it did at the end of its training, but learns no more.

    Draws of the weights come from a stream of their own; ε stays at its last value.

    Args:
        record: of an experiment of this section.
        replica: place of the seed in the record; it keeps the weights of the first seeds only.
        agent: number of the agent in its world.
        seed: of the random streams.

    Raises:
        RecordError: if the record is of a config that is not known here.
        ValueError: if the record has no weights of that replica or agent.
    """

    def __init__(self, record: Record, replica: int = 0, agent: int = 0, seed: int = 100) -> None:
        name = record.header["name"]
        if name not in CONFIGS or config_hash(CONFIGS[name]) != record.header["config_hash"]:
            raise RecordError(f"the record {record.label} is of no config known here: run its unit again")
        config, weights = CONFIGS[name], record.arrays["weights"]
        if not (0 <= replica < weights.shape[0] and 0 <= agent < weights.shape[1]):
            held = f"{weights.shape[0]} seeds and {weights.shape[1]} agents"
            raise ValueError(f"the record has the weights of {held}, not of seed number {replica}, agent {agent}")
        mine = config.agents[agent]
        self.name, self.drop, self.hold, self.seed = mine.policy, mine.drop_when_acting, mine.hold, seed
        self.policy, self.ticks, self.rules = make_policy(self.name, config), config.ticks, config.rules
        self.acts_on_draws = self.policy.draws_weights and mine.draws_until is None
        self.network = QNetwork((STATE_SIZE, *config.hidden, C), [seed])
        self.network.parameters.copy_(torch.tensor(weights[replica, agent]))
        self.before, self.taken = np.ones((1, w.INPUTS)), np.zeros((1, C))

    def state(self, inputs: NDArray) -> Float[np.ndarray, "1 D"]:
        """Return what the network sees: the present inputs, those before, and the action between."""
        return np.concatenate((inputs, self.before, ACTION_SCALE * self.taken), axis=-1)

    def values(self, inputs: NDArray, tick: int) -> tuple[Float[np.ndarray, "1 C"], Float[np.ndarray, "1 C"]]:
        """Return the Q-values of the present state under a weight draw and without dropout."""
        step = (tick - 1) % w.CHUNK
        if step == 0:
            chunk = (tick - 1) // w.CHUNK
            draws, number = max(1, w.CHUNK // self.hold), chunk // max(1, self.hold // w.CHUNK)
            self.masks = MaskStream([self.seed], self.network.sizes[:-1], self.drop, draws, 1, "animation", number)
            uniform = torch.rand(w.CHUNK, 2 + C, dtype=torch.float64, generator=self._generator(chunk)).numpy()
            self.chance = uniform[:, :1], uniform[:, 1:2], gumbel(uniform[:, None, 2:])
        state = self.state(inputs).astype(np.float32)
        rows = torch.from_numpy(np.stack((state, state), axis=1))
        drawn, plain = (
            self.network.forward(rows, self.masks.at(step // self.hold))[-1].numpy().transpose(1, 0, 2).copy()
        )
        return drawn, plain

    def __call__(self, inputs: Float[np.ndarray, "1 27"], tick: int) -> Int[np.ndarray, " 1"]:
        """Return the action at ``tick`` (1, 2, ... in turn)."""
        drawn, plain = self.values(inputs, tick)
        chance = Chance(*(numbers[(tick - 1) % w.CHUNK] for numbers in self.chance))
        action = self.policy(drawn if self.acts_on_draws else plain, chance, self.ticks)
        self.before, self.taken = inputs, ONE_HOT[action]
        return action

    def _generator(self, chunk: int) -> torch.Generator:
        return rng.generator(self.seed, "policy", "animation", chunk)


@dataclass(frozen=True)
class Moment:
    """A state of the world and what happened since the start: ticks, items eaten, sum of rewards."""

    scene: Scene
    tick: int
    food: int
    poison: int
    reward: float


def run(agent: TrainedAgent, seed: int = 100, ticks: int = 600, every: int = 4) -> list[Moment]:
    """Return each ``every``-th state while the agent acts in the world that ``seed`` lays out.

    Raises:
        ValueError: if ``ticks`` or ``every`` < 1.
    """
    if ticks < 1 or every < 1:
        raise ValueError(f"ticks and every must be positive, got {ticks} and {every}")
    moments, food, poison, total = [], 0, 0, 0.0
    for _, (world, outcome, reward) in zip(range(ticks), rollout([seed], agent, agent.rules), strict=False):
        food, poison = food + int(outcome.food.sum()), poison + int(outcome.poison.sum())
        total += float(reward.sum())
        if world.clock % every == 0:
            moments.append(Moment(Scene.of(world), world.clock, food, poison, total))
    return moments


def compare(names: Sequence[str], *, seed: int = 100, ticks: int = 600, folder: Path | None = None) -> Player:
    """Return an animation of the recorded agents of some configs, of the first seed, in worlds that ``seed`` lays out.

    Each agent has a world for itself here, even where several shared one in training.

    Raises:
        RecordError: if a config has no record.
        ValueError: if two of the agents have one policy, by which they are told apart.
    """
    runs: dict[str, list[Moment]] = {}
    for name in names:
        published = records.find(EXPERIMENT, name=name, folder=folder, published=True)
        if not published:
            command = f"dropout-uncertainty run {EXPERIMENT} --config {name} --seeds 0-9"
            raise RecordError(f"there is no record of {EXPERIMENT}/{name}: `{command}` makes it")
        for number in range(published[0].arrays["weights"].shape[1]):
            agent = TrainedAgent(published[0], agent=number)
            if agent.name in runs:
                raise ValueError(f"expected agents of different policies, got {agent.name!r} twice")
            runs[agent.name] = run(agent, seed, ticks)
    return animation(runs)


def animation(runs: Mapping[str, Sequence[Moment]], *, rate: float = 15.0) -> Player:
    """Return an animation of one or more agents, each in its own copy of the world, side by side.

    ``runs`` are equally long; their keys are policies, whose names stand above the worlds.

    Raises:
        ValueError: if the runs differ in length.
    """
    if len({len(moments) for moments in runs.values()}) != 1:
        raise ValueError(f"expected runs of one length, got {[len(moments) for moments in runs.values()]} moments")
    offsets = [GAP + number * (w.WIDTH + GAP) for number in range(len(runs))]
    size = offsets[-1] + w.WIDTH + GAP, HEAD + w.HEIGHT
    background = [
        shape for (name, x) in zip(runs, offsets, strict=True) for shape in [_title(name, x, size[0]), *_walls(x)]
    ]
    frames, labels = [], []
    for moments in zip(*runs.values(), strict=True):
        pairs = list(zip(runs, moments, strict=True))
        frames.append(
            [
                shape
                for (name, moment), x in zip(pairs, offsets, strict=True)
                for shape in _moving(moment.scene, x, COLOURS[name])
            ]
        )
        labels.append("\n".join([f"Tick {moments[0].tick}", *(_tally(name, moment) for name, moment in pairs)]))
    description = (
        f"Worlds of {' and '.join(LABELS[name] for name in runs)} side by side: walls, food as filled red discs, "
        "poison as green rings, and the agent with its nine eyes"
    )
    return Player(frames, size, description, labels, background=background, rate=rate)


def _title(name: str, left: float, width: float) -> Shape:
    return text(left + 10, HEAD - 18, LABELS[name], font_size=letters(width))


def _walls(left: float) -> list[Shape]:
    style: dict[str, str | float] = {"stroke_width": 4, "stroke_linecap": "round"}
    return [line(left + x1, HEAD + y1, left + x2, HEAD + y2, **style) for x1, y1, x2, y2 in w.WALLS]


def _moving(scene: Scene, left: float, colour: str) -> list[Shape]:
    """Return the shapes of items, eyes and the agent."""
    items = [
        _item(left + x, HEAD + y, kind)
        for x, y, kind in zip(scene.item_x, scene.item_y, scene.item_kind.tolist(), strict=True)
    ]
    x, y, angle = left + scene.x[0], HEAD + scene.y[0], scene.angle[0]
    end_x, end_y = scene.eye_ends()
    eyes = [
        _eye(x, y, left + to_x, HEAD + to_y, kind)
        for to_x, to_y, kind in zip(end_x[0], end_y[0], scene.sensed_kind[0].tolist(), strict=True)
    ]
    reach = w.AGENT_RADIUS * np.array([1.0, 1.8, 1.0])
    around = angle + np.array([-1.2, 0.0, 1.2])
    nose = polygon(list(zip(x + reach * np.sin(around), y + reach * np.cos(around), strict=True)), fill=colour)
    body = circle(x, y, w.AGENT_RADIUS, fill=colour, stroke="currentColor", stroke_width=1.5)
    return [*items, *eyes, nose, body]


def _item(x: float, y: float, kind: int) -> Shape:
    if kind == w.NOTHING:
        return circle(0, 0, 0, fill="none", stroke="none", stroke_width=4)
    if kind == w.FOOD:
        return circle(x, y, w.ITEM_RADIUS, fill=KIND_COLOURS[kind], stroke="none", stroke_width=4)
    return circle(x, y, w.ITEM_RADIUS - 2, fill="none", stroke=KIND_COLOURS[kind], stroke_width=4)


def _eye(x: float, y: float, to_x: float, to_y: float, kind: int) -> Shape:
    colour = KIND_COLOURS[kind] if kind in (w.FOOD, w.POISON) else "currentColor"
    return line(
        x, y, to_x, to_y, stroke=colour, stroke_width=1 if kind == w.NOTHING else 2.5,
        stroke_opacity=0.4 if kind == w.NOTHING else 1, stroke_dasharray="7 5" if kind == w.POISON else "none",
    )  # fmt: skip


def _tally(name: str, moment: Moment) -> str:
    mean = moment.reward / moment.tick
    return f"{LABELS[name]}: food {moment.food}, poison {moment.poison}, mean reward {mean:.2f}"
