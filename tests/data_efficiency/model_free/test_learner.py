"""Runs without a model: what a trial is, what counts, and that a run goes on as if it had never stopped."""

import copy
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from dropout_uncertainty.data_efficiency.model_free import learner
from dropout_uncertainty.data_efficiency.model_free.config import (
    DDPG_AS_PRINTED,
    NAF_AS_PRINTED,
    SEARCH,
    ModelFreeConfig,
)
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.runs.unit import RunError
from dropout_uncertainty.settings import config_dict, config_diff

SMALL = {"trials": 9, "test_every": 3, "hidden": (8, 6), "batch": 16}
DDPG, NAF = replace(DDPG_AS_PRINTED, **SMALL), replace(NAF_AS_PRINTED, **SMALL, updates=2)
SEEDS = (100, 101, 102)


def run(config, seeds=SEEDS, blocks=3):
    process = learner.start(config, seeds, precision="float64")
    for _ in range(blocks):
        process.advance()
    return process


@pytest.mark.parametrize("config", [DDPG, NAF])
def test_a_run_gives_a_test_in_every_block_and_trials_with_noise_between(config):
    record = run(config).result()
    tested = np.isfinite(record["costs"]).all(-1)
    assert np.flatnonzero(tested[0]).tolist() == [3, 6, 9]
    assert (tested == tested[0]).all()
    assert np.flatnonzero(np.isfinite(record["training_cost"][0])).tolist() == [1, 2, 4, 5, 7, 8]
    assert np.isfinite(record["td_error"]).all()


@pytest.mark.parametrize("config", [DDPG, NAF])
def test_a_repetition_alone_and_a_resumed_run_give_the_same(config):
    whole = run(config).result()
    alone = run(config, SEEDS[1:2]).result()
    stopped = run(config, blocks=1)
    resumed = learner.start(config, SEEDS, precision="float64")
    resumed.restore(copy.deepcopy(stopped.state()))
    for _ in range(2):
        resumed.advance()
    for name, values in whole.items():
        np.testing.assert_allclose(alone[name][0], values[1], rtol=1e-5)
        np.testing.assert_array_equal(resumed.result()[name], values)


def test_the_search_changes_what_its_names_say_and_has_the_grid_of_nafs_paper():
    words = {
        "noise_std": "noise",
        "normalise": "not-normalised",
        "policy_rate": "policy-rate",
        "follow": "follow",
        "value_decay": "no-decay",
    }
    for name, config in SEARCH.items():
        printed = replace(DDPG_AS_PRINTED if config.method == "ddpg" else NAF_AS_PRINTED, trials=400)
        for key, _, new in config_diff(config_dict(printed), config_dict(config)):
            assert words.get(key, "rate") in name
            assert key in ("normalise", "value_decay") or any(
                float(part) == new for part in re.findall(r"-([0-9.]+(?:e-\d)?)", name)
            )
    grid = {(c.value_rate, c.noise_std) for c in SEARCH.values() if c.method == "naf" and c.follow == NAF.follow}
    assert grid == {(rate, noise) for rate in (1e-4, 1e-3, 1e-2) for noise in (0.1, 0.3, 1.0)}


def test_the_plant_is_that_of_the_other_learners():
    process = run(DDPG, blocks=1)
    rows = process.memory.rows[:, : len(process.memory)].reshape(len(SEEDS), 3, DDPG.plant.steps, -1)
    plant, trial = DDPG.plant, 2
    draw = lambda make, name, t: process._draw(make, "environment", name, t)  # noqa: E731
    state = draw(lambda g: cartpole.start_states(plant, (), g), "start", trial + 1)
    costs = []
    for t in range(plant.steps):
        state = cartpole.step(plant, state, plant.force_limit * rows[:, trial, t, -3])
        costs.append(cost(plant, state))
    torch.testing.assert_close(process.log["costs"][:, trial + 1], torch.stack(costs, -1), atol=1e-5, rtol=0)
    torch.testing.assert_close(rows[:, trial, :, -2], 1 - torch.stack(costs, -1), atol=1e-5, rtol=0)


def test_what_was_reached_is_where_the_next_step_begins():
    process = run(replace(DDPG, time_input=True), blocks=1)
    rows = process.memory.rows[:, : DDPG.plant.steps]
    before, after = rows[..., :6], rows[..., 6:12]
    torch.testing.assert_close(after[:, :-1], before[:, 1:])
    torch.testing.assert_close(after[0, :, 5], torch.arange(1.0, DDPG.plant.steps + 1, dtype=torch.float64) / 25)


