"""Deep PILCO (thesis algorithm 4): particles through a dropout network, a Gaussian fitted to them at every step.

Lines of the algorithm and where they are: 2-3 particles and one weight draw for each (`draw`), 5-8 the network moves
every particle (`particles.predict`), 9-11 moments of the particles and new particles from them (`particles.match`). The
trial's expected cost is their mean cost (`objective`), which Adam or BFGS lowers (`improve`). Replicas R first.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import Masks
from dropout_uncertainty.data_efficiency.deep_pilco import trial_gradient
from dropout_uncertainty.data_efficiency.deep_pilco.particles import (
    COST_OF,
    MATCHING,
    Draws,
    Function,
    multiplied_out,
    predict,
)  # fmt: skip
from dropout_uncertainty.data_efficiency.minimise import batched
from dropout_uncertainty.data_efficiency.plant.cartpole import FEATURE_NAMES, CartPole
from dropout_uncertainty.data_efficiency.policies import Layout, RBFPolicy
from dropout_uncertainty.settings import at_least, positive, tidy

OPTIMISERS = ("adam", "bfgs")
# Optimisation steps whose particles and masks are drawn at once.
BLOCK = 10
DIM = len(FEATURE_NAMES)


@dataclass(frozen=True)
class Planning:
    """How the particles are made, moved and judged, and how the policy is improved on them."""

    particles: int = 30  #: Particles K; the paper has 10.
    #: Moments matched at each step: those of all dimensions together ("full"), of each by itself ("diagonal", as
    #: algorithm 4 writes them), or none ("off").
    matching: str = "full"
    #: Each particle keeps its weight draw over the whole trajectory (thesis section 5.4.2); otherwise a fresh one at
    #: each step.
    hold_masks: bool = True
    #: The noise of new particles has mean 0 and standard deviation 1 over the particles of each step; otherwise, as
    #: algorithm 4 has it, only on average.
    standard_noise: bool = True
    #: The predicted cost is the mean cost of the particles ("particles"), or the cost of their mean ("mean"), which is
    #: flat and makes a public re-implementation fail.
    cost_of: str = "particles"
    #: Of the policy: "adam" (thesis section 5.4.2), or "bfgs" on particles and masks that stay as they are.
    optimiser: str = "adam"
    policy_steps: int = 300  #: Optimisation steps per trial (line searches of BFGS); the paper has 1000.
    policy_rate: float = 1e-2  #: Step size of Adam; thesis and paper give none.
    policy_final_rate: float = 1.0  #: The last step size as a share of the first; between them it falls along a cosine.
    clip: float = 1.0  #: Largest norm of a replica's gradient; 0, as in thesis and paper: not limited.
    #: Optimisation steps for which particles and masks are kept (thesis: 1); 0: fixed for all steps of a trial.
    redraw_every: int = 1

    def __post_init__(self) -> None:
        tidy(self)
        for name, choices in (("matching", MATCHING), ("cost_of", COST_OF), ("optimiser", OPTIMISERS)):
            if getattr(self, name) not in choices:
                raise ValueError(f"expected {name} to be one of {', '.join(choices)}, got {getattr(self, name)!r}")
        at_least(2, particles=self.particles)
        at_least(1, policy_steps=self.policy_steps)
        at_least(0, clip=self.clip, redraw_every=self.redraw_every)
        positive(policy_rate=self.policy_rate)
        if not 0 <= self.policy_final_rate <= 1:
            raise ValueError(f"policy_final_rate must lie in [0, 1], got {self.policy_final_rate}")
        if self.optimiser == "bfgs" and self.redraw_every != 0:
            raise ValueError("BFGS needs the same particles at every step: set redraw_every to 0")


@runtime_checkable
class Dynamics(Protocol):
    """What particles can be moved by: a model of which functions are drawn, one per particle."""

    @property
    def seeds(self) -> tuple[int, ...]:
        """One per replica."""

    @property
    def log_noise(self) -> Tensor:
        """A tensor of the dtype and on the device in which particles are moved."""

    def draw(self, count: int, *path: str | int) -> Masks:
        """Return what distinguishes ``count`` functions per replica, a tensor [R, count, ...] or None each."""

    def function(self, masks: Masks) -> Function:
        """Return these functions."""

    def select(self, replicas: Sequence[int]) -> "Dynamics":
        """Return a copy with some of the replicas."""


@runtime_checkable
class Shape(Protocol):
    """How the parameters of a policy stand in one vector."""

    def policy(self, parameters: Tensor) -> RBFPolicy:
        """Return the policies of parameters [R, P]."""


@dataclass(frozen=True)
class RBFShape(Layout):
    """A policy's parameters with a weight for each basis function."""

    basis: int = 50

    def policy(self, parameters: Float[Tensor, "R P"]) -> RBFPolicy:
        """Return the policies of these parameters."""
        scales, centres, weights = self.split(parameters)
        return RBFPolicy(centres, scales, weights)

    def initial(self, spread: Sequence[float], weight_std: float, generator: Generator) -> Float[Tensor, " P"]:
        """Return a random policy over the features (x, v, w, sin θ, cos θ).

        Centres are normal around the cart at rest with the pole hanging (cos θ = -1), with standard deviations
        ``spread``, which are the first length-scales too; weights are normal with standard deviation ``weight_std``.
        """
        device = generator.device
        scale = torch.tensor(spread, dtype=torch.float64, device=device)
        centres = scale * torch.randn(self.basis, self.dim, generator=generator, dtype=torch.float64, device=device)
        centres[:, -1] -= 1.0
        weights = weight_std * torch.randn(self.basis, generator=generator, dtype=torch.float64, device=device)
        return torch.cat((scale.log(), centres.reshape(-1), weights))


