"""Predictions of stored trials without their velocities."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy import finish

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.hidden_state import language, prediction
from dropout_uncertainty.data_efficiency.hidden_state.prediction import CONFIGS, PredictionConfig, stored_trials
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.unit import RunError
from dropout_uncertainty.settings import config_diff

SMALL = {"hidden": (8,), "sizes": (2, 3), "ahead": 2, "steps": 4, "particles": 3}


def small(name="lstm-held"):
    return replace(CONFIGS[f"hidden/{name}"], **SMALL)


def test_stored_trials_are_those_of_the_repetition():
    seen, forces = stored_trials("deep-pilco-ours", (12, 3, 103))
    (record,) = (r for r in records.find("data_efficiency", name="deep-pilco-ours") if 12 in r.seeds)
    row = record.seeds.index(12)
    assert np.allclose(seen[0], record.arrays["states"][row][..., [0, 3]])
    assert np.allclose(forces[0], record.arrays["forces"][row])
    assert seen.shape == (3, 41, 26, 2)
    assert not torch.equal(seen[1], seen[2])  # a development seed, of repetition 23


def test_trials_that_are_not_stored_are_said_to_be_missing(tmp_path, monkeypatch):
    with pytest.raises(UserError, match="the records of doubt/ensemble keep none"):
        stored_trials("doubt/ensemble", (0,))
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_RECORDS", str(tmp_path))
    with pytest.raises(UserError, match="run data_efficiency --config deep-pilco-ours --seeds 0-19 makes them"):
        stored_trials("deep-pilco-ours", (0,))


def test_models_differ_in_what_they_should():
    base = CONFIGS["hidden/lstm-held"]
    differing = {name: {f for f, *_ in config_diff(base, config)} for name, config in CONFIGS.items()}
    assert differing["hidden/lstm-fresh"] == {"held"}
    assert differing["hidden/lstm-no-dropout"] == {"drop"}
    assert differing["hidden/last-one"] == {"kind", "hidden"}
    assert differing["hidden/last-four"] == {"kind", "hidden", "window"}


def test_observations_are_the_trials_to_come_with_noise_of_the_named_size():
    found = finish(prediction.start(small(), (100, 101))).result()
    true, _ = stored_trials("deep-pilco-ours", (100, 101))
    off = found["observed"][:, 1] - true[:, 3:5, 1:].numpy()
    assert off.std() == pytest.approx(0.01, rel=0.1)
    assert found["predicted_mean"].shape == found["predicted_std"].shape == (2, 2, 2, 25, 2)
    assert np.isfinite(found["predicted_std"]).all()


def test_all_models_predict_the_same_observations():
    first, second = (finish(prediction.start(small(name), (100,))).result() for name in ("last-four", "lstm-fresh"))
    assert np.array_equal(first["observed"], second["observed"])
    assert not np.allclose(first["predicted_mean"], second["predicted_mean"])


@pytest.mark.parametrize("name", ["last-one", "lstm-held", "lstm-fresh"])
def test_resumed_is_whole_and_alone_is_as_among_others(name):
    whole = finish(prediction.start(small(name), (100, 101), precision="float64")).result()
    begun, rest = (prediction.start(small(name), (100, 101), precision="float64") for _ in range(2))
    begun.advance()
    rest.restore(begun.state())
    for key, value in finish(rest).result().items():
        assert np.array_equal(value, whole[key]), key
    for key, value in finish(prediction.start(small(name), (101,), precision="float64")).result().items():
        assert np.allclose(value[0], whole[key][1], atol=1e-5), key


def test_the_command_line_knows_the_models_and_their_twenty_seeds():
    (unit,) = configs.units("hidden/lstm-held")
    assert unit.seeds == tuple(range(20))


@pytest.mark.parametrize(
    ("change", "words"),
    [({"kind": "gru"}, "gru"), ({"hidden": (8, 8)}, "one layer"), ({"particles": 1}, "particles must be at least 2")],
)
def test_settings_that_cannot_be_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        PredictionConfig(**{"kind": "recurrent", "hidden": (8,)} | change)


def test_more_trials_than_there_are_is_one_sentence():
    with pytest.raises(ValueError, match="got 41 of deep-pilco-ours"):
        prediction.start(replace(small(), sizes=(40,)), (100,))


@pytest.mark.parametrize("module", [prediction, language])
def test_another_device_is_refused(module):
    with pytest.raises(RunError, match="run on the CPU, got the device cuda"):
        module.start(next(iter(module.CONFIGS.values())), (100,), device="cuda")
