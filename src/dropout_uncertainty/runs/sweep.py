"""From named configs to units of work: one way to cut seeds, for all sections."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from dropout_uncertainty.errors import unknown
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.process import Process
from dropout_uncertainty.runs.unit import RunError, Unit


@dataclass(frozen=True)
class Sweep:
    """Configs of an experiment whose seeds are cut into units in one way."""

    experiment: str  #: its name.
    configs: Mapping[str, Any]  #: by their names.
    start: Callable[..., Process]  #: makes the process of a unit.
    #: those that it can run in; the first is the section's own, that of the published records.
    precisions: Sequence[str]
    group: Mapping[str, int]  #: most seeds of a unit, by device type.
    repetitions: int  #: seeds that are run where none are named: 0, 1, ...
    memory: Callable[[Any], float]  #: bytes that a repetition of a config takes at the height of the work, an estimate.

    def units(
        self, name: str, seeds: Sequence[int] | None = None, device: str = "cpu", precision: str | None = None
    ) -> list[Unit]:
        """Return the units of a named config; raises RunError for a precision or device that it cannot run on."""
        own, config = self.precisions[0], self.configs[name]
        if (precision or own) not in self.precisions:
            choices = " or ".join(self.precisions)
            raise RunError(f"{self.experiment}/{name} runs in {choices}, got the precision {precision}")
        seeds = range(self.repetitions) if seeds is None else list(seeds)
        kind = torch.device(device).type
        if kind not in self.group:
            raise RunError(f"{self.experiment}/{name} runs on {' or '.join(self.group)}, got the device {device}")
        size = self.group[kind]
        apart = [[seed for seed in seeds if (seed < records.DEVELOPMENT) == published] for published in (True, False)]
        groups = [tuple(part[i : i + size]) for part in apart for i in range(0, len(part), size)]
        return [
            Unit(self.experiment, name, self.start, config, group, device, precision or own, own,
                 self.memory(config) * len(group))
            for group in groups
        ]  # fmt: skip


def units(
    sweeps: Iterable[Sweep],
    name: str,
    seeds: Sequence[int] | None = None,
    device: str = "cpu",
    precision: str | None = None,
) -> list[Unit]:
    """Return the work of the config of that name among some sweeps; by default in the section's own precision.

    Raises:
        RunError: if there is no config of that name, or it cannot run in that precision or on that device.
    """
    of = {config: sweep for sweep in sweeps for config in sweep.configs}
    if name not in of:
        raise RunError(unknown("config", name, of))
    return of[name].units(name, seeds, device, precision)
