"""Dropout networks as dynamics model: what a draw means, what is learned, and that replicas do not meddle."""

import math

import pytest
import torch

from dropout_uncertainty.bayes import weight_decay
from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import LOG_NOISE_RANGE, DropoutDynamics
from dropout_uncertainty.data_efficiency.deep_pilco.network_gradient import set_gradients
from dropout_uncertainty.data_efficiency.plant.cartpole import features
from dropout_uncertainty.rng import generator

FIT = {"steps": 20, "rate": 1e-2, "final_rate": 0.1, "batch": 16, "length_scale": 0.3}


def dynamics(seeds=(100, 101), **options):
    return DropoutDynamics(seeds, **{"hidden": (12, 10), "drop": 0.25, "dtype": torch.float64, **options})


def gradients(model, inputs, targets, masks, decays):
    """Set the gradients of the parameters and return the likelihood part of the objective."""
    return set_gradients(model.net, model.activation, model.log_noise, LOG_NOISE_RANGE, inputs, targets, masks, decays)


def transitions(runs=2, count=30, noise=0.0):
    """Return inputs and targets of a system that is linear in features and force."""
    g = generator(100, "test transitions")
    states = torch.randn(runs, count, 4, generator=g, dtype=torch.float64) * torch.tensor([1.0, 2.0, 5.0, 2.0])
    forces = 10 * torch.rand(runs, count, generator=g, dtype=torch.float64) - 5
    inputs = torch.cat((features(states), forces[..., None]), -1)
    mix = torch.randn(6, 4, generator=g, dtype=torch.float64)
    return inputs, inputs @ mix + noise * torch.randn(runs, count, 4, generator=g, dtype=torch.float64)


@pytest.mark.parametrize("activation", ["relu", "sigmoid"])
@pytest.mark.parametrize("input_drop", [0.0, 0.25])
def test_a_drawn_function_is_the_network_under_its_masks(activation, input_drop):
    model = dynamics(activation=activation, input_drop=input_drop)
    inputs, targets = transitions()
    model.fit(inputs, targets, "fit", **FIT)
    masks = model.draw(5, "draw")
    scaled = (inputs[:, :5] - model.input_mean) / model.input_std
    expected = model.net(scaled, masks) * model.target_std + model.target_mean
    torch.testing.assert_close(model.function(masks)(inputs[:, :5]), expected, rtol=1e-10, atol=1e-10)
    expected = model.net(scaled) * model.target_std + model.target_mean
    torch.testing.assert_close(model.function(None)(inputs[:, :5]), expected, rtol=1e-10, atol=1e-10)


def test_a_function_keeps_its_draw_and_another_draw_is_another_function():
    model, (inputs, _) = dynamics(), transitions()
    function, x = model.function(model.draw(5, 0)), inputs[:, :5]
    assert torch.equal(function(x), function(x))
    assert torch.equal(function(x), model.function(model.draw(5, 0))(x))
    assert not torch.equal(function(x), model.function(model.draw(5, 1))(x))
    same = inputs[:, :1].expand(-1, 5, -1)
    assert function(same).std(1).min() > 0  # rows follow functions of their own


def test_the_objective_is_the_mean_negative_log_likelihood_with_the_decay_of_the_prior():
    model = dynamics(drop=0.1)
    n, length_scale = 50, 0.4
    decays = [weight_decay(n, p, length_scale, 1.0) for p in model.drop]
    inputs, target = torch.zeros(2, 3, 6, dtype=torch.float64), torch.full((2, 3, 4), 0.5, dtype=torch.float64)
    std = math.exp(-2.0)
    likelihood = torch.distributions.Normal(0.0, std).log_prob(torch.tensor(0.5)).item() + 0.5 * math.log(2 * math.pi)
    squares = [weight.detach()[1].square().sum().item() for weight in model.net.weights]
    keep = (1.0, 0.9, 0.9)
    expected = -4 * likelihood + sum(k * length_scale**2 / (2 * n) * s for k, s in zip(keep, squares, strict=True))
    found = gradients(model, inputs, target, model.draw(3, 0), decays) + model._penalty(decays)
    assert found[1].item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("activation", "input_drop"), [("relu", 0.0), ("sigmoid", 0.2)])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-4)])
