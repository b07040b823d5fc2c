"""Learning steps a second of DDPG and NAF as printed, twenty repetitions together, on one thread.

    python benchmarks/model_free.py [--quick]

Beside each stands what the same machine makes of the matrix products of such a step alone, at the same moment, and, if
stable-baselines3 is installed, its own DDPG with networks of the same widths (one repetition; no batch normalisation).
"""

import argparse
import contextlib
import time
from collections.abc import Callable

import torch

from dropout_uncertainty.data_efficiency.model_free import learner
from dropout_uncertainty.data_efficiency.model_free.config import ModelFreeConfig

SEEDS = tuple(range(100, 120))


def cpu_seconds(work: Callable[[], object], repeats: int) -> float:
    """Return the CPU seconds of one call, mean over some after one to warm up."""
    work()
    started = time.process_time()
    for _ in range(repeats):
        work()
    return (time.process_time() - started) / repeats


def learning_step(config: ModelFreeConfig) -> Callable[[], object]:
    """Return one learning step of all repetitions."""
    process = learner.start(config, SEEDS)
    for trial in range(1, 5):
        process._trial(trial, testing=False)
    uniform = torch.rand(len(SEEDS), config.batch, dtype=torch.float64)
    return lambda: process.agent.learn(process.memory.sample(uniform))


def products(config: ModelFreeConfig) -> Callable[[], object]:
    """Return the products of the widest layer in such a step, forward and back: nearly all there are."""
    inner, outer = config.hidden[0], config.hidden[1]
    rows, weights = torch.randn(len(SEEDS), config.batch, inner), torch.randn(len(SEEDS), inner, outer)
    slope = torch.randn(len(SEEDS), config.batch, outer)
    forward, back_rows, back_weights = (5, 3, 2) if config.method == "ddpg" else (2, 1, 1)

    def work() -> None:
        for _ in range(forward):
            torch.bmm(rows, weights)
        for _ in range(back_rows):
            torch.bmm(slope, weights.mT)
        for _ in range(back_weights):
            torch.bmm(rows.mT, slope)

    return work


def stable_baselines(config: ModelFreeConfig, steps: int) -> float | None:
    """Return learning steps a second of stable-baselines3's DDPG on our cart-pole; None where it is not installed."""
    with contextlib.suppress(ModuleNotFoundError):
        from stable_baselines3 import DDPG

        from dropout_uncertainty.data_efficiency.plant.environment import CartPoleSwingUp

        model = DDPG(
            "MlpPolicy", CartPoleSwingUp(), learning_starts=100, batch_size=config.batch, gamma=config.discount,
            tau=config.follow, policy_kwargs={"net_arch": list(config.hidden)}, seed=100, device="cpu",
        )  # fmt: skip
        model.learn(200)
        started = time.process_time()
        model.learn(steps, reset_num_timesteps=False)
        return steps / (time.process_time() - started)
    return None


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer repeats")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    repeats = 5 if quick else 100
    print(f"{'':16} {'steps/s':>8} {'products alone':>15} {'share':>6}")
    for name in ("ddpg-as-printed", "naf-as-printed"):
        config = learner.CONFIGS[name]
        ours, alone = (len(SEEDS) / cpu_seconds(make(config), repeats) for make in (learning_step, products))
        print(f"{name:16} {ours:8.0f} {alone:15.0f} {ours / alone:6.0%}")
    theirs = stable_baselines(learner.CONFIGS["ddpg-as-printed"], 100 if quick else 1000)
    print(
        "stable-baselines3's DDPG:",
        "not installed" if theirs is None else f"{theirs:.0f} steps/s, environment included",
    )


if __name__ == "__main__":
    main()
