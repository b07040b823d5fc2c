"""All configs of section 5.4 by name, and their units: what the command line knows."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any

from dropout_uncertainty.data_efficiency.ablations import variants
from dropout_uncertainty.data_efficiency.deep_pilco import learner as deep_pilco
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.runs.execute import Unit

__all__ = ["CONFIGS", "units"]

MODULES: tuple[ModuleType, ...] = (pilco, deep_pilco, variants)
CONFIGS: dict[str, Any] = {name: config for module in MODULES for name, config in module.CONFIGS.items()}


def units(name: str, seeds: Sequence[int], **options: str) -> list[Unit]:
    """Return the work of a named config, cut into units; ``options`` are device and precision.

    Raises:
        ValueError: if there is no config of that name.
    """
    for module in MODULES:
        if name in module.CONFIGS:
            return module.units(name, seeds, **options)
    raise ValueError(f"unknown config {name!r}, choose one of {', '.join(CONFIGS)}")
