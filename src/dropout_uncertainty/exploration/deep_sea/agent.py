"""Agents of section 5.3 in Deep Sea: the chapter's network and learner, R replicas of K members at once.

Most agents have one member. An ensemble has several, each with a network and a replay memory of its own, and follows
one of them through an episode. What is told apart here is how long a draw is held: see ``Agent.episode``.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import Masks
from dropout_uncertainty.exploration.deep_sea.config import EPISODES, Config, make_policy
from dropout_uncertainty.exploration.deep_sea.network import CellNetwork
from dropout_uncertainty.exploration.deep_sea.world import ACTIONS, DeepSea, cell_count, random_mapping
from dropout_uncertainty.exploration.policies import Chance, gumbel
from dropout_uncertainty.exploration.q_network import MaskStream
from dropout_uncertainty.exploration.replay import ReplayMemory

__all__ = ["Agent"]

ONE_HOT = np.eye(ACTIONS)


class Agent:
    """R replicas of one agent, each in a sea of its own. Learning begins when a memory holds a minibatch."""

    def __init__(
        self, config: Config, seeds: Sequence[int], *, dtype: torch.dtype = torch.float32, device: str = "cpu"
    ) -> None:
        self.policy, self.size, self.seeds, self.drop = make_policy(config), config.size, tuple(seeds), config.drop
        self.members, self.share, self.batch, self.held = config.members, config.share, config.batch, config.held
        self.discount, self.rate, self.decay = config.discount, config.learning_rate, config.l2_decay
        self.sea = DeepSea(random_mapping(self.size, seeds))
        self.dtype, self.device = dtype, device
        self.sea_dtype = torch.zeros(0, dtype=dtype).numpy().dtype
        self.sizes = cell_count(self.size), *config.hidden, ACTIONS
        self.network = self._networks("learner")
        self.memory = ReplayMemory(len(self.network.seeds), config.memory, 1, ACTIONS, dtype=dtype, device=device)
        self.prior: Tensor | None = None
        if config.prior_scale:
            every_cell = torch.arange(self.sizes[0], device=device).repeat(len(self.network.seeds), 1)
            self.prior = config.prior_scale * self._networks("prior").forward(every_cell)[-1]

    def _networks(self, role: str) -> CellNetwork:
        """Return the networks of all members, those of a replica one after the other."""
        seeds = np.repeat(self.seeds, self.members).tolist()
        # one-hot inputs of mean square 1, for which the first layer's initial weights are made
        options = {"scale": self.sizes[0] ** 0.5, "dtype": self.dtype, "device": self.device}
        networks = CellNetwork(self.sizes, seeds, **options)
        each = networks.parameters.view(len(self.seeds), self.members, -1)
        for member in range(self.members):
            each[:, member] = CellNetwork(self.sizes, self.seeds, "deep-sea", role, member, **options).parameters
        return networks

    def prepare(self, block: int) -> None:
        """Draw the random numbers of a block of episodes (0, 1, ...)."""
        moves, learners, self.block = EPISODES * self.size, len(self.network.seeds), block
        replay = self._uniform("replay", moves, self.members, 1 + self.batch).swapaxes(0, 1)
        replay = replay.reshape(moves, learners, 1 + self.batch)
        before = np.arange(moves) > 0  # a move is stored after the minibatch before it was read
        self.rows = self.memory.plan(replay, before, extra=0).rows
        self.slots = self.memory.plan(replay[..., :1], np.ones(moves, dtype=bool), extra=0).slots
        policy = self._uniform("policy", moves, 2 + ACTIONS)
        self.chance = policy[..., 0].T, policy[..., 1].T, gumbel(policy[..., 2:]).swapaxes(0, 1)
        self.follows = (self._uniform("member", EPISODES) * self.members).astype(np.int64).T
        self.learns = (self._uniform("bootstrap", moves, self.members) < self.share).swapaxes(0, 1)
        self.masks = self._draws("learning", moves, 2 * self.batch)
        self.draws = self._draws("acting", EPISODES if self.held == "episode" else moves, 1)

    def _uniform(self, name: str, *shape: int) -> Float[np.ndarray, "R ..."]:
        return rng.uniform(self.seeds, shape, name, "deep-sea", self.block).numpy()

    def _draws(self, name: str, count: int, rows: int) -> MaskStream:
        """Return a stream of ``count`` times ``rows`` weight draws per learner, its own for each member."""
        members = range(1, self.members)
        seeds = [own for seed in self.seeds for own in (seed, *(rng.derived(seed, "member", m) for m in members))]
        return MaskStream(
            seeds, self.sizes[:-1], self.drop, count, rows, "deep-sea", name, self.block,
            dtype=self.dtype, device=self.device,
        )  # fmt: skip

    def episode(self, number: int, visit: Callable[[NDArray], None]) -> Bool[np.ndarray, " R"]:
        """Play and learn through one episode (0, 1, ... of the block); return who found the treasure.

        ``visit`` is called with the cells [R] that are entered.
        """
        self.sea.reset()
        found = np.zeros(len(self.seeds), dtype=bool)
        follows = self.follows[number]
        per_episode = self.held == "episode"
        draw = self.draws.at(number if per_episode else number * self.size)  # the first draw, held for the episode ...
        while not self.sea.over:
            step = number * self.size + self.sea.row
            visit(self.sea.cell)
            if not per_episode:
                draw = self.draws.at(step)  # ... or for this move alone
            q = self._learn(step, draw)
            action = self._act(q, follows, step)
            found |= self._move(action, step)
        return found

    def _act(self, q: Float[np.ndarray, "L C"], follows: Int[np.ndarray, " R"], step: int) -> Int[np.ndarray, " R"]:
        """Return the actions, from the values that the followed members give the present states."""
        q = q.reshape(len(self.seeds), self.members, ACTIONS)[self.sea.replicas, follows]
        chance = Chance(*(numbers[step] for numbers in self.chance))
        return self.policy(q, chance, self.block * EPISODES * self.size + step + 1)

    def _move(self, action: Int[np.ndarray, " R"], step: int) -> Bool[np.ndarray, " R"]:
        """Make a move and store it, for each member as it may learn from it or not; return who found the treasure."""
        before = np.zeros((len(self.seeds), self.members, 1 + ACTIONS), self.sea_dtype)
        after = np.zeros_like(before)
        before[..., 0] = self.sea.cell[:, None]
        before[..., 1:] = self.learns[step][..., None] * ONE_HOT[action][:, None]  # no action taken: no error
        reward, found = self.sea.step(action)
        if not self.sea.over:
            after[..., 0] = self.sea.cell[:, None]
            after[..., 2] = 1.0
        after[..., 1] = reward[:, None]
        self.memory.store(self.slots[step], before.reshape(-1, 1 + ACTIONS), after.reshape(-1, 1 + ACTIONS))
        return found

    def _learn(self, step: int, draw: Masks) -> Float[np.ndarray, "L C"]:
        """Take a learning step; return the values of the present states before it, under ``draw`` if it is acted on."""
        cells = torch.from_numpy(np.repeat(self.sea.cell, self.members)[:, None]).to(self.device)
        masks = self.masks.at(step)
        if self.policy.draws_weights:
            for mask, drawn in zip(masks, draw, strict=True):
                if mask is not None and drawn is not None:
                    mask[:, -1] = drawn[:, 0]
        if self.memory.stored < self.batch:
            present = tuple(mask if mask is None else mask[:, -1:] for mask in masks)
            q = self.network.forward(cells, present)[-1]
            prior = self._prior(cells)
            return (q if prior is None else q + prior)[:, 0].cpu().numpy()
        rows = self.memory.read(self.rows[step])
        cells = torch.cat((rows[..., 0].long(), cells), 1)
        after = rows[:, self.batch :]
        q, _ = self.network.learn(
            cells, rows[:, : self.batch, 1:], after[..., 1], masks, discount=self.discount * after[..., 2],
            rate=self.rate, decay=self.decay, prior=self._prior(cells),
        )  # fmt: skip
        return q[:, 0].cpu().numpy()

    def _prior(self, cells: Int[Tensor, "L rows"]) -> Float[Tensor, "L rows C"] | None:
        if self.prior is None:
            return None
        return self.prior.gather(1, cells[..., None].expand(-1, -1, ACTIONS))

    def state(self) -> dict:
        """Return everything needed to continue, between two blocks."""
        return {"parameters": self.network.parameters.clone(), "memory": self.memory.state()}

    def restore(self, state: dict, replicas: Int[np.ndarray, " r"] | None = None) -> None:
        """Continue from ``state()``; ``replicas``: from that of some replicas of a larger company."""
        if replicas is None:
            replicas = np.arange(len(self.seeds))
        learners = (replicas[:, None] * self.members + np.arange(self.members)).reshape(-1)
        self.network.parameters.copy_(state["parameters"][learners])
        memory = {name: value if name == "stored" else value[learners] for name, value in state["memory"].items()}
        self.memory.restore(memory)
