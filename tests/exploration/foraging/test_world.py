"""The world against the original program, tick by tick, and rules that can be checked by hand."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from dropout_uncertainty.exploration.foraging import world as w

GOLDEN = Path(__file__).parents[2] / "golden"
with gzip.open(GOLDEN / "rl2d_trace.json.gz") as file:
    EPISODES = {episode["name"]: episode for episode in json.load(file)["episodes"]}


def world_of(episode, replicas=1):
    """Return a world in the state in which a recorded episode starts."""
    world = w.World(np.zeros((replicas, w.ITEMS, 3)), agents=len(episode["agents0"]))
    world.clock = episode["clock0"]
    for name, key in (("item_x", "x"), ("item_y", "y"), ("item_kind", "type")):
        getattr(world, name)[:] = [item[key] for item in episode["items0"]]
    world.item_born[:] = [episode["clock0"] - item["age"] for item in episode["items0"]]
    for name in ("x", "y", "angle"):
        getattr(world, name)[:] = [agent[name] for agent in episode["agents0"]]
    return world


class Ids:
    """The original's item ids by slot of ours; its list is ordered by id."""

    def __init__(self, episode):
        self.of_slot = [item["id"] for item in episode["items0"]]
        assert self.of_slot == sorted(self.of_slot)

    def slot(self, item_id):
        return self.of_slot.index(item_id)

    def ageing(self, tick):
        """Return the recorded uniforms by slot; those not drawn must not be needed."""
        uniforms = np.full((1, w.ITEMS), np.nan)
        for item_id, uniform, _ in tick["age_rolls"]:
            uniforms[0, self.slot(item_id)] = uniform
        return uniforms


def spawning(tick):
    if tick["spawn_roll"] is None:
        return np.full((1, 4), np.nan)
    return np.array([[tick["spawn_roll"], *(tick["spawn"]["u"] if tick["spawn"] else [np.nan] * 3)]])


@pytest.mark.parametrize("name", EPISODES)
def test_every_tick_of_the_original_is_reproduced(name):
    episode = EPISODES[name]
    world, ids = world_of(episode), Ids(episode)
    assert world.eye_angles.tolist() == episode["eye_angles"]
    assert w.WALLS.tolist() == episode["walls"]
    for tick, actions in zip(episode["ticks"], episode["actions"], strict=True):
        readings = world.sense()
        outcome = world.step(np.array([actions]), ids.ageing(tick), spawning(tick))
        reward = world.reward(readings, np.array([actions]), outcome)[0]
        expected = {key: np.array([agent[key] for agent in tick["agents"]]) for key in tick["agents"][0]}
        assert world.clock == tick["clock"]
        np.testing.assert_array_equal(readings.kind[0], expected["eye_type"])
        np.testing.assert_allclose(readings.distance[0], expected["eye_prox"], rtol=0, atol=1e-9)
        for key in ("x", "y", "angle"):
            np.testing.assert_allclose(getattr(world, key)[0], expected[key], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(outcome.blocked[0], expected["wall_hit"])
        np.testing.assert_allclose(reward, expected["reward"], rtol=0, atol=1e-9)
        if tick.get("inputs"):
            np.testing.assert_allclose(world.inputs(readings)[0], tick["inputs"], rtol=0, atol=1e-9)
        eaters = {ids.of_slot[slot]: int(outcome.eater[0, slot]) for slot in np.flatnonzero(outcome.eater[0] >= 0)}
        assert eaters == {item_id: agent for item_id, _, agent in tick["eaten"]}
        for agent in range(world.agents):
            kinds = [kind for _, kind, by in tick["eaten"] if by == agent]
            assert [outcome.food[0, agent], outcome.poison[0, agent]] == [kinds.count(w.FOOD), kinds.count(w.POISON)]
        assert [ids.of_slot[slot] for slot in np.flatnonzero(outcome.withered[0])] == [
            item_id for item_id, _, gone in tick["age_rolls"] if gone
        ]
        if tick["spawn"]:
            ids.of_slot[outcome.spawned[0]] = tick["spawn"]["id"]
        assert (outcome.spawned[0] >= 0) == bool(tick["spawn"])
        assert (world.item_kind[0] != w.NOTHING).sum() == tick["n_items"]
    for item in episode["items_end"]:
        slot = ids.slot(item["id"])
        assert world.item_kind[0, slot] == item["type"]
        np.testing.assert_allclose([world.item_x[0, slot], world.item_y[0, slot]], [item["x"], item["y"]], atol=1e-9)
        assert world.clock - world.item_born[0, slot] == item["age"]


def test_what_a_step_cannot_use_is_refused_and_changes_nothing():
    values = np.random.default_rng(100)
    world = w.World(values.random((2, w.ITEMS, 3)), agents=1)
    straight = np.zeros((2, 1), dtype=int)
    for actions in (straight - 1, straight + 5):
        with pytest.raises(ValueError, match="expected actions from 0 to 4"):
            world.step(actions)
    assert world.clock == 0
    for _ in range(9):
        world.step(straight)
    for spawning in (None, 2 * np.ones((2, 4))):
        with pytest.raises(ValueError, match="a new item, due at clock 10"):
            world.step(straight, spawning=spawning)
    assert world.clock == 9


def test_a_layout_of_the_wrong_shape_or_range_is_refused():
    for layout in (np.zeros((1, 29, 3)), np.ones((1, 30, 3)), np.full((1, 30, 3), np.nan)):
        with pytest.raises(ValueError, match="the first items"):
            w.World(layout)
