"""The predicted cost of a policy and its gradient, worked out by hand for the common settings of algorithm 4.

Autograd goes through some sixty arrays a step and back. Here whatever needs no order in time is done for all steps at
once, before and after the two loops: the costs, the slopes of the force, the gradients of the policy's parameters.
What is left in the loops is the network, forward and back, and moments of four numbers. Arrays of states have the
particles K last, where they are contiguous.
"""

import threading
from dataclasses import dataclass
from typing import Any, cast

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import DrawnFunction
from dropout_uncertainty.data_efficiency.deep_pilco.network_gradient import pull_back
from dropout_uncertainty.data_efficiency.deep_pilco.particles import JITTER, RELATIVE_JITTER, Draws
from dropout_uncertainty.data_efficiency.gaussians.moments import identity
from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole

ACTIVATION = {"relu": torch.relu_, "sigmoid": torch.sigmoid_}
# Rows of `_Trial.inputs`: the network is given the first six, the policy all but the first.
FORCE, SEEN, SQUARES, ONE = slice(0, 1), slice(1, 6), slice(6, 11), slice(11, 12)
NETWORK, POLICY = slice(0, 6), slice(1, 12)

_KEPT = threading.local()  # the last trial of each thread, see `_Trial.kept`


def covers(draws: Draws, matching: str, cost_of: str) -> bool:
    """Return whether `value_and_gradient` holds for these settings; autograd (`particles.predict`) always does."""
    if matching != "full" or cost_of != "particles":
        return False
    return all(
        type(f) is DrawnFunction and f.angle_features and f.input_mask is None and len(f.weights) > 1
        for f in draws.functions
    )


@torch.inference_mode()
def value_and_gradient(
    matrix: Float[Tensor, "R Q N"], weights: Float[Tensor, "R N 1"], plant: CartPole, draws: Draws
) -> tuple[Float[Tensor, " R"], Float[Tensor, "R Q N"], Float[Tensor, "R N 1"]]:
    """Return the mean cost over particles and times 1 ... T, and its gradients in ``matrix`` and ``weights``.

    Args:
        matrix: with ``weights``, the policy as `particles.multiplied_out` returns it.
        weights: see there.
        plant: constants, number of steps and limit of the force.
        draws: the random numbers of the trial.
    """
    networks = [_Network(cast(DrawnFunction, function)) for function in draws.functions]  # as `covers` wants them
    trial = _Trial.run(matrix, weights, plant, draws, networks)
    value, slope = _costs(plant, trial.states[1:])
    in_force = _forward_slopes(trial, matrix, weights, plant.force_limit)
    force_gradient = _backward(trial, slope, in_force, draws, networks)
    # The output u is a sum over basis functions, so one product gives the gradient in both arrays.
    in_output = trial.inputs[:, POLICY] * (force_gradient * _force_slope(trial.output, plant.force_limit))
    gradient = in_output.flatten(2) @ trial.heights.flatten(1, 2)
    failed = (trial.info > 0).any(0)
    gradient, value = (x.masked_fill(failed.view(-1, *(1,) * (x.ndim - 1)), torch.nan) for x in (gradient, value))
    return value, gradient * weights.mT, gradient[:, -1:].mT


class _Network:
    """A drawn function with the force as its first input, forward and back; states and inputs have K last."""

    def __init__(self, function: DrawnFunction) -> None:
        first, *others = function.weights
        self.weights = [first.roll(1, 1), *others]
        self.biases = function.biases
        self.activation = function.activation

    def change(self, x: Float[Tensor, "R D K"], hidden: list[Tensor]) -> Float[Tensor, "R E K"]:
        """Return the change of state; the activations of the hidden layers [R, K, H] go into ``hidden``."""
        h = x.mT
        for weight, bias, out in zip(self.weights[:-1], self.biases[:-1], hidden, strict=True):
            h = ACTIVATION[self.activation](torch.baddbmm(bias, h, weight, out=out))
        return torch.baddbmm(self.biases[-1].mT, self.weights[-1].mT, h.mT)

    def pull_back(self, gradient: Float[Tensor, "R E K"], hidden: list[Tensor]) -> Float[Tensor, "R D K"]:
        """Return the gradient in the inputs for one in the change of state."""
        g = gradient.mT
        for weight, h in zip(reversed(self.weights[1:]), reversed(hidden), strict=True):
            g = pull_back(self.activation, torch.bmm(g, weight.mT), h)
        return torch.bmm(self.weights[0], g.mT)


