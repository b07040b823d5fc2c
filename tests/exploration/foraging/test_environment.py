"""The Gymnasium environment: its checker, and the same world behind it."""

import warnings

import numpy as np
import pytest

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.foraging import world as w


@pytest.fixture
def make():
    pytest.importorskip("gymnasium")
    from dropout_uncertainty.exploration.foraging.environment import ForagingWorld

    return ForagingWorld


def test_passes_gymnasiums_checker(make):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*spec.*")  # made without registry
        check_env(make(), skip_render_check=True)


@pytest.mark.parametrize("rules", [None, w.Rules(first_eye=-1.0, displaced_hits=False, doubled_proximity=True)])
def test_is_the_world_with_one_agent(make, rules):
    """The same moves and the same random numbers lead through the same states, observations and rewards."""
    env, ticks = make(400, rules), 400
    observation, _ = env.reset(seed=100)
    numbers = np.random.Generator(np.random.PCG64(np.random.SeedSequence(100)))  # as Gymnasium makes them
    world = w.World(numbers.random((1, w.ITEMS, 3)), rules=rules)
    actions = np.random.default_rng(101).choice(5, ticks, p=[0.8, 0.1, 0.04, 0.03, 0.03])
    total = np.zeros(3, dtype=int)
    for t, action in enumerate(actions):
        readings = world.sense()
        np.testing.assert_array_equal(observation, world.inputs(readings)[0, 0])
        outcome = world.step(np.array([[action]]), numbers.random((1, w.ITEMS)), numbers.random((1, 4)))
        observation, reward, terminated, truncated, info = env.step(action)
        assert observation in env.observation_space
        assert reward == world.reward(readings, np.array([[action]]), outcome)[0, 0]
        assert (terminated, truncated) == (False, t == ticks - 1)
        assert tuple(info.values()) == (outcome.food[0, 0], outcome.poison[0, 0], outcome.blocked[0, 0])
        total += [info["food"], info["poison"], info["blocked"]]
    np.testing.assert_array_equal([env.world.x, env.world.y, env.world.angle], [world.x, world.y, world.angle])
    assert (total > 0).all()  # all of this was seen to happen


def test_observations_stay_inside_their_space(make):
    """Displaced points of items are sensed beyond the range of the eyes, but not farther than the space allows."""
    env, values = make(), np.random.default_rng(100)
    world = w.World(values.random((200, w.ITEMS, 3)))
    world.x[:], world.y[:] = values.uniform(20, 680, (2, 200, 1))
    highest = 0.0
    for _ in range(50):
        world.angle[:] = values.uniform(0, 2 * np.pi, (200, 1))
        seen = world.inputs(world.sense())
        highest = max(highest, seen.max())
        assert seen.min() > 0
    assert 1.0 < highest <= env.observation_space.high.max()


def test_misuse_is_named(make):
    with pytest.raises(UserError, match="at least one, got 0"):
        make(0)
    env = make()
    with pytest.raises(UserError, match="call reset first"):
        env.step(0)
    env.reset(seed=100)
    for action in (5, -1):
        with pytest.raises(UserError, match=f"from 0 to 4, got {action}"):
            env.step(action)
    assert env.world.clock == 0
    with pytest.raises(UserError, match="a whole number of ticks"):
        make(-5)


@pytest.mark.parametrize("action", [2, np.int8(2), np.int64(2)])
def test_integers_of_all_kinds_are_actions(make, action):
    env, other = make(), make()
    env.reset(seed=100)
    other.reset(seed=100)
    np.testing.assert_array_equal(env.step(action)[0], other.step(2)[0])
