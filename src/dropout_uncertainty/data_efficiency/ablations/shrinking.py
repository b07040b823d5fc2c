"""The shrinking cloud: what refitting a Gaussian to few particles leaves of the spread that is planned with.

Lines 10 and 11 of the thesis's algorithm 4 fit a Gaussian to K particles, dividing by K, and draw K new ones. Each time
the expected variance falls to 1 - 1/K of what it was, unless the noise of the new particles is standardised. Measured
in three learners after their first trials, with the policy that is about to be tried: variance of the cloud of K
particles, with plain and with standardised noise, beside that of so many particles that nothing is lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from dropout_uncertainty.data_efficiency.deep_pilco import learner, particles, planning
from dropout_uncertainty.data_efficiency.deep_pilco.learner import (
    AS_TEXT,
    AS_WRITTEN,
    OURS,
    DeepPilcoConfig,
    DeepPilcoLearning,
)
from dropout_uncertainty.data_efficiency.deep_pilco.planning import Dynamics
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.settings import widened

__all__ = ["CONFIGS", "FAMILY", "NOISE", "Shrinking", "ShrinkingConfig", "start"]

FAMILY = "shrinking"
#: Ways to draw new particles, by whether their noise is standardised.
NOISE = {"plain": False, "standardised": True}
#: Of the first trials, where the doubt is largest.
TRIALS = 2


@dataclass(frozen=True)
class ShrinkingConfig(DeepPilcoConfig):
    """A learner, and how its clouds are looked at."""

    draws: int = 32  #: Clouds of as many particles as are planned with.
    many: int = 500  #: Particles of the cloud that loses next to nothing.

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.draws < 2 or self.many < self.particles:
            raise ValueError(f"expected 2 or more draws of {self.particles} or more, got {self.draws} and {self.many}")


class Shrinking(DeepPilcoLearning):
    """R repetitions of Deep PILCO; nothing of what is measured goes into learning."""

    config: ShrinkingConfig

    def __init__(
        self, config: ShrinkingConfig, seeds: Sequence[int], device: str, dtype: torch.dtype, kept: Sequence[str] | None
    ) -> None:
        super().__init__(config, seeds, device, dtype, kept)
        size = config.plant.steps, 4
        sizes = {name: size if name == "many_variance" else (len(NOISE), *size) for name in MEASURED}
        self.log |= self._blank(sizes, self.total)

    def _predict(self, model: Dynamics) -> None:
        super()._predict(model)
        config = self.config
        (many,) = self._variances(model, config.many, 1, standard=config.standard_noise)
        self.log["many_variance"][:, self.done] = many
        for row, standard in enumerate(NOISE.values()):
            few = self._variances(model, config.particles, config.draws, standard)
            self.log["mean_variance"][:, self.done, row] = few.mean(0)
            self.log["median_variance"][:, self.done, row] = few.quantile(0.5, 0)

    def _variances(self, model: Dynamics, count: int, draws: int, standard: bool) -> torch.Tensor:
        """Return the variances [draw, R, T, 4] of clouds of ``count`` particles, before they are drawn anew."""
        plan, policy = replace(self.config, standard_noise=standard), self.shape.policy(self.policy)
        drawn = planning.draw(model, plan.plant, plan, count, "shrinking", self.done, blocks=draws)
        with torch.no_grad():
            return torch.stack([particles.predict(policy, plan.plant, d, plan.matching).variance for d in drawn])

    def result(self) -> dict[str, np.ndarray]:
        """Return the record; variances in full precision, since they span many powers of ten."""
        return super().result() | {name: self.log[name].numpy().astype(np.float32) for name in MEASURED}


#: [R, trial, T, 4], the latter two for each kind of noise.
MEASURED = ("many_variance", "mean_variance", "median_variance")
LEARNERS = {"as-text": AS_TEXT, "as-paper": AS_WRITTEN, "ours": OURS}
CONFIGS = {f"{FAMILY}/{name}": widened(ShrinkingConfig, config, trials=TRIALS) for name, config in LEARNERS.items()}


def memory(config: ShrinkingConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: the activations of many particles at one step."""
    return learner.memory(config) + 4.0 * config.many * (sum(config.hidden) + config.basis) * 8


start = partial(learner.start, kind=Shrinking, kept=("costs", *MEASURED))
SWEEPS = [Sweep(EXPERIMENT, CONFIGS, start, ("float32", "float64"), GROUP, 10, memory)]
