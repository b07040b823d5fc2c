"""The cart-pole of thesis section 5.4: exact equations of motion in SI units under a zero-order hold.

State, last axis: cart position x [m], cart velocity v [m/s], pole angular velocity w [rad/s], pole angle
theta [rad]. theta = 0 is upright and pi hangs, counter-clockwise positive, so the tip stands at
``(x - l sin theta, l cos theta)``; the angle is not wrapped. The pole is a uniform rod on a frictionless
pivot, the cart has viscous friction with the ground. Everything is batched over leading axes (replicas R
first, then particles K) and differentiable.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dropout_uncertainty.settings import tidy

# Runge-Kutta steps per control interval of 0.1 s. Against the original's adaptive integrator (tolerance
# 1e-12) the largest one-interval error over all recorded states, where the pole tumbles at up to 33 rad/s, is
# 4e-4 with 10 steps, 4e-6 with 32 and 4e-8 with 96; below 10 rad/s 10 steps already give 3e-6.
SUBSTEPS = 96

STATE_NAMES = ("x", "v", "w", "theta")
FEATURE_NAMES = ("x", "v", "w", "sin theta", "cos theta")


@dataclass(frozen=True)
class CartPole:
    """A plant: constants, length of a trial, start distribution. Named ones are in ``PRESETS``."""

    pole_length: float  # full length l of the rod [m]
    steps: int  # control steps T of one trial
    start_std: float  # standard deviation of each of the four start states [m, m/s, rad/s, rad]
    solved_steps: int  # a trial is judged on its last steps: the number of them
    observation_noise: float = 0.01  # standard deviation added to each observed state; seen by policy and model alike
    cart_mass: float = 0.5  # M [kg]
    pole_mass: float = 0.5  # m [kg]
    friction: float = 0.1  # b, between cart and ground [N s/m]
    gravity: float = 9.82  # g [m/s^2]
    force_limit: float = 10.0  # the policy's force lies in [-limit, limit] [N]
    dt: float = 0.1  # control interval [s]
    cost_width: float = 0.25  # width of the saturating cost [m]
    start_mean: tuple[float, float, float, float] = (0.0, 0.0, 0.0, torch.pi)  # at rest, hanging

    def __post_init__(self) -> None:
        tidy(self)
        positive = {name: getattr(self, name) for name in ("pole_length", "pole_mass", "cart_mass", "dt", "cost_width")}
        spreads = ("start_std", "observation_noise", "friction", "gravity", "force_limit")
        others = {name: getattr(self, name) for name in spreads}
        if not all(0 < value < math.inf for value in positive.values()):
            raise ValueError(f"expected positive lengths, masses and times, got {positive}")
        if not all(0 <= value < math.inf for value in others.values()):
            raise ValueError(f"expected no negative and no infinite numbers, got {others}")
        if self.steps < 1 or self.solved_steps < 1:
            raise ValueError(f"expected a step or more, got {self.steps} and {self.solved_steps} to be judged on")
        if len(self.start_mean) != 4 or not all(map(math.isfinite, self.start_mean)):
            raise ValueError(f"expected a mean start state (x, v, w, theta), got {self.start_mean}")
        if abs(self.start_mean[3]) > 2 * math.pi:
            raise ValueError(f"expected the start angle in radians, got {self.start_mean[3]}: is it in degrees?")


# As two re-implementations written from the Deep PILCO paper have it, and as thesis figure 5.8 fits (10 steps
# are 1 s).
PAPER = CartPole(pole_length=0.6, steps=25, start_std=0.02, solved_steps=5)
# The cart-pole scenario of the original PILCO code (pilco-matlab, scenarios/cartPole/settings_cp.m).
MATLAB = CartPole(pole_length=0.5, steps=40, start_std=0.1, solved_steps=10)
PRESETS = {"paper": PAPER, "matlab": MATLAB}


def preset(name: str) -> CartPole:
    """Return the plant of that name.

    Raises:
        ValueError: for an unknown name.
    """
    if name not in PRESETS:
        raise ValueError(f"expected a plant preset out of {sorted(PRESETS)}, got {name!r}")
    return PRESETS[name]


def _check_states(state: object) -> None:
    """Raise ValueError for what is no tensor of states."""
    if not isinstance(state, Tensor):
        raise ValueError(f"expected a tensor of states, got {type(state).__name__}: use torch.as_tensor")
    if not state.is_floating_point():
        raise ValueError(f"expected states in floating point, got {state.dtype}")
    if state.shape[-1:] != (4,):
        raise ValueError(f"expected states (x, v, w, theta) along the last axis, got shape {tuple(state.shape)}")


def derivative(
    plant: CartPole, state: Float[Tensor, "*batch 4"], force: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch 4"]:
    """Return the time derivative of the state under a horizontal force [N] on the cart."""
    _, v, w, theta = state.unbind(-1)
    m, total, length, g = plant.pole_mass, plant.cart_mass + plant.pole_mass, plant.pole_length, plant.gravity
    sin, cos = theta.sin(), theta.cos()
    pull = force - plant.friction * v
    centrifugal = m * length * w * w * sin
    denominator = 4 * total - 3 * m * cos * cos
    dv = (-2 * centrifugal + 3 * m * g * sin * cos + 4 * pull) / denominator
    dw = (-3 * centrifugal * cos + 6 * total * g * sin + 6 * pull * cos) / (length * denominator)
    return torch.stack((v, dv, dw, w), -1)


def check_interval(plant: CartPole) -> None:
    """Raise ValueError if a control interval at the largest force is not integrated to within 1e-6."""
    state = torch.tensor([[0.0, 0.0, 0.0, angle] for angle in (0.0, 1.0, torch.pi)], dtype=torch.float64)
    force = torch.full((3,), plant.force_limit, dtype=torch.float64)
    error = float((step(plant, state, force) - step(plant, state, force, 2 * SUBSTEPS)).abs().max())
    if not error <= 1e-6:
        raise ValueError(
            f"an interval of this plant is integrated with an error of {error:.1g}, expected 1e-6 at most: it is too "
            "stiff, shorten dt or take heavier masses, a longer pole, less friction"
        )


def step(plant: CartPole, state: Tensor, force: Tensor, substeps: int = SUBSTEPS) -> Tensor:
    """Return the state one control interval later: Runge-Kutta steps of order 4 under a constant force.

    Args:
        plant: the physical constants.
        state: [..., 4] in SI units.
        force: [...] in newton.
        substeps: how many integration steps the interval is cut into.

    Raises:
        ValueError: if the last axis of the state is not (x, v, w, theta), or there is not one force per state.
    """
    _check_states(state)
    if not isinstance(force, Tensor):
        force = torch.as_tensor(force, dtype=state.dtype, device=state.device)
    if force.ndim and force.shape != state.shape[:-1]:
        shapes = tuple(force.shape), tuple(state.shape)
        raise ValueError(f"expected one force per state, [...] and [..., 4], got shapes {shapes}")
    h = plant.dt / substeps
    for _ in range(substeps):
        k1 = derivative(plant, state, force)
        k2 = derivative(plant, state + h / 2 * k1, force)
        k3 = derivative(plant, state + h / 2 * k2, force)
        k4 = derivative(plant, state + h * k3, force)
        state = state + h / 6 * (k1 + 2 * (k2 + k3) + k4)
    return state


def tip(plant: CartPole, state: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 2"]:
    """Return the horizontal and vertical position [m] of the pole's end, the track at height 0.

    Raises:
        ValueError: if the last axis of the state is not (x, v, w, theta).
    """
    _check_states(state)
    x, theta = state[..., 0], state[..., 3]
    return torch.stack((x - plant.pole_length * theta.sin(), plant.pole_length * theta.cos()), -1)


def features(state: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 5"]:
    """Return (x, v, w, sin theta, cos theta): what policies and models are given for the angle.

    Raises:
        ValueError: if the last axis of the state is not (x, v, w, theta).
    """
    _check_states(state)
    return torch.cat((state[..., :3], state[..., 3:].sin(), state[..., 3:].cos()), -1)


def start_states(plant: CartPole, shape: tuple[int, ...], generator: Generator) -> Float[Tensor, "*shape 4"]:
    """Return draws from the start distribution p(X_0)."""
    noise = torch.randn(*shape, 4, generator=generator, dtype=torch.float64, device=generator.device)
    return noise.new_tensor(plant.start_mean) + plant.start_std * noise


def observation_noise(plant: CartPole, shape: tuple[int, ...], generator: Generator) -> Float[Tensor, "*shape 4"]:
    """Return draws of the noise added to true states to make observed ones."""
    noise = torch.randn(*shape, 4, generator=generator, dtype=torch.float64, device=generator.device)
    return plant.observation_noise * noise


@dataclass(frozen=True)
class Rollout:
    """One trial per batch entry; T control steps, hence T + 1 times."""

    states: Float[Tensor, "*batch times 4"]  # true
    observed: Float[Tensor, "*batch times 4"]  # with observation noise
    forces: Float[Tensor, "*batch steps"]  # applied [N]


def rollout(
    plant: CartPole, start: Float[Tensor, "*batch 4"], act: Callable[[Tensor, int], Tensor], noise: Tensor
) -> Rollout:
    """Execute one trial of ``plant.steps`` steps.

    Args:
        plant: the physical constants.
        start: the true states at time 0.
        act: gives the force [N] from the observed state [..., 4] and the step; clipped to the plant's limit.
        noise: [..., T + 1, 4] observation noise, drawn ahead of time. Policy and model see the same noisy
            state.

    Raises:
        ValueError: if the shapes disagree or a force is not finite.
    """
    expected = (*start.shape[:-1], plant.steps + 1, 4)
    if tuple(noise.shape) != expected:
        raise ValueError(f"expected observation noise of shape {expected}, got {tuple(noise.shape)}")
    visited, forces = [start], []
    for t in range(plant.steps):
        force = act(visited[-1] + noise[..., t, :], t).clamp(-plant.force_limit, plant.force_limit)
        if not force.isfinite().all():
            raise ValueError(f"expected finite forces, got NaN or infinity at step {t}; look at the policy")
        forces.append(force)
        visited.append(step(plant, visited[-1], force))
    states = torch.stack(visited, -2)
    return Rollout(states, states + noise, torch.stack(forces, -1))
