"""PILCO: the original's predicted trials and gradients, brute-force particles, and a system it must learn to steer."""

import math
from dataclasses import replace

import pytest
import torch

from dropout_uncertainty.data_efficiency import policies
from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian
from dropout_uncertainty.data_efficiency.pilco import planning
from dropout_uncertainty.data_efficiency.pilco.gaussian_process import GaussianProcess
from dropout_uncertainty.data_efficiency.plant.cartpole import MATLAB, PAPER, features
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.data_efficiency.policies import RBFPolicy
from dropout_uncertainty.rng import generator

# the original's angle is 0 where the pole hangs: sines and cosines of our angle have the other sign
TURN = torch.tensor([1.0, 1, 1, -1, -1, 1], dtype=torch.float64)
HALF_TURN = torch.tensor([0.0, 0, 0, math.pi], dtype=torch.float64)


def model_of(case):
    inducing = (case["induce"] * TURN)[None] if case["induce"].numel() else None
    targets, hyper = case["targets"].T[None], case["hyp"].T[None]
    return GaussianProcess((case["inputs"] * TURN)[None], targets, hyper, inducing).posterior()[0]


def policy_of(hyp, inputs, targets):
    return RBFPolicy.from_targets((inputs * TURN[:5])[None], hyp[:5].T[None], targets.T[None])


@pytest.mark.parametrize("number", range(5))
def test_one_predicted_step_matches_the_original(golden, derivatives, close, number):
    case = golden("propagated")[number]
    model, m, s = model_of(case), case["m"][:, 0] + HALF_TURN, case["s"]
    parameters = (case["pol_hyp"], case["pol_inputs"], case["pol_targets"])
    limit = case["maxU"].item()

    def step(m, s, *parameters):
        state = Gaussian(m[None], (s + s.mT)[None] / 2)
        return tuple(a[0] for a in planning.propagate(model, policy_of(*parameters), limit, state))

    mean, cov = step(m, s, *parameters)
    close(mean - HALF_TURN, case["M"], name="M")
    close(cov, case["S"], name="S")
    for i, name in enumerate("MS"):
        close(derivatives.jacobian(lambda m, i=i: step(m, s, *parameters)[i], m), case[f"d{name}dm"], 1e-7, "dm")
        jac = derivatives.jacobian(lambda s, i=i: step(m, s, *parameters)[i], s)
        close(derivatives.symmetrise(jac, 4), derivatives.symmetrise(case[f"d{name}ds"], 4), 1e-7, f"d{name}ds")
        columns = []
        for j, parameter in enumerate(parameters):

            def varied(p, i=i, j=j):
                return step(m, s, *parameters[:j], p, *parameters[j + 1 :])[i]

            columns.append(derivatives.jacobian(varied, parameter))
        close(torch.cat(columns, 1), case[f"d{name}dp"], 1e-7, f"d{name}dp")


def check_value(case, close, value_tolerance, gradient_tolerance):
    parameters = [case[f"pol_{name}"].clone().requires_grad_() for name in ("hyp", "inputs", "targets")]
    start = Gaussian((case["m0"][:, 0] + HALF_TURN)[None], case["S0"][None])
    horizon = int(case["H"])
    states = planning.predict(model_of(case), policy_of(*parameters), MATLAB, start, horizon)
    costs = planning.expected_costs(MATLAB, states)[0]
    total = (costs * case["gamma"] ** torch.arange(1, horizon + 1)).sum()
    close(total, case["J"], value_tolerance, "J")
    close(costs, case["traj_cost"][0, 1:], value_tolerance, "costs")
    close(states.mean[0] - HALF_TURN, case["traj_mean"].T, gradient_tolerance, "means")
    close(states.cov[0].mT.reshape(horizon + 1, 16), case["traj_cov"], gradient_tolerance, "covariances")
    got = torch.cat([g.mT.reshape(-1) for g in torch.autograd.grad(total, parameters)])
    expected = torch.cat([case[f"dJ_{name}"].mT.reshape(-1) for name in ("hyp", "inputs", "targets")])
    assert (got - expected).norm() <= gradient_tolerance * expected.norm()


