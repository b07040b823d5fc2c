"""The environments by their names in Gymnasium: found after two imports in any order, and drawn."""

import subprocess
import sys

import numpy as np
import pytest

from dropout_uncertainty import environments
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.errors import UserError

gymnasium = pytest.importorskip("gymnasium")
NAMES = list(environments.ENVIRONMENTS)


LOOKS = "dropout_uncertainty, importlib.util; importlib.util.find_spec('gymnasium'); import gymnasium"


@pytest.mark.parametrize("order", ["dropout_uncertainty, gymnasium", "gymnasium, dropout_uncertainty", LOOKS])
def test_two_imports_in_any_order_give_the_names(order):
    code = f"import {order}; print(*(name for name in gymnasium.registry if name.startswith('dropout_uncertainty/')))"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert outcome.stdout.split() == NAMES


def test_the_package_alone_imports_neither_gymnasium_nor_numpy():
    code = "import dropout_uncertainty, sys; print({'gymnasium', 'numpy', 'torch', 'matplotlib'} & set(sys.modules))"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert outcome.stdout.strip() == "set()"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("ignore:.*infinity")  # positions of the cart have no bounds
def test_checked_drawn_and_stacked(name):
    from gymnasium.utils.env_checker import check_env

    env = gymnasium.make(name, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.reset(seed=100)
    first = env.render()
    env.action_space.seed(100)
    for _ in range(5):
        env.step(env.action_space.sample())
    later = env.render()
    assert first.dtype == np.uint8
    assert first.shape[2] == 3
    assert first.shape == later.shape
    assert (first != later).any()
    assert gymnasium.make(name).unwrapped.render() is None
    many = gymnasium.make_vec(name, num_envs=2)
    many.reset(seed=100)
    assert many.step(many.action_space.sample())[1].shape == (2,)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("action", ["left", None, 99, np.array([[1, 2]])])
def test_a_wrong_action_is_one_sentence(name, action):
    env = gymnasium.make(name).unwrapped
    env.reset(seed=100)
    with pytest.raises(UserError, match=r"^expected an action .*, got [^\n]+$"):
        env.step(action)


@pytest.mark.parametrize("name", NAMES)
def test_what_cannot_be_drawn_is_refused(name):
    with pytest.raises(UserError, match="render mode rgb_array or None, got 'ansi'"):
        gymnasium.make(name, render_mode="ansi")
    env = gymnasium.make(name, render_mode="rgb_array").unwrapped
    if hasattr(env, "world") or hasattr(env, "plant"):
        with pytest.raises(UserError, match="call reset first"):
            env.render()


def test_a_plant_of_ones_own_is_accepted():
    plant = cartpole.CartPole(pole_length=0.8, steps=30, start_std=0.0, solved_steps=5)
    env = gymnasium.make("dropout_uncertainty/CartPoleSwingUp-v0", plant=plant)
    assert env.unwrapped.plant is plant
    env.reset(seed=100)
    assert not env.step(np.ones(1, np.float32))[3]
