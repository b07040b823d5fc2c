"""The shrinking cloud: what refitting does to a walk that does nothing, and what is measured of it in a learner."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy import finish

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.ablations import shrinking
from dropout_uncertainty.data_efficiency.configs import CONFIGS
from dropout_uncertainty.data_efficiency.deep_pilco import learner, planning
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.settings import config_diff

SMALL = {
    "plant": replace(PAPER, steps=6, solved_steps=2), "trials": 2, "hidden": (16, 16), "basis": 5, "particles": 4,
    "policy_steps": 4, "model_steps": 6, "batch": 8, "redraws": 1,
}  # fmt: skip


pytestmark = pytest.mark.usefixtures("coarse_plant")


@pytest.fixture(scope="module")
def looked(coarse_plant):
    config = replace(CONFIGS["shrinking/as-text"], **SMALL, many=1000, draws=60)
    return finish(shrinking.start(config, (100, 101), precision="float64"))


@pytest.mark.parametrize("name", ["as-text", "as-paper", "ours"])
def test_a_learner_differs_in_its_trials_alone(name):
    published = {"as-paper": "as-written"}.get(name, name)
    differing = config_diff(CONFIGS[f"deep-pilco-{published}"], CONFIGS[f"shrinking/{name}"])
    assert {field for field, *_ in differing} == {"trials", "draws", "many"}


def test_looking_does_not_disturb_learning(looked):
    usual = finish(learner.start(replace(learner.AS_TEXT, **SMALL), (100, 101), precision="float64"))
    assert torch.equal(looked.log["costs"], usual.log["costs"])


def test_plain_noise_loses_spread_and_standardised_noise_does_not(looked):
    many, mean = (looked.log[name][:, 1:] for name in ("many_variance", "mean_variance"))
    left = {name: (mean[:, :, row] / many)[..., 0].mean((0, 1)) for row, name in enumerate(shrinking.NOISE)}
    assert 0.6 < left["plain"][0] < 0.9  # 3/4 of the start state's, and nothing else yet
    assert left["plain"][-1] < left["plain"][0] - 0.1
    assert (left["standardised"] > left["plain"])[1:].all()


def test_the_variance_of_few_particles_is_that_of_their_draws(looked):
    plan = replace(looked.config, standard_noise=False)
    draws = list(planning.draw(looked.model, plan.plant, plan, 4, "shrinking", 2, blocks=800))
    start = torch.stack([d.start.var(1, correction=0) for d in draws]).mean(0)
    torch.testing.assert_close(start, torch.full_like(start, 0.75 * plan.plant.start_std**2), rtol=0.12, atol=0)


def test_records_are_small_and_a_repetition_is_the_same_alone(looked):
    record = looked.result()
    assert set(record) == {"costs", *shrinking.MEASURED, *looked.COUNTS}
    one = finish(shrinking.start(looked.config, (101,), precision="float64")).result()
    for name in shrinking.MEASURED:
        np.testing.assert_allclose(one[name][0], record[name][1], rtol=1e-5)


def test_units_and_bad_input_are_named():
    assert configs.units("shrinking/ours")[0].label == "data_efficiency/shrinking/ours/000-009"
    with pytest.raises(ValueError, match="draws of 30 or more, got 32 and 20"):
        replace(CONFIGS["shrinking/ours"], many=20)