@dataclass
class _Trial:
    """A predicted trial and what its gradient needs."""

    states: Float[Tensor, "times R 4 K"]
    inputs: Float[Tensor, "R 12 T K"]
    heights: Float[Tensor, "R T K N"]  # of the basis functions
    output: Float[Tensor, "R 1 T K"]  # of the policy, before the squash
    centred: Float[Tensor, "T R 4 K"]
    factor: Float[Tensor, "T R 4 4"]
    info: Int[Tensor, "T R"]  # above 0 where a covariance had no factor
    hidden: list[list[Tensor]]  # by step and layer

    @classmethod
    def kept(cls, *key: Any) -> "_Trial":
        """Return what ``empty`` does, the same arrays at each call of a thread: to clear tens of MiB takes long."""
        if getattr(_KEPT, "key", None) != key:
            _KEPT.key, _KEPT.trial = key, cls.empty(*key)
        return _KEPT.trial

    @classmethod
    def empty(
        cls, shape: torch.Size, basis: int, widths: tuple[int, ...], dtype: torch.dtype, device: torch.device
    ) -> "_Trial":
        """Return the arrays of a trial."""
        runs, steps, count, dim = shape

        def new(*size: int) -> Tensor:
            return torch.empty(size, dtype=dtype, device=device)

        return cls(
            new(steps + 1, runs, dim, count), new(runs, ONE.stop, steps, count).fill_(1.0),
            new(runs, steps, count, basis), new(runs, 1, steps, count),
            new(steps, runs, dim, count), new(steps, runs, dim, dim),
            torch.empty(steps, runs, dtype=torch.int32, device=device),
            [[new(runs, count, width) for width in widths] for _ in range(steps)],
        )  # fmt: skip

    @classmethod
    def run(cls, matrix: Tensor, weights: Tensor, plant: CartPole, draws: Draws, networks: list[_Network]) -> "_Trial":
        """Move the particles and keep everything."""
        _, steps, count, dim = draws.noise.shape
        widths = tuple(weight.shape[-1] for weight in networks[0].weights[:-1])
        trial = cls.kept(draws.noise.shape, matrix.shape[-1], widths, matrix.dtype, matrix.device)
        trial.states[0] = draws.start.mT
        scale, jitter = _jitter(matrix, dim, count)
        for t in range(steps):
            state = trial.states[t]
            trial._act(t, state, matrix, weights.mT, plant.force_limit)
            moved = networks[t % len(networks)].change(trial.inputs[:, NETWORK, t], trial.hidden[t]).add_(state)
            mean = moved.mean(-1, keepdim=True)
            centred = torch.sub(moved, mean, out=trial.centred[t])
            cov = torch.addcmul(jitter, torch.bmm(centred, centred.mT), scale)
            factor, _ = torch.linalg.cholesky_ex(cov, out=(trial.factor[t], trial.info[t]))
            torch.baddbmm(mean, factor, draws.noise[:, t].mT, out=trial.states[t + 1])
        return trial

    def _act(self, t: int, state: Tensor, matrix: Tensor, weights: Tensor, limit: float) -> None:
        """Set the inputs of a step."""
        rows = self.inputs[:, :, t]
        seen = rows[:, SEEN]
        seen[:, :3] = state[:, :3]
        torch.sin(state[:, 3:], out=seen[:, 3:4])
        torch.cos(state[:, 3:], out=seen[:, 4:])
        torch.mul(seen, seen, out=rows[:, SQUARES])
        height = torch.exp(torch.bmm(rows[:, POLICY].mT, matrix), out=self.heights[:, t])
        output = torch.bmm(weights, height.mT)
        self.output[:, :, t] = output
        sine = output.sin_()
        # the squash, for sin 3u = 3 sin u - 4 sin³ u
        torch.mul(sine, torch.addcmul(1.5 * limit * rows[:, ONE], sine, sine, value=-limit / 2), out=rows[:, FORCE])


