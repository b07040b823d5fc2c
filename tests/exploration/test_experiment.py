"""Runs: resumed equals uninterrupted, one seed alone equals itself among others, and what a run records."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration import agent, experiment
from dropout_uncertainty.exploration.experiment import AS_DEMO, CONFIGS, WIDE, AgentConfig, start
from dropout_uncertainty.exploration.foraging import world
from dropout_uncertainty.runs import execute, records
from dropout_uncertainty.runs.unit import Unit
from dropout_uncertainty.settings import config_hash

#: Small and quick to learn, but with every feature of the published configs.
SMALL = replace(
    AS_DEMO, ticks=1500, burn_in=300, learning_start=200, anneal_end=1200, memory=700, batch=16, hidden=(20, 20)
)
#: The same for policies without a schedule.
PLAIN = replace(SMALL, agents=(AgentConfig("greedy"),), anneal_end=AS_DEMO.anneal_end)
MIXED = replace(
    PLAIN, agents=(AgentConfig("annealed-thompson", (0.1, 0.2, 0.0)), AgentConfig("boltzmann")), held_out_every=2
)


THOMPSON = AgentConfig("thompson", (0.1, 0.2, 0.0))
#: Agents that act on draws of their own.
HELD = replace(
    PLAIN,
    agents=(
        replace(THOMPSON, hold=200, draws_until=900),
        AgentConfig("thompson", drop_acting=(0.0, 0.2, 0.1), hold=10),
    ),
)


def run(process, steps=None):
    for _ in range(process.total - process.done if steps is None else steps):
        process.advance()
    return process


@pytest.mark.parametrize("steps", [0, 2])
@pytest.mark.parametrize("config", [SMALL, MIXED, HELD], ids=["as-demo", "mixed", "held"])
def test_a_resumed_run_ends_with_the_same_arrays(config, steps, tmp_path):
    whole = run(start(config, (100, 101))).result()
    interrupted = run(start(config, (100, 101)), steps)
    torch.save(interrupted.state(), tmp_path / "state.pt")
    resumed = start(config, (100, 101))
    resumed.restore(torch.load(tmp_path / "state.pt", weights_only=True))
    run(interrupted)  # going on must not reach into what was saved
    assert records.checksum(run(resumed).result()) == records.checksum(whole)


@pytest.mark.parametrize("config", [SMALL, MIXED, HELD], ids=["as-demo", "mixed", "held"])
def test_a_seed_alone_agrees_with_itself_among_others(config):
    # the record is rounded, so what it is made from is compared
    among = run(start(config, (100, 101), precision="float64"), 2)
    alone = run(start(config, (101,), precision="float64"), 2)
    for name, values in alone.log.items():
        np.testing.assert_allclose(values, among.log[name][1:], rtol=0, atol=1e-9, err_msg=name)
    for mine, theirs in zip(alone.agents, among.agents, strict=True):
        torch.testing.assert_close(mine.network.parameters, theirs.network.parameters[1:], rtol=0, atol=1e-9)
    if config.held_out_every:
        np.testing.assert_allclose(alone.held_out, among.held_out[1:], rtol=0, atol=1e-9)


def test_recording_adds_up():
    process = run(start(SMALL, (100, 101)))
    result = process.result()
    reward, last = result["reward"].astype(float), result["average_reward"]
    np.testing.assert_allclose(last[..., 1:], (reward[..., 1:] + reward[..., :-1]) / 2, atol=1e-6)
    eaten = result["food"].astype(float) * 5 - result["poison"] * 6.0
    rest = reward - eaten / 500  # view and straight motion
    assert (rest > 0).all()
    assert (rest <= 1.1).all()
    assert (result["explored"][..., 0] >= 200).all()  # nothing learned yet: all of these are random
    assert (result["explored"][..., -1] < 500).all()
    assert np.isnan(result["td_error"]).sum() == 0
    assert (result["blocked"] <= 500).all()


def test_actions_of_the_epsilon_greedy_agent_explore_as_often_as_epsilon_says():
    config = replace(SMALL, agents=(AgentConfig("epsilon-greedy"),), anneal_end=301, epsilon_floor=0.25, ticks=1000)
    explored = run(start(config, range(100, 120))).result()["explored"][:, 0, 1].mean() / 500
    assert explored == pytest.approx(0.25 * 0.8, abs=4 * (0.2 * 0.8 / 10_000) ** 0.5)


def test_held_out_transitions_are_not_learned_from():
    process = run(start(MIXED, (100,)), 2)
    first = process.agents[0]
    assert first.memory.stored == 498  # block 1 but for its first two ticks
    assert first.held_out.stored == 500
    learned = first.memory.memory[: 2 * first.memory.size : 2, : agent.STATE_SIZE]
    kept = first.held_out.memory[: 2 * first.held_out.size : 2, : agent.STATE_SIZE]
    assert not (learned[:, None] == kept[None]).all(-1).any()
    result = run(process).result()
    assert result["held_out_td_error"].shape == result["learned_td_error"].shape == (1, 2, 1)
    assert np.isfinite(result["held_out_td_error"]).all()


def test_a_transition_is_what_the_agent_saw_did_and_got():
    process = start(replace(PLAIN, agents=(AgentConfig("thompson", (0.0, 0.2, 0.0)),)), (100,))
    seen, did, got = [], [], []
    receive, act = process.agents[0].receive, process.agents[0].act

    def spy_act(inputs, tick):
        seen.append(inputs.copy())
        actions = act(inputs, tick)
        did.append(actions[0].copy())
        return actions

    process.agents[0].act = spy_act
    process.agents[0].receive = lambda reward: (got.append(reward.copy()), receive(reward))
    process.advance()
    memory, one_hot = process.agents[0].memory, np.eye(5)
    for slot, t in ((0, 2), (100, 102), (497, 499)):  # slot 0 holds the move of the second tick (index 1) ...
        before = np.concatenate((seen[t - 1][0], seen[t - 2][0], 27 * one_hot[did[t - 2][0]]))
        after = np.concatenate((seen[t][0], seen[t - 1][0], 27 * one_hot[did[t - 1][0]]))
        row, next_row = memory.memory[2 * slot : 2 * slot + 2].numpy()
        np.testing.assert_allclose(row[:59], before, rtol=1e-6)
        np.testing.assert_allclose(next_row[:59], after, rtol=1e-6)
        np.testing.assert_array_equal(row[59:], one_hot[did[t - 1][0]])
        np.testing.assert_allclose(next_row[59], got[t - 1][0], rtol=1e-6)


def test_learning_starts_at_the_tick_the_original_does():
    process = start(replace(AS_DEMO, ticks=1500, burn_in=1200), (100,))
    untouched = process.agents[0].network.parameters.clone()
    learned_at = []
    learn = process.agents[0]._learn
    process.agents[0]._learn = lambda step: (learned_at.append(process.world.clock + 1), learn(step))[1]
    run(process, 3)
    assert learned_at[0] == 1003
    assert len(learned_at) == 1500 - 1002
    assert not torch.equal(untouched, process.agents[0].network.parameters)


def masks_in_learning(config, ticks):
    """Return the masks that the first agent learned with, by tick, up to ``ticks``."""
    process, seen = start(config, (100, 101)), {}
    mine = process.agents[0]
    learn = mine.network.learn

    def spy(states, taken, reward, masks, **settings):
        seen[process.world.clock + 1] = [None if mask is None else mask.clone() for mask in masks]
        return learn(states, taken, reward, masks, **settings)

    mine.network.learn = spy
    run(process, ticks // 500)
    return seen


@pytest.mark.parametrize("hold", [1, 10, 100, 200])
def test_a_draw_is_held_for_as_many_ticks_as_said(hold):
    seen = masks_in_learning(replace(PLAIN, agents=(replace(THOMPSON, hold=hold),)), 500)
    acting = {tick: masks[0][:, -2] for tick, masks in seen.items()}
    for tick in range(210, 500):
        same = torch.equal(acting[tick], acting[tick + 1])
        assert same == (tick % hold != 0)
        assert not torch.equal(seen[tick][0][:, 0], seen[tick + 1][0][:, 0])  # learning draws at every tick
    assert not torch.equal(acting[210][0], acting[210][1])  # replicas draw for themselves


def test_an_agent_may_act_on_draws_and_learn_without():
    agent = AgentConfig("thompson", drop_acting=(0.0, 0.2, 0.0))
    seen = masks_in_learning(replace(PLAIN, agents=(agent,)), 500)
    kept = torch.stack([masks[1][:, -2] for masks in seen.values()])
    assert (kept > 0).float().mean().item() == pytest.approx(0.8, abs=4 * (0.16 / kept.numel()) ** 0.5)
    assert set(kept.unique().tolist()) == {0.0, 1.25}
    for masks in seen.values():
        assert masks[0] is None
        assert masks[2] is None
        assert (masks[1][:, :-2] == 1).all()
        assert (masks[1][:, -1] == 1).all()


def test_learning_does_not_depend_on_what_is_acted_on():
    """The draws of learning are the same ones; until actions differ, so are the weights."""
    drawn, mean = (
        run(start(replace(PLAIN, burn_in=1400, agents=(agent,)), (100,)), 2).agents[0].network
        for agent in (THOMPSON, replace(THOMPSON, policy="greedy"))
    )
    assert torch.equal(drawn.parameters, mean.parameters)


def test_masks_are_switched_off_at_the_tick_said():
    def log(agent):
        return run(start(replace(PLAIN, agents=(agent,), ticks=1000), (100, 101))).log

    until, always = log(replace(THOMPSON, draws_until=500)), log(THOMPSON)
    for name in always:
        np.testing.assert_array_equal(until[name][..., 0], always[name][..., 0])
    assert not until["explored"][..., 1].any()
    assert always["explored"][..., 1].all()


def test_a_run_reaches_its_record(tmp_path):
    unit = Unit("exploration", "small", start, SMALL, (100, 101))
    record = execute.run_unit(unit, folder=tmp_path)
    assert record.arrays["average_reward"].shape == (2, 2, 3)
    assert record.header["config"]["agents"][0] == {"policy": "thompson", "drop": [0.0, 0.2, 0.0]}


def test_published_configs_say_what_they_are():
    assert set(CONFIGS) >= {"as-demo", "as-written", "wide", "wide-dropout"} | {
        f"ours-{name}" for name in ("thompson", "epsilon-greedy", "boltzmann", "annealed-thompson")
    }
    assert CONFIGS["as-written"].agents[0].drop == (0.1, 0.1, 0.1)
    assert CONFIGS["as-demo"].agents[0].drop == (0.0, 0.2, 0.0)
    assert all(len(config.agents) == 1 for name, config in CONFIGS.items() if name.startswith("ours"))
    plain, dropout = WIDE["wide"], WIDE["wide-dropout"]
    assert replace(plain, agents=dropout.agents) == dropout
    assert config_hash(CONFIGS["two-by-two/dropout-draw"]) == config_hash(CONFIGS["ours-thompson"])
    assert config_hash(CONFIGS["two-by-two/plain-mean"]) == config_hash(CONFIGS["ours-greedy"])
    (unit,) = experiment.units("as-demo")
    assert unit.label == "exploration/as-demo/000-009"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"agents": ()}, "at least one agent"),
        ({"ticks": 1234}, "multiple of 500"),
        ({"ticks": 500, "burn_in": 498}, "ticks must exceed burn_in"),
        ({"agents": (AgentConfig("thompson"),)}, "at least one drop probability must be above 0"),
        ({"agents": (replace(THOMPSON, drop_acting=(0.0, 0.0, 0.0)),)}, "at least one drop probability"),
        ({"agents": (replace(THOMPSON, drop_acting=(0.1,)),)}, "3 drop probabilities"),
        ({"agents": (replace(THOMPSON, hold=30),)}, "divisor or a multiple of 100"),
        ({"agents": (replace(THOMPSON, hold=0),)}, "hold must be at least 1, got 0"),
        ({"agents": (replace(THOMPSON, draws_until=302),)}, "draws_until must be at least 303"),
        ({"agents": (replace(THOMPSON, draws_until=1500),)}, "before the last tick"),
        ({"agents": (AgentConfig("greedy", hold=10),)}, "greedy acts on the mean weights"),
        ({"agents": (AgentConfig("boltzmann", draws_until=500),)}, "boltzmann acts on the mean weights"),
        ({"memory": 200}, "or learning never starts, got 200"),
        ({"batch": 0}, "batch must be at least 1"),
        ({"hidden": (20, 0)}, "hidden layer's width"),
        ({"discount": 1.1}, "discount must be a number from 0 to 1"),
        ({"discount": float("nan")}, "discount must be a finite number, got nan"),
        ({"learning_rate": 0.0}, "nothing is learned"),
        ({"l2_decay": -0.1}, "l2_decay must be at least 0"),
        ({"epsilon_floor": 1.5}, "floor of epsilon"),
        ({"held_out_every": 4}, "at most the 3 blocks, got 4"),
        ({"agents": (AgentConfig("ucb"),)}, "unknown policy 'ucb'"),
        ({"agents": (AgentConfig("thompson", (0.0, 1.0, 0.0)),)}, "drop probability"),
        ({"agents": (AgentConfig("thompson", (0.1,)),)}, "3 drop probabilities"),
        ({"burn_in": 100}, "burn_in must exceed"),
        ({"anneal_end": 300}, "anneal_end must exceed"),
        ({"cooling_end": 300}, "cooling_end does nothing here"),
        ({"held_out_every": 1}, "held_out_every"),
    ],
)
def test_bad_configs_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SMALL, **change)


@pytest.mark.parametrize(
    ("agent", "change", "message"),
    [
        ("boltzmann", {"cooling_end": 300}, "cooling_end must exceed"),
        ("boltzmann", {"temperature_end": 0.0}, "temperatures must be positive"),
        ("annealed-thompson", {"temperature_start": float("inf")}, "temperature_start must be a finite number"),
        ("boltzmann", {"anneal_end": 1200}, "anneal_end does nothing here"),
        ("epsilon-greedy", {"temperature_start": 0.2}, "temperature_start does nothing here"),
        ("greedy", {"epsilon_floor": 0.1}, "epsilon_floor does nothing here"),
    ],
)
def test_schedules_that_cannot_be_or_that_nobody_follows_are_refused(agent, change, message):
    drop = (0.0, 0.2, 0.0) if agent == "annealed-thompson" else (0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match=message):
        replace(PLAIN, agents=(AgentConfig(agent, drop),), **change)


def test_a_tick_out_of_turn_is_refused():
    process = start(PLAIN, (100,))
    process.advance()
    for tick in (0, 300, 501):
        with pytest.raises(ValueError, match=f"tick {tick} is not prepared for"):
            process.agents[0].act(np.ones((1, 27)), tick)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_an_agent_that_has_diverged_does_not_go_on():
    with pytest.raises(UserError, match="of 2 networks are no longer finite"):
        run(start(replace(SMALL, learning_rate=50.0), (100, 101)))


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="at least one seed"):
        start(SMALL, ())
    for seeds in ((-1,), (100, 100)):
        with pytest.raises(ValueError, match="0 or more and once only"):
            start(SMALL, seeds)
    for precision in ("bfloat16", "float16"):
        with pytest.raises(UserError, match=f"float32 or float64, not in '{precision}'"):
            start(SMALL, (100,), precision=precision)
    with pytest.raises(UserError, match="unknown config"):
        experiment.units("as-dreamt")
    with pytest.raises(ValueError, match="at least one, got 0"):
        world.World(np.zeros((1, 30, 3)), agents=0)
