"""What the learners of section 5.4 share: trials on the real plant, their log, counts, timings and checkpoint."""

import contextlib
import copy
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Generator, Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.data_efficiency import policies
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cartpole import Rollout
from dropout_uncertainty.data_efficiency.plant.cost import cost, solved
from dropout_uncertainty.runs.unit import RunError, precision_dtype
from dropout_uncertainty.settings import of_type

EXPERIMENT = "data_efficiency"
#: Most repetitions of a unit of section 5.4, by device: on a CPU the time per repetition hardly falls beyond.
GROUP = {"cpu": 20, "cuda": 40}
#: `Learner.PRECISION` where the model is a network: observed states follow from the seed, the others are only drawn.
LEAN = {"observed": None} | dict.fromkeys(("predicted_mean", "predicted_std", "predicted_cost", "repeats"), np.float16)


class Learner:
    """R repetitions of thesis algorithm 3 in one batch; a step is a trial, step 0 the random one.

    A method says how it learns between two trials (`_learn`) and what a first policy is (`_initial`).

    Args:
        config: of the method: its plant, the number of trials and more.
        seeds: one per repetition.
        shape: how the parameters of a policy stand in one vector.
        kept: names of the arrays of a small record; None: the whole record.

    Raises:
        ValueError: without seeds.
    """

    #: What computing time is spent on.
    PARTS: tuple[str, ...] = ("model", "policy", "trial")
    #: What is counted in each trial.
    COUNTS: tuple[str, ...] = ()
    #: What a checkpoint holds.
    STATE: tuple[str, ...] = ("done", "policy", "log", "counts", "seconds")
    #: Precision of an array of the record where it is not float32; None: it is left out.
    PRECISION: Mapping[str, Any] = {}
    policy: Tensor  # parameters, [R, P]

    def __init__(self, config: Any, seeds: Sequence[int], shape: Any, kept: Sequence[str] | None = None) -> None:
        self.config, self.seeds, self.shape, self.kept = config, rng.check_seeds(seeds), shape, kept
        self.total, self.done = config.trials + 1, 0
        cartpole.check_interval(config.plant)
        times, steps = config.plant.steps + 1, config.plant.steps
        sizes = {
            "states": (times, 4),  # true
            "observed": (times, 4),
            "forces": (steps,),  # [N]
            "costs": (steps,),  # realised, of the true states 1 ... T
        }
        self.log = self._blank(sizes, self.total)
        self.counts = {name: torch.zeros(len(self.seeds), self.total, dtype=torch.int64) for name in self.COUNTS}
        self.seconds = {name: [0.0] * self.total for name in self.PARTS}  # CPU, all repetitions

    def advance(self) -> str:
        """Learn from the trials so far and run the next one; the first trial has random forces."""
        if self.done:
            self._learn()
        with self._timed("trial"):
            self._run_trial()
        costs = self.log["costs"][:, self.done]
        self.done += 1
        count = int(solved(self.config.plant, costs).sum())
        return f"cost {costs.mean().item():.3f}, solved {count}/{len(self.seeds)}"

    def _learn(self) -> None:
        """Algorithm 3, lines 5 to 8: fit the model, improve the policy, note what the model expects of it."""
        raise NotImplementedError

    def _initial(self, generator: Generator) -> Tensor:
        """Return the parameters of a random policy, [P]."""
        raise NotImplementedError

    def _run_trial(self) -> None:
        """Algorithm 3, line 4: run the trial and keep it."""
        plant, trial = self.config.plant, self.done
        ran = self._execute(*self._begin(), self._act() if trial else self._random())
        self.log["costs"][:, trial] = cost(plant, ran.states[:, 1:])
        for name in ("states", "observed", "forces"):
            self.log[name][:, trial] = getattr(ran, name)

    def _begin(self, prefix: str = "", shape: tuple[int, ...] = ()) -> tuple[Tensor, Tensor]:
        """Return start states and observation noise of a trial, from streams of their own for each prefix."""
        plant = self.config.plant
        begin = self._draw(lambda g: cartpole.start_states(plant, shape, g), prefix + "start")
        times = (*shape, plant.steps + 1)
        return begin, self._draw(lambda g: cartpole.observation_noise(plant, times, g), prefix + "noise")

    def _execute(self, begin: Tensor, noise: Tensor, act: Callable[[Tensor, int], Tensor]) -> Rollout:
        return cartpole.rollout(self.config.plant, begin, act, noise)

    def _act(self) -> Callable[[Tensor, int], Tensor]:
        """Return what the policy does in an observed state."""
        policy = self.shape.policy(self.policy.double().cpu())
        return lambda observed, _: policies.force(policy, self.config.plant, observed)

    def _random(self) -> Callable[[Tensor, int], Tensor]:
        """Return forces drawn evenly within the plant's limit, whatever is observed."""
        plant = self.config.plant
        drawn = self._draw(lambda g: torch.rand(plant.steps, generator=g, dtype=torch.float64), "forces")
        return lambda _, t: plant.force_limit * (2 * drawn[:, t] - 1)

    def _draw(self, draw: Callable[[Generator], Tensor], name: str) -> Tensor:
        return rng.stacked(draw, self.seeds, "environment", name, self.done)

    def _draw_policy(self, *path: int) -> Tensor:
        return rng.stacked(self._initial, self.seeds, "policy", *path)

    def _blank(self, sizes: Mapping[str, tuple[int, ...]], trials: int) -> dict[str, Tensor]:
        """Return arrays [R, trials, ...] to be filled."""
        shape = len(self.seeds), trials
        return {k: torch.full((*shape, *s), torch.nan, dtype=torch.float64) for k, s in sizes.items()}

    @contextlib.contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        started = time.process_time()
        yield
        self.seconds[part][self.done] = time.process_time() - started

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue."""
        held = {name: getattr(self, name) for name in self.STATE}
        return {name: x.state() if hasattr(x, "state") else copy.deepcopy(x) for name, x in held.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from `state()` of a process made with the same arguments."""
        for name, value in state.items():
            if hasattr(own := getattr(self, name), "restore"):
                own.restore(value)
            else:
                setattr(self, name, copy.deepcopy(value))

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the record, [R, trial, ...]; entries of the random trial that mean nothing are NaN."""
        kinds = {name: self.PRECISION.get(name, np.float32) for name in self.log}
        arrays = {name: self.log[name].numpy().astype(kind) for name, kind in kinds.items() if kind is not None}
        return arrays | {name: value.numpy().astype(np.int32) for name, value in self.counts.items()}

    def timings(self) -> dict[str, list[float]]:
        """Return CPU seconds per trial of all repetitions together, by part."""
        return {f"{name}_cpu_s": values for name, values in self.seconds.items()}


def on_cpu(
    kind: Callable[[Any, Sequence[int], torch.dtype], Any],
    settings: type,
    what: str,
    config: Any,
    seeds: Sequence[int],
    device: str = "cpu",
    precision: str = "float32",
) -> Any:
    """Return the process of one unit, of a kind that runs on the CPU alone; `what` names it in words.

    Raises:
        RunError: for another device, or an unknown precision.
        ValueError: without seeds, or for a config of another type than `settings`.
    """
    if torch.device(device).type != "cpu":
        raise RunError(f"{what} run on the CPU, got the device {device}")
    return kind(of_type(settings, config, "config"), seeds, precision_dtype(precision))
