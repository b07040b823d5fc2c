"""The Gymnasium environment: its checker, and the same plant behind it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cost import cost, solved
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.rng import generator


@pytest.fixture
def make():
    pytest.importorskip("gymnasium")
    from dropout_uncertainty.data_efficiency.plant.environment import CartPoleSwingUp

    return CartPoleSwingUp


@pytest.mark.parametrize("preset", sorted(cartpole.PRESETS))
def test_passes_gymnasiums_checker(make, preset):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(infinity|spec).*")  # unbounded positions; made without registry
        check_env(make(preset), skip_render_check=True)


@pytest.mark.parametrize("preset", sorted(cartpole.PRESETS))
@pytest.mark.parametrize("fastest", [0.0, 10.0, 35.0])
def test_a_step_in_floats_is_that_of_the_plant(make, preset, fastest):
    from dropout_uncertainty.data_efficiency.plant.extrapolation import step

    plant, g, count = cartpole.preset(preset), generator(100, "states"), 200
    spread = torch.tensor([2.0, 4.0, 0.0, 3.0], dtype=torch.float64)
    states = spread * torch.randn(count, 4, generator=g, dtype=torch.float64)
    states[:, 2] = fastest * (2 * torch.rand(count, generator=g, dtype=torch.float64) - 1)
    forces = plant.force_limit * (2 * torch.rand(count, generator=g, dtype=torch.float64) - 1)
    exact = cartpole.step(plant, states, forces, 400)
    got = [step(plant, tuple(s), f) for s, f in zip(states.tolist(), forces.tolist(), strict=True)]
    np.testing.assert_allclose(got, exact, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "change",
    [{"dt": 0.5}, {"cart_mass": 0.02, "pole_mass": 0.01, "friction": 5.0, "pole_length": 0.3}, {"friction": 500.0}],
)
def test_a_step_of_another_plant_is_cut_finer(make, change):
    from dropout_uncertainty.data_efficiency.plant.extrapolation import step

    plant = replace(cartpole.PAPER, **change)
    states = torch.randn(20, 4, generator=generator(100, "states"), dtype=torch.float64)
    exact = cartpole.step(plant, states, torch.full((20,), 7.0, dtype=torch.float64), 4_000)
    np.testing.assert_allclose([step(plant, tuple(s), 7.0) for s in states.tolist()], exact, rtol=0, atol=1e-5)


def test_a_plant_that_moves_too_fast_is_named(make):
    from dropout_uncertainty.data_efficiency.plant.extrapolation import step

    with pytest.raises(ValueError, match=r"moves too fast for a control interval of 0\.1 s"):
        step(replace(cartpole.PAPER, friction=1e6), (0.0, 1.0, 0.0, 3.0), 7.0)


def test_a_force_at_its_limit_may_be_rounded(make):
    moved = []
    for action in (1.0, np.nextafter(np.float32(1), np.float32(2))):
        env = make()
        env.reset(seed=100)
        moved.append(env.step([action])[4]["state"].tolist())
    assert moved[0] == moved[1]


def test_a_hanging_pole_is_not_balanced(make):
    plant = replace(cartpole.PAPER, cost_width=2.0)
    with pytest.raises(ValueError, match="hangs at rest would count as balanced"):
        solved(plant, torch.zeros(plant.steps))


def test_steps_the_plant_and_ends_with_the_trial(make):
    env = make("paper")
    observation, info = env.reset(seed=100)
    assert np.abs(observation - info["state"]).max() < 0.06
    state = torch.from_numpy(info["state"])
    for t in range(env.plant.steps):
        action = np.array([0.3 * (-1) ** t], dtype=np.float32)
        _, reward, terminated, truncated, info = env.step(action)
        state = cartpole.step(env.plant, state, torch.tensor(10 * float(action[0]), dtype=torch.float64))
        np.testing.assert_allclose(info["state"], state, rtol=0, atol=1e-5)  # errors of 25 steps add up
        assert reward == pytest.approx(1 - cost(env.plant, torch.from_numpy(info["state"])).item())
        assert (terminated, truncated) == (False, t == env.plant.steps - 1)


def test_misuse_is_named(make):
    env = make()
    with pytest.raises(UserError, match="call reset first"):
        env.step(np.zeros(1, dtype=np.float32))
    env.reset(seed=100)
    for action in (np.array([np.nan], dtype=np.float32), 10.0, [0.1, 0.2], np.array([[1.01]])):
        with pytest.raises(UserError, match=r"one number in \[-1, 1\], the share of 10 N"):
            env.step(action)


def test_a_number_a_list_and_an_array_are_the_same_action(make):
    states = []
    for action in (0.5, [0.5], np.float32(0.5), np.array([0.5], dtype=np.float32), np.array([[0.5]])):
        env = make()
        env.reset(seed=100)
        states.append(env.step(action)[4]["state"])
    assert all(np.array_equal(state, states[0]) for state in states)
