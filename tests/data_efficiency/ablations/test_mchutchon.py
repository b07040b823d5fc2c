"""Particles through PILCO's Gaussian process: drawn from the right distribution, moved and improved by shared code."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.ablations import mchutchon
from dropout_uncertainty.data_efficiency.deep_pilco import planning
from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian
from dropout_uncertainty.data_efficiency.pilco.gaussian_process import GaussianProcess
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.rng import generator

PLANT = replace(PAPER, steps=6, solved_steps=2)


pytestmark = pytest.mark.usefixtures("coarse_plant")


@pytest.fixture(scope="module")
def dynamics():
    g = generator(100)
    inputs = torch.randn(2, 30, 6, generator=g, dtype=torch.float64)
    targets = 0.2 * torch.sin(inputs @ torch.randn(6, 4, generator=g, dtype=torch.float64) / 2).mT
    hyper = torch.tensor([1.0] * 6 + [-1.0, -3.0], dtype=torch.float64).expand(2, 4, 8)
    return mchutchon.GaussianDynamics(GaussianProcess(inputs, targets, hyper).posterior()[0], (100, 101))


def test_changes_are_drawn_from_the_posterior_at_each_place(dynamics):
    place = torch.full((2, 1, 6), 0.7, dtype=torch.float64)
    drawn = dynamics.function(dynamics.draw(20_000, "draw"))(place.expand(-1, 20_000, -1))
    certain = Gaussian(place[:, 0], torch.zeros(2, 6, 6, dtype=torch.float64))
    expected = dynamics.posterior.moments(certain)
    variance = expected.cov.diagonal(dim1=-2, dim2=-1)
    assert ((drawn.mean(1) - expected.mean).abs() < 4 * (variance / 20_000).sqrt()).all()
    torch.testing.assert_close(drawn.var(1), variance, rtol=0.06, atol=0)


def test_gradients_stay_finite_at_the_data(dynamics):
    at = dynamics.posterior.centres[:, :5].clone().requires_grad_()
    dynamics.function(dynamics.draw(5, "draw"))(at).sum().backward()
    assert at.grad.isfinite().all()


def test_selected_replicas_draw_what_they_drew(dynamics):
    x = torch.ones(2, 4, 6, dtype=torch.float64)
    part = dynamics.select([1])
    whole, alone = (d.function(d.draw(4, "draw")) for d in (dynamics, part))
    torch.testing.assert_close(alone(x[1:]), whole(x)[1:])
    assert isinstance(dynamics, planning.Dynamics)


def test_each_step_has_a_draw_of_its_own(dynamics):
    plan = planning.Planning(hold_masks=False, particles=4)
    (draws,) = planning.draw(dynamics, PLANT, plan, 4, "test")
    assert len(draws.functions) == PLANT.steps
    assert not torch.equal(draws.functions[0].noise, draws.functions[1].noise)


@pytest.mark.parametrize("name", ["mchutchon/fixed-bfgs-diagonal", "mchutchon/fresh-adam-full"])
def test_repetitions_run_and_are_the_same_alone(name):
    config = mchutchon.CONFIGS[name]
    plan = replace(config.planning, particles=5, policy_steps=3)
    config = replace(config, plant=PLANT, trials=2, basis=3, model_iterations=5, planning=plan)
    many, one = (mchutchon.start(config, seeds) for seeds in ((100, 101), (101,)))
    for process in (many, one):
        while process.done < process.total:
            process.advance()
    record = many.result()
    assert set(record) == {*many.kept, *many.COUNTS}
    assert np.isfinite(record["predicted_variance"][:, 1:]).all()
    assert not record["policy_repairs"].any()
    torch.testing.assert_close(one.log["costs"][0], many.log["costs"][1], rtol=1e-6, atol=1e-6)


def test_the_six_settings_and_bad_ones():
    assert set(mchutchon.CONFIGS) == {
        f"mchutchon/{way}-{matching}"
        for way in ("fixed-bfgs", "fresh-adam")
        for matching in ("full", "diagonal", "off")
    }
    assert mchutchon.CONFIGS["mchutchon/fixed-bfgs-off"].planning.policy_steps == 150
    with pytest.raises(ValueError, match="set hold_masks to False"):
        mchutchon.ParticlePilcoConfig(planning=planning.Planning())
    with pytest.raises(ValueError, match="float64, got float32"):
        mchutchon.start(mchutchon.CONFIGS["mchutchon/fixed-bfgs-off"], (100,), precision="float32")
    with pytest.raises(UserError, match="unknown config 'mchutchon/nothing'"):
        configs.units("mchutchon/nothing")
