"""Learning where only x and θ are seen: what the policy is given, the predicted cost and its gradient, and a unit."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from toy import finish

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.deep_pilco.learner import OURS
from dropout_uncertainty.data_efficiency.deep_pilco.planning import RBFShape
from dropout_uncertainty.data_efficiency.hidden_state import control
from dropout_uncertainty.data_efficiency.hidden_state.control import CONFIGS, MIXED, PAST, ControlConfig, HiddenShape
from dropout_uncertainty.data_efficiency.policies import force
from dropout_uncertainty.rng import generator
from dropout_uncertainty.runs.unit import RunError
from dropout_uncertainty.settings import config_diff

NAMES = ("last-one", "last-four", "lstm-held")
SMALL = {"trials": 2, "particles": 4, "policy_steps": 3, "basis": 6, "noise": True}


def small(name="lstm-held", **changes):
    config = CONFIGS[f"hidden/control-{name}"]
    model = replace(config.model, steps=4, hidden=(8,), drop=0.3)
    return replace(config, model=model, **SMALL | changes)


def learner(name="lstm-held", seeds=(100, 101), **changes):
    return control.start(small(name, **changes), seeds, precision="float64")


def test_what_the_policy_is_given():
    """Mean speeds over the last one, two and three intervals are 3, 2.5 and 2 m/s, and -1, -1.5 and 1 rad/s."""
    shape = HiddenShape(6)
    assert shape.on_states.size + MIXED == len(learner()._initial(generator(100)))
    parameters = torch.zeros(1, shape.on_states.size + MIXED)
    parameters[0, -MIXED:] = torch.tensor([1.0, 2.0, -1.0, 0.0, 0.0, 1.0])
    past = [torch.tensor([[[x, theta]]]) for x, theta in ((0.0, -0.3), (0.1, 0.3), (0.3, 0.1), (0.6, 0.0))]
    expected = torch.tensor([0.6, 3.0 + 5.0 - 2.0, 1.0, 0.0, 1.0])
    assert torch.allclose(shape.policy(parameters).inputs(past, 0.1), expected, atol=1e-5)


def test_at_first_the_policy_does_what_one_that_sees_the_state_would_do_while_the_speeds_are_even():
    config = CONFIGS["hidden/control-last-one"]
    mine = control.start(config, (100,), precision="float64")
    states = RBFShape(config.basis)
    drawn = states.initial(config.spread, config.weight_std, generator(100, "policy", 0))
    state = torch.tensor([[0.3, 1.0, -2.0, 2.5]], dtype=torch.float64)
    act = mine._act()
    for t in range(PAST):
        seen = state.clone()
        seen[:, 0] += (t + 1 - PAST) * config.plant.dt * state[:, 1]
        seen[:, 3] += (t + 1 - PAST) * config.plant.dt * state[:, 2]
        found = act(seen, t)
    assert torch.allclose(found, force(states.policy(drawn[None]), config.plant, state), atol=1e-9)


def test_on_the_plant_speeds_are_not_looked_at():
    mine = learner("last-four")
    one, two = mine._act(), mine._act()
    for t in range(3):
        seen = torch.randn(2, 4, generator=generator(100, t), dtype=torch.float64)
        other = seen.clone()
        other[:, 1:3] = 7.0
        assert torch.equal(one(seen, t), two(other, t))


@pytest.mark.parametrize("name", NAMES)
def test_the_gradient_is_that_of_the_predicted_cost(name):
    mine = learner(name)
    mine.advance()
    mine._train()

    def value(parameters):
        return mine._objective(mine.model, mine.seeds, "plan", 1, 0)(parameters)

    step = 1e-6 * torch.randn(mine.policy.shape, generator=generator(100), dtype=torch.float64)
    slope = (value(mine.policy + step)[0] - value(mine.policy - step)[0]) / 2
    assert torch.allclose((value(mine.policy)[1] * step).sum(1), slope, rtol=1e-4)
    assert (slope != 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_some_replicas_of_a_model_predict_as_among_all(name):
    mine = learner(name)
    mine.advance()
    mine._train()
    whole = mine._objective(mine.model, mine.seeds, 0)(mine.policy)
    part = mine._objective(mine.model.select([1]), mine.seeds[1:], 0)(mine.policy[1:])
    for one, two in zip(whole, part, strict=True):
        assert torch.allclose(one[1:], two, atol=1e-9)


def test_without_noise_particles_differ_by_their_starts_and_their_draws_alone():
    mine = learner(noise=False)
    _, noise = mine._started(mine._noise(mine.seeds, 4, 1, 0)[:, 0])
    assert not noise.any()
    assert learner()._started(mine._noise(mine.seeds, 4, 1, 0)[:, 0])[1].std() > 0.5


@pytest.mark.parametrize("name", NAMES)
def test_resumed_is_whole_and_alone_is_as_among_others(name):
    whole = finish(learner(name)).result()
    assert whole["costs"].shape == (2, 3, 25)
    assert whole["predicted_mean"].shape == (2, 3, 26, 2)
    assert np.isfinite(whole["predicted_cost"][:, 1:]).all()
    begun, rest = learner(name), learner(name)
    begun.advance()
    begun.advance()
    rest.restore(begun.state())
    for key, value in finish(rest).result().items():
        assert np.array_equal(value, whole[key], equal_nan=True), key
    for key, value in finish(learner(name, (101,))).result().items():
        assert np.allclose(value[0], whole[key][1], atol=1e-5, equal_nan=True), key


def test_the_command_line_knows_the_learners_and_their_ten_seeds():
    for name in NAMES:
        (unit,) = configs.units(f"hidden/control-{name}")
        assert unit.seeds == tuple(range(10))


def test_all_but_the_model_is_as_in_our_setting():
    config = CONFIGS["hidden/control-last-one"]
    shared = {f.name for f in fields(config)} & {f.name for f in fields(OURS)} - {"trials"}
    assert len(shared) == 10
    assert {name: getattr(config, name) for name in shared} == {name: getattr(OURS, name) for name in shared}
    models = {name: config_diff(config, other) for name, other in CONFIGS.items()}
    assert all(field == "model" for differences in models.values() for field, *_ in differences)


def test_settings_that_cannot_be_are_refused():
    model = CONFIGS["hidden/control-lstm-held"].model
    with pytest.raises(ValueError, match="particles must be at least 1, got 0"):
        ControlConfig(model, particles=0)
    with pytest.raises(ValueError, match="positive spreads"):
        ControlConfig(model, spread=(1.0, 2.0))
    for change in ({"clip": -1.0}, {"guard": 5.0}):
        with pytest.raises(ValueError, match="no negative clip and a guard"):
            ControlConfig(model, **change)
    with pytest.raises(RunError, match="run on the CPU, got the device cuda"):
        control.start(CONFIGS["hidden/control-lstm-held"], (100,), device="cuda")
