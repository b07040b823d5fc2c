"""All configs of section 5.4 by name, and their units: what the command line knows."""

from collections.abc import Sequence
from typing import Any

from dropout_uncertainty.data_efficiency.ablations import variants
from dropout_uncertainty.data_efficiency.deep_pilco import learner as deep_pilco
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.runs import sweep
from dropout_uncertainty.runs.execute import Unit

__all__ = ["CONFIGS", "units"]

SWEEPS = (*pilco.SWEEPS, *deep_pilco.SWEEPS, *variants.SWEEPS)
CONFIGS: dict[str, Any] = {**pilco.CONFIGS, **deep_pilco.CONFIGS, **variants.CONFIGS}


def units(
    name: str, seeds: Sequence[int] | None = None, device: str = "cpu", precision: str | None = None
) -> list[Unit]:
    """Return the units of a named config, as `sweep.units` does."""
    return sweep.units(SWEEPS, name, seeds, device, precision)
