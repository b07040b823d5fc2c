"""From the text to a learner that works: each choice in which `OURS` differs from `AS_TEXT`, added or taken alone.

"literal/add/<change>" is the learner of the text with one choice of ours, "literal/drop/<change>" ours with one of the
text. The changes are the fields in which the two configs differ.
"""

from dataclasses import replace

from dropout_uncertainty.data_efficiency.deep_pilco import learner
from dropout_uncertainty.data_efficiency.deep_pilco.learner import AS_TEXT, OURS, DeepPilcoConfig
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.settings import config_diff

__all__ = ["CHANGES", "CONFIGS", "FAMILY", "TRIALS"]

FAMILY = "literal"
#: Controlled trials: those within which the thesis's learner succeeds.
TRIALS = 25
#: The fields of the config by the name of the change.
CHANGES = {field.replace("_", "-"): field for field, *_ in config_diff(AS_TEXT, OURS)}


def _changed(base: DeepPilcoConfig, other: DeepPilcoConfig, field: str) -> DeepPilcoConfig:
    return replace(base, trials=TRIALS, **{field: getattr(other, field)})


CONFIGS: dict[str, DeepPilcoConfig] = {
    **{f"literal/add/{name}": _changed(AS_TEXT, OURS, field) for name, field in CHANGES.items()},
    **{f"literal/drop/{name}": _changed(OURS, AS_TEXT, field) for name, field in CHANGES.items()},
}


SWEEPS = [Sweep(EXPERIMENT, CONFIGS, learner.start_search, ("float32", "float64"), GROUP, 10, learner.memory)]
