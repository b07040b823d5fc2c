"""Learners with and without doubt: they differ in what is named, and plan with what they should."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy import finish

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.ablations import doubt
from dropout_uncertainty.data_efficiency.configs import CONFIGS
from dropout_uncertainty.data_efficiency.deep_pilco.ensemble import Ensemble
from dropout_uncertainty.data_efficiency.deep_pilco.learner import AS_TEXT, AS_WRITTEN, OURS
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.data_efficiency.pilco import planning
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.settings import config_diff

SHORT = {"plant": replace(PAPER, steps=6, solved_steps=2), "trials": 2}
SMALL = SHORT | {
    "hidden": (16, 16), "basis": 5, "particles": 10, "policy_steps": 4, "model_steps": 6, "batch": 8, "redraws": 1,
}  # fmt: skip
SMALL_PILCO = SHORT | {"basis": 3, "policy_iterations": 3, "model_iterations": 5}


pytestmark = pytest.mark.usefixtures("coarse_plant")


def start(config, seeds, **options):
    """Return the process of a config of the family."""
    name = "pilco-mean" if isinstance(config, pilco.PilcoConfig) else "ensemble"
    return configs.units(f"doubt/{name}")[0].start(config, seeds, **options)


@pytest.mark.parametrize(
    ("name", "differing"),
    [
        ("mean-network", {"doubt", "trials"}),
        ("no-dropout", {"drop", "trials"}),
        ("ensemble", {"drop", "ensemble", "trials"}),
        ("ensemble-mean", {"doubt"}),
        ("as-text-mean", {"doubt", "trials"}),
        ("pilco-mean", {"doubt"}),
    ],
)
def test_a_learner_differs_in_the_named_fields_from_the_one_with_doubt(name, differing):
    config, other = doubt.CONFIGS[f"doubt/{name}"], CONFIGS[doubt.WITH_DOUBT[name]]
    assert {field for field, *_ in config_diff(config, other)} == differing


def test_the_text_differs_from_ours_in_thirteen_choices():
    differing = {f for f, *_ in config_diff(OURS, AS_TEXT)}
    assert len(differing) == 13
    from_paper = config_diff(AS_WRITTEN, AS_TEXT)
    assert {f for f, *_ in from_paper} == {"memory", "angle_features", "standardise"}


@pytest.mark.parametrize("name", ["ensemble", "ensemble-mean", "mean-network", "as-text-mean"])
def test_learners_run_and_leave_small_records(name):
    process = finish(start(replace(doubt.CONFIGS[f"doubt/{name}"], **SMALL), (100, 101)))
    record = process.result()
    assert set(record) == {*doubt.KEPT, *process.COUNTS}
    assert np.isfinite(record["costs"]).all()
    assert np.isfinite(record["predicted_std"][:, 1:]).all()
    assert sum(array.nbytes for array in record.values()) < 4000


def test_an_ensemble_continues_and_a_repetition_is_the_same_alone(tmp_path):
    config = replace(doubt.CONFIGS["doubt/ensemble"], **SMALL, guard=0.5)
    whole = finish(start(config, (100, 101), precision="float64"))
    assert isinstance(whole.model, Ensemble)
    half = start(config, (100, 101), precision="float64")
    half.advance()
    half.advance()
    torch.save(half.state(), tmp_path / "state.pt")
    other = start(config, (100, 101), precision="float64")
    other.restore(torch.load(tmp_path / "state.pt", weights_only=True))
    for name, expected in whole.result().items():
        np.testing.assert_array_equal(finish(other).result()[name], expected, err_msg=name)
    single = finish(start(config, (101,), precision="float64"))
    torch.testing.assert_close(single.log["costs"][0], whole.log["costs"][1], rtol=1e-9, atol=1e-9)


def test_a_sure_ensemble_parts_its_particles_no_further_than_their_start():
    config = replace(doubt.CONFIGS["doubt/ensemble"], **SMALL)
    doubting, sure = (finish(start(replace(config, doubt=d), (100,), precision="float64")) for d in (True, False))
    wide, narrow = (p.log["predicted_std"][0, 1, -1] for p in (doubting, sure))
    assert (narrow < wide).all()


def test_pilco_on_its_mean_plans_without_the_variance_of_its_model(monkeypatch):
    config = replace(doubt.CONFIGS["doubt/pilco-mean"], **SMALL_PILCO)
    seen = []
    improve = planning.improve
    monkeypatch.setattr(planning, "improve", lambda model, *rest: seen.append(model) or improve(model, *rest))
    process = finish(start(config, (100,), precision="float64"))
    assert all(model.precision is None and model.fixed for model in seen)
    record = process.result()
    assert set(record) == {*doubt.KEPT_PILCO, *process.COUNTS}
    usual = finish(pilco.start(replace(config, doubt=True), (100,)))
    assert seen[-1].precision is not None
    np.testing.assert_array_equal(record["states"][:, 0], usual.result()["states"][:, 0])
    assert (record["predicted_variance"][0, 1, -1] < usual.result()["predicted_variance"][0, 1, -1]).all()


def test_units_and_bad_input_are_named():
    (unit,) = configs.units("doubt/pilco-mean", (100, 101))
    assert (unit.label, unit.precision) == ("data_efficiency/doubt/pilco-mean/100-101", "float64")
    assert configs.units("doubt/ensemble", (100,))[0].precision == "float32"
    with pytest.raises(UserError, match="unknown config 'doubt/nothing', choose one of pilco-paper"):
        configs.units("doubt/nothing")
    with pytest.raises(ValueError, match="PILCO runs in float64, got float32"):
        start(doubt.CONFIGS["doubt/pilco-mean"], (100,), precision="float32")
    with pytest.raises(ValueError, match="got bfloat16"):
        start(doubt.CONFIGS["doubt/ensemble"], (100,), precision="bfloat16")
    with pytest.raises(ValueError, match=r"several without dropout, got 5 with 0\.05"):
        replace(OURS, ensemble=5)
    with pytest.raises(ValueError, match="share 32 particles"):
        replace(OURS, drop=0.0, ensemble=5, particles=32)
