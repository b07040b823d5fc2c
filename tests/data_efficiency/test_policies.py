"""Policies and cost: the original's moments and derivatives, Monte Carlo, limits of certainty, clear errors."""

import math
from dataclasses import replace

import pytest
import torch

from dropout_uncertainty.data_efficiency import policies
from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian, feature_moments
from dropout_uncertainty.data_efficiency.plant.cartpole import MATLAB, PAPER, features
from dropout_uncertainty.data_efficiency.plant.cost import cost, mean_cost, saturating_mean
from dropout_uncertainty.data_efficiency.policies import RBFPolicy
from dropout_uncertainty.rng import generator

HALF_TURN = torch.tensor([0.0, 0, 0, math.pi], dtype=torch.float64)


def policy_of(hyp, inputs, targets):
    """The policy of the original's parameters; it overrules their signal and noise."""
    return RBFPolicy.from_targets(inputs[None], hyp[: inputs.shape[1]].T[None], targets.T[None])


def output(policy, m, s, limit=None):
    x = Gaussian(m[None], s[None])
    moments = policy.moments(x) if limit is None else policies.force_moments(policy, limit, x)
    return tuple(a[0] for a in moments)


@pytest.mark.parametrize("key", ["congp", "conCat"])
@pytest.mark.parametrize("number", range(5))
def test_rbf_policy_matches_the_original(golden, derivatives, close, check_moments, key, number):
    case = golden(key)[number]
    limit = case["maxU"].reshape(-1) if key == "conCat" else None  # one per output
    m, s = case["m"][:, 0], case["s"]
    parameters = (case["hyp"], case["inputs"], case["targets"])
    policy = policy_of(*parameters)
    # for a certain input (case 4) the covariance is the jitter of 1e-6 plus rounding of the difference of two
    # moments
    tolerance = 1e-8 if s.abs().max() == 0 else 1e-9
    check_moments(case, lambda m, s: output(policy, m, s, limit), m, s, ("M", "S", "C"), tolerance, tolerance)
    for i, name in enumerate("MSC"):
        columns = []
        for j, parameter in enumerate(parameters):

            def varied(p, i=i, j=j):
                return output(policy_of(*parameters[:j], p, *parameters[j + 1 :]), m, s, limit)[i]

            columns.append(derivatives.jacobian(varied, parameter))
        close(torch.cat(columns, 1), case[f"d{name}dp"], tolerance, f"d{name}dp")


def test_the_mean_of_a_saturating_cost_matches_the_original(golden, derivatives, close):
    for case in golden("lossSat"):
        m, s, target = case["m"][:, 0], case["s"], case["z"][:, 0]
        values, vectors = torch.linalg.eigh(case["W"])
        factor = (vectors * values.clamp_min(0).sqrt()).mT

        def mean(m, s, target=target, factor=factor):
            return saturating_mean(Gaussian(m, (s + s.mT) / 2), target, factor).reshape(1)

        close(mean(m, s), case["L"], 1e-9, "L")
        close(derivatives.jacobian(lambda m, s=s: mean(m, s), m), case["dLdm"], 1e-9, "dLdm")
        d_s = derivatives.symmetrise(derivatives.jacobian(lambda s, m=m: mean(m, s), s), 6)
        close(d_s, derivatives.symmetrise(case["dLds"].reshape(1, -1), 6), 1e-9, "dLds")


def test_cost_of_a_gaussian_state_matches_the_original(golden, derivatives, close):
    for case in golden("loss_cp"):
        m, s = case["m"][:, 0] + HALF_TURN, case["s"]
        widths = case["width"].reshape(-1).tolist()

        def value(m, s, case=case, widths=widths):
            """The original's mixture over widths and its bonus for uncertainty, put together here."""
            total = 0
            for width in widths:
                plant = replace(MATLAB, cost_width=width, pole_length=case["p"].item())
                state = Gaussian(m, (s + s.mT) / 2)
                mean = mean_cost(plant, state)
                variance = 1 - mean_cost(replace(plant, cost_width=width / 2**0.5), state) - (1 - mean) ** 2
                bonus = case["expl"] * variance.sqrt() if case["expl"] != 0 and variance > 1e-12 else 0
                total = total + mean + bonus
            return (total / len(widths)).reshape(1)

        close(value(m, s), case["L"], name="L")
        close(derivatives.jacobian(lambda m, s=s: value(m, s), m), case["dLdm"], name="dLdm")
        jac = derivatives.symmetrise(derivatives.jacobian(lambda s, m=m: value(m, s), s), 4)
        close(jac, derivatives.symmetrise(case["dLds"], 4), 1e-8, "dLds")


