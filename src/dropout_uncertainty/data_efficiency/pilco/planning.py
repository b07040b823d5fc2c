"""PILCO (thesis algorithm 3): predict the trial with a Gaussian process and matched moments, improve the policy.

Steps of the algorithm and where they are: 4 run a trial (``cartpole.rollout``), 5 train the dynamics model
(``train_model``), 6 predict state distributions (``predict``), 7 expected cost and its gradient
(``expected_costs``), 8 improve the policy (``improve``). ``learner`` joins them. float64, replicas R first.
The model is evaluated on the device that holds its data; parameters stay on the CPU, where the optimisers are.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian, Moments, appended, feature_moments, identity
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import Linearised, SquaredExponential
from dropout_uncertainty.data_efficiency.minimise.batched import Minimum, minimise
from dropout_uncertainty.data_efficiency.pilco import gaussian_process as gp
from dropout_uncertainty.data_efficiency.plant.cartpole import FEATURE_NAMES, CartPole, features
from dropout_uncertainty.data_efficiency.plant.cost import cost, mean_cost
from dropout_uncertainty.data_efficiency.policies import Layout, RBFPolicy, force, force_moments

DIM = len(FEATURE_NAMES)


@runtime_checkable
class Model(Protocol):
    """What a prediction asks of the dynamics: how the state changes, given features and force as a Gaussian."""

    def moments(self, x: Gaussian) -> Moments:
        """Return the moments of the change of state [R, 4]."""


def transitions(observed: Float[Tensor, "R times 4"], forces: Float[Tensor, "R steps"]) -> tuple[Tensor, Tensor]:
    """Return what the model learns from one trial: features and force [R, T, 6], state differences [R, 4, T]."""
    if observed.shape[1] != forces.shape[1] + 1:
        raise ValueError(
            f"expected one state more than forces, got {observed.shape[1]} states and {forces.shape[1]} forces"
        )
    inputs = torch.cat((features(observed[:, :-1]), forces[..., None]), -1)
    return inputs, (observed[:, 1:] - observed[:, :-1]).mT


def propagate(model: Model, policy: RBFPolicy, limit: float, state: Gaussian) -> Gaussian:
    """Return the distribution of the next state (x, v, w, theta): features, policy, squash, dynamics, sum.

    The model's noise is not added to the state, as in the original (pilco-matlab, base/propagated.m).
    """
    seen = feature_moments(state)
    force = force_moments(policy, limit, seen.out)
    joint = appended(seen.out, force, DIM)
    change = model.moments(joint.out)
    shared = state.cov @ seen.slope @ joint.slope @ change.slope
    return Gaussian(state.mean + change.mean, state.cov + change.cov + shared + shared.mT)


def predict(model: Model, policy: RBFPolicy, plant: CartPole, start: Gaussian, steps: int | None = None) -> Gaussian:
    """Return the predicted state distributions of times 0 ... T: mean [R, T + 1, 4] and covariance [R, T + 1, 4, 4].

    Raises:
        ValueError: if the start covariance is not symmetric and positive semi-definite.
    """
    smallest = torch.linalg.eigvalsh(start.cov).min()
    if not (smallest > -1e-9 and torch.allclose(start.cov, start.cov.mT)):
        raise ValueError(
            f"expected a symmetric positive semi-definite start covariance, its smallest eigenvalue is {smallest:.3g}"
        )
    states = [start]
    for _ in range(plant.steps if steps is None else steps):
        states.append(propagate(model, policy, plant.force_limit, states[-1]))
    return Gaussian(torch.stack([s.mean for s in states], 1), torch.stack([s.cov for s in states], 1))


def start_distribution(plant: CartPole, replicas: int, device: torch.device | str = "cpu") -> Gaussian:
    """Return p(X_0) for each replica."""
    mean = torch.tensor(plant.start_mean, dtype=torch.float64, device=device).expand(replicas, 4)
    cov = plant.start_std**2 * torch.eye(4, dtype=torch.float64, device=device).expand(replicas, 4, 4)
    return Gaussian(mean, cov)


def expected_costs(plant: CartPole, states: Gaussian) -> Float[Tensor, "R steps"]:
    """Return the expected cost of each predicted state after the first, times 1 ... T."""
    return mean_cost(plant, Gaussian(states.mean[:, 1:], states.cov[:, 1:]))


@dataclass(frozen=True)
class PolicyShape(Layout):
    """A policy's parameters with a target for each basis function."""

    def policy(self, parameters: Float[Tensor, "R P"]) -> RBFPolicy:
        """Return the policies of these parameters."""
        scales, centres, targets = self.split(parameters)
        return RBFPolicy.from_targets(centres, scales, targets)

    def initial(
        self, plant: CartPole, target_std: float, log_length_scales: tuple[float, ...], generator: Generator
    ) -> Float[Tensor, " P"]:
        """Return a random policy: centres from the start distribution of the features, small random targets."""
        start = feature_moments(start_distribution(plant, 1))
        jitter = 1e-12 * torch.eye(self.dim, dtype=torch.float64)  # the cosine hardly varies at the start
        factor = torch.linalg.cholesky(start.cov[0] + jitter)
        noise = torch.randn(self.basis, self.dim, generator=generator, dtype=torch.float64)
        centres = start.mean[0] + noise @ factor.mT
        targets = target_std * torch.randn(self.basis, generator=generator, dtype=torch.float64)
        scales = torch.tensor(log_length_scales, dtype=torch.float64)
        return torch.cat((scales, centres.reshape(-1), targets))


