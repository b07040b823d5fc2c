"""The saturating cost of the pole's tip for a point or a Gaussian state, and what "solved" means.

``cost = 1 - exp(-d^2 / (2 width^2))``, where d [m] is the distance of the tip from its place when the pole stands
upright over the middle of the track (the black cross of thesis figure 5.6). It is 0 there and 1 far away. The
cost is flat far from the goal; only the spread of an uncertain state gives it a slope there, which is why its
expectation is what PILCO minimises.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian, feature_moments, identity
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import spd_inverse
from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole, tip

# A trial is solved when the mean cost of its last second (`matlab`) or half second (`paper`) is below this.
SOLVED_BELOW = 0.2


def cost(plant: CartPole, state: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch"]:
    """Return the cost in [0, 1] of each state."""
    x, y = tip(plant, state).unbind(-1)
    squared_distance = x**2 + (y - plant.pole_length) ** 2
    return 1 - torch.exp(-squared_distance / (2 * plant.cost_width**2))


def mean_cost(plant: CartPole, state: Gaussian) -> Float[Tensor, "*batch"]:
    """Return the expected cost of a Gaussian state, its features matched by a Gaussian."""
    length = plant.pole_length
    # rows: horizontal and vertical distance of the tip from its goal, in widths, as functions of the features
    factor = state.mean.new_tensor([[1.0, 0, 0, -length, 0], [0, 0, 0, 0, length]]) / plant.cost_width
    target = state.mean.new_tensor([0.0, 0, 0, 0, 1])
    return saturating_mean(feature_moments(state).out, target, factor)


def saturating_mean(z: Gaussian, target: Float[Tensor, " D"], factor: Float[Tensor, "P D"]) -> Float[Tensor, "*batch"]:
    """Return the mean of ``1 - exp(-|factor (z - target)|^2 / 2)`` for a Gaussian z of D dimensions."""
    offset, spread = (z.mean - target) @ factor.mT, factor @ z.cov @ factor.mT
    inverse, log_det = spd_inverse(identity(len(factor), spread.dtype, spread.device) + spread)
    gain = (inverse @ offset[..., None])[..., 0]
    return 1 - torch.exp(((offset * gain).sum(-1) + log_det) / -2)


def solved(plant: CartPole, costs: Float[Tensor, "*batch steps"]) -> Bool[Tensor, "*batch"]:
    """Return whether a trial with these realised costs of steps 1 ... T ended with the pole balanced.

    Raises:
        ValueError: if there is not one cost per step of the plant, or these costs cannot tell up from down.
    """
    if costs.shape[-1] != plant.steps:
        raise ValueError(f"expected {plant.steps} costs, one per step of the trial, got {costs.shape[-1]}")
    if plant.solved_steps > plant.steps:
        raise ValueError(f"a trial of {plant.steps} steps cannot be judged on its last {plant.solved_steps}")
    hanging = 1 - math.exp(-2 * (plant.pole_length / plant.cost_width) ** 2)
    if hanging < SOLVED_BELOW:
        raise ValueError(
            f"a pole that hangs at rest would count as balanced, at a cost of {hanging:.2g}: take a smaller cost_width"
        )
    return costs[..., -plant.solved_steps :].mean(-1) < SOLVED_BELOW
