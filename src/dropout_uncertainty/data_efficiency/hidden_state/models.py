"""Models of what is seen of the cart-pole: from observations (x, θ) and forces to the change of the observation.

A feed-forward network is given the last observation or the last few; a recurrent one reads all of them, one by one.
Both are followed step by step: what has been seen is a value, ``memory``, and so is the draw of the weights. Networks
are given x [m], sin θ, cos θ and the force [N], and predict the differences of x and θ to the next observation, with
Gaussian noise of learned size. Replicas R first, then sequences N or particles K.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import Masks, weight_decay
from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import (
    LOG_NOISE_START,
    DropoutDynamics,
    Networks,
    check_finite,
    scaling,
    without_gradient,
)
from dropout_uncertainty.data_efficiency.hidden_state.lstm import LSTM
from dropout_uncertainty.settings import at_least, tidy

__all__ = ["INPUTS", "OUTPUTS", "SEEN", "Fit", "Model", "ModelConfig", "Recurrent", "Windowed", "free_run", "windows"]

#: What a network is given of a step (x, sin θ, cos θ, force), and what it predicts (differences of x and θ).
INPUTS, OUTPUTS = 4, 2
#: Places of x and θ in a state.
SEEN = (0, 3)
KINDS = ("feed-forward", "recurrent")


@dataclass(frozen=True)
class Fit:
    """How a model is trained, on all sequences with a new Adam."""

    steps: int
    rate: float
    final_rate: float
    batch: int
    length_scale: float


@runtime_checkable
class Model(Protocol):
    """What can be fitted to sequences and followed."""

    def fit(
        self, seen: Float[Tensor, "R N T D"], changes: Float[Tensor, "R N T E"], *path: str | int, how: Fit
    ) -> tuple[Float[Tensor, " R"], Int[Tensor, " R"]]:
        """Train; return the late objective [nats per step] and how often a gradient was left out."""

    def draw(self, count: int, steps: int, *path: str | int) -> Any:
        """Return ``count`` weight draws per replica for so many steps."""

    def step(self, seen: Float[Tensor, "R K D"], memory: Any, draw: Any, t: int) -> tuple[Tensor, Any]:
        """Return the predicted change [R, K, E] and what is then remembered; ``memory`` is None before step 0."""

    def noise_std(self) -> Float[Tensor, "R E"]:
        """Return the learned standard deviation of the noise, in SI units."""

    def select(self, replicas: Sequence[int]) -> "Model":
        """Return a copy with some of the replicas."""

    def state(self) -> dict[str, Tensor]:
        """Return a copy of all that a fit changes."""

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from `state()` of a model made with the same arguments."""