def draw(
    model: Dynamics, plant: CartPole, plan: Planning, count: int, *path: str | int, blocks: int = 1
) -> Iterator[Draws]:
    """Yield the random numbers of ``blocks`` predicted trials of ``count`` particles, from the streams of a path."""
    like, steps = model.log_noise, plant.steps

    def normal(generator: Generator) -> Tensor:
        shape = (blocks, steps + 1, count, 4)
        return torch.randn(shape, generator=generator, dtype=like.dtype, device=like.device)

    noise = rng.stacked(normal, model.seeds, "particles", *path, device=like.device)
    start = noise.new_tensor(plant.start_mean) + plant.start_std * noise[:, :, 0]
    noise = standardised(noise[:, :, 1:]) if plan.standard_noise else noise[:, :, 1:]
    per_trial = 1 if plan.hold_masks else steps
    masks = model.draw(blocks * per_trial * count, *path)

    def function(place: int) -> Function:
        part = slice(place * count, (place + 1) * count)
        return model.function(tuple(m if m is None else m[:, part] for m in masks))

    for block in range(blocks):
        functions = tuple(function(block * per_trial + t) for t in range(per_trial))
        yield Draws(start[:, block], functions, noise[:, block])


def _stream(model: Dynamics, plant: CartPole, plan: Planning, *path: str | int) -> Iterator[Draws]:
    """Yield the random numbers of each optimisation step, fresh after ``redraw_every`` of them."""
    for block in itertools.count():
        for draws in draw(model, plant, plan, plan.particles, *path, block, blocks=BLOCK if plan.redraw_every else 1):
            yield from itertools.repeat(draws, plan.redraw_every) if plan.redraw_every else itertools.repeat(draws)


def standardised(noise: Float[Tensor, "*batch K D"]) -> Float[Tensor, "*batch K D"]:
    """Return the noise with mean 0 and variance 1 over the particles."""
    centred = noise - noise.mean(-2, keepdim=True)
    return centred / centred.square().mean(-2, keepdim=True).sqrt()


def objective(
    plant: CartPole, shape: Shape, plan: Planning, parameters: Float[Tensor, "R P"], draws: Draws
) -> tuple[Float[Tensor, " R"], Float[Tensor, "R P"]]:
    """Return the predicted cost, averaged over times 1 ... T, and its gradient in the policy's parameters."""
    leaf = parameters.detach().requires_grad_()
    with torch.enable_grad():
        if trial_gradient.covers(draws, plan.matching, plan.cost_of):
            matrix, weights = multiplied_out(shape.policy(leaf))
            value, *gradients = trial_gradient.value_and_gradient(matrix.detach(), weights.detach(), plant, draws)
            (gradient,) = torch.autograd.grad((matrix, weights), leaf, gradients)
        else:
            prediction = predict(shape.policy(leaf), plant, draws, plan.matching)
            value = prediction.costs(plant, plan.cost_of).mean(-1)
            (gradient,) = torch.autograd.grad(value.sum(), leaf)
    return value.detach().clone(), gradient  # the clone of what inference mode made is a tensor like others


@dataclass(frozen=True)
class Improved:
    """Policies after optimisation, with the predicted cost they reached and how often a gradient was left out."""

    parameters: Float[Tensor, "R P"]
    value: Float[Tensor, " R"]  # mean over the last tenth of the steps
    repairs: Int[Tensor, " R"]


