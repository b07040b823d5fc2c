"""All configs of section 5.4 by name, and their units: what the command line knows."""

from functools import partial
from typing import Any

from dropout_uncertainty.data_efficiency.ablations import doubt, gradients, literal, mchutchon, shrinking, variants
from dropout_uncertainty.data_efficiency.deep_pilco import learner as deep_pilco
from dropout_uncertainty.data_efficiency.hidden_state import control, language, prediction
from dropout_uncertainty.data_efficiency.model_free import learner as model_free
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.runs import sweep

__all__ = ["CONFIGS", "units"]

MODULES = (
    pilco, deep_pilco, variants, doubt, literal, mchutchon, gradients, shrinking, model_free, prediction, control,
    language,
)  # fmt: skip
SWEEPS = tuple(sweep for module in MODULES for sweep in module.SWEEPS)
CONFIGS: dict[str, Any] = {name: config for sweep in SWEEPS for name, config in sweep.configs.items()}


#: The units of a named config.
units = partial(sweep.units, SWEEPS)
