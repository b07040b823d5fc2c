"""Estimates of a gradient that is known, and of one that a search begins with."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy import finish

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.ablations import gradients, mchutchon
from dropout_uncertainty.data_efficiency.ablations.gradients import ESTIMATES, estimate
from dropout_uncertainty.data_efficiency.deep_pilco import planning
from dropout_uncertainty.data_efficiency.deep_pilco.planning import RBFShape
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.data_efficiency.pilco.gaussian_process import GaussianProcess
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.rng import generator

DOUBLE = {"dtype": torch.float64}
PLANT = replace(PAPER, steps=6, solved_steps=2)
#: Repetitions of an estimate, its particles and steps; start and parameters of the linear system.
DRAWS, PARTICLES, STEPS = 400, 50, 4
BEGIN, THETA = 0.5, (-0.3, 0.4, -0.7)


pytestmark = pytest.mark.usefixtures("coarse_plant")


def linear(state, parameters):
    """x' = (0.9 + θ₀) x + θ₁ + exp(θ₂) · noise."""
    first, second, third = (p[..., None] for p in parameters.unbind(-1))
    return (0.9 + first) * state + second, third.exp().expand_as(state)


def squares(state):
    return (state[..., 0] - 1) ** 2


def known(steps):
    """Return the gradient of the expected cost of the linear system, from its exact moments."""
    theta = torch.tensor(THETA, **DOUBLE, requires_grad=True)
    mean, variance, total = torch.tensor(BEGIN, **DOUBLE), torch.tensor(0.0, **DOUBLE), 0.0
    for _ in range(steps):
        mean = (0.9 + theta[0]) * mean + theta[1]
        variance = (0.9 + theta[0]) ** 2 * variance + torch.exp(2 * theta[2])
        total = total + (mean - 1) ** 2 + variance
    return torch.autograd.grad(total / steps, theta)[0]


def repeated(share, particles=PARTICLES, draws=DRAWS):
    noise = torch.randn(draws, STEPS, particles, 1, generator=generator(100), **DOUBLE)
    start = torch.full((draws, particles, 1), BEGIN, **DOUBLE)
    return estimate(linear, squares, start, torch.tensor(THETA, **DOUBLE).expand(draws, -1), noise, share)


@pytest.mark.parametrize(
    ("name", "particles"), [("pathwise", 20), ("likelihood-ratio", 20), ("total-propagation", 800)]
)
def test_the_mean_of_many_estimates_is_the_gradient(name, particles):
    found = repeated(ESTIMATES[name], particles)
    error = found.std(0) / DRAWS**0.5
    assert (error < 0.04).all()  # or the test could not fail
    assert ((found.mean(0) - known(STEPS)).abs() < 4 * error).all()


def test_the_bias_of_total_propagation_vanishes_with_many_particles():
    few, many = ((repeated(None, count).mean(0) - known(STEPS)).norm() for count in (10, 400))
    assert few > 0.1
    assert many < few / 10


def test_a_fixed_mixture_is_not_biased_by_few_particles_either():
    found = repeated(0.3, particles=3, draws=4000)
    assert ((found.mean(0) - known(STEPS)).abs() < 4 * found.std(0) / 4000**0.5).all()


def test_the_pathwise_estimate_is_the_gradient_of_the_cost_of_the_particles():
    noise = torch.randn(1, STEPS, 5, 1, generator=generator(100), **DOUBLE)
    start, theta = torch.full((1, 5, 1), BEGIN, **DOUBLE), torch.tensor([THETA], **DOUBLE, requires_grad=True)
    state, total = start, 0.0
    for t in range(STEPS):
        mean, std = linear(state, theta[:, None].expand(-1, 5, -1))
        state = mean + std * noise[:, t]
        total = total + squares(state).mean() / STEPS
    (expected,) = torch.autograd.grad(total, theta)
    torch.testing.assert_close(estimate(linear, squares, start, theta.detach(), noise, 0.0), expected)


def test_total_propagation_varies_less_than_the_worse_and_hardly_more_than_the_better_of_the_two():
    spread = {name: repeated(share, 400).var(0).sum() for name, share in ESTIMATES.items()}
    low, high = sorted((spread["pathwise"], spread["likelihood-ratio"]))
    assert spread["total-propagation"] < 1.2 * low < high


def test_through_a_gaussian_process_it_is_the_gradient_that_searches_follow():
    g = generator(100)
    inputs = torch.randn(2, 30, 6, generator=g, **DOUBLE)
    targets = 0.2 * torch.sin(inputs @ torch.randn(6, 4, generator=g, **DOUBLE) / 2).mT
    hyper = torch.tensor([1.0] * 6 + [-1.0, -3.0], **DOUBLE).expand(2, 4, 8)
    model = GaussianProcess(inputs, targets, hyper).posterior()[0]
    shape = RBFShape(3)
    policies = torch.stack([shape.initial((1.0,) * 5, 0.5, generator(seed)) for seed in (100, 101)])
    plan = planning.Planning(hold_masks=False, matching="off", particles=7)
    dynamics = mchutchon.GaussianDynamics(model, (100, 101))
    (draws,) = planning.draw(dynamics, PLANT, plan, 7, "test")
    _, expected = planning.objective(PLANT, shape, plan, policies, draws)
    noise = torch.stack([function.noise for function in draws.functions], 1)
    step = gradients.policy_step(model, PLANT, shape)
    found = estimate(step, lambda state: cost(PLANT, state), draws.start, policies, noise, 0.0)
    torch.testing.assert_close(found, expected)


SMALL = {
    "plant": PLANT, "trials": 2, "basis": 3, "policy_iterations": 3, "model_iterations": 5, "particles": 5, "draws": 3,
    "horizons": (2, 6),
}  # fmt: skip


def test_looking_does_not_disturb_learning_and_a_repetition_is_the_same_alone():
    config = replace(gradients.CONFIGS["gradients/pilco"], **SMALL)
    many, one = (finish(gradients.start(config, seeds)) for seeds in ((100, 101), (101,)))
    record = many.result()
    assert set(record) == {"costs", *gradients.MEASURED, *many.COUNTS}
    assert (record["gradient_variance"][:, 1:] > 0).all()
    assert record["gradient_variance"].shape == (2, 3, len(ESTIMATES), 2)
    for name in ("costs", *gradients.MEASURED):
        np.testing.assert_allclose(one.result()[name][0], record[name][1], rtol=1e-5, atol=1e-7)
    plain = {k: v for k, v in SMALL.items() if k not in ("particles", "draws", "horizons")}
    usual = finish(pilco.start(replace(pilco.LONGER["pilco-paper-15"], **plain), (100, 101)))
    np.testing.assert_array_equal(usual.result()["costs"], record["costs"])


def test_units_and_bad_input_are_named():
    assert configs.units("gradients/pilco")[0].label == "data_efficiency/gradients/pilco/000-009"
    with pytest.raises(ValueError, match="horizons of 1 to 6 steps, got 5, 3 and \\(2, 7\\)"):
        replace(gradients.CONFIGS["gradients/pilco"], **SMALL | {"horizons": (2, 7)})
    with pytest.raises(ValueError, match="2 or more particles"):
        replace(gradients.CONFIGS["gradients/pilco"], particles=1)
