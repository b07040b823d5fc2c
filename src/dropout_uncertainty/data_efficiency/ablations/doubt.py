"""What doubt is worth: learners that plan with and without it, paired seed by seed (statements DE2 and DE7).

Deep PILCO as `OURS`, its first trials beside networks whose doubt is left out at planning or never there, and beside
ensembles; as the thesis says it, on draws and on the mean network; and PILCO with its variance and without.
`deep-pilco-ours`, `deep-pilco-as-text` and `pilco-paper-15` are the learners with doubt that the others pair up with.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dropout_uncertainty.data_efficiency.deep_pilco import learner
from dropout_uncertainty.data_efficiency.deep_pilco.learner import AS_TEXT, OURS, DeepPilcoConfig, SearchRun
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.data_efficiency.pilco.learner import LONGER, PilcoConfig, PilcoLearning
from dropout_uncertainty.runs import sweep
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.runs.unit import Unit, precision_dtype

__all__ = ["CONFIGS", "FAMILY", "TRIALS", "WITH_DOUBT", "DoubtRun", "PilcoDoubtRun", "start", "units"]

FAMILY = "doubt"
#: Controlled trials of the Deep PILCO learners: those within which the thesis's succeeds.
TRIALS = 25
#: Members of the ensembles.
MEMBERS = 5
#: The published learner with doubt that each config is compared with.
WITH_DOUBT = {
    "mean-network": "deep-pilco-ours",
    "no-dropout": "deep-pilco-ours",
    "ensemble": "deep-pilco-ours",
    "ensemble-mean": "doubt/ensemble",
    "as-text-mean": "deep-pilco-as-text",
    "pilco-mean": "pilco-paper-15",
}

BASE = replace(OURS, trials=TRIALS)
ENSEMBLE = replace(BASE, drop=0.0, ensemble=MEMBERS)
CONFIGS: dict[str, DeepPilcoConfig | PilcoConfig] = {
    "doubt/mean-network": replace(BASE, doubt=False),
    "doubt/no-dropout": replace(BASE, drop=0.0),
    "doubt/ensemble": ENSEMBLE,
    "doubt/ensemble-mean": replace(ENSEMBLE, doubt=False),
    "doubt/as-text-mean": replace(AS_TEXT, trials=TRIALS, doubt=False),
    "doubt/pilco-mean": replace(LONGER["pilco-paper-15"], doubt=False),
}


class DoubtRun(SearchRun):
    """Deep PILCO with a small record: costs, and predicted and true states."""

    KEPT = ("costs", "predicted_cost", "states", "predicted_mean", "predicted_std")


class PilcoDoubtRun(PilcoLearning):
    """PILCO with a small record of the same."""

    KEPT = ("costs", "predicted_cost", "states", "predicted_mean", "predicted_variance")

    def result(self) -> dict[str, np.ndarray]:
        """Return predicted and realised costs and states [R, trial, ...], and how often something was mended."""
        arrays = super().result()
        return {name: arrays[name] for name in (*self.KEPT, *self.COUNTS)}


def start(
    config: DeepPilcoConfig | PilcoConfig, seeds: Sequence[int], device: str = "cpu", precision: str = "float32"
) -> DoubtRun | PilcoDoubtRun:
    """Return the process of one unit.

    Raises:
        ValueError: without seeds, or for a precision that the method does not run in.
    """
    if isinstance(config, PilcoConfig):
        if precision != "float64":
            raise ValueError(f"PILCO runs in float64, got {precision}; leave it out")
        return PilcoDoubtRun(config, seeds, device)
    if precision == "bfloat16":
        raise ValueError("Deep PILCO runs in float32 or float64, got bfloat16")
    return DoubtRun(config, seeds, device, precision_dtype(precision))


SWEEPS = [
    Sweep(EXPERIMENT, {n: c for n, c in CONFIGS.items() if isinstance(c, kind)}, start, precisions, GROUP, 40, memory)
    for kind, precisions, memory in (
        (DeepPilcoConfig, ("float32", "float64"), learner.memory),
        (PilcoConfig, ("float64",), pilco.memory),
    )
]


def units(
    name: str, seeds: Sequence[int] | None = None, device: str = "cpu", precision: str | None = None
) -> list[Unit]:
    """Return the units of a named config, as `sweep.units` does."""
    return sweep.units(SWEEPS, name, seeds, device, precision)