def objective(
    model: SquaredExponential, plant: CartPole, shape: PolicyShape, parameters: Float[Tensor, "R P"]
) -> tuple[Float[Tensor, " R"], Float[Tensor, "R P"]]:
    """Return the predicted sum of expected costs over times 1 ... T and its gradient in the policy's parameters.

    The trial is predicted without autograd; then the derivatives of all steps are worked out side by side, so that only
    a product of small matrices is left to do for each step, backwards.
    """
    leaf = parameters.detach().to(model.centres).requires_grad_()
    memory = _Memory(model)
    with torch.no_grad():
        states = predict(memory, shape.policy(leaf), plant, start_distribution(plant, len(leaf), leaf.device))
    with torch.enable_grad():
        mean, cov = (part.requires_grad_() for part in states)
        total = expected_costs(plant, states).sum(-1)
        costs = _flat(*torch.autograd.grad(total.sum(), (mean, cov)))[:, 1:]
        before = Gaussian(*(part[:, :-1].detach().requires_grad_() for part in states))
        after = _flat(*propagate(memory.recalled(), shape.policy(leaf), plant.force_limit, before))
        each = identity(after.shape[-1], after.dtype, after.device)[:, None, None].expand(-1, *after.shape)
        rows = _flat(*torch.autograd.grad(after, before, each, is_grads_batched=True, retain_graph=True))
        (gradient,) = torch.autograd.grad(after, leaf, _adjoints(costs, rows.movedim(0, -2)))
    return total.detach(), gradient


def _flat(mean: Tensor, cov: Tensor) -> Tensor:
    return torch.cat((mean, cov.flatten(-2)), -1)


def _adjoints(costs: Float[Tensor, "R T S"], steps: Float[Tensor, "R T S S"]) -> Float[Tensor, "R T S"]:
    """Return how the sum of costs changes with the states 1 ... T, from how each cost and each next state does."""
    found = [costs[:, -1]]
    for t in reversed(range(1, costs.shape[1])):
        found.append(costs[:, t - 1] + (found[-1][:, None] @ steps[:, t])[:, 0])
    return torch.stack(found[::-1], 1)