def _jitter(like: Tensor, dim: int, count: int) -> tuple[Tensor, Tensor]:
    """Return what the sums of squares are multiplied by to be covariances of `particles.match`, and what is added."""
    one = identity(dim, like.dtype, like.device)
    return (1 + RELATIVE_JITTER * one) / count, JITTER * one


def _force_slope(output: Tensor, limit: float) -> Tensor:
    """Return the derivative of the squash."""
    return 1.5 * limit * output.cos() ** 3


def _forward_slopes(trial: _Trial, matrix: Tensor, weights: Tensor, limit: float) -> Float[Tensor, "R 4 T K"]:
    """Return the derivatives of the force in the state, for all steps."""
    in_features = (trial.heights.flatten(1, 2) @ (matrix[:, :-1] * weights.mT).mT).mT
    linear, squares = in_features.unflatten(-1, trial.output.shape[2:]).chunk(2, 1)
    seen = trial.inputs[:, SEEN]
    slopes = torch.addcmul(linear, seen, squares, value=2)
    angle = slopes[:, 3:4] * seen[:, 4:] - slopes[:, 4:] * seen[:, 3:4]
    return torch.cat((slopes[:, :3], angle), 1) * _force_slope(trial.output, limit)


def _costs(plant: CartPole, states: Float[Tensor, "T R 4 K"]) -> tuple[Float[Tensor, " R"], Float[Tensor, "T R 4 K"]]:
    """Return the mean cost (`cost.cost`) and its gradient in the states."""
    length, width = plant.pole_length, plant.cost_width
    sin, cos = states[:, :, 3].sin(), states[:, :, 3].cos()
    x, y = states[:, :, 0] - length * sin, length * (cos - 1)
    height = torch.exp(-(x * x + y * y) / (2 * width**2))
    share = height / (width**2 * states.shape[0] * states.shape[-1])
    gradient = torch.zeros_like(states)
    gradient[:, :, 0] = share * x
    gradient[:, :, 3] = -length * share * (x * cos + y * sin)
    return (1 - height).mean((0, 2)), gradient


def _backward(
    trial: _Trial, slope: Tensor, in_force: Tensor, draws: Draws, networks: list[_Network]
) -> Float[Tensor, "R 1 T K"]:
    """Return the gradient in the forces, from those of the costs in the states."""
    steps, runs, dim, count = slope.shape
    inverse = torch.linalg.solve_triangular(trial.factor, identity(dim, slope.dtype, slope.device), upper=False)
    scale, _ = _jitter(slope, dim, count)
    # with a further column one product gives the mean of the gradients over the particles too
    noise = torch.cat((draws.noise, torch.full_like(draws.noise[..., :1], 1 / count)), -1)
    lower = torch.tensor([max(i, j) * dim + min(i, j) for i in range(dim) for j in range(dim)], device=slope.device)
    forces, gradient = torch.empty_like(trial.output), torch.zeros_like(slope[0])
    for t in reversed(range(steps)):
        gradient = gradient + slope[t]
        in_factor, in_mean = torch.bmm(gradient, noise[:, t]).split((dim, 1), -1)
        # Through the factor L of the covariance: L^-T (lower half of L' dL, mirrored) L^-1.
        half = torch.bmm(trial.factor[t].mT, in_factor).flatten(1)
        mirrored = half.index_select(1, lower).view(runs, dim, dim)
        in_cov = torch.bmm(torch.bmm(inverse[t].mT, mirrored), inverse[t]) * scale
        moved = torch.baddbmm(in_mean, in_cov, trial.centred[t])
        in_inputs = networks[t % len(networks)].pull_back(moved, trial.hidden[t])
        force, linear, sine, cosine = in_inputs.split((1, 3, 1, 1), 1)
        forces[:, :, t] = force
        gradient = torch.addcmul(moved, in_force[:, :, t], force)
        gradient[:, :3] += linear
        sin, cos = trial.inputs[:, SEEN, t][:, 3:].chunk(2, 1)
        gradient[:, 3:].addcmul_(sine, cos).addcmul_(cosine, sin, value=-1)
    return forces