def test_gradients_by_hand_are_those_of_autograd(activation, input_drop, dtype, tolerance):
    model = dynamics(activation=activation, input_drop=input_drop, hidden=(16, 12), dtype=dtype)
    g, decays, masks = generator(100, "gradients"), (0.01, 0.02, 0.03), model.draw(9, 0)
    inputs, targets = torch.randn(2, 9, 6, generator=g, dtype=dtype), torch.randn(2, 9, 4, generator=g, dtype=dtype)
    with torch.no_grad():
        for bias in model.net.biases:
            bias += 0.3 * torch.randn(bias.shape, generator=g, dtype=dtype)
        model.log_noise[0, 0] = torch.tensor([-6.0, -4.9, -0.1, 0.5])  # beyond the limits the gradient is 0
    noise = torch.distributions.Normal(model.net(inputs, masks), model.log_noise.clamp(*LOG_NOISE_RANGE).exp())
    constant = 4 * 0.5 * math.log(2 * math.pi)
    loss = -noise.log_prob(targets).sum(-1).mean(-1) - constant
    decay = sum(d * w.square().sum() for d, w in zip(decays, model.net.weights, strict=True))
    parameters = [*model.net.parameters(), model.log_noise]
    expected = torch.autograd.grad(loss.sum() + decay, parameters)
    close = {"rtol": tolerance, "atol": tolerance}
    torch.testing.assert_close(gradients(model, inputs, targets, masks, decays), loss.detach(), **close)
    for parameter, gradient in zip(parameters, expected, strict=True):
        scale = gradient.abs().max().item()
        torch.testing.assert_close(parameter.grad, gradient, rtol=tolerance, atol=tolerance * scale)


def test_noise_at_one_of_its_limits_has_the_gradient_of_noise_within():
    """As autograd's clamp has it in PyTorch 2.13; in 2.15 it is 0 there, and noise could not leave its limit."""
    model, (low, high) = dynamics(dtype=torch.float64), LOG_NOISE_RANGE
    inputs, targets, masks = torch.zeros(2, 9, 6).double(), torch.full((2, 9, 4), 2.0).double(), model.draw(9, 0)
    found = []
    for inside in (0.0, 1e-9):
        with torch.no_grad():
            ends = [low - 1e-9, low + inside, high - inside, high + 1e-9]
            model.log_noise[:] = torch.tensor(ends, dtype=torch.float64)
        gradients(model, inputs, targets, masks, (0.0, 0.0, 0.0))
        found.append(model.log_noise.grad[:, 0].clone())
    at, within = found
    assert (at[:, [0, 3]] == 0).all()
    assert (at[:, [1, 2]] != 0).all()
    torch.testing.assert_close(at, within, rtol=1e-6, atol=1e-6)


def test_a_fit_learns_the_function_and_the_size_of_the_noise():
    model = dynamics(hidden=(40, 40), drop=0.0)
    inputs, targets = transitions(count=400, noise=2.0)
    loss, repairs = model.fit(
        inputs, targets, steps=400, rate=1e-2, final_rate=0.05, batch=100, length_scale=0.3,
    )  # fmt: skip
    fresh, clean = inputs[:, ::2], transitions(count=400)[1][:, ::2]
    error = (model.function(None)(fresh) - clean).square().mean().sqrt()
    assert error < 0.15 * clean.std()
    assert ((model.noise_std() > 1.0) & (model.noise_std() < 2.5)).all()
    assert loss.shape == (2,)
    assert repairs.tolist() == [0, 0]


def test_a_fit_continues_from_the_weights_of_the_last():
    model, (inputs, targets) = dynamics(drop=0.0), transitions()
    first, _ = model.fit(inputs, targets, 1, **FIT | {"batch": 30})
    second, _ = model.fit(inputs, targets, 2, **FIT | {"batch": 30})
    assert (second < first).all()