def test_nothing_ends_with_a_trial_unless_it_is_asked_for():
    for ends in (False, True):
        process = run(replace(DDPG, end_is_terminal=ends), blocks=1)
        discount = process.memory.rows[:, : len(process.memory), -1].reshape(len(SEEDS), -1, DDPG.plant.steps)
        assert (discount[..., :-1] == DDPG.discount).all()
        assert (discount[..., -1] == (0.0 if ends else DDPG.discount)).all()


def test_tests_have_no_noise_and_other_trials_that_of_ornstein_and_uhlenbeck():
    process = run(DDPG, blocks=1)
    steps = DDPG.plant.steps
    first = process.memory.rows[:, :steps]  # nothing is learned before a minibatch is there
    fresh = learner.start(DDPG, SEEDS, precision="float64")
    plain = torch.stack([fresh.agent.act(first[:, t, :5]) for t in range(steps)], -1)
    noise = first[..., -3] - plain
    torch.testing.assert_close(noise[:, :10], process._disturbance(1)[:, :10])
    drawn = (noise[:, 1:10] - (1 - DDPG.noise_return) * noise[:, :9]) / DDPG.noise_std
    assert 0.6 < drawn.std() < 1.4
    last = process.memory.rows[:, 2 * steps : 3 * steps]
    assert (last[..., -3].abs() < 1).all()  # what the policy says by itself lies inside the limits
    many = run(replace(DDPG, trials=3), range(100, 400), blocks=0)._disturbance(1)
    expected = DDPG.noise_std**2 * sum(0.85 ** (2 * k) for k in range(steps))
    assert many[:, -1].var().item() == pytest.approx(expected, rel=0.2)


def test_a_repetition_ends_after_its_solved_tests_and_the_others_go_on(monkeypatch):
    config = replace(DDPG, trials=12, solved_tests=2)

    def solved(plant, costs):
        tests = torch.zeros(costs.shape[:2], dtype=torch.bool)
        tests[1, 1:3] = True  # the second repetition solves the second and third test
        return tests & costs.isfinite().all(-1)

    others = run(config, SEEDS[::2], blocks=4)
    monkeypatch.setattr(learner, "solved", solved)
    process = run(config, blocks=4)
    assert process.running.tolist() == [0, 2]
    record, expected = process.result(), others.result()
    assert np.flatnonzero(np.isfinite(record["costs"][1]).all(-1)).tolist() == [3, 6, 9]
    for name, values in expected.items():
        np.testing.assert_allclose(record[name][[0, 2]], values, rtol=1e-5)
    stopped = learner.start(config, SEEDS, precision="float64")
    stopped.restore(copy.deepcopy(process.state()))
    assert stopped.running.tolist() == [0, 2]


def test_where_all_have_ended_nothing_is_computed(monkeypatch):
    monkeypatch.setattr(learner, "solved", lambda plant, costs: costs.isfinite().all(-1))
    process = run(replace(DDPG, solved_tests=1))
    assert len(process.running) == 0
    assert process.done == process.total
    assert np.isnan(process.result()["costs"][:, 4:]).all()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"method": "sac"}, "expected the method ddpg or naf, got 'sac'"),
        ({"trials": 25}, "whole blocks"),
        ({"batch": 1}, "batch must be at least 2, got 1"),
        ({"hidden": (10,)}, "two or more hidden layers"),
        ({"scale": (1.0, 1.0)}, "five positive scales"),
        ({"discount": 1.5}, "shares between 0 and 1"),
        ({"value_rate": 0.0}, "value_rate must be positive, got 0.0"),
    ],
)
def test_wrong_settings_are_answered_in_a_sentence(values, words):
    with pytest.raises(ValueError, match=words):
        ModelFreeConfig(**values)


def test_another_device_is_refused():
    with pytest.raises(RunError, match="run on the CPU, got the device cuda"):
        learner.start(DDPG, SEEDS, device="cuda")


@pytest.mark.parametrize("config", [DDPG, NAF])
def test_networks_that_diverge_end_their_repetition_and_no_other(config):
    usual = run(config).result()["costs"]
    process = run(config, blocks=1)
    for trained in process.agent.networks.values():
        with torch.no_grad():
            trained.network.parameters[0][1] = torch.nan
    process.advance()
    assert process.running.tolist() == [0, 2]
    process.advance()
    costs = process.result()["costs"]
    np.testing.assert_array_equal(np.isfinite(costs[1]).any(-1).nonzero()[0], [3, 6])
    np.testing.assert_allclose(costs[[0, 2]], usual[[0, 2]], rtol=1e-5)
