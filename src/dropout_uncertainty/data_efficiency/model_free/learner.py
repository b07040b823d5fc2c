"""The runs of the learners without a model: trials on the real plant, a learning step or more at every step of it."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP, on_cpu
from dropout_uncertainty.data_efficiency.model_free.config import (
    DDPG_AS_PRINTED,
    DDPG_TUNED,
    ENDS,
    NAF_AS_PRINTED,
    NAF_TUNED,
    SEARCH,
    ModelFreeConfig,
)
from dropout_uncertainty.data_efficiency.model_free.ddpg import DDPG
from dropout_uncertainty.data_efficiency.model_free.naf import NAF
from dropout_uncertainty.data_efficiency.model_free.replay import Memory, Transitions
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cost import cost, solved
from dropout_uncertainty.data_efficiency.plant.extrapolation import step_each
from dropout_uncertainty.runs.sweep import Sweep

__all__ = ["CONFIGS", "ModelFree", "start"]

METHODS: dict[str, type[DDPG] | type[NAF]] = {"ddpg": DDPG, "naf": NAF}
CONFIGS = {
    "ddpg": DDPG_TUNED, "naf": NAF_TUNED, "ddpg-as-printed": DDPG_AS_PRINTED, "naf-as-printed": NAF_AS_PRINTED,
    **SEARCH, **ENDS,
}  # fmt: skip


class ModelFree:
    """R repetitions of DDPG or NAF; a step of the process is a block of trials that ends with a test.

    A repetition whose last tests were all solved (`ModelFreeConfig.solved_tests`) takes no part in later blocks,
    nor does one whose networks have diverged, which stays among the unsolved.
    """

    def __init__(self, config: ModelFreeConfig, seeds: Sequence[int], dtype: torch.dtype) -> None:
        self.config, self.seeds, self.dtype = config, rng.check_seeds(seeds), dtype
        plant = config.plant
        cartpole.check_interval(plant)
        inputs = len(cartpole.FEATURE_NAMES) + config.time_input
        self.agent = METHODS[config.method](config, self.seeds, inputs, dtype)
        self.memory = Memory(len(self.seeds), min(config.memory, config.trials * plant.steps), inputs, dtype)
        self.scale = torch.tensor(config.scale, dtype=dtype)
        self.total, self.done = config.trials // config.test_every, 0
        #: Numbers of the repetitions that still run.
        self.running = torch.arange(len(self.seeds))
        shape = len(self.seeds), config.trials + 1  # there is no trial 0
        self.log = {
            "costs": torch.full((*shape, plant.steps), torch.nan, dtype=torch.float64),
            "training_cost": torch.full(shape, torch.nan, dtype=torch.float64),
            "td_error": torch.full((len(self.seeds), self.total), torch.nan, dtype=torch.float64),
        }

    def advance(self) -> str:
        """Run a block of trials; repetitions that have solved enough tests in a row end with it."""
        config, first = self.config, self.done * self.config.test_every + 1
        if len(self.running):
            errors = [self._trial(trial, testing=False) for trial in range(first, first + config.test_every - 1)]
            errors.append(self._trial(first + config.test_every - 1, testing=True))
            self.log["td_error"][self.running, self.done] = torch.stack(errors).nanmean(0).double()
        self.done += 1
        tests = self._solved_tests()
        recent = tests[:, max(0, self.done - config.solved_tests) : self.done]
        going = recent.sum(1) < config.solved_tests
        self._keep(going[self.running] & self._sound())
        return f"solved {int(tests.any(1).sum())}/{len(self.seeds)}, {len(self.running)} running"

    def _solved_tests(self) -> Tensor:
        """Return which tests were solved [R, tests]; those that were not made count as unsolved."""
        every = self.config.test_every
        return solved(self.config.plant, self.log["costs"][:, every::every])

    def _sound(self) -> Tensor:
        """Return which of the running repetitions [R] have networks that still give numbers."""
        return self.agent.act(torch.zeros(len(self.running), self.memory.widths[0], dtype=self.dtype)).isfinite()

    def _keep(self, which: Tensor) -> None:
        if which.all():
            return
        kept = which.nonzero()[:, 0]
        self.running = self.running[kept]
        self.memory.keep(kept)
        for network in self.agent.networks.values():
            network.keep(kept)

    def _trial(self, trial: int, testing: bool) -> Float[Tensor, " R"]:
        """Run one trial, learning at every step; return the mean squared TD error."""
        config, plant = self.config, self.config.plant
        state = self._draw(lambda g: cartpole.start_states(plant, (), g), "environment", "start", trial)
        noise = self._draw(
            lambda g: cartpole.observation_noise(plant, (plant.steps + 1,), g), "environment", "noise", trial
        )
        disturbance = torch.zeros(len(state), plant.steps) if testing else self._disturbance(trial)
        size = plant.steps, config.updates, config.batch
        chosen = self._draw(lambda g: torch.rand(size, generator=g, dtype=torch.float64), "replay", trial)
        inputs, costs, errors = self._inputs(state + noise[:, 0], 0), [], []
        for t in range(plant.steps):
            # networks that have just diverged push with no force for the rest of their last block
            action = (self.agent.act(inputs).nan_to_num(0.0) + disturbance[:, t].to(self.dtype)).clamp(-1, 1)
            state = step_each(plant, state, plant.force_limit * action.double())
            costs.append(cost(plant, state))
            following = self._inputs(state + noise[:, t + 1], t + 1)
            ends = config.end_is_terminal and t + 1 == plant.steps
            discount = torch.full_like(action, 0.0 if ends else config.discount)
            reward = (1 - costs[-1]).to(self.dtype)
            numbers = (x[:, None, None] for x in (action, reward, discount))
            self.memory.store(Transitions(inputs[:, None], following[:, None], *numbers))
            errors += [self._learn(chosen[:, t, update]) for update in range(config.updates)]
            inputs = following
        name = "costs" if testing else "training_cost"
        realised = torch.stack(costs, -1)
        self.log[name][self.running, trial] = realised if testing else realised.mean(-1)
        return torch.stack(errors).nanmean(0)

    def _learn(self, uniform: Float[Tensor, "R B"]) -> Float[Tensor, " R"]:
        if len(self.memory) < self.config.batch:
            return torch.full((len(uniform),), torch.nan, dtype=self.dtype)
        return self.agent.learn(self.memory.sample(uniform))

    def _inputs(self, observed: Float[Tensor, "R 4"], t: int) -> Float[Tensor, "R inputs"]:
        """Return what the networks are given: scaled features, and perhaps the share of the trial that is over."""
        scaled = cartpole.features(observed).to(self.dtype) / self.scale
        if not self.config.time_input:
            return scaled
        return torch.cat((scaled, scaled.new_full((len(scaled), 1), t / self.config.plant.steps)), -1)

    def _disturbance(self, trial: int) -> Float[Tensor, "R T"]:
        """Return Ornstein-Uhlenbeck noise from 0 on, in shares of the force limit."""
        steps, kept = self.config.plant.steps, 1 - self.config.noise_return
        drawn = self._draw(lambda g: torch.randn(steps, generator=g, dtype=torch.float64), "policy", trial)
        noise, values = torch.zeros(len(drawn), dtype=torch.float64), []
        for t in range(steps):
            noise = kept * noise + self.config.noise_std * drawn[:, t]
            values.append(noise)
        return torch.stack(values, -1)

    def _draw(self, draw: Callable[[Generator], Tensor], *path: str | int) -> Tensor:
        return rng.stacked(draw, [self.seeds[i] for i in self.running.tolist()], *path)

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue."""
        return {
            "done": self.done,
            "running": self.running,
            "log": self.log,
            "memory": self.memory.state(),
            "networks": {name: network.state() for name, network in self.agent.networks.items()},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from ``state()`` of a process made with the same arguments."""
        self.done, self.running, self.log = state["done"], state["running"], state["log"]
        self.memory.restore(state["memory"])
        for name, network in self.agent.networks.items():
            network.restore(state["networks"][name])

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the record, NaN for what was not done.

        ``costs`` [R, trials + 1, T] of the tests, at their numbers among all trials, which begin with 1;
        ``training_cost`` [R, trials + 1] mean cost of a step in the other trials; ``td_error`` [R, blocks] mean square.
        """
        return {name: values.numpy().astype(np.float32) for name, values in self.log.items()}


def memory(config: ModelFreeConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: its memory twice, for a checkpoint, and its log."""
    transitions = min(config.memory, config.trials * config.plant.steps)
    return 2.0 * transitions * (4 * 15 + 8)


start = partial(on_cpu, ModelFree, ModelFreeConfig, "learners without a model")
SWEEPS = [
    Sweep(EXPERIMENT, CONFIGS, start, ("float32", "float64"), {"cpu": GROUP["cpu"]}, repetitions=20, memory=memory)
]