@pytest.mark.parametrize("number", range(5))
def test_predicted_trials_match_the_original(golden, close, number):
    check_value(golden("value")[number], close, 1e-8, 1e-6)


@pytest.mark.parametrize("number", range(2))
def test_predicted_trials_with_trained_models_match_the_original(golden, close, number):
    check_value(golden("value_trained")[number], close, 1e-6, 1e-4)


def toy(replicas=2, count=30, basis=4, seed=100):
    """A model learnt from a few random transitions of a short trial, and parameters of a policy."""
    g = generator(seed)
    plant = replace(PAPER, steps=5, start_std=0.1)
    inputs = torch.randn(replicas, count, 6, generator=g, dtype=torch.float64)
    mix = torch.randn(6, 4, generator=g, dtype=torch.float64)
    targets = 0.2 * torch.sin(inputs @ mix / 2).mT
    hyper = torch.tensor([1.0] * 6 + [-1.0, -3.0], dtype=torch.float64).expand(replicas, 4, 8)
    model, _ = GaussianProcess(inputs, targets, hyper).posterior()
    shape = planning.PolicyShape(basis)
    draw = [shape.initial(plant, 0.5, (0.0,) * 5, generator(seed + i)) for i in range(replicas)]
    return model, plant, shape, torch.stack(draw)


def test_objective_has_the_right_gradient():
    model, plant, shape, parameters = toy()
    _, gradient = planning.objective(model, plant, shape, parameters)
    direction = torch.randn(parameters.shape, generator=generator(101), dtype=torch.float64)
    up, down = (planning.objective(model, plant, shape, parameters + h * direction)[0] for h in (1e-5, -1e-5))
    torch.testing.assert_close((gradient * direction).sum(1), (up - down) / 2e-5, rtol=1e-6, atol=1e-8)


def test_one_step_agrees_with_brute_force_particles():
    model, plant, shape, parameters = toy()
    policy = shape.policy(parameters)
    start = planning.start_distribution(plant, 2)
    start = Gaussian(start.mean - 2.0, start.cov)
    predicted = planning.propagate(model, policy, plant.force_limit, start)
    noise = torch.randn(2, 20_000, 4, generator=generator(102), dtype=torch.float64)
    states = start.mean[:, None] + plant.start_std * noise
    inputs = torch.cat((features(states), policies.force(policy, plant, states)[..., None]), -1)
    moved = states + model(inputs)
    error = moved.std(1) / math.sqrt(moved.shape[1])
    # features and force are matched by a Gaussian, so agreement is close, not exact
    assert ((moved.mean(1) - predicted.mean).abs() < 5 * error + 0.02).all()
    own = model.moments(Gaussian(inputs.mean(1), torch.zeros(2, 6, 6, dtype=torch.float64))).cov
    spread = torch.stack([torch.cov(m.T) for m in moved]) + own
    torch.testing.assert_close(spread, predicted.cov, rtol=0, atol=0.15 * predicted.cov.abs().max().item())


def test_improve_lowers_the_predicted_cost_and_reports_its_work():
    model, plant, shape, parameters = toy()
    before, _ = planning.objective(model, plant, shape, parameters)
    found = planning.improve(model, plant, shape, parameters, 8)
    after, _ = planning.objective(model, plant, shape, found.x)
    assert (after < before).all()
    torch.testing.assert_close(after, found.value, rtol=1e-9, atol=1e-9)
    assert (found.iterations <= 8).all()
    assert (found.evaluations >= found.iterations).all()