class _Memory:
    """A model that keeps what it was asked and what it said at each step, to give the derivatives of all at once."""

    def __init__(self, model: SquaredExponential) -> None:
        self.model = model
        self.kept: list[tuple[Tensor, ...]] = []

    def moments(self, x: Gaussian) -> Moments:
        """Return the moments of the next step's change."""
        values, sums = self.model.values(x)
        self.kept.append((*x, values, *sums))
        return Linearised(values, None).moments(x)

    def recalled(self) -> Linearised:
        """Return what was said and its derivatives, with a time axis behind that of the replicas."""
        mean, cov, values, *sums = (torch.stack(part, 1) for part in zip(*self.kept, strict=True))
        return Linearised(values, self.model.jacobian(Gaussian(mean, cov), tuple(sums)))


def predict_points(
    model: SquaredExponential, policy: RBFPolicy, plant: CartPole, start: Float[Tensor, "R 4"]
) -> Float[Tensor, "R times 4"]:
    """Return the trajectory that a model without doubt predicts: the posterior mean is taken for the truth."""
    states = [start]
    for _ in range(plant.steps):
        seen = torch.cat((features(states[-1]), force(policy, plant, states[-1])[..., None]), -1)
        states.append(states[-1] + model(seen))
    return torch.stack(states, 1)


def step_gradients(
    model: SquaredExponential, plant: CartPole, shape: PolicyShape, parameters: Float[Tensor, "R P"]
) -> tuple[Float[Tensor, "R steps P"], Float[Tensor, "R steps P"], Gaussian]:
    """Return what each step's cost adds to the gradient that the search begins with, and the predicted states.

    The first are gradients of the expected costs of times 1 ... T, which sum to that of ``objective``; the second
    those of a model without doubt (``predict_points``), to compare with (thesis section 5.4.1, last paragraph).
    """
    leaf = parameters.detach().to(model.centres).requires_grad_()
    start = start_distribution(plant, len(leaf), leaf.device)
    with torch.enable_grad():
        states = predict(model, shape.policy(leaf), plant, start)
        sure = predict_points(model, shape.policy(leaf), plant, start.mean)
        both = [expected_costs(plant, states), cost(plant, sure[:, 1:])]
        grads = [
            torch.stack([torch.autograd.grad(c, leaf, retain_graph=True)[0] for c in costs.sum(0)], 1) for costs in both
        ]
    return grads[0], grads[1], Gaussian(states.mean.detach(), states.cov.detach())


def improve(
    model: SquaredExponential, plant: CartPole, shape: PolicyShape, parameters: Float[Tensor, "R P"], iterations: int
) -> Minimum:
    """Return policies of lower predicted cost: at most ``iterations`` line searches each from ``parameters``."""
    parts: dict[tuple[int, ...], SquaredExponential] = {}

    def evaluate(x: Tensor, numbers: list[int]) -> tuple[Tensor, Tensor]:
        key = tuple(numbers)
        if key not in parts:
            parts.clear()  # the batch only shrinks: an earlier selection does not come back
            parts[key] = model.select(numbers)
        return objective(parts[key], plant, shape, x)

    return minimise(evaluate, parameters, iterations)


def train_model(
    inputs: Float[Tensor, "R N D"], targets: Float[Tensor, "R E N"], log_hyper: Tensor | None, iterations: int
) -> tuple[Tensor, Minimum]:
    """Return fitted hyper-parameters, begun from the given ones or, at first, from the spread of the data.

    A replica whose likelihood cannot be computed at the warm start begins from the spread of the data
    instead.
    """
    fresh = gp.initial_hyper(inputs, targets).cpu()
    start = fresh if log_hyper is None else log_hyper
    fitted, found = gp.fit_hyper(inputs, targets, start, iterations)
    failed = found.value.isnan().reshape(start.shape[:2])
    if failed.any() and log_hyper is not None:
        again, _ = gp.fit_hyper(inputs, targets, fresh, iterations)
        fitted = torch.where(failed[..., None], again, fitted)
    return fitted, found
