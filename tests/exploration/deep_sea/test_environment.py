"""The Gymnasium environment: its checker, its id, and the same sea behind it."""

import warnings

import numpy as np
import pytest

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.deep_sea.world import DeepSea


@pytest.fixture
def make():
    gymnasium = pytest.importorskip("gymnasium")
    return lambda **settings: gymnasium.make("dropout_uncertainty/DeepSea-v0", **settings).unwrapped


def test_passes_gymnasiums_checker(make):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make(size=4), skip_render_check=True)


def test_is_the_sea_with_one_agent(make):
    env = make(size=6, mapping_seed=7)
    sea = DeepSea(env.sea.mapping)
    assert 0 < sea.mapping.mean() < 1
    assert (make(size=6, mapping_seed=8).sea.mapping != sea.mapping).any()
    actions, treasures = np.random.default_rng(100), 0
    for episode in range(30):
        observation, info = env.reset(seed=episode)
        sea.reset()
        assert not info["found"]
        assert observation[0, 0] == observation.sum() == 1
        while not sea.over:
            right = sea.mapping[0, sea.row, sea.column[0]]
            action = right if actions.random() < 0.9 else 1 - right
            reward, found = sea.step(np.array([action]))
            observation, got, terminated, truncated, info = env.step(action)
            assert (got, terminated, truncated, info["found"]) == (reward[0], sea.over, False, found[0])
            assert observation in env.observation_space
            assert observation.sum() == (not sea.over)
            assert sea.over or observation[sea.row, sea.column[0]] == 1
            treasures += info["found"]
    assert 0 < treasures < 30


def test_misuse_is_named(make):
    with pytest.raises(UserError, match="at least 2 rows, got a size of 1"):
        make(size=1)
    env = make(size=2)
    with pytest.raises(UserError, match="call reset first"):
        env.step(0)
    env.reset()
    with pytest.raises(UserError, match="from 0 to 1, got 2"):
        env.step(2)
    env.step(0)
    env.step(1)
    with pytest.raises(UserError, match="call reset first"):
        env.step(0)