def inputs_of(observed: Float[Tensor, "*batch 2"], forces: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 4"]:
    """Return what a network is given for observations (x, θ) and forces."""
    x, theta = observed.unbind(-1)
    return torch.stack((x, theta.sin(), theta.cos(), forces), -1)


def before(first: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Return what stands for the steps before the first: the same observation and no force, for a pole at rest."""
    return torch.cat((first[..., :3], torch.zeros_like(first[..., 3:])), -1)


def windows(seen: Float[Tensor, "R N T D"], length: int) -> Float[Tensor, "R N T L"]:
    """Return each step's last ``length`` inputs side by side, the latest last."""
    padded = torch.cat((before(seen[:, :, :1]).expand(-1, -1, length - 1, -1), seen), 2)
    return padded.unfold(2, length, 1).mT.flatten(-2)


class Windowed:
    """R dropout networks on the last observations; a particle keeps its draw over the trajectory."""

    def __init__(self, seeds: Sequence[int], length: int, **options: Any) -> None:
        self.length = length
        self.networks = DropoutDynamics(seeds, ends=(INPUTS * length, OUTPUTS), **options)

    def fit(
        self, seen: Float[Tensor, "R N T D"], changes: Float[Tensor, "R N T E"], *path: str | int, how: Fit
    ) -> tuple[Float[Tensor, " R"], Int[Tensor, " R"]]:
        """Train on single steps, a draw for each (`DropoutDynamics.fit`)."""
        rows = windows(seen, self.length).flatten(1, 2)
        return self.networks.fit(rows, changes.flatten(1, 2), *path, **vars(how))

    def draw(self, count: int, steps: int, *path: str | int) -> Any:
        """Return the functions that the particles follow."""
        return self.networks.function(self.networks.draw(count, *path))

    def step(self, seen: Float[Tensor, "R K D"], memory: Any, draw: Any, t: int) -> tuple[Tensor, Any]:
        """Return the predicted change and the last inputs."""
        past = [before(seen)] * (self.length - 1) if memory is None else memory
        window = [*past, seen]
        return draw(torch.cat(window, -1)), window[1:]

    def noise_std(self) -> Float[Tensor, "R E"]:
        """Return the learned standard deviation of the noise, in SI units."""
        return self.networks.noise_std()

    def select(self, replicas: Sequence[int]) -> "Windowed":
        """Return a copy with some of the replicas."""
        part = copy.copy(self)
        part.networks = self.networks.select(replicas)
        return part

    def state(self) -> dict[str, Tensor]:
        """Return a copy of all that a fit changes."""
        return self.networks.state()

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from `state()` of a model made with the same arguments."""
        self.networks.restore(state)


class Recurrent(Networks):
    """R recurrent networks that read the sequence; masks are held over it, or fresh at every step.

    Args:
        seeds: one per replica.
        width: units of the layer.
        drop: drop probabilities of the inputs, of the recurrent state and of the units before the output.
        held: whether a sequence has one draw of the weights, in training and afterwards.
        dtype: of the networks.
    """

    def __init__(
        self, seeds: Sequence[int], width: int, drop: Sequence[float], held: bool, dtype: torch.dtype = torch.float32
    ) -> None:
        self.seeds, self.width, self.drop, self.held = tuple(seeds), width, tuple(drop), held
        blank = torch.zeros(len(self.seeds), 1, 1, dtype=dtype)
        self.log_noise = nn.Parameter(blank.expand(-1, 1, OUTPUTS) + LOG_NOISE_START)
        self.net: LSTM = self._new_net(self.seeds)
        self.input_mean, self.input_std = blank, blank + 1
        self.target_mean, self.target_std = blank, blank + 1

    def fit(
        self, seen: Float[Tensor, "R N T D"], changes: Float[Tensor, "R N T E"], *path: str | int, how: Fit
    ) -> tuple[Float[Tensor, " R"], Int[Tensor, " R"]]:
        """Train on whole sequences: the objective is that of `DropoutDynamics.fit`, a step being a transition.

        ``how.batch`` counts sequences. The network's output is the mean of a step's change given all before it. A
        network with a parameter that is not finite begins anew, which counts as a gradient that was left out.

        Raises:
            ValueError: if a number is not finite.
        """
        check_finite(seen, changes)
        repairs = self._restart_broken()
        self.input_mean, self.input_std = scaling(seen.flatten(1, 2))
        self.target_mean, self.target_std = scaling(changes.flatten(1, 2))
        x = (seen - self.input_mean[:, None]) / self.input_std[:, None]
        y = (changes - self.target_mean[:, None]) / self.target_std[:, None]
        decays = [weight_decay(x[0, ..., 0].numel(), p, how.length_scale, 1.0) for p in self.drop]
        parameters = [*self.net.parameters(), self.log_noise]
        adam = torch.optim.Adam(parameters, lr=how.rate, fused=True)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, how.steps, eta_min=how.rate * how.final_rate)
        late = torch.zeros_like(x[:, 0, 0, 0])
        tail = max(1, how.steps // 10)
        for step in range(how.steps):
            loss = self._loss(*self._batch(x, y, how.batch, *path, step))
            loss = loss + sum(d * w.square().sum((1, 2)) for d, w in zip(decays, self.net.weights, strict=True))
            adam.zero_grad()
            loss.sum().backward()
            repairs += without_gradient(~loss.detach().isfinite(), parameters)
            adam.step()
            schedule.step()
            if step >= how.steps - tail:
                late += loss.detach() / tail
        return late, repairs

    def _new_net(self, seeds: Sequence[int]) -> LSTM:
        """Return networks of this kind before any fit, in the precision of ``log_noise``."""
        return LSTM((INPUTS, self.width, OUTPUTS), self.drop, seeds, dtype=self.log_noise.dtype)

    def _batch(self, x: Tensor, y: Tensor, batch: int, *path: str | int) -> tuple[Tensor, Tensor, Masks]:
        """Return some sequences, drawn with replacement, and a weight draw for each."""
        count, steps = x.shape[1:3]
        batch = min(batch, count)
        rows = rng.stacked(lambda g: torch.randint(count, (batch,), generator=g), self.seeds, "batches", *path)
        runs = torch.arange(len(x))[:, None]
        return x[runs, rows], y[runs, rows], self.draw(batch, steps, *path)

    def _loss(self, x: Float[Tensor, "R B T D"], y: Float[Tensor, "R B T E"], masks: Masks) -> Float[Tensor, " R"]:
        """Return the mean negative log-likelihood of a step, in nats but for a constant."""
        noise = self._log_noise()[:, None]
        out, _ = self.net(x, masks)
        return (((out - y) * (-noise).exp()).square() / 2 + noise).mean((1, 2)).sum(-1)

    def draw(self, count: int, steps: int, *path: str | int) -> Masks:
        """Return a draw per sequence, or per sequence and step."""
        return self.net.draw(count, *path, steps=None if self.held else steps)

    def step(self, seen: Float[Tensor, "R K D"], memory: Any, draw: Any, t: int) -> tuple[Tensor, Any]:
        """Return the predicted change and the state of the layer."""
        x = (seen - self.input_mean) / self.input_std
        out, memory = self.net.step(x, memory or self.net.blank(x.shape[1]), draw, t)
        return out * self.target_std + self.target_mean, memory


@dataclass(frozen=True)
class ModelConfig:
    """A model and how it is trained."""

    kind: str  #: "feed-forward" or "recurrent".
    window: int = 1  #: Observations that a feed-forward network is given.
    hidden: tuple[int, ...] = (200, 200)  #: Widths of the layers; of the recurrent network one.
    #: Drop probability of the hidden units, in a recurrent network of the state and before the output.
    drop: float = 0.05
    input_drop: float = 0.0  #: Drop probability of the inputs.
    held: bool = True  #: Whether a particle keeps its masks over the sequence; feed-forward ones always do.
    steps: int = 600  #: Adam steps of a fit.
    rate: float = 0.002  #: Their size at first.
    final_rate: float = 0.1  #: Their size at the end, as a share of that at first.
    batch: int = 100  #: Transitions of a step, rounded to whole trials for a recurrent network.
    length_scale: float = 0.1**0.5  #: Of the prior over the weights.

    def __post_init__(self) -> None:
        tidy(self)
        if self.kind not in KINDS or not self.hidden or (self.kind == "recurrent" and len(self.hidden) != 1):
            raise ValueError(
                f"expected one layer of a recurrent network, or some of a feed-forward one, got {self.hidden} of "
                f"{self.kind!r}; choose one of {', '.join(KINDS)}"
            )
        at_least(1, hidden=min(self.hidden), window=self.window, steps=self.steps, batch=self.batch)

    def model(self, seeds: Sequence[int], dtype: torch.dtype = torch.float32) -> Model:
        """Return new networks."""
        if self.kind == "recurrent":
            return Recurrent(seeds, self.hidden[0], (self.input_drop, self.drop, self.drop), self.held, dtype)
        options = {"hidden": self.hidden, "drop": self.drop, "input_drop": self.input_drop, "dtype": dtype}
        return Windowed(seeds, self.window, **options)

    def fit(self, steps: int) -> Fit:
        """Return how it is trained on trials of so many steps."""
        batch = max(1, self.batch // steps) if self.kind == "recurrent" else self.batch
        return Fit(self.steps, self.rate, self.final_rate, batch, self.length_scale)


@torch.no_grad()
def free_run(
    model: Model,
    first: Float[Tensor, "R N 2"],
    forces: Float[Tensor, "R N T"],
    noise: Float[Tensor, "R N K T 2"],
    *path: str | int,
) -> tuple[Float[Tensor, "R N T 2"], Float[Tensor, "R N T 2"]]:
    """Return mean and standard deviation of the observations at steps 1 ... T, given the first one and all forces.

    K particles per sequence read their own predictions, each with noise of the learned size, under a weight draw of
    its own. The variance is that of the particles before noise and of the noise.
    """
    runs, count, particles, steps, _ = noise.shape
    rows = (runs, count * particles)
    observed = first[:, :, None].expand(-1, -1, particles, -1).reshape(*rows, OUTPUTS)
    pushed = forces[:, :, None].expand(-1, -1, particles, -1).reshape(*rows, steps)
    std, draw, memory = model.noise_std()[:, None], model.draw(rows[1], steps, *path), None
    means, deviations = [], []
    for t in range(steps):
        change, memory = model.step(inputs_of(observed, pushed[..., t]), memory, draw, t)
        moved = (observed + change).unflatten(1, (count, particles))
        means.append(moved.mean(2))
        deviations.append((moved.var(2, correction=0) + std.square()).sqrt())
        observed = moved.flatten(1, 2) + std * noise[:, :, :, t].flatten(1, 2)
    return torch.stack(means, 2), torch.stack(deviations, 2)