def improve(
    model: Dynamics, plant: CartPole, shape: Shape, plan: Planning, parameters: Float[Tensor, "R P"], *path: str | int
) -> Improved:
    """Return policies of lower predicted cost, starting from ``parameters``; the path names the random streams."""
    if plan.optimiser == "bfgs":
        return _improve_fixed(model, plant, shape, plan, parameters, *path)
    draws = _stream(model, plant, plan, *path)
    return descend(
        lambda current: objective(plant, shape, plan, current, next(draws)), parameters.to(model.log_noise),
        steps=plan.policy_steps, rate=plan.policy_rate, final_rate=plan.policy_final_rate, clip=plan.clip,
    )  # fmt: skip


def descend(
    evaluate: Callable[[Tensor], tuple[Tensor, Tensor]],
    parameters: Float[Tensor, "R P"],
    *,
    steps: int,
    rate: float,
    final_rate: float,
    clip: float,
) -> Improved:
    """Return policies after steps of Adam; a gradient that is not finite, or whose value is not, is left out.

    Args:
        evaluate: gives predicted costs [R] and their gradients [R, P] for parameters [R, P], under new draws each time.
        parameters: where to begin.
        steps: how many.
        rate: their size at first; it falls along a cosine.
        final_rate: their size at the end, as a share of ``rate``.
        clip: to which length a replica's gradient is cut, if it is longer; 0: it is not.
    """
    current = parameters.detach().clone().requires_grad_()
    adam = torch.optim.Adam([current], lr=rate, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps, eta_min=rate * final_rate)
    late = torch.zeros_like(parameters[:, 0])
    repairs, tail = torch.zeros_like(late).long(), max(1, steps // 10)
    for step in range(steps):
        value, gradient = evaluate(current)
        bad = ~(gradient.isfinite().all(1) & value.isfinite())
        repairs += bad
        gradient = gradient.masked_fill(bad[:, None], 0.0)
        if clip:
            gradient = gradient * (clip / gradient.norm(dim=1, keepdim=True).clamp_min(clip))
        current.grad = gradient
        adam.step()
        schedule.step()
        if step >= steps - tail:
            late += value / tail
    return Improved(current.detach(), late, repairs)


def _improve_fixed(
    model: Dynamics, plant: CartPole, shape: Shape, plan: Planning, parameters: Tensor, *path: str | int
) -> Improved:
    """Lower the predicted cost of one fixed set of particles and masks by BFGS (McHutchon's setting)."""
    parts: dict[tuple[int, ...], tuple[Dynamics, Draws]] = {}

    def evaluate(x: Tensor, numbers: list[int]) -> tuple[Tensor, Tensor]:
        key = tuple(numbers)
        if key not in parts:
            part = model.select(numbers)
            parts.clear()  # the batch only shrinks: an earlier selection does not come back
            parts[key] = part, next(draw(part, plant, plan, plan.particles, *path, 0))
        part, draws = parts[key]
        return objective(plant, shape, plan, x.to(part.log_noise), draws)

    found = batched.minimise(evaluate, parameters, plan.policy_steps)
    lost = found.value.isnan()
    best = torch.where(lost[:, None], parameters.to(found.x), found.x)
    return Improved(best.to(model.log_noise), found.value.to(model.log_noise), found.repairs + lost.long())


def guarded(
    search: Callable[[Sequence[int], Tensor, int], Improved],
    parameters: Float[Tensor, "R P"],
    fresh: Sequence[Float[Tensor, "R P"]],
    above: float,
) -> tuple[Improved, Int[Tensor, " R"]]:
    """Improve; where the predicted cost stays ``above`` or is NaN, try from each of the ``fresh`` policies in turn.

    ``search`` improves the policies of some replicas, given their numbers, the parameters to begin from, and the number
    of the attempt. The better policy is kept. No real trial is used. Returns the policies and how many redraws each
    had.
    """
    best = search(range(len(parameters)), parameters, 0)
    redraws = torch.zeros_like(best.repairs)
    for attempt, start in enumerate(fresh, 1):
        rows = (~(best.value <= above)).nonzero()[:, 0].tolist()
        if not rows:
            break
        again = search(rows, start[rows], attempt)
        better = (again.value < best.value[rows]) | best.value[rows].isnan()
        chosen = [row for row, yes in zip(rows, better.tolist(), strict=True) if yes]
        best.parameters[chosen], best.value[chosen] = again.parameters[better], again.value[better]
        best.repairs[rows] += again.repairs
        redraws[rows] += 1
    return best, redraws
