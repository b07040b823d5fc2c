"""Time of one predicted trial with gradient (40 steps) on one thread, beside the stored figures of two other programs.

    python benchmarks/pilco.py [--quick]

Prints CPU seconds per repetition for one repetition and for ten in a batch, then how the time of one prediction step
grows with the number of transitions N, inputs Q and outputs D, with exponents fitted by least squares on log-log axes.
The stored figures (`records/original/pilco_octave_bench.csv`) were taken on another machine, a 2-core server CPU.
"""

import argparse
import csv
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import SquaredExponential
from dropout_uncertainty.data_efficiency.pilco import planning
from dropout_uncertainty.data_efficiency.pilco.gaussian_process import GaussianProcess, initial_hyper
from dropout_uncertainty.data_efficiency.plant.cartpole import MATLAB
from dropout_uncertainty.rng import generator

STORED = Path(__file__).parents[1] / "records" / "original" / "pilco_octave_bench.csv"


def posterior(runs: int, count: int, inputs: int = 6, outputs: int = 4) -> SquaredExponential:
    """Return the posterior over smooth functions from synthetic transitions."""
    g = generator(100, "benchmark")
    x = torch.randn(runs, count, inputs, generator=g, dtype=torch.float64)
    mix = torch.randn(inputs, outputs, generator=g, dtype=torch.float64) / inputs**0.5
    noise = 0.01 * torch.randn(runs, outputs, count, generator=g, dtype=torch.float64)
    y = 0.1 * torch.sin(x @ mix).mT + noise
    functions, _ = GaussianProcess(x, y, initial_hyper(x, y)).posterior()
    return functions


def cpu_seconds(work: Callable[[], object], repeats: int) -> float:
    """Return the least CPU time of a few calls, after one to warm up."""
    work()
    times = []
    for _ in range(repeats):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return min(times)


def trial(runs: int, count: int, repeats: int) -> float:
    """Return CPU seconds per repetition of one objective with gradient."""
    model, shape = posterior(runs, count), planning.PolicyShape(10)
    scales = (0.0, 0.0, 0.0, -0.36, -0.36)
    draws = [shape.initial(MATLAB, 0.1, scales, generator(100 + r, "policy")) for r in range(runs)]
    parameters = torch.stack(draws)
    return cpu_seconds(lambda: planning.objective(model, MATLAB, shape, parameters), repeats) / runs


def step(count: int, inputs: int, outputs: int, repeats: int) -> float:
    """Return CPU seconds of one prediction through the Gaussian process, with gradient."""
    model = posterior(1, count, inputs, outputs)
    cov = 0.01 * torch.eye(inputs, dtype=torch.float64)[None]
    mean = torch.zeros(1, inputs, dtype=torch.float64)

    def work() -> None:
        m, s = mean.clone().requires_grad_(), cov.clone().requires_grad_()
        sum(part.sum() for part in model.moments(Gaussian(m, s))).backward()

    return cpu_seconds(work, repeats)


def stored() -> dict[tuple[str, int], float]:
    """Return CPU seconds by program and N, full Gaussian process with a policy of ten basis functions."""
    with STORED.open() as file:
        rows = [row for row in csv.DictReader(file) if row["policy_basis"] == "10" and "fitc" not in row["note"]]
    return {(row["impl"].split()[0].split("/")[0], int(row["N"])): float(row["cpu_s"]) for row in rows}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer sizes and repeats")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    repeats = 2 if quick else 7
    print(f"{platform.processor() or platform.machine()}, torch {torch.__version__}, one thread, float64")
    print("\nCPU seconds of one objective with gradient, 40 steps, 4 outputs, 6 inputs, 10 basis functions")
    print(f"{'N':>5} {'one':>8} {'of ten':>8} {'Octave':>8} {'ratio':>6} {'TensorFlow':>11} {'ratio':>6}")
    figures = stored()
    for count in (40, 200) if quick else (40, 200, 400):
        one, ten = trial(1, count, repeats), trial(10, count, max(1, repeats // 3))
        octave, tensorflow = figures["pilco-matlab", count], figures["nrontsis", count]
        ratios = octave / one, tensorflow / one
        print(f"{count:5d} {one:8.3f} {ten:8.3f} {octave:8.2f} {ratios[0]:6.1f} {tensorflow:11.2f} {ratios[1]:6.1f}")
    print("\nMilliseconds of one prediction step with gradient, and growth")
    base = {"count": 200, "inputs": 6, "outputs": 4} if quick else {"count": 400, "inputs": 6, "outputs": 4}
    sizes = {"count": (100, 200, 400, 800), "inputs": (4, 8, 16, 32), "outputs": (2, 4, 8, 12)}
    for name, letter in (("count", "N"), ("inputs", "Q"), ("outputs", "D")):
        chosen = sizes[name][:3] if quick else sizes[name]
        times = [step(**{**base, name: size}, repeats=repeats) for size in chosen]
        exponent = np.polyfit(np.log(chosen), np.log(times), 1)[0]
        listed = "  ".join(f"{size}: {1e3 * t:.1f}" for size, t in zip(chosen, times, strict=True))
        print(f"{letter}  {listed}   ~ {letter}^{exponent:.2f}")


if __name__ == "__main__":
    main()