def test_gradients_by_step_sum_to_that_of_the_objective():
    model, plant, shape, parameters = toy()
    _, gradient = planning.objective(model, plant, shape, parameters)
    doubting, sure, states = planning.step_gradients(model, plant, shape, parameters)
    torch.testing.assert_close(doubting.sum(1), gradient, rtol=1e-9, atol=1e-12)
    leaf = parameters.clone().requires_grad_()
    mean = torch.tensor(plant.start_mean, dtype=torch.float64).expand(2, 4)
    visited = planning.predict_points(model, shape.policy(leaf), plant, mean)
    (expected,) = torch.autograd.grad(cost(plant, visited[:, 3]).sum(), leaf)
    torch.testing.assert_close(sure[:, 2], expected)
    assert states.mean.shape == (2, 6, 4)


def test_a_trial_without_doubt_follows_the_model_s_mean():
    model, plant, shape, parameters = toy()
    policy, start = shape.policy(parameters), planning.start_distribution(plant, 2)
    points = planning.predict_points(model, policy, plant, start.mean)
    certain = Gaussian(start.mean, torch.zeros_like(start.cov))
    after = planning.propagate(model, policy, plant.force_limit, certain).mean
    torch.testing.assert_close(points[:, 1], after, rtol=0, atol=1e-4)  # the policy adds a small variance
    again = planning.predict_points(model, policy, replace(plant, steps=1), points[:, 1])
    torch.testing.assert_close(again[:, 1], points[:, 2])


def test_the_mean_of_a_model_has_the_moments_of_plain_functions():
    """Fixed functions take the path with gradients by hand; those of any others are autograd's."""
    model, plant, shape, parameters = toy()
    fixed, free = model.mean_function(), replace(model, precision=None)
    values = [planning.objective(f, plant, shape, parameters) for f in (fixed, free, model)]
    for mine, plain, doubting in zip(*values, strict=True):
        torch.testing.assert_close(mine, plain, rtol=1e-7, atol=1e-9)
        assert not torch.allclose(mine, doubting, rtol=1e-6)
    assert fixed.select([1]).fixed
    certain = Gaussian(torch.zeros(2, 6, dtype=torch.float64), torch.zeros(2, 6, 6, dtype=torch.float64))
    assert fixed.moments(certain).cov.abs().max() < 1e-12
    assert model.moments(certain).cov.diagonal(dim1=-2, dim2=-1).min() > 1e-6


def test_a_replica_alone_improves_as_among_others():
    model, plant, shape, parameters = toy(replicas=3)
    together = planning.improve(model, plant, shape, parameters, 5)
    for r in range(3):
        alone = planning.improve(model.select([r]), plant, shape, parameters[r : r + 1], 5)
        torch.testing.assert_close(alone.x[0], together.x[r], rtol=1e-9, atol=1e-9)


def test_a_replica_whose_prediction_breaks_down_is_reported_and_leaves_the_others_alone():
    model, plant, shape, parameters = toy(replicas=2)
    model.weights[0, 0, 0] = math.nan
    found = planning.improve(model, plant, shape, parameters, 3)
    assert found.value[0].isnan()
    assert found.repairs[0] > 0
    torch.testing.assert_close(found.x[0], parameters[0])
    assert found.value[1].isfinite()


def test_transitions_are_features_and_differences():
    observed = torch.randn(2, 4, 4, generator=generator(100), dtype=torch.float64)
    forces = torch.randn(2, 3, generator=generator(101), dtype=torch.float64)
    inputs, targets = planning.transitions(observed, forces)
    torch.testing.assert_close(inputs[1, 2, :5], features(observed[1, 2]))
    assert inputs[1, 2, 5] == forces[1, 2]
    torch.testing.assert_close(targets[1, :, 2], observed[1, 3] - observed[1, 2])


def test_bad_input_is_named():
    model, plant, shape, parameters = toy()
    bad = Gaussian(torch.zeros(2, 4, dtype=torch.float64), -torch.eye(4, dtype=torch.float64).expand(2, 4, 4))
    with pytest.raises(ValueError, match="smallest eigenvalue is -1"):
        planning.predict(model, shape.policy(parameters), plant, bad)
    with pytest.raises(ValueError, match="got 4 states and 4 forces"):
        planning.transitions(torch.zeros(1, 4, 4), torch.zeros(1, 4))
