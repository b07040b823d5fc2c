"""The experiments of section 5.3: agents learning in the 2D world, all seeds of a config at once."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.exploration.agent import STATE_SIZE, Agent
from dropout_uncertainty.exploration.config import BLOCK, NO_DROPOUT, AgentConfig, Config, check_precision
from dropout_uncertainty.exploration.foraging import world
from dropout_uncertainty.exploration.foraging.world import CHUNK, World
from dropout_uncertainty.runs import sweep
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.runs.unit import precision_dtype
from dropout_uncertainty.settings import of_type

__all__ = [
    "AS_DEMO", "AS_WRITTEN", "BLOCK", "CONFIGS", "OURS", "TWO_BY_TWO", "WIDE", "AgentConfig", "Config", "Foraging",
    "start", "units",
]  # fmt: skip

#: The final weights of this many seeds are kept, for animations.
KEPT_WEIGHTS = 2
EXPERIMENT = "exploration"


#: The demo's Thompson agent has one dropout layer, behind the first hidden one (rl_demo.html), the text's has three.
THOMPSON_OF_DEMO = AgentConfig("thompson", (0.0, 0.2, 0.0))
THOMPSON_OF_TEXT = AgentConfig("thompson", (0.1, 0.1, 0.1))


#: The demo: both agents in one world.
AS_DEMO = Config(agents=(THOMPSON_OF_DEMO, AgentConfig("epsilon-greedy")), ticks=1_000_000)
#: The thesis text: dropout 0.1 before every weight layer.
AS_WRITTEN = replace(AS_DEMO, agents=(THOMPSON_OF_TEXT, AgentConfig("epsilon-greedy")), ticks=200_000)
#: One agent per world, the same network, and the demo's dropout wherever weights are drawn.
OURS = {
    name: replace(AS_DEMO, agents=(AgentConfig(name, drop),), ticks=200_000)
    for name, drop in (
        ("thompson", THOMPSON_OF_DEMO.drop),
        ("epsilon-greedy", NO_DROPOUT),
        ("boltzmann", NO_DROPOUT),
        ("annealed-thompson", THOMPSON_OF_DEMO.drop),
        ("greedy", NO_DROPOUT),
    )
}
#: Over-fitting (EX6): networks of the demo's and of four times its width, without and with the text's dropout.
#: All act ε-greedily on the network without dropout, so that only the dropout in learning distinguishes a pair.
WIDE = {
    name: replace(
        AS_DEMO, agents=(AgentConfig("epsilon-greedy", drop),), ticks=100_000, hidden=hidden, held_out_every=10
    )
    for name, hidden, drop in (
        ("narrow", (50, 50), NO_DROPOUT),
        ("narrow-dropout", (50, 50), THOMPSON_OF_TEXT.drop),
        ("wide", (200, 200), NO_DROPOUT),
        ("wide-dropout", (200, 200), THOMPSON_OF_TEXT.drop),
    )
}
#: Is it exploration? Learning with and without dropout, by acting on a draw and on the mean weights (the four primary
#: ones, first); draws no longer acted on in the second half; draws held for longer; and ε-greedy on the same seeds,
#: with its own schedule and with one ten times shorter from the end of the burn-in (197,000 ticks to 19,700).
TWO_BY_TWO = {
    f"two-by-two/{name}": replace(OURS["thompson"], agents=(agent,))
    for name, agent in (
        ("dropout-draw", THOMPSON_OF_DEMO),
        ("dropout-mean", AgentConfig("greedy", THOMPSON_OF_DEMO.drop)),
        ("plain-draw", AgentConfig("thompson", drop_acting=THOMPSON_OF_DEMO.drop)),
        ("plain-mean", AgentConfig("greedy")),
        ("masks-off-late", replace(THOMPSON_OF_DEMO, draws_until=100_000)),
        *((f"hold-{ticks}", replace(THOMPSON_OF_DEMO, hold=ticks)) for ticks in (10, 100, 1000)),
        ("epsilon-greedy", AgentConfig("epsilon-greedy")),
    )
}
TWO_BY_TWO["two-by-two/epsilon-greedy-short"] = replace(TWO_BY_TWO["two-by-two/epsilon-greedy"], anneal_end=22_700)
#: The configs of the chapter's own notebook.
PUBLISHED = {
    "as-demo": AS_DEMO,
    "as-written": AS_WRITTEN,
    **{f"ours-{name}": config for name, config in OURS.items()},
    **WIDE,
}


def shortened(config: Config) -> Config:
    """Return the version of a config for profile ``quick``."""
    if config.held_out_every:
        return replace(config, ticks=4_500, held_out_every=3)
    return replace(config, ticks=15_000 if len(config.agents) > 1 else 9_000)


def shortest(config: Config) -> Config:
    """Return the same for the many agents of ``TWO_BY_TWO``."""
    agents = tuple(replace(agent, draws_until=agent.draws_until and 4_500) for agent in config.agents)
    return replace(config, agents=agents, ticks=6_000)


CONFIGS: dict[str, Config] = {
    **PUBLISHED,
    **TWO_BY_TWO,
    **{f"quick/{name}": shortened(config) for name, config in PUBLISHED.items()},
    **{f"quick/{name}": shortest(config) for name, config in TWO_BY_TWO.items()},
}


class Foraging:
    """Agents learning in R replicas of the world; one step of work is a block of 500 ticks.

    ``log`` holds per replica, agent and block: mean reward, food and poison eaten, moves undone by a wall, exploring
    actions (see ``Agent.act``), and the mean squared TD error of the minibatches.
    """

    LOG = ("reward", "food", "poison", "blocked", "explored", "td_error")

    def __init__(
        self, config: Config, seeds: Sequence[int], *, device: str = "cpu", precision: str = "float32"
    ) -> None:
        check_precision(precision)
        self.config, self.seeds = of_type(Config, config, "config"), rng.check_seeds(seeds)
        self.total, self.done = config.ticks // BLOCK, 0
        self.world = World(world.start_numbers(self.seeds), len(config.agents), config.rules)
        options: dict[str, Any] = {"dtype": precision_dtype(precision), "device": device}
        self.agents = [Agent(config, self.seeds, index, **options) for index in range(len(config.agents))]
        shape = (len(self.seeds), len(self.agents), self.total)
        self.log = {name: np.full(shape, np.nan) for name in self.LOG}
        evaluations = (*shape[:2], self.total // config.held_out_every) if config.held_out_every else None
        self.held_out = np.full((*evaluations, 2), np.nan) if evaluations else None

    def advance(self) -> str:
        """Run one block of ticks; return the mean reward per agent."""
        sums = {name: np.zeros(self.log[name].shape[:2]) for name in self.LOG}
        for _ in range(BLOCK // CHUNK):
            self._chunk(sums)
        for name, values in sums.items():
            self.log[name][..., self.done] = values / BLOCK if name == "reward" else values
        self.log["td_error"][..., self.done] = np.stack([agent.mean_squared_error() for agent in self.agents], axis=1)
        for agent in self.agents:
            agent.network.check_finite()
        self.done += 1
        if self.held_out is not None and self.done % self.config.held_out_every == 0:
            errors = [np.stack(agent.held_out_errors(), axis=-1) for agent in self.agents]
            self.held_out[:, :, self.done // self.config.held_out_every - 1] = np.stack(errors, axis=1)
        means = self.log["reward"][..., self.done - 1].mean(0)
        return "reward " + ", ".join(f"{mean:.2f}" for mean in means)

    def _chunk(self, sums: dict[str, np.ndarray]) -> None:
        """Run the ticks for which random numbers are drawn at once, and add up what happens."""
        chunk = self.world.clock // CHUNK
        ageing, spawning = world.coming_numbers(self.seeds, chunk, CHUNK)
        every = self.config.held_out_every
        for agent in self.agents:
            agent.prepare(chunk, holding_out=every > 0 and self.done % every == every - 1)
        actions = np.zeros((len(self.seeds), len(self.agents)), dtype=np.int64)
        explores = np.zeros(actions.shape, dtype=bool)
        for tick in range(chunk * CHUNK + 1, (chunk + 1) * CHUNK + 1):
            readings = self.world.sense()
            inputs = self.world.inputs(readings)
            for index, agent in enumerate(self.agents):
                actions[:, index], explores[:, index] = agent.act(inputs[:, index], tick)
            outcome = self.world.step(actions, ageing, spawning[:, (tick - 1) % CHUNK // world.SPAWN_PERIOD])
            reward = self.world.reward(readings, actions, outcome)
            for index, agent in enumerate(self.agents):
                agent.receive(reward[:, index])
            for name, value in (
                ("reward", reward), ("food", outcome.food), ("poison", outcome.poison), ("blocked", outcome.blocked),
                ("explored", explores),
            ):  # fmt: skip
                sums[name] += value

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue."""
        return {
            "done": self.done,
            "world": {name: torch.as_tensor(value) for name, value in self.world.state().items()},
            "agents": [agent.state() for agent in self.agents],
            "log": {name: torch.tensor(values) for name, values in self.log.items()},
            "held_out": None if self.held_out is None else torch.tensor(self.held_out),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from ``state()`` of a process made with the same arguments."""
        self.done = state["done"]
        self.world.restore(state["world"])
        for agent, saved in zip(self.agents, state["agents"], strict=True):
            agent.restore(saved)
        self.log = {name: values.numpy().copy() for name, values in state["log"].items()}
        if self.held_out is not None:
            self.held_out = state["held_out"].numpy().copy()

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the record: [R, A, blocks], and what is named in the comments."""
        counts = {name: self.log[name].astype(np.int16) for name in ("food", "poison", "blocked", "explored")}
        reward = self.log["reward"]
        last = np.concatenate((reward[..., :1], 0.5 * (reward[..., 1:] + reward[..., :-1])), axis=-1)
        arrays = {
            "average_reward": last.astype(np.float32),  # of the last 1000 ticks, the demo's curve
            "reward": reward.astype(np.float32),
            "td_error": self.log["td_error"].astype(np.float32),
            "weights": self._final_weights(),  # [first seeds, A, P]
            **counts,
        }
        if self.held_out is not None:  # [R, A, evaluations]
            arrays["held_out_td_error"], arrays["learned_td_error"] = np.moveaxis(self.held_out, -1, 0).astype(
                np.float32
            )
        return arrays

    def _final_weights(self) -> np.ndarray:
        kept = [agent.network.parameters[:KEPT_WEIGHTS].cpu().numpy() for agent in self.agents]
        return np.stack(kept, axis=1).astype(np.float32)


#: Makes the process of one unit.
start = Foraging


def memory(config: Config) -> float:
    """Return an estimate of the bytes that a repetition takes: its replay memories, and the copies for a checkpoint."""
    rows = 2 * (config.memory + config.held_out_size)
    return 4.0 * len(config.agents) * rows * (STATE_SIZE + len(world.ACTIONS)) * 5


SWEEP = Sweep(
    EXPERIMENT, CONFIGS, start, ("float32", "float64"), {"cpu": 20, "cuda": 40}, repetitions=10, memory=memory
)


#: The units of a named config.
units = partial(sweep.units, [SWEEP])
