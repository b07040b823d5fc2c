"""Learning runs of Deep PILCO: data kept, continued, batched and reported as they should be."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from toy import finish

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.deep_pilco import learner as experiment
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER, derivative
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.data_efficiency.policies import force
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import records

#: Two short trials with the least work that goes through every part.
SHORT = replace(
    experiment.OURS,
    plant=replace(PAPER, steps=6, solved_steps=2),
    trials=2,
    hidden=(16, 16),
    basis=5,
    particles=6,
    policy_steps=4,
    model_steps=6,
    batch=8,
    guard=0.5,
    redraws=1,
)


pytestmark = pytest.mark.usefixtures("coarse_plant")


@pytest.fixture(scope="module")
def finished(coarse_plant):
    return finish(experiment.start(SHORT, (100, 101), precision="float64"))


def test_record_holds_consistent_trials(finished):
    record = finished.result()
    states, forces = (torch.from_numpy(record[name]).double() for name in ("states", "forces"))
    assert states.shape == (2, 3, 7, 4)
    torch.testing.assert_close(
        cartpole.step(SHORT.plant, states[:, :, :-1], forces), states[:, :, 1:], rtol=0, atol=1e-4
    )
    torch.testing.assert_close(cost(SHORT.plant, states[:, :, 1:]).float(), torch.from_numpy(record["costs"]))
    assert np.abs(record["forces"]).max() <= 10
    for name in ("predicted_mean", "predicted_std", "predicted_cost", "model_loss", "noise_std"):
        assert np.isnan(record[name][:, 0]).all(), name
        assert np.isfinite(record[name][:, 1:]).all(), name
    assert (record["predicted_std"][:, 1:] >= 0).all()
    assert record["shown"].tolist() == [1, 2]
    assert record["repeats"].shape == (2, 2, experiment.REPEATS, 7, 4)
    assert np.isfinite(record["repeats"]).all()
    assert record["policy_redrawn"][:, 1:].tolist() == [[1, 1], [1, 1]]  # nothing is learned in six steps
    assert not record["model_repairs"].any()


def test_the_recorded_policy_gives_the_recorded_forces(finished):
    record = finished.result()
    policy = finished.shape.policy(torch.from_numpy(record["policy"][:, 0]).double())
    again = force(policy, SHORT.plant, finished.log["observed"][:, 1, :-1])
    np.testing.assert_allclose(again.numpy(), record["forces"][:, 1], rtol=0, atol=1e-4)


def test_repeats_start_elsewhere_and_follow_the_plant(finished):
    repeats = finished.log["repeats"][:, 0]
    assert repeats[:, :, 0].std(1).min() > 0
    assert torch.allclose(repeats[:, :, 0].mean((0, 1)), torch.tensor(PAPER.start_mean).double(), atol=0.05)


@pytest.mark.parametrize(("memory", "rows"), [(0, 12), (1, 6)])
def test_networks_learn_from_the_remembered_transitions(finished, monkeypatch, memory, rows):
    process = experiment.start(replace(SHORT, memory=memory), (100, 101), precision="float64")
    process.restore(copy.deepcopy(finished.state()) | {"done": 2})
    seen = {}
    monkeypatch.setattr(process.model, "fit", lambda x, y, *_, **__: seen.update(x=x, y=y) or (torch.zeros(2),) * 2)
    process._train()
    observed, forces = finished.log["observed"], finished.log["forces"]
    assert seen["x"].shape == (2, rows, 6)
    torch.testing.assert_close(seen["x"][1, -1, :3], observed[1, 1, -2, :3])
    torch.testing.assert_close(seen["x"][1, -1, 5], forces[1, 1, -1])
    torch.testing.assert_close(seen["y"][1, -1], observed[1, 1, -1] - observed[1, 1, -2])


def test_continued_equals_uninterrupted(finished, tmp_path):
    half = experiment.start(SHORT, (100, 101), precision="float64")
    for _ in range(2):
        half.advance()
    torch.save(half.state(), tmp_path / "state.pt")
    other = experiment.start(SHORT, (100, 101), precision="float64")
    other.restore(torch.load(tmp_path / "state.pt", weights_only=True))
    finish(other)
    for name, expected in finished.result().items():
        np.testing.assert_array_equal(other.result()[name], expected, err_msg=name)


def test_a_repetition_alone_equals_the_same_among_ten(finished):
    many = finish(experiment.start(SHORT, tuple(range(95, 105)), precision="float64"))
    for row, seed in ((0, 100), (1, 101)):
        for name, value in finished.log.items():
            torch.testing.assert_close(
                value[row], many.log[name][seed - 95], rtol=1e-9, atol=1e-9, equal_nan=True, msg=lambda m, n=name: n + m
            )


def test_the_euler_plant_moves_in_one_step():
    process = experiment.start(replace(SHORT, integration="euler"), (100,), precision="float64")
    process.advance()
    states, forces = process.log["states"][:, 0], process.log["forces"][:, 0]
    moved = states[:, :-1] + 0.1 * derivative(PAPER, states[:, :-1], forces)
    torch.testing.assert_close(moved, states[:, 1:])


@pytest.mark.parametrize(
    "change",
    [
        {"matching": "diagonal", "standard_noise": False, "activation": "sigmoid"},
        {"matching": "off", "hold_masks": False},
        {"optimiser": "bfgs", "redraw_every": 0},
        {"drop": 0.0},
        {"input_drop": 0.1},
        {"angle_features": False, "standardise": False},
        {"cost_of": "mean", "guard": 1.0},
    ],
    ids=lambda change: next(iter(change)),
)
def test_every_variant_runs(finished, change):
    process = finish(experiment.start(replace(SHORT, **change), (100,)))
    record = process.result()
    assert np.isfinite(record["costs"]).all()
    assert not np.array_equal(record["policy"][0], finished.result()["policy"][0])
    assert not record["model_repairs"].any()


def test_a_policy_that_is_lost_is_redrawn_and_counted():
    process = experiment.start(SHORT, (100, 101), precision="float64")
    process.advance()
    process.policy[1] = math.nan
    process.advance()
    record = process.result()
    assert record["policy_repairs"][:, 1].tolist() == [0, SHORT.policy_steps]
    assert record["policy_redrawn"][1, 1] == 1
    assert np.isfinite(record["policy"][:, 0]).all()


def test_units_cut_seeds_into_batches():
    units = configs.units("deep-pilco-ours", range(100, 125))
    assert [len(unit.seeds) for unit in units] == [20, 5]
    assert units[0].label == "data_efficiency/deep-pilco-ours/100-119"
    assert units[0].config == experiment.OURS


def test_records_of_the_search_are_small():
    (unit,) = configs.units("search/start", (100, 101))
    assert unit.label == "data_efficiency/search/start/100-101"
    record = finish(unit.start(SHORT, (100, 101))).result()
    assert set(record) == {"costs", "predicted_cost", "model_loss", *experiment.DeepPilcoLearning.COUNTS}
    assert sum(array.nbytes for array in record.values()) < 1000


def test_published_records_fit_into_five_megabytes():
    stored = records.find("data_efficiency", name="deep-pilco-ours")
    assert sum(record.path.stat().st_size for record in stored) < 2.5e6  # as written comes beside it
    assert sum(len(record.seeds) for record in stored) == 40


def test_bad_input_is_named():
    with pytest.raises(UserError, match="unknown config 'deep', choose one of pilco-paper"):
        configs.units("deep")
    with pytest.raises(ValueError, match="at least one seed"):
        experiment.start(SHORT, ())
    with pytest.raises(ValueError, match="got bfloat16"):
        experiment.start(SHORT, (100,), precision="bfloat16")
    with pytest.raises(ValueError, match="trials must be at least 1, got 0"):
        replace(SHORT, trials=0)
    with pytest.raises(ValueError, match="runge-kutta or euler"):
        replace(SHORT, integration="exact")
    with pytest.raises(ValueError, match="5 positive spreads"):
        replace(SHORT, spread=(1.0, 2.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"drop": 1.0}, "drop probabilities"),
        ({"guard": 2.0}, "drop probabilities"),
        ({"model_rate": 0.0}, "^model_rate must be positive, got 0.0$"),
        ({"length_scale": -1.0}, "length_scale must be positive"),
        ({"hidden": ()}, "expected layers"),
        ({"activation": "tanh"}, "expected layers"),
    ],
)
def test_settings_that_cannot_work_are_named_at_once(change, words):
    with pytest.raises(ValueError, match=words):
        replace(SHORT, **change)
