"""From the text to a learner that works: each choice in which `OURS` differs from `AS_TEXT`, added or taken alone.

"literal/add/<change>" is the learner of the text with one choice of ours, "literal/drop/<change>" ours with one of the
text. The changes are the fields in which the two configs differ.
"""

from collections.abc import Sequence
from dataclasses import replace

from dropout_uncertainty import records
from dropout_uncertainty.data_efficiency.deep_pilco_experiment import (
    AS_TEXT,
    EXPERIMENT,
    OURS,
    DeepPilcoConfig,
    groups,
    start_search,
)
from dropout_uncertainty.runs import Unit

__all__ = ["CHANGES", "CONFIGS", "FAMILY", "TRIALS", "units"]

FAMILY = "literal"
#: Controlled trials: those within which the thesis's learner succeeds.
TRIALS = 25
#: The fields of the config by the name of the change.
CHANGES = {field.replace("_", "-"): field for field, *_ in records.config_diff(AS_TEXT, OURS)}


def _changed(base: DeepPilcoConfig, other: DeepPilcoConfig, field: str) -> DeepPilcoConfig:
    return replace(base, trials=TRIALS, **{field: getattr(other, field)})


CONFIGS: dict[str, DeepPilcoConfig] = {
    **{f"literal/add/{name}": _changed(AS_TEXT, OURS, field) for name, field in CHANGES.items()},
    **{f"literal/drop/{name}": _changed(OURS, AS_TEXT, field) for name, field in CHANGES.items()},
}


def units(
    name: str, seeds: Sequence[int] = tuple(range(10)), device: str = "cpu", precision: str = "float32"
) -> list[Unit]:
    """Return the work of a named config, cut as Deep PILCO's is.

    Raises:
        ValueError: if there is no config of that name.
    """
    if name not in CONFIGS:
        raise ValueError(f"unknown config {name!r}, choose one of {', '.join(CONFIGS)}")
    return [
        Unit(EXPERIMENT, name, start_search, CONFIGS[name], group, device, precision) for group in groups(seeds, device)
    ]
