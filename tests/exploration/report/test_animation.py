"""The agents in the animation act as they did at the end of their training, and the pictures show what happens."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from dropout_uncertainty.exploration import experiment
from dropout_uncertainty.exploration.experiment import CONFIGS, OURS, AgentConfig
from dropout_uncertainty.exploration.foraging import world as w
from dropout_uncertainty.exploration.foraging.drawing import KIND_COLOURS
from dropout_uncertainty.exploration.report import animation
from dropout_uncertainty.exploration.report.animation import TrainedAgent, run
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_hash

#: ε-greedy and Thompson in one world; short, and with more exploration left at its end than is published.
SMALL = replace(
    OURS["epsilon-greedy"], ticks=500, burn_in=401, learning_start=400, anneal_end=402, epsilon_floor=0.3, batch=16,
    hidden=(20, 20), agents=(AgentConfig("epsilon-greedy"), AgentConfig("thompson", (0.0, 0.4, 0.0))),
)  # fmt: skip


@pytest.fixture(scope="module")
def process():
    """Return a training at its end."""
    process = experiment.start(SMALL, (100, 101))
    process.advance()
    return process


@pytest.fixture(scope="module")
def record(process):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(CONFIGS, "small", SMALL)
        header = {"experiment": "exploration", "name": "small", "config_hash": config_hash(SMALL)}
        yield records.Record(header, process.result(), Path("100-101.npz"))


def moves(agent, ticks=300):
    """Let an agent look at a world that it does not change; return inputs, actions and values of every tick."""
    world = w.World(np.random.default_rng(100).random((ticks, w.ITEMS, 3)))
    world.angle[:, 0] = np.linspace(0, 6, ticks)
    inputs = world.inputs(world.sense())
    seen = []
    values = agent.values
    agent.values = lambda *arguments: seen.append(values(*arguments)) or seen[-1]
    actions = [agent(inputs[t], t + 1)[0] for t in range(ticks)]
    return inputs[:, 0], np.array(actions), np.array(seen)[:, :, 0]


@pytest.mark.parametrize("number", [0, 1])
def test_sees_and_values_what_the_agent_in_training_does(record, process, number):
    acting, trained = TrainedAgent(record, 1, number), process.agents[number]
    trained.receive(np.zeros(2))
    world = w.World(np.random.default_rng(100).random((5, w.ITEMS, 3)))
    inputs = world.inputs(world.sense())[:, 0]
    for t in range(5):
        before = acting.before, acting.taken
        action = acting(inputs[t][None], t + 1)
        if t:
            trained._take_in(np.repeat(inputs[t][None], 2, 0), 501 + t, t)  # stores beside, never reads
            acting_saw = np.concatenate((inputs[t], before[0][0], 27 * before[1][0]))
            np.testing.assert_allclose(trained.current[1, :59], acting_saw, rtol=1e-6)
            state = torch.from_numpy(trained.current[:, None, :59].copy())
            expected = trained.network.forward(state)[-1][1, 0].numpy()
            acting.before, acting.taken = before
            np.testing.assert_allclose(acting.values(inputs[t][None], t + 1)[1][0], expected, rtol=1e-4, atol=1e-5)
            acting.before, acting.taken = inputs[t][None], np.eye(5)[action]
        else:
            trained.current[:, :27] = inputs[0]
        trained.action = np.repeat(action, 2)


def test_epsilon_greedy_explores_at_its_floor(record):
    _, actions, values = moves(TrainedAgent(record, 0, 0), 500)
    np.testing.assert_array_equal(values[:, 0], values[:, 1])  # no dropout
    explored = (actions != values[:, 1].argmax(-1)).mean()
    assert explored == pytest.approx(0.3 * 0.8, abs=4 * (0.24 * 0.76 / 500) ** 0.5)


def test_thompson_takes_the_best_action_of_a_new_draw_at_every_tick(record):
    agent = TrainedAgent(record, 0, 1)
    net = agent.network
    inputs, actions, values = moves(agent, 200)
    np.testing.assert_array_equal(actions, values[:, 0].argmax(-1))
    agent.before, agent.taken, kept = inputs[:1], np.eye(5)[:1], []
    (w1, w2, w3), (b1, b2, b3) = ([part[0].numpy() for part in parts] for parts in (net.weights, net.biases))
    hidden = np.maximum(agent.state(inputs[1:2]) @ w1 + b1, 0)
    for tick in range(1, 101):
        drawn, plain = agent.values(inputs[1:2], tick)
        mask = agent.masks.at(tick - 1)[1][0].numpy()
        by_hand = np.maximum((mask * hidden) @ w2 + b2, 0) @ w3 + b3  # one row under the draw, one without dropout
        np.testing.assert_allclose(by_hand, np.concatenate((drawn, plain)), rtol=1e-4, atol=1e-5)
        kept.append(mask[0] > 0)
    assert np.unique(mask[0]) == pytest.approx([0, 1 / 0.6])
    assert np.mean(kept) == pytest.approx(0.6, abs=4 * (0.24 / np.size(kept)) ** 0.5)
    assert len(np.unique(kept, axis=0)) > 95


def test_same_seed_same_run_and_sums_add_up(record):
    first, again = (run(TrainedAgent(record, 0, 1), 100, ticks=150, every=2) for _ in range(2))
    assert [moment.tick for moment in first] == list(range(2, 151, 2))
    np.testing.assert_array_equal([m.scene.x for m in first], [m.scene.x for m in again])
    assert [moment.reward for moment in first] == [moment.reward for moment in again]
    last = first[-1]
    assert 0 < last.reward - 5 * last.food + 6 * last.poison <= 1.1 * last.tick
    other = run(TrainedAgent(record, 0, 1), 101, ticks=2, every=2)
    assert not np.array_equal(other[0].scene.item_x, first[0].scene.item_x)


def test_published_agents_play_side_by_side_in_the_same_world():
    names = ("thompson", "epsilon-greedy")
    agents = [TrainedAgent(records.find("exploration", OURS[name])[0]) for name in names]
    assert [agent.name for agent in agents] == list(names)
    assert agents[1].policy.epsilon(agents[1].ticks) == 0.05
    moments = {name: run(agent, 100, ticks=40) for name, agent in zip(names, agents, strict=True)}
    player = animation.animation(moments)
    assert len(player.frames) == len(player.labels) == 10
    left, right = (moments[name][-1] for name in names)
    frame = player.frames[-1]
    half = len(frame) // 2
    for moment, shapes, offset in ((left, frame[:half], 30), (right, frame[half:], 760)):
        items, scene = shapes[: w.ITEMS], moment.scene
        for item, x, y, kind in zip(items, scene.item_x, scene.item_y, scene.item_kind, strict=True):
            expected = (round(offset + x, 1), round(50 + y, 1)) if kind != w.NOTHING else (0, 0)
            assert (item.attributes["cx"], item.attributes["cy"]) == expected
            colours = {item.attributes["fill"], item.attributes["stroke"]} - {"none"}
            assert colours == ({KIND_COLOURS[kind]} if kind != w.NOTHING else set())
            assert (item.attributes["fill"] == "none") == (kind != w.FOOD)
        body = shapes[-1].attributes
        assert (body["cx"], body["cy"]) == (round(offset + scene.x[0], 1), round(50 + scene.y[0], 1))
        assert [shape.tag for shape in shapes].count("line") == 9
    assert player.labels[-1].splitlines()[1] == (
        f"Thompson sampling: food {left.food}, poison {left.poison}, mean reward {left.reward / 40:.2f}"
    )
    page = player._repr_html_()
    assert "ε-greedy</text>" in page
    growth = len(str(player.changes()[1:])) / (len(player.frames) - 1)
    assert len(page) + 140 * growth < 300_000  # with 150 frames


def test_compare_finds_published_agents_and_names_the_command_for_missing_ones(tmp_path):
    player = animation.compare(["ours-thompson", "ours-epsilon-greedy"], seed=101, ticks=8)
    agent = TrainedAgent(records.find("exploration", OURS["epsilon-greedy"])[0])
    expected = run(agent, 101, ticks=8)[-1].scene
    body = player.frames[-1][-1].attributes
    assert (body["cx"], body["cy"]) == (round(760 + expected.x[0], 1), round(50 + expected.y[0], 1))
    with pytest.raises(records.RecordError, match="run exploration --config ours-boltzmann --seeds 0-9"):
        animation.compare(["ours-boltzmann"], folder=tmp_path)


def test_misuse_is_named(record):
    with pytest.raises(ValueError, match="2 seeds and 2 agents, not of seed number 2, agent 0"):
        TrainedAgent(record, 2)
    unknown = records.Record(record.header | {"config_hash": "0" * 16}, record.arrays, record.path)
    with pytest.raises(records.RecordError, match="no config known here"):
        TrainedAgent(unknown)
    agent = TrainedAgent(record)
    with pytest.raises(ValueError, match="must be positive"):
        run(agent, ticks=0)
    with pytest.raises(ValueError, match="runs of one length, got"):
        animation.animation({"thompson": run(agent, ticks=4), "boltzmann": run(agent, ticks=8)})


def test_agents_of_one_policy_cannot_be_told_apart():
    with pytest.raises(ValueError, match="expected agents of different policies, got 'thompson' twice"):
        animation.compare(["ours-thompson", "as-written"], ticks=8)
