"""Pictures of the world show the state they are made from, and Figure 5.3 a state that is really reached."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex

from dropout_uncertainty.exploration import experiment
from dropout_uncertainty.exploration.foraging import world as w
from dropout_uncertainty.exploration.foraging.drawing import KIND_COLOURS, Scene, draw_world, figure_5_3_scene, rollout


@pytest.fixture(scope="module")
def scene():
    return figure_5_3_scene()


@pytest.fixture
def ax():
    figure, ax = plt.subplots()
    yield ax
    plt.close(figure)


def test_figure_5_3_shows_the_agent_lower_left_facing_north_west(scene):
    assert w.WALLS[:, 0].min() < scene.x[0] < w.WIDTH / 2
    assert w.HEIGHT / 2 < scene.y[0] < w.WALLS[:, 3].max()
    heading = np.sin(scene.angle[0]), np.cos(scene.angle[0])
    np.testing.assert_allclose(heading, [-(0.5**0.5), -(0.5**0.5)], atol=0.2)  # up is negative
    assert set(scene.sensed_kind[0]) >= {w.WALL, w.FOOD, w.POISON}
    np.testing.assert_array_equal(figure_5_3_scene().item_x, scene.item_x)
    with pytest.raises(ValueError, match="allow more"):
        figure_5_3_scene(seeds=1, ticks=2)


def test_every_item_eye_and_wall_is_drawn_where_it_is(scene, ax):
    assert draw_world(ax, scene) is ax
    *discs, body = ax.patches
    present = scene.item_kind != w.NOTHING
    centres = np.stack([0.5 * (disc.get_xy().min(0) + disc.get_xy().max(0)) for disc in discs])
    np.testing.assert_allclose(centres, np.stack((scene.item_x, scene.item_y), 1)[present], atol=1e-9)
    kinds = scene.item_kind[present]
    assert [to_hex(disc.get_edgecolor()) for disc in discs] == [KIND_COLOURS[kind] for kind in kinds]
    assert [to_hex(disc.get_facecolor()) == "#ffffff" for disc in discs] == (kinds == w.POISON).tolist()
    front = body.get_xy()[np.hypot(*(body.get_xy() - [scene.x[0], scene.y[0]]).T).argmax()]
    assert (front < [scene.x[0], scene.y[0]]).all()
    walls, eyes = ax.lines[: len(w.WALLS)], ax.lines[len(w.WALLS) :]
    for line, (x1, y1, x2, y2) in zip(walls, w.WALLS, strict=True):
        np.testing.assert_array_equal(line.get_xydata(), [[x1, y1], [x2, y2]])
    for eye, line in enumerate(eyes):
        kind, way = scene.sensed_kind[0, eye], np.diff(line.get_xydata(), axis=0)[0]
        assert line.get_color() == KIND_COLOURS[kind]
        assert (line.get_linestyle() == "--") == (kind == w.POISON)
        assert np.hypot(*way) == pytest.approx(min(85, scene.sensed[0, eye]))
        assert np.arctan2(*way) % (2 * np.pi) == pytest.approx(scene.eye_angle[0, eye] % (2 * np.pi))
    assert ax.get_ylim() == (w.HEIGHT, 0)  # y points down


def test_scene_is_a_copy_of_one_replica(ax):
    worlds = w.World(np.random.default_rng(100).random((2, w.ITEMS, 3)), agents=2)
    second = Scene.of(worlds, 1)
    np.testing.assert_array_equal(second.item_x, worlds.item_x[1])
    np.testing.assert_array_equal(second.sensed_kind, worlds.sense().kind[1])
    worlds.step(np.zeros((2, 2), dtype=np.int64))
    assert second.y.tolist() == [50.0, 50.0]
    assert worlds.y[1, 0] > 50
    draw_world(ax, worlds, replica=1)
    assert len(ax.patches) == w.ITEMS + 2
    with pytest.raises(ValueError, match="replicas 0 to 1, got 2"):
        Scene.of(worlds, 2)


def test_rollout_is_the_world_of_the_experiments():
    """With the actions of an agent that learns, the world goes through the same states."""
    config = replace(experiment.OURS["thompson"], ticks=3_500)
    process = experiment.start(config, (100, 101))
    act, taken = process.agents[0].act, []

    def spy(inputs, tick):
        actions, explores = act(inputs, tick)
        taken.append((inputs.copy(), actions))
        return actions, explores

    process.agents[0].act = spy
    process.advance()

    def replay(inputs, tick):
        np.testing.assert_array_equal(inputs, taken[tick - 1][0])
        return taken[tick - 1][1]

    ticks = list(zip(range(500), rollout((100, 101), replay), strict=False))
    mean = np.mean([tick.reward for _, tick in ticks], axis=0)
    np.testing.assert_allclose(mean, process.log["reward"][..., 0], rtol=1e-12)
    world = ticks[-1][1].world
    for name in ("x", "y", "angle", "item_x", "item_kind", "item_born"):
        np.testing.assert_array_equal(getattr(world, name), getattr(process.world, name))
