"""Time of the two optimisers of Deep PILCO on one thread, against replicas, particles and number of transitions.

    python benchmarks/deep_pilco.py [--quick]

A policy step is one predicted trial of 25 steps with gradient, fresh particles and masks and Adam's step; a dynamics
step is one minibatch of 100 transitions. Both are given in CPU milliseconds per repetition, with the share of the
matrix rate that this machine reaches on a product of two 1024 x 1024 matrices in float32. The last line adds up one
trial of one repetition with the settings of `OURS`.
"""

import argparse
import platform
import time
from collections.abc import Callable
from dataclasses import replace

import torch

from dropout_uncertainty.data_efficiency.deep_pilco import planning
from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import DropoutDynamics
from dropout_uncertainty.data_efficiency.deep_pilco.learner import OURS, start
from dropout_uncertainty.rng import generator

#: Multiplications and additions of one pass of one row through the network, forward.
PASS = 2 * sum(a * b for a, b in ((6, 200), (200, 200), (200, 4)))


def cpu_seconds(work: Callable[[], object], repeats: int) -> float:
    """Return the least CPU time of a few calls, after one to warm up."""
    work()
    times = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def matrix_rate(repeats: int) -> float:
    """Return operations per second of a large matrix product."""
    a = torch.randn(1024, 1024, generator=generator(100, "matrix"))
    return 2 * 1024**3 / cpu_seconds(lambda: a @ a, repeats)


def policy_step(runs: int, particles: int, repeats: int, steps: int = 10) -> float:
    """Return CPU seconds per repetition of one policy step."""
    plan = replace(OURS, particles=particles, policy_steps=steps)
    seeds = tuple(range(100, 100 + runs))
    model, shape = DropoutDynamics(seeds), planning.RBFShape(plan.basis)
    policy = torch.stack([shape.initial(plan.spread, plan.weight_std, generator(seed, "policy")) for seed in seeds])
    work = lambda: planning.improve(model, plan.plant, shape, plan, policy, 0)  # noqa: E731
    return cpu_seconds(work, repeats) / steps / runs


def dynamics_step(runs: int, count: int, repeats: int, steps: int = 20) -> float:
    """Return CPU seconds per repetition of one dynamics step."""
    model = DropoutDynamics(tuple(range(100, 100 + runs)))
    g = generator(100, "benchmark")
    inputs, targets = torch.randn(runs, count, 6, generator=g), torch.randn(runs, count, 4, generator=g)
    options = {"rate": 1e-3, "final_rate": 1.0, "batch": OURS.batch, "length_scale": OURS.length_scale}
    return cpu_seconds(lambda: model.fit(inputs, targets, 0, steps=steps, **options), repeats) / steps / runs


def real_trial(runs: int) -> float:
    """Return CPU seconds per repetition of one real trial, integrated accurately."""
    process = start(OURS, tuple(range(100, 100 + runs)))
    return cpu_seconds(process._run_trial, 1) / runs  # step 0, again and again


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer sizes and repeats")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    repeats = 1 if quick else 5
    rate, moves = matrix_rate(3 * repeats), OURS.plant.steps
    print(f"{platform.processor() or platform.machine()}, torch {torch.__version__}, one thread, float32")
    print(f"matrix product: {rate / 1e9:.0f} thousand million operations per second")

    print("\nMilliseconds per policy step and repetition (share of the matrix rate)")
    widths = (10, 30) if quick else (10, 30, 100)
    print("replicas " + "".join(f"{f'K = {k}':>18}" for k in widths))
    policy = {}
    for runs in (5, 20) if quick else (1, 5, 10, 20, 40):
        for k in widths:
            policy[runs, k] = policy_step(runs, k, repeats)
        shares = [2 * PASS * moves * k / policy[runs, k] / rate for k in widths]
        cells = (f"{1e3 * policy[runs, k]:9.2f} ({share:5.0%})" for k, share in zip(widths, shares, strict=True))
        print(f"{runs:8d} " + " ".join(cells))

    print("\nMilliseconds per dynamics step and repetition (share of the matrix rate)")
    counts = (25, 1000) if quick else (25, 250, 1000)
    print("replicas " + "".join(f"{f'N = {n}':>18}" for n in counts))
    dynamics = {}
    for runs in (5, 20) if quick else (1, 5, 10, 20, 40):
        for n in counts:
            dynamics[runs, n] = dynamics_step(runs, n, repeats)
        shares = [3 * PASS * min(n, OURS.batch) / dynamics[runs, n] / rate for n in counts]
        cells = (f"{1e3 * dynamics[runs, n]:9.2f} ({share:5.0%})" for n, share in zip(counts, shares, strict=True))
        print(f"{runs:8d} " + " ".join(cells))

    parts = OURS.policy_steps * policy[20, 30], OURS.model_steps * dynamics[20, 1000], real_trial(20)
    print(
        f"\nOne trial of one repetition among twenty: {sum(parts):.2f} CPU seconds "
        f"(policy {parts[0]:.2f}, network {parts[1]:.2f}, real trial {parts[2]:.2f})"
    )


if __name__ == "__main__":
    main()