def test_a_replica_alone_equals_the_same_among_others():
    inputs, targets = transitions(runs=10)
    many = dynamics(seeds=range(100, 110))
    alone = dynamics(seeds=(107,))
    for trial in (1, 2):
        many.fit(inputs, targets, trial, **FIT)
        alone.fit(inputs[7:8], targets[7:8], trial, **FIT)
    for name, value in alone.state().items():
        torch.testing.assert_close(value[0], many.state()[name][7], rtol=1e-9, atol=1e-9)


def test_selected_replicas_are_copies():
    model, (inputs, targets) = dynamics(seeds=(100, 101, 102)), transitions(runs=3)
    model.fit(inputs, targets, 1, **FIT)
    part, x = model.select([2, 0]), inputs[[2, 0], :5]
    expected = model.function(model.draw(5, "again"))(inputs[:, :5])[[2, 0]]
    torch.testing.assert_close(part.function(part.draw(5, "again"))(x), expected)
    before = model.state()
    part.fit(inputs[[2, 0]], targets[[2, 0]], 2, **FIT)
    assert all(torch.equal(value, before[name]) for name, value in model.state().items())
    assert model.select([0, 1, 2]) is model


def test_a_broken_replica_begins_anew_and_leaves_the_others_alone():
    inputs, targets = transitions()
    broken, sound = dynamics(), dynamics()
    with torch.no_grad():
        broken.net.weights[1][1, 0, 0] = math.nan
    _, repairs = broken.fit(inputs, targets, 1, **FIT)
    sound.fit(inputs, targets, 1, **FIT)
    assert repairs.tolist() == [0, 1]
    for name, value in sound.state().items():
        torch.testing.assert_close(broken.state()[name], value)


def test_a_diverging_objective_is_left_out_and_counted():
    inputs, targets = transitions()
    model, sound = dynamics(standardise=False), dynamics(standardise=False)
    wild = targets.clone()
    wild[1] = 1e200
    _, repairs = model.fit(inputs, wild, 1, **FIT)
    sound.fit(inputs, targets, 1, **FIT)
    assert repairs.tolist() == [0, FIT["steps"]]
    for name, value in sound.state().items():
        torch.testing.assert_close(model.state()[name][0], value[0])


def test_state_restores_a_model():
    inputs, targets = transitions()
    model, other = dynamics(), dynamics()
    model.fit(inputs, targets, 1, **FIT)
    other.restore(model.state())
    model.fit(inputs, targets, 2, **FIT)
    other.fit(inputs, targets, 2, **FIT)
    assert all(torch.equal(value, other.state()[name]) for name, value in model.state().items())


def test_raw_inputs_are_the_state_and_the_force():
    model = dynamics(angle_features=False, standardise=False)
    states, forces = torch.randn(2, 7, 4, generator=generator(100), dtype=torch.float64), torch.ones(2, 7).double()
    inputs = model.inputs(states, forces)
    assert torch.equal(inputs, torch.cat((states, forces[..., None]), -1))
    model.fit(inputs, states, 1, **FIT)
    assert model.input_std.unique().tolist() == [1.0]
    assert model.target_mean.unique().tolist() == [0.0]


def test_a_column_that_does_not_vary_is_not_scaled():
    model, (inputs, targets) = dynamics(), transitions()
    inputs[..., 0] = 3.0
    model.fit(inputs, targets, 1, **FIT)
    assert model.input_std[:, 0, 0].tolist() == [1.0, 1.0]


def test_bad_input_is_named():
    inputs, targets = transitions()
    with pytest.raises(ValueError, match="relu or sigmoid"):
        dynamics(activation="tanh")
    with pytest.raises(ValueError, match=r"lies in \[0, 1\)"):
        dynamics(drop=1.0)
    with pytest.raises(ValueError, match=r"expected inputs \[2, N, 6\] and targets \[2, N, 4\], got \(\(2, 30, 5\)"):
        dynamics().fit(inputs[..., 1:], targets, 1, **FIT)
    inputs[0, 0, 0] = math.inf
    with pytest.raises(ValueError, match="finite transitions"):
        dynamics().fit(inputs, targets, 1, **FIT)
