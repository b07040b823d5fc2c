"""A process run to its end; and a tiny unit of work for the tests of runs, a random walk that takes its time."""

import time
from dataclasses import dataclass

import torch

from dropout_uncertainty import rng
from dropout_uncertainty.runs import execute
from dropout_uncertainty.runs.unit import Unit


def finish(process):
    """Advance a process to its end, and return it."""
    while process.done < process.total:
        process.advance()
    return process


@dataclass(frozen=True)
class Walk:
    steps: int = 40
    seconds: float = 0.0


class RandomWalk:
    def __init__(self, config, seeds):
        self.config, self.seeds, self.total, self.done = config, seeds, config.steps, 0
        self.position = torch.zeros(len(seeds), dtype=torch.float64)
        self.path = []

    def advance(self):
        time.sleep(self.config.seconds)
        self.position += rng.stacked(lambda g: torch.randn((), generator=g, dtype=torch.float64), self.seeds, self.done)
        self.path.append(self.position.clone())
        self.done += 1
        return f"at {self.position[0]:.2f}"

    def state(self):
        return {"done": self.done, "position": self.position, "path": self.path}

    def restore(self, state):
        self.done, self.position, self.path = state["done"], state["position"].clone(), list(state["path"])

    def result(self):
        return {"path": torch.stack(self.path, 1).numpy()}


def start(config, seeds, *, device="cpu", precision="float64"):
    return RandomWalk(config, seeds)


#: As an experiment of the command line.
CONFIGS = {"walk": Walk(), "long": Walk(steps=50)}


def units(name, seeds, *, device="cpu", precision=None):
    return [Unit("toy", name, start, CONFIGS[name], tuple(seeds), device, precision or "float32", "float32")]


def unit(**config):
    return Unit("toy", "walk", start, Walk(**config), (100, 101))


def one_by_one(name, seeds, *, device="cpu"):
    """Return a unit for each seed, with a checkpoint after every step wherever it is computed."""
    return [Unit("toy", name, start_often, CONFIGS[name], (seed,), device) for seed in seeds]


def start_often(config, seeds, **options):
    checkpoint_often()
    return start(config, seeds, **options)


def checkpoint_often():
    execute.CHECKPOINT_SECONDS = -1.0
