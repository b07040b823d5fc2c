"""Runs in Deep Sea: resumed equals whole, alone equals among others, and what a record holds."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.deep_sea.experiment import AGENTS, CONFIGS, REGRET, TIMES, WINDOW, start, units
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.unit import RunError
from dropout_uncertainty.settings import config_hash

SMALL = {
    name: replace(CONFIGS[f"deep-sea/{name}/5"], size=6, episodes=300, memory=300, batch=16, hidden=(20, 20))
    for name in AGENTS
}
SEEDS = (100, 101, 102)


def run(process, steps=None):
    for _ in range(process.total if steps is None else steps):
        if process.done < process.total:
            process.advance()
    return process


@pytest.mark.parametrize("name", ["dropout-per-episode", "ensemble-priors"])
def test_a_resumed_run_ends_with_the_same_arrays(name, tmp_path):
    whole = run(start(SMALL[name], SEEDS))
    interrupted = start(SMALL[name], SEEDS)
    while len(interrupted.active) == len(SEEDS):
        interrupted.advance()
    assert len(interrupted.active) > 0  # some are let go before the others
    torch.save(interrupted.state(), tmp_path / "state.pt")
    resumed = start(SMALL[name], SEEDS)
    resumed.restore(torch.load(tmp_path / "state.pt", weights_only=True))
    run(interrupted)
    assert records.checksum(run(resumed).result()) == records.checksum(whole.result())


@pytest.mark.parametrize("name", ["annealed-thompson", "ensemble"])
def test_a_seed_alone_agrees_with_itself_among_others(name):
    among = run(start(SMALL[name], SEEDS, precision="float64"), 4)
    alone = run(start(SMALL[name], SEEDS[1:2], precision="float64"), 4)
    for key, values in alone.result().items():
        np.testing.assert_array_equal(values, among.result()[key][1:2], err_msg=key)
    mine = alone.agent.network.parameters
    torch.testing.assert_close(mine, among.agent.network.parameters.view(3, *mine.shape)[1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", AGENTS)
def test_the_record_adds_up(name):
    process = run(start(SMALL[name], SEEDS))
    result, n = process.result(), SMALL[name].size
    found, episodes, first, visits = (result[key] for key in ("found", "episodes", "first_visit", "visits"))
    for replica in range(len(SEEDS)):
        length = episodes[replica]
        assert not found[replica, length:].any()
        if length < 300:
            assert max((~found[replica, :length]).mean(), (~found[replica, length - WINDOW : length]).mean()) < REGRET
    for index, time in enumerate(TIMES):
        reached = episodes >= time
        assert (visits[reached, index].sum((1, 2)) == time * n).all()
        assert (visits[reached, index, 0, 0] == time).all()
        np.testing.assert_array_equal(visits[reached, index] > 0, (first >= 0)[reached] & (first < time)[reached])
    assert (first[:, 0, 0] == 0).all()
    assert (first[:, np.triu_indices(n, 1)[0], np.triu_indices(n, 1)[1]] == -1).all()
    saw = found.any(1)
    assert (first[saw, n - 1, n - 1] <= found[saw].argmax(1)).all()


def test_a_tenth_is_not_enough():
    process = start(SMALL["greedy"], SEEDS)
    process.found[:2, 100:112] = process.found[1, 0] = True  # bad episodes: 108, 107 and 120 of 120
    process.done = 12
    process._retire()
    assert process.active.tolist() == [0, 2]
    assert process.length.tolist() == [300, 120, 300]


def test_all_configs_are_named_after_agent_and_size():
    for name, config in CONFIGS.items():
        assert name.split("/")[-1] == str(config.size)
    assert len(config_hash(CONFIGS["deep-sea/greedy/10"])) > 0
    assert len({config_hash(config) for config in CONFIGS.values()}) == len(CONFIGS)


def test_seeds_are_cut_into_units():
    assert [unit.seeds for unit in units("deep-sea/greedy/10", range(40))] == [tuple(range(40))]
    parts = [unit.seeds for unit in units("deep-sea/ensemble/10", range(25))]
    assert [len(part) for part in parts] == [10, 10, 5]
    assert sum(parts, ()) == tuple(range(25))
    with pytest.raises(RunError, match="unknown config 'deep-sea/greed/10'"):
        units("deep-sea/greed/10")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"policy": "gredy"}, "unknown policy 'gredy'"),
        ({"size": 1}, "at least 2 rows, got a size of 1"),
        ({"episodes": 15}, "positive multiple of 10 up to 32,760, got 15"),
        ({"episodes": 40_000}, "up to 32,760, got 40000"),
        ({"drop": (0.1, 0.0, 0.0)}, "the first 0 for one-hot inputs"),
        ({"policy": "thompson"}, "a drop probability must be above 0"),
        ({"share": 0.0}, r"a share lies in \(0, 1\], got 0.0"),
        ({"anneal_episodes": 0}, "anneal_episodes must be at least 1, got 0"),
        ({"learning_rate": 0.0}, "nothing is learned, got 0.0"),
        ({"memory": 0}, "memory must be at least 1, got 0"),
    ],
)
def test_configs_that_make_no_sense_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        replace(CONFIGS["deep-sea/greedy/5"], **settings)
    with pytest.raises(ValueError, match="at least one seed"):
        start(CONFIGS["deep-sea/greedy/5"], ())
    with pytest.raises(ValueError, match="once only"):
        start(CONFIGS["deep-sea/greedy/5"], (100, 100))
    with pytest.raises(UserError, match="float32 or float64"):
        start(CONFIGS["deep-sea/greedy/5"], (100,), precision="bfloat16")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_an_agent_that_has_diverged_does_not_dive_on():
    with pytest.raises(UserError, match="networks are no longer finite"):
        run(start(replace(SMALL["greedy"], learning_rate=50.0), SEEDS))