def some_state(seed=100):
    root = 0.3 * torch.randn(2, 4, 4, generator=generator(seed), dtype=torch.float64)
    return Gaussian(torch.tensor([[0.1, 0, 0, 0.3], [-0.2, 1, 0, 2.5]], dtype=torch.float64), root @ root.mT)


def some_policy(seed=100):
    g = generator(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    return RBFPolicy.from_targets(normal(2, 7, 5), 0.3 * normal(2, 1, 5), normal(2, 1, 7))


def test_points_in_any_batch_shape_and_within_the_limit():
    states = torch.randn(2, 6, 4, generator=generator(101), dtype=torch.float64)
    policy = some_policy()
    forces = policies.force(policy, PAPER, states)
    assert forces.shape == (2, 6)
    assert forces.abs().max() <= PAPER.force_limit
    one = policies.force(policy, PAPER, states[:, 3])
    torch.testing.assert_close(one, forces[:, 3])
    folded = policies.force(policy, PAPER, states.reshape(2, 2, 3, 4))
    torch.testing.assert_close(folded.reshape(2, 6), forces)


def test_rbf_policy_is_a_sum_of_gaussians_and_nearly_meets_its_targets():
    rbf = some_policy()
    x = features(torch.randn(2, 1, 4, generator=generator(101), dtype=torch.float64))
    distance = (x - rbf.centres) / rbf.log_length_scales.exp()
    by_hand = (rbf.weights[:, 0] * torch.exp(-(distance**2).sum(-1) / 2)).sum(-1)
    torch.testing.assert_close(rbf(x)[:, 0, 0], by_hand)
    targets = torch.randn(2, 1, 7, generator=generator(100, "targets"), dtype=torch.float64)
    again = RBFPolicy.from_targets(rbf.centres, rbf.log_length_scales, targets)
    torch.testing.assert_close(again(rbf.centres)[..., 0], targets[:, 0], rtol=0, atol=0.02)


def test_squash_reaches_the_limit_flatly():
    u = torch.linspace(-3, 3, 1001, dtype=torch.float64)
    assert policies.squash(u, 10.0).abs().max() <= 10
    top = torch.tensor([math.pi / 2], dtype=torch.float64, requires_grad=True)
    value = policies.squash(top, 10.0)
    assert value.item() == pytest.approx(10)
    assert torch.autograd.grad(value, top)[0].abs() < 1e-12


def test_a_certain_state_gives_the_force_of_the_point():
    state = some_state()
    certain = Gaussian(state.mean, torch.zeros_like(state.cov))
    policy = some_policy()
    moments = policies.force_moments(policy, 10.0, feature_moments(certain).out)
    point = policies.force(policy, MATLAB, state.mean)
    # the jitter on the preliminary variance of 1e-6 moves the mean by about as much
    torch.testing.assert_close(moments.mean[:, 0], point, rtol=0, atol=1e-4)
    assert (moments.cov >= 0).all()
    assert (moments.cov < 1e-3).all()


def test_expected_cost_matches_monte_carlo_over_gaussian_features_and_the_point():
    state = some_state()
    mean = mean_cost(MATLAB, state)
    x = feature_moments(state)
    noise = torch.randn(60_000, 2, 5, generator=generator(102), dtype=torch.float64)
    jitter = 1e-10 * torch.eye(5, dtype=torch.float64)
    draws = x.mean + (torch.linalg.cholesky(x.cov + jitter) @ noise[..., None])[..., 0]
    length = MATLAB.pole_length
    tip = torch.stack((draws[..., 0] - length * draws[..., 3], length * draws[..., 4] - length), -1)
    costs = 1 - torch.exp(-(tip**2).sum(-1) / (2 * MATLAB.cost_width**2))
    error = costs.std(0) / math.sqrt(len(costs))
    assert ((costs.mean(0) - mean).abs() < 4.5 * error).all()
    point = mean_cost(MATLAB, Gaussian(state.mean, torch.zeros_like(state.cov)))
    torch.testing.assert_close(point, cost(MATLAB, state.mean))


def test_uncertainty_gives_the_hanging_pole_a_slope():
    # the reason why PILCO takes the expectation: 1 rad from hanging, the point's cost is flat
    def slope(std):
        theta = torch.tensor(math.pi - 1, dtype=torch.float64, requires_grad=True)
        mean = torch.stack((*torch.zeros(3, dtype=torch.float64), theta))
        cov = torch.diag(torch.tensor([0.0, 0, 0, std**2], dtype=torch.float64))
        return torch.autograd.grad(mean_cost(PAPER, Gaussian(mean, cov)), theta)[0].item()

    assert abs(slope(1.0)) > 50 * abs(slope(0.0))
