"""Time per trial of PILCO and Deep PILCO against transitions N, inputs Q and outputs D (statement DE8).

Transitions are synthetic, so that N, Q and D can be chosen. What is timed is what depends on them: fitting the
dynamics model, and predicting a trial through it with the gradient that a policy's search needs. A linear map from
the state to the model's inputs stands for features and policy. A trial is made of as many evaluations as the
configs have optimisation steps (of PILCO: line searches, taken to need one each); a few are timed, the rest is
multiplied out. PILCO has its exact Gaussian process, no inducing inputs, in float64.

A record's arrays are what the timed work computed, which is a function of config and seeds; its times depend on the
machine and stand in the provenance.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import DropoutDynamics
from dropout_uncertainty.data_efficiency.deep_pilco.learner import OURS, DeepPilcoConfig, dtype_of
from dropout_uncertainty.data_efficiency.deep_pilco.particles import match
from dropout_uncertainty.data_efficiency.deep_pilco.planning import standardised
from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import SquaredExponential
from dropout_uncertainty.data_efficiency.pilco import gaussian_process as gp
from dropout_uncertainty.data_efficiency.pilco.learner import PILCO_PAPER, PilcoConfig
from dropout_uncertainty.rng import check_seeds, generator
from dropout_uncertainty.runs.process import threads

__all__ = ["AXES", "METHODS", "Scaling", "ScalingConfig", "start"]

#: Deep PILCO with the moments of all dimensions together (`OURS`), and of each alone (thesis algorithm 4).
METHODS = ("pilco", "deep-pilco", "deep-pilco-diagonal")
AXES = ("transitions", "inputs", "outputs")
START_STD = 0.1  # of the synthetic state at time 0
NOISE_STD = 0.01  # of the synthetic state differences, whose signal has a standard deviation of about 0.07
REPEATS = 2  # the quicker one counts


@dataclass(frozen=True)
class ScalingConfig:
    """Which sizes are timed; where one varies, the others are those of `base`."""

    #: Gives the numbers of evaluations and the length of the trial.
    pilco: PilcoConfig = field(default_factory=lambda: PILCO_PAPER)
    #: The same for Deep PILCO, and network, particles and minibatches.
    deep: DeepPilcoConfig = field(default_factory=lambda: OURS)
    #: Transitions, inputs and outputs; inputs and outputs are the cart-pole's.
    base: tuple[int, int, int] = (400, 6, 4)
    #: Transitions, inputs, outputs.
    pilco_sizes: tuple[tuple[int, ...], ...] = ((50, 100, 200, 400, 800, 1600), (6, 12, 24, 48, 96), (2, 4, 8, 16))
    #: Farther than PILCO's: where they begin to count is to be seen.
    deep_sizes: tuple[tuple[int, ...], ...] = ((50, 200, 800, 3200), (6, 24, 96, 384, 1536), (4, 16, 64, 256))
    timed: int = 5  #: Evaluations of a fit that are timed, and steps of PILCO's predicted trial.

    def sizes(self, method: str) -> tuple[tuple[int, ...], ...]:
        """Return the sizes of a method, one tuple per axis."""
        return self.pilco_sizes if method == "pilco" else self.deep_sizes

    def points(self) -> list[tuple[str, int, tuple[int, int, int]]]:
        """Return what is timed: method, axis that varies, and (N, Q, D)."""
        found = []
        for method in METHODS:
            for axis, sizes in enumerate(self.sizes(method)):
                for size in sizes:
                    n, q, d = (size if i == axis else usual for i, usual in enumerate(self.base))
                    found.append((method, axis, (n, q, d)))
        return found


class Scaling:
    """R repetitions with data of their own; a step takes the times of all of them at one point."""

    def __init__(self, config: ScalingConfig, seeds: Sequence[int], device: str, dtype: torch.dtype) -> None:
        if device != "cpu":
            raise ValueError(f"times are taken on one thread of the CPU, got the device {device}; use --device cpu")
        self.config, self.seeds, self.dtype = config, check_seeds(seeds), dtype
        self.points = config.points()
        self.total, self.done = len(self.points), 0
        blank = torch.full((len(self.seeds), self.total), torch.nan, dtype=torch.float64)
        self.log = {name: blank.clone() for name in ("fit_value", "trial_value", "fit_s", "policy_s")}

    def advance(self) -> str:
        """Take the times at one point."""
        method, _, (n, q, d) = self.points[self.done]
        with threads(1):
            for row, seed in enumerate(self.seeds):
                works = self._pilco(seed, n, q, d) if method == "pilco" else self._deep(method, seed, n, q, d)
                for name, (work, times) in zip(("fit", "policy"), works, strict=True):
                    seconds, value = timed(work)
                    self.log[f"{name}_s"][row, self.done] = times * seconds
                    self.log["fit_value" if name == "fit" else "trial_value"][row, self.done] = value
        total = (self.log["fit_s"] + self.log["policy_s"])[:, self.done].mean()
        self.done += 1
        return f"{method}, N {n}, Q {q}, D {d}: {total:.2f} s"

    def _pilco(self, seed: int, n: int, q: int, d: int) -> list[tuple[Callable[[], float], float]]:
        """Return the work of an evaluation of the likelihood and of some predicted steps, and how often they occur."""
        config, count = self.config.pilco, self.config.timed
        x, y = transitions(seed, n, q, d, torch.float64)
        targets = y.mT[None]
        hyper = gp.initial_hyper(x[None], targets)
        model, _ = gp.GaussianProcess(x[None], targets, hyper).posterior()
        several = x.expand(d, -1, -1)
        fit = lambda: float(gp.negative_log_likelihood(hyper[0], several, targets[0])[0].sum())  # noqa: E731
        inputs = linear_map(seed, d, q, torch.float64)
        policy = lambda: gaussian_trial(model, inputs, count)  # noqa: E731
        return [(fit, float(config.model_iterations)), (policy, config.policy_iterations * config.plant.steps / count)]

    def _deep(self, method: str, seed: int, n: int, q: int, d: int) -> list[tuple[Callable[[], float], float]]:
        """Return the work of some steps of the fit and of a step of the policy, and how often they occur."""
        config, count = self.config.deep, self.config.timed
        x, y = transitions(seed, n, q, d, self.dtype)
        plan = replace(config, matching="diagonal") if method == "deep-pilco-diagonal" else config

        def network() -> DropoutDynamics:
            return DropoutDynamics((seed,), hidden=config.hidden, drop=config.drop, ends=(q, d), dtype=self.dtype)

        def fit() -> float:
            loss, _ = model.fit(
                x[None], y[None], 0, steps=count, rate=config.model_rate, final_rate=config.model_final_rate,
                batch=config.batch, length_scale=config.length_scale,
            )  # fmt: skip
            return float(loss)

        model, untrained = network(), network()
        inputs = linear_map(seed, d, q, self.dtype)
        policy = lambda: particle_trial(untrained, inputs, plan)  # noqa: E731
        return [(fit, config.model_steps / count), (policy, float(config.policy_steps))]

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue."""
        return {"done": self.done, "log": self.log}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from `state()` of a process made with the same arguments."""
        self.done, self.log = state["done"], state["log"]

    def result(self) -> dict[str, np.ndarray]:
        """Return what the work computed [R, point], which shows that it was done."""
        return {name: self.log[name].numpy().astype(np.float32) for name in ("fit_value", "trial_value")}

    def timings(self) -> dict[str, list[list[float]]]:
        """Return CPU seconds per trial of the real budget, by repetition and point: of fit and of policy search."""
        return {f"scaling_{name}": self.log[name].tolist() for name in ("fit_s", "policy_s")}


def transitions(seed: int, n: int, q: int, d: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Return n inputs [N, Q] and noisy smooth differences of a state [N, D]."""
    g = generator(seed, "scaling", n, q, d)
    x, noise = torch.randn(n, q, generator=g, dtype=torch.float64), torch.randn(n, d, generator=g, dtype=torch.float64)
    mix = torch.randn(q, d, generator=g, dtype=torch.float64) / q**0.5
    return x.to(dtype), (0.1 * (x @ mix).sin() + NOISE_STD * noise).to(dtype)


