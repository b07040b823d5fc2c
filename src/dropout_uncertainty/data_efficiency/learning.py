"""What the learners of section 5.4 share."""

from collections.abc import Sequence

import torch

__all__ = ["EXPERIMENT", "GROUP", "groups"]

EXPERIMENT = "data_efficiency"
#: Repetitions per unit of section 5.4, by device: on a CPU the time per repetition hardly falls beyond.
GROUP = {"cpu": 20, "cuda": 40}


def groups(seeds: Sequence[int], device: str) -> list[tuple[int, ...]]:
    """Cut seeds into those of each unit on a device, "cpu" or "cuda" (`GROUP`)."""
    size = GROUP[torch.device(device).type]
    return [tuple(seeds[i : i + size]) for i in range(0, len(seeds), size)]
