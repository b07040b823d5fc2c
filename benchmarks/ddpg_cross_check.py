"""Our DDPG beside that of stable-baselines3 on the same cart-pole: cost of tests over 400 trials, five seeds each.

    python benchmarks/ddpg_cross_check.py [--trials 400] [--seeds 5]

Ours are the stored runs of the best setting of the search. Its DDPG is given the same features, widths, step sizes,
noise and tests; what is left different is printed with the table. Ten minutes of one core.
"""

import argparse
import itertools

import gymnasium
import numpy as np
import torch
from stable_baselines3 import DDPG
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise

from dropout_uncertainty.data_efficiency.model_free.config import SEARCH, ModelFreeConfig
from dropout_uncertainty.data_efficiency.model_free.report.analysis import searched
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.environment import CartPoleSwingUp
from dropout_uncertainty.stats import in_words, t_interval

NAME = "ddpg-search/noise-1-no-decay-not-normalised"


class Features(gymnasium.ObservationWrapper):
    """The features that our learners see, scaled as theirs."""

    def __init__(self, config: ModelFreeConfig) -> None:
        super().__init__(CartPoleSwingUp(config.plant))
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (5,), np.float32)
        self.scale = np.array(config.scale)

    def observation(self, state: np.ndarray) -> np.ndarray:
        """Return x, v, w, sin θ and cos θ, each by its spread."""
        features = cartpole.features(torch.from_numpy(state)[None])[0].numpy()
        return (features / self.scale).astype(np.float32)


class TwoRates(DDPG):
    """DDPG whose policy and Q keep step sizes of their own, and whose Q has a decay; theirs has one size for both."""

    config: ModelFreeConfig

    def _update_learning_rate(self, optimizers: object) -> None:
        for part, rate, decay in (
            (self.actor, self.config.policy_rate, 0.0), (self.critic, self.config.value_rate, self.config.value_decay),
        ):  # fmt: skip
            part.optimizer.param_groups[0].update(lr=rate, weight_decay=decay)


class Tests(BaseCallback):
    """Takes the noise away in every tenth trial, and keeps what such a trial cost."""

    def __init__(self, every: int) -> None:
        super().__init__()
        self.every, self.trial, self.cost, self.costs = every, 1, 0.0, []
        self.noise: OrnsteinUhlenbeckActionNoise | None = None

    def _on_step(self) -> bool:
        self.cost += 1 - float(self.locals["rewards"][0])
        if self.locals["dones"][0]:
            if self.trial % self.every == 0:
                self.costs.append(self.cost)
            self.trial, self.cost = self.trial + 1, 0.0
            self.noise = self.noise or self.model.action_noise
            self.model.action_noise = None if self.trial % self.every == 0 else self.noise
        return True


def theirs(config: ModelFreeConfig, trials: int, seed: int) -> np.ndarray:
    """Return the mean cost per step of the tests [tests]."""
    noise = OrnsteinUhlenbeckActionNoise(np.zeros(1), config.noise_std * np.ones(1), theta=config.noise_return, dt=1.0)
    model = TwoRates(
        "MlpPolicy", Features(config), batch_size=config.batch, gamma=config.discount, tau=config.follow, seed=seed,
        learning_starts=0, buffer_size=trials * config.plant.steps, action_noise=noise, device="cpu",
        policy_kwargs={"net_arch": list(config.hidden)},
    )  # fmt: skip
    model.config, tests = config, Tests(config.test_every)
    model.learn(trials * config.plant.steps, callback=tests)
    return np.array(tests.costs) / config.plant.steps


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    learning, every = searched()[NAME], SEARCH[NAME].test_every
    ours = learning.counted(learning.trial_costs)
    others = np.stack([theirs(SEARCH[NAME], asked.trials, 100 + seed) for seed in range(asked.seeds)])
    edges = range(0, asked.trials + 1, 100) if asked.trials % 100 == 0 else (0, asked.trials)
    print(f"{'trials':>10} {'ours':>22} {'stable-baselines3':>22}")
    for low, high in itertools.pairwise(edges):
        block = slice(low // every, high // every)
        columns = (in_words(t_interval(costs[:, block].mean(1))) for costs in (ours, others))
        print(f"{f'{low + 1}-{high}':>10}", *(f"{column:>22}" for column in columns))
    print("Different in theirs: the action joins Q at its input, layers start and end with PyTorch's weights.")


if __name__ == "__main__":
    main()