def linear_map(seed: int, d: int, q: int, dtype: torch.dtype) -> Float[Tensor, "D Q"]:
    """Return the map from state to inputs; the gradient is taken in it, as it is in a policy's parameters."""
    noise = torch.randn(d, q, generator=generator(seed, "scaling", "map", d, q), dtype=torch.float64)
    return (noise / (d * q) ** 0.5).to(dtype).requires_grad_()


def gaussian_trial(model: SquaredExponential, inputs: Float[Tensor, "D Q"], steps: int) -> float:
    """Predict some steps through a Gaussian process, with gradient; return the sum of all variances."""
    d = inputs.shape[0]
    state = Gaussian(inputs.new_zeros(1, d), START_STD**2 * torch.eye(d, dtype=inputs.dtype)[None])
    total = inputs.new_zeros(())
    for _ in range(steps):
        change = model.moments(Gaussian(state.mean @ inputs, inputs.mT @ state.cov @ inputs))
        shared = state.cov @ inputs @ change.slope
        state = Gaussian(state.mean + change.mean, state.cov + change.cov + shared + shared.mT)
        total = total + state.cov.diagonal(dim1=-2, dim2=-1).sum()
    torch.autograd.grad(total, inputs)
    return total.item()


def particle_trial(model: DropoutDynamics, inputs: Float[Tensor, "D Q"], plan: DeepPilcoConfig) -> float:
    """Predict a trial with fresh particles and masks, with gradient; return the sum of all variances."""
    (seed,), (d, _), shape = model.seeds, inputs.shape, (1, plan.plant.steps + 1, plan.particles, inputs.shape[0])
    noise = torch.randn(shape, generator=generator(seed, "scaling", "particles", d), dtype=inputs.dtype)
    state, noise = START_STD * noise[:, 0], standardised(noise[:, 1:])
    function = model.function(model.draw(plan.particles, "scaling"))
    total = inputs.new_zeros(())
    for t in range(plan.plant.steps):
        state, _, variance = match(state + function(state @ inputs), noise[:, t], plan.matching)
        total = total + variance.sum()
    torch.autograd.grad(total, inputs)
    return total.item()


def timed(work: Callable[[], float]) -> tuple[float, float]:
    """Return the least CPU seconds of a few calls after one to warm up, and what that first call returned."""
    value, times = work(), []
    for _ in range(REPEATS):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times), value


def start(config: ScalingConfig, seeds: Sequence[int], device: str = "cpu", precision: str = "float32") -> Scaling:
    """Return the process of one unit.

    Raises:
        ValueError: without seeds, for bfloat16, or if times are to be taken elsewhere than on the CPU.
    """
    return Scaling(config, seeds, device, dtype_of(precision))


def memory(config: ScalingConfig) -> float:
    """Return an estimate of the bytes that a repetition takes; sizes are timed one repetition after the other."""
    return 8.0 * 4 * max(config.pilco_sizes[0]) ** 2
