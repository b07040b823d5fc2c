"""Which model predicts a cart-pole best of which only x and θ are seen, with noise (statement DE13).

The trials are those that Deep PILCO has run and that are stored: their true states lose the velocities and get new
noise, their forces stay. After some trials of data a model is trained anew, and predicts the trials that came next from
their first observation and their forces alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.data_efficiency.hidden_state.models import SEEN, ModelConfig, free_run, inputs_of
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP, on_cpu
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.settings import at_least, widened

__all__ = ["CONFIGS", "FAMILY", "MODELS", "Prediction", "PredictionConfig", "stored_trials"]

FAMILY = "hidden"
#: Stored repetitions; development seeds, from 100 on, take other trials than published ones.
STORED = 40


@dataclass(frozen=True)
class PredictionConfig(ModelConfig):
    """A model and what it has to predict."""

    source: str = "deep-pilco-ours"  #: Config whose stored trials are data.
    sizes: tuple[int, ...] = (5, 10, 20)  #: Trials of data.
    ahead: int = 5  #: Trials that are predicted: those that came next.
    particles: int = 50  #: Of a predicted trial.
    noise: float = 0.01  #: Standard deviation of the noise on x [m] and θ [rad].

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(1, sizes=min(self.sizes, default=0), ahead=self.ahead)
        at_least(2, particles=self.particles)


def stored_trials(name: str, seeds: Sequence[int]) -> tuple[Float[Tensor, "R N times 2"], Float[Tensor, "R N T"]]:
    """Return x [m] and θ [rad] without noise, and the forces [N], of a learner's stored trials; trial 0 is random.

    A seed has the trials of the repetition of that number, from 40 on again from the first.

    Raises:
        UserError: if they are not stored, or without the forces.
    """
    found = {s: (r, i) for r in records.find(EXPERIMENT, name=name) for i, s in enumerate(r.seeds)}
    wanted = [seed % STORED for seed in seeds]
    if missing := [seed for seed in wanted if seed not in found]:
        raise UserError(
            f"expected stored trials of {name} for the seeds {missing}, got none in {records.root()}: "
            f"dropout-uncertainty run {EXPERIMENT} --config {name} --seeds 0-19 makes them"
        )
    rows = [found[seed] for seed in wanted]
    if any("forces" not in record.arrays for record, _ in rows):
        raise UserError(f"expected trials with their forces, the records of {name} keep none: take deep-pilco-ours")
    states, forces = (np.stack([record.arrays[key][i] for record, i in rows]) for key in ("states", "forces"))
    return torch.tensor(states)[..., SEEN].double(), torch.tensor(forces).double()


class Prediction:
    """R repetitions with trials of their own; a step trains on one size of data and predicts what came next."""

    def __init__(self, config: PredictionConfig, seeds: Sequence[int], dtype: torch.dtype) -> None:
        self.config, self.seeds, self.dtype = config, rng.check_seeds(seeds), dtype
        self.total, self.done = len(config.sizes), 0
        true, forces = stored_trials(config.source, self.seeds)
        if max(config.sizes) + config.ahead > true.shape[1]:
            raise ValueError(
                f"expected {max(config.sizes)} trials and {config.ahead} more, got {true.shape[1]} of {config.source}"
            )
        noise = rng.normal(self.seeds, tuple(true.shape[1:]), "hidden", "observations")
        self.observed, self.forces = (true + config.noise * noise).to(dtype), forces.to(dtype)
        shape = len(self.seeds), self.total, config.ahead, forces.shape[-1], len(SEEN)
        self.log = {name: torch.full(shape, torch.nan) for name in ("observed", "predicted_mean", "predicted_std")}
        self.log |= {"loss": torch.full(shape[:2], torch.nan), "repairs": torch.zeros(shape[:2])}

    def advance(self) -> str:
        """Train on the next size of data and predict."""
        config, size, steps = self.config, self.config.sizes[self.done], self.forces.shape[-1]
        old, new = slice(0, size), slice(size, size + config.ahead)
        model = config.model(self.seeds, self.dtype)
        seen = inputs_of(self.observed[:, old, :-1], self.forces[:, old])
        loss, repairs = model.fit(seen, self.observed[:, old].diff(dim=2), "fit", size, how=config.fit(steps))
        shape = config.ahead, config.particles, steps, len(SEEN)
        noise = rng.normal(self.seeds, shape, "hidden", "particles", size).to(self.dtype)
        first, true = self.observed[:, new, 0], self.observed[:, new, 1:]
        mean, std = free_run(model, first, self.forces[:, new], noise, "predict", size)
        values = {"observed": true, "predicted_mean": mean, "predicted_std": std, "loss": loss, "repairs": repairs}
        for name, value in values.items():
            self.log[name][:, self.done] = value.detach()
        self.done += 1
        return f"{size} trials: loss {loss.mean().item():.2f}"

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue."""
        return {"done": self.done, "log": self.log}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from `state()` of a process made with the same arguments."""
        self.done, self.log = state["done"], state["log"]

    def result(self) -> dict[str, np.ndarray]:
        """Return observations and predictions [R, size, trial, T, (x, θ)], and loss and repairs of the fits."""
        return {name: value.numpy().astype(np.float32) for name, value in self.log.items()}


FEED_FORWARD = ModelConfig("feed-forward")
LSTM = ModelConfig("recurrent", hidden=(64,))
#: Models by name.
MODELS = {
    "last-one": FEED_FORWARD,
    "last-four": replace(FEED_FORWARD, window=4),
    "lstm-held": LSTM,
    "lstm-fresh": replace(LSTM, held=False),
    "lstm-no-dropout": replace(LSTM, drop=0.0, input_drop=0.0),
}
CONFIGS = {f"{FAMILY}/{name}": widened(PredictionConfig, model) for name, model in MODELS.items()}


def memory(config: PredictionConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: the masks and activations of particles at all steps."""
    return 4.0 * config.ahead * config.particles * PAPER.steps * sum(config.hidden) * 12


start = partial(on_cpu, Prediction, PredictionConfig, "models of hidden states")
SWEEPS = [Sweep(EXPERIMENT, CONFIGS, start, ("float32", "float64"), {"cpu": GROUP["cpu"]}, 20, memory)]
