"""An agent of section 5.3: eyes in, action out, learning at every tick; R replicas of it at once.

In one tick the demo acts on the Q-network, then learns from a minibatch. Both read the same weights, and the transition
that ends in the present state is complete before the action is chosen. So one forward pass serves both: the minibatch
and the present state go through the network together.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import Masks
from dropout_uncertainty.exploration.config import Config, make_policy
from dropout_uncertainty.exploration.foraging import world
from dropout_uncertainty.exploration.foraging.world import CHUNK
from dropout_uncertainty.exploration.policies import Chance, gumbel
from dropout_uncertainty.exploration.q_network import MaskStream, QNetwork, td_error
from dropout_uncertainty.exploration.replay import ReplayMemory

__all__ = ["STATE_SIZE", "Agent"]

C = len(world.ACTIONS)
#: Numbers in a state: what is seen now, what was seen before, and the action between, one-hot times 27 (deepqlearn.js).
STATE_SIZE = 2 * world.INPUTS + C
ACTION_SCALE = float(world.INPUTS)
ONE_HOT = np.eye(C)


class Agent:
    """R replicas of agent number ``index`` of a config; the number is part of the names of its random streams."""

    def __init__(
        self,
        config: Config,
        seeds: Sequence[int],
        index: int = 0,
        *,
        dtype: torch.dtype = torch.float32,
        device: str = "cpu",
    ) -> None:
        mine, self.seeds, self.index = config.agents[index], tuple(seeds), index
        self.policy, self.drop, self.hold = make_policy(mine.policy, config), mine.drop, mine.hold
        self.draws_until = np.inf if mine.draws_until is None else mine.draws_until
        # the draw of every tick is the last one of the learning step, unless it differs from those
        own_draws = self.policy.draws_weights and (mine.hold > 1 or mine.drop_acting is not None)
        self.chunk: int | None = None
        self.drop_acting = mine.drop_when_acting if own_draws else None
        self.ones: dict[int, Tensor] = {}
        self.batch, self.learning_start = config.batch, config.learning_start
        self.learning: dict[str, Any] = {
            "discount": config.discount, "rate": config.learning_rate, "decay": config.l2_decay,
        }  # fmt: skip
        self.dtype, self.device, replicas = dtype, device, len(self.seeds)
        self.network = QNetwork((STATE_SIZE, *config.hidden, C), self.seeds, index, dtype=dtype, device=device)
        memory = partial(ReplayMemory, replicas, state_size=STATE_SIZE, actions=C, dtype=dtype, device=device)
        self.memory = memory(capacity=config.memory)
        # as the memories fill and forget at the same pace, both hold transitions of the same ages
        self.held_out = memory(capacity=config.held_out_size) if config.held_out_every else None
        self.current = torch.zeros(replicas, STATE_SIZE + C, dtype=dtype).numpy()
        self.action, self.reward = np.zeros(replicas, np.int64), np.zeros(replicas)  # nothing done yet
        self.minibatch = torch.zeros(replicas, 2 * self.batch + 2, STATE_SIZE + C, dtype=dtype, device=device)
        #: Sum of squared TD errors of the replay minibatches [R] and number of learning steps, since last asked.
        self.squared_error, self.steps = torch.zeros(replicas, device=device), 0

    def prepare(self, chunk: int, holding_out: bool = False) -> None:
        """Draw the random numbers for the ticks of a chunk (0, 1, ...); ``holding_out``: transitions are kept aside."""
        self.chunk = chunk
        storing = chunk * CHUNK + 1 + np.arange(CHUNK) >= 3  # a transition needs two states, a state two readings
        uniform = self._uniform("replay", chunk, 1 + self.batch)
        self.store_in = self.memory
        self.plan = self.memory.plan(uniform, storing & (not holding_out), extra=2)
        self.slots = self.plan.slots
        if holding_out and self.held_out is not None:
            self.store_in = self.held_out
            self.slots = self.held_out.plan(uniform[:, :, :1], storing, extra=0).slots
        # no masks are needed before learning starts
        drop = self.drop if self.memory.stored + CHUNK > self.learning_start else [0.0] * len(self.drop)
        self.masks = MaskStream(
            self.seeds, self.network.sizes[:-1], drop, CHUNK, 2 * self.batch + 1, self.index, chunk,
            dtype=self.dtype, device=self.device,
        )  # fmt: skip
        if self.drop_acting is not None:
            self.held = MaskStream(
                self.seeds, self.network.sizes[:-1], self.drop_acting, max(1, CHUNK // self.hold), 1, self.index,
                "acting", chunk // max(1, self.hold // CHUNK), dtype=self.dtype, device=self.device,
            )  # fmt: skip
        policy = self._uniform("policy", chunk, 2 + C)
        self.chance = policy[..., 0], policy[..., 1], gumbel(policy[..., 2:])

    def _uniform(self, name: str, chunk: int, count: int) -> Float[np.ndarray, "T R count"]:
        return rng.uniform(self.seeds, (CHUNK, count), name, self.index, chunk).transpose(0, 1).numpy()

    def act(self, inputs: Float[np.ndarray, "R 27"], tick: int) -> tuple[Int[np.ndarray, " R"], NDArray]:
        """Take in what the eyes sense at ``tick``, learn, and return the actions and which of them explore.

        An action explores if the network without dropout values another one higher, or if there are no values yet.

        Raises:
            ValueError: if ``tick`` does not lie in the chunk last prepared.
        """
        chunk, step = divmod(tick - 1, CHUNK)
        if chunk != self.chunk:
            raise ValueError(f"tick {tick} is not prepared for: call prepare({chunk}) first")
        self._take_in(inputs, tick, step)
        chance = Chance(*(numbers[step] for numbers in self.chance))
        if self.memory.size > self.learning_start:
            drawn, plain = self._learn(step)
            draws = self.policy.draws_weights and tick <= self.draws_until
            action = self.policy(drawn if draws else plain, chance, tick)
            explores = action != plain.argmax(-1)
        else:
            action = (chance.which * C).astype(np.int64)
            explores = np.ones(len(action), dtype=bool)
        self.action = action
        return action, explores

    def receive(self, reward: Float[np.ndarray, " R"]) -> None:
        """Take in the reward of the action just taken."""
        self.reward = reward

    def _take_in(self, inputs: NDArray, tick: int, step: int) -> None:
        """Make the new state, and a transition of the last one, its action and reward, and the new one."""
        before, now = self.current.copy(), self.current
        now[:, world.INPUTS : 2 * world.INPUTS] = before[:, : world.INPUTS]
        now[:, : world.INPUTS] = inputs
        if tick > 1:
            taken = ONE_HOT[self.action]
            now[:, 2 * world.INPUTS : STATE_SIZE] = ACTION_SCALE * taken
            now[:, STATE_SIZE] = self.reward
            before[:, STATE_SIZE:] = taken
        if tick > 2:
            self.store_in.store(self.slots[step], before, now)
        if self.store_in is not self.memory or tick <= 2:
            self.memory.observe(now)

    def _learn(self, step: int) -> tuple[NDArray, NDArray]:
        """Take a learning step; return the Q-values of the present state under a weight draw and without dropout."""
        size = len(self.minibatch)
        rows = self.memory.read(self.plan.rows[step], out=self.minibatch)
        states, further = rows[..., :STATE_SIZE], rows[..., STATE_SIZE:]
        taken, reward = further[:, : self.batch], further[:, self.batch : 2 * self.batch, 0]
        q, error = self.network.learn(states, taken, reward, self._draws(step), **self.learning)
        self.squared_error += error.square().mean(1)
        self.steps += 1
        drawn, plain = q.cpu().numpy().reshape(size, 2, C).transpose(1, 0, 2)
        return drawn, plain

    def _draws(self, step: int) -> Masks:
        """Return a draw for each row of the minibatch: of learning, then the one acted on, and none for the last row.

        The tensors are overwritten by the next call.
        """
        masks = self.masks.at(step)
        if self.drop_acting is None:
            return masks
        held = self.held.at(step // self.hold)
        return tuple(self._with_held(layer, mask, held[layer]) for layer, mask in enumerate(masks))

    def _with_held(self, layer: int, mask: Tensor | None, held: Tensor | None) -> Tensor | None:
        """Return the mask of a layer with the draw that is acted on put in; ``mask`` None: no dropout in learning."""
        if mask is None and held is not None:
            if layer not in self.ones:
                self.ones[layer] = held.new_ones(len(self.seeds), 2 * self.batch + 2, held.shape[-1])
            mask = self.ones[layer]
        if mask is not None:
            mask[:, 2 * self.batch] = 1.0 if held is None else held[:, 0]
        return mask

    def mean_squared_error(self) -> Float[np.ndarray, " R"]:
        """Return the mean squared TD error of the minibatches since the last call; NaN if there were none."""
        mean = self.squared_error.cpu().numpy() / self.steps if self.steps else np.full(len(self.seeds), np.nan)
        self.squared_error, self.steps = torch.zeros_like(self.squared_error), 0
        return mean

    def held_out_errors(self) -> tuple[NDArray, NDArray]:
        """Return the mean squared TD errors [R], without dropout, of transitions held out and as many learned from."""
        assert self.held_out is not None
        count = self.held_out.size
        return self._evaluate(self.held_out, count), self._evaluate(self.memory, count)

    def _evaluate(self, memory: ReplayMemory, count: int) -> NDArray:
        rows = memory.read(memory.spread(count))
        taken, reward = rows[:, :count, STATE_SIZE:], rows[:, count:, STATE_SIZE]
        q = self.network.forward(rows[..., :STATE_SIZE])[-1]
        return td_error(q, taken, reward, self.learning["discount"]).square().mean(1).cpu().numpy()

    def state(self) -> dict:
        """Return everything needed to continue, between two chunks."""
        return {
            "parameters": self.network.parameters.clone(),
            "memory": self.memory.state(),
            "held_out": self.held_out.state() if self.held_out else None,
            "current": torch.tensor(self.current),
            "action": torch.tensor(self.action),
            "reward": torch.tensor(self.reward),
        }

    def restore(self, state: dict) -> None:
        """Continue from ``state()``."""
        self.network.parameters.copy_(state["parameters"])
        self.memory.restore(state["memory"])
        if self.held_out:
            self.held_out.restore(state["held_out"])
        self.current = state["current"].numpy().copy()
        self.action, self.reward = state["action"].numpy(), state["reward"].numpy()
