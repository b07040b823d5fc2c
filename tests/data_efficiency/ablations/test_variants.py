"""Variants of Deep PILCO differ in one thing; looking into a learner does not disturb it; times are what they say."""

from dataclasses import asdict, fields, replace

import numpy as np
import pytest
import torch
from toy import finish

from dropout_uncertainty import cli
from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.ablations import probes, scaling, variants
from dropout_uncertainty.data_efficiency.ablations.variants import BASE, CONFIGS, MECHANISM, VARIANTS
from dropout_uncertainty.data_efficiency.deep_pilco import learner as experiment
from dropout_uncertainty.data_efficiency.deep_pilco import planning
from dropout_uncertainty.data_efficiency.deep_pilco.learner import OURS
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.rng import generator
from dropout_uncertainty.settings import config_diff, config_hash

#: The least work that goes through every part.
SMALL = {
    "plant": replace(PAPER, steps=6, solved_steps=2), "trials": 2, "hidden": (16, 16), "basis": 5, "particles": 6,
    "policy_steps": 4, "model_steps": 6, "batch": 8, "guard": 0.5, "redraws": 1,
}  # fmt: skip
LOOK = {
    "measured": (1, 2), "cloud": 20, "gradient_draws": 3, "horizons": (2, 6), "counts": (4, 12), "objective_draws": 3,
}  # fmt: skip


pytestmark = pytest.mark.usefixtures("coarse_plant")


@pytest.fixture(scope="module")
def looked(coarse_plant):
    return finish(variants.start_mechanism(replace(MECHANISM, **SMALL, **LOOK), (100, 101), precision="float64"))


@pytest.fixture(scope="module")
def ours(coarse_plant):
    return finish(experiment.start(replace(OURS, **SMALL), (100, 101), precision="float64"))


# --- the table ---


def test_the_base_is_ours_for_fewer_trials():
    assert {f.name: getattr(BASE, f.name) for f in fields(OURS)} == vars(OURS) | {"trials": variants.TRIALS}
    assert {f.name: getattr(MECHANISM, f.name) for f in fields(OURS)} == vars(OURS) | {"trials": variants.TRIALS}


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_differs_in_the_named_fields_alone(name):
    variant = VARIANTS[name]
    differing = {field: new for field, _, new in config_diff(BASE, variant.config)}
    assert differing == dict(variant.changes)
    assert CONFIGS[f"what-matters/{name}"] == variant.config


def test_no_two_variants_are_the_same():
    assert len({config_hash(config) for config in CONFIGS.values()}) == len(CONFIGS)


def test_the_command_line_knows_the_family():
    modules = cli.config_modules("data_efficiency")
    assert cli.config_names("what-matters", modules) == list(CONFIGS)
    for name in CONFIGS:
        assert modules[name].CONFIGS[name] is CONFIGS[name]
        (unit,) = configs.units(name, range(10))
        assert unit.label == f"data_efficiency/{name}/000-009"
    with pytest.raises(UserError, match="unknown config 'what-matters/nothing'"):
        configs.units("what-matters/nothing")


def test_the_base_learns_as_ours_does(ours):
    process = finish(variants.start(replace(BASE, **SMALL), (100, 101), precision="float64"))
    np.testing.assert_array_equal(process.result()["costs"], ours.result()["costs"].astype(np.float16))
    assert torch.equal(process.policy, ours.policy)


def test_a_sure_planner_has_the_same_network_and_no_masks(ours):
    process = variants.start(replace(BASE, **SMALL, doubt=False), (100, 101), precision="float64")
    process.advance()
    process.advance()
    for mine, other in zip(process.model.net.parameters(), ours.model.net.parameters(), strict=True):
        assert mine.shape == other.shape
    # trial 1 is fitted to the same random trial, so the loss is the same: training keeps its dropout
    torch.testing.assert_close(process.log["model_loss"][:, 1], ours.log["model_loss"][:, 1])
    assert not torch.equal(process.log["predicted_mean"][:, 1], ours.log["predicted_mean"][:, 1])
    view = process.model.mean()
    assert view.select([1]).drop == (0.0, 0.0, 0.0)
    (draws,) = planning.draw(view, process.config.plant, process.config, 4, "test")
    x = torch.randn(2, 4, 6, generator=generator(100, "test"), dtype=torch.float64)
    torch.testing.assert_close(draws.functions[0](x), process.model.function(None)(x))


@pytest.mark.parametrize("name", ["masks-redrawn-matching-off", "particles-fixed-bfgs", "mean-network", "raw-inputs"])
def test_variants_run_and_leave_small_records(name):
    process = finish(variants.start(replace(VARIANTS[name].config, **SMALL), (100,)))
    record = process.result()
    assert set(record) == {"costs", "predicted_cost", *process.COUNTS}
    assert np.isfinite(record["costs"]).all()
    assert record["costs"].dtype == np.float16


# --- the mechanism ---


def test_looking_does_not_disturb_learning(looked, ours):
    np.testing.assert_array_equal(looked.log["costs"], ours.log["costs"])
    assert torch.equal(looked.policy, ours.policy)
    for mine, other in zip(looked.model.net.parameters(), ours.model.net.parameters(), strict=True):
        assert torch.equal(mine, other)


def test_everything_is_measured(looked):
    record = looked.result()
    shapes = {name: record[name].shape for name in looked.found}
    assert shapes == {
        "cloud_mean": (2, 2, 4, 6, 4), "cloud_std": (2, 2, 4, 6, 4), "cloud_valley": (2, 2, 4, 6), "penalty": (2, 2, 6),
        "gradient_variance": (2, 2, 3, 2), "gradient_norm": (2, 2, 3, 2), "objective": (2, 2, 3, 2),
        "reached": (2, 2, 3), "fresh": (2, 2, 3), "diagonal_std": (2, 2, 2, 6, 4), "penalty_diagonal": (2, 2, 6),
    }  # fmt: skip
    assert all(np.isfinite(record[name]).all() for name in looked.found)
    np.testing.assert_allclose(record["true_states"], looked.log["states"][:, [1, 2]], rtol=1e-6)


def test_a_look_can_be_continued(looked, tmp_path):
    config = replace(MECHANISM, **SMALL, **LOOK)
    half = variants.start_mechanism(config, (100, 101), precision="float64")
    half.advance()
    half.advance()
    torch.save(half.state(), tmp_path / "state.pt")
    other = variants.start_mechanism(config, (100, 101), precision="float64")
    other.restore(torch.load(tmp_path / "state.pt", weights_only=True))
    for name, expected in looked.result().items():
        np.testing.assert_array_equal(finish(other).result()[name], expected, err_msg=name)


def test_records_of_the_mechanism_are_small():
    process = variants.start_mechanism(MECHANISM, range(100, 110))
    assert sum(array.nbytes for array in process.result().values()) < 5e5


def test_clouds_are_those_of_their_plans(looked):
    """Masks that are held and free particles: the cloud is that of whole functions, followed one by one."""
    config = replace(looked.config, hold_masks=True, matching="off")
    (draws,) = planning.draw(looked.model, config.plant, config, config.cloud, "mechanism", "cloud", 2)
    (function,) = draws.functions
    policy = looked.shape.policy(looked.policy)
    matrix, weights = probes.multiplied_out(policy)
    state = draws.start
    for t in range(config.plant.steps):
        state = state + function(probes.act(state, matrix, weights, config.plant.force_limit, True))
        torch.testing.assert_close(state.mean(1), looked.found["cloud_mean"][:, 1, 1, t], rtol=1e-6, atol=1e-8)
        std = state.std(1, correction=0)
        torch.testing.assert_close(std, looked.found["cloud_std"][:, 1, 1, t], rtol=1e-6, atol=1e-8)


def test_objective_without_matching_is_a_mean_over_particles(looked):
    """Known by hand: without matching the objective is a plain mean, so 4 particles at a time or all at once agree."""
    config = replace(looked.config, matching="off")
    few = planning.draw(looked.model, config.plant, config, 4, "bias", blocks=8)
    values = torch.stack([planning.objective(config.plant, looked.shape, config, looked.policy, d)[0] for d in few])
    few = list(planning.draw(looked.model, config.plant, config, 4, "bias", blocks=8))
    moved = []
    for draws in few:
        prediction = probes.predict(looked.shape.policy(looked.policy), config.plant, draws, "off")
        moved.append(prediction.particles)
    whole = probes.cost(config.plant, torch.cat(moved, 2)).mean((1, 2))
    torch.testing.assert_close(values.mean(0), whole)


def normal(*shape):
    return torch.randn(shape, generator=generator(100, "valley"), dtype=torch.float64)


def chosen(share, *shape):
    return (torch.rand(shape, generator=generator(101, "valley"), dtype=torch.float64) < share).double()


def test_valley_finds_two_groups_and_nothing_else():
    batch = (300, 200)
    parted = lambda x: (probes.valley(x) >= probes.PARTED).double().mean().item()  # noqa: E731
    assert parted(normal(*batch)) == 0
    assert parted(-torch.rand(batch, generator=generator(102), dtype=torch.float64).log()) < 0.05  # skewed
    assert parted(torch.rand(batch, generator=generator(102), dtype=torch.float64)) < 0.05
    heavy = normal(*batch) / normal(*batch, 3).square().mean(-1).sqrt()
    assert parted(heavy) < 0.05
    assert parted(normal(*batch) + 6 * chosen(0.02, *batch)) < 0.05  # stragglers
    assert parted(normal(*batch) + 5 * chosen(0.5, *batch)) == 1
    assert parted(normal(*batch) + 6 * chosen(0.2, *batch)) > 0.9
    assert probes.valley(torch.tensor([0.0] * 50 + [1.0] * 50)).item() > 0.9


def test_valley_does_not_depend_on_place_and_scale():
    x = normal(20, 100) + 4 * chosen(0.5, 20, 100)
    torch.testing.assert_close(probes.valley(x), probes.valley(-3 - 100 * x))


def test_a_gaussian_over_two_bad_groups_can_be_cheaper_than_they_are():
    """The penalty is no law: two groups left and right of upright, and a Gaussian that covers it."""
    states = torch.zeros(1, 1, 1000, 4, dtype=torch.float64)
    noise = normal(1, 1, 1000, 4)
    states[..., 3] = torch.where(torch.arange(1000) % 2 == 0, 1.0, -1.0) + 0.01 * noise[..., 0]
    assert probes.penalty(PAPER, states, noise).item() < -0.05
    states[..., 3] = torch.where(torch.arange(1000) % 2 == 0, 0.0, np.pi) + 0.01 * noise[..., 0]
    assert probes.penalty(PAPER, states, noise).item() > 0.05


def test_bad_horizons_are_named():
    with pytest.raises(ValueError, match="expected horizons of 1 to 6 steps"):
        replace(MECHANISM, plant=SMALL["plant"])


# --- times ---

TINY = replace(
    variants.SCALING,
    deep=replace(OURS, hidden=(8,), particles=5, plant=SMALL["plant"]),
    base=(20, 3, 2), pilco_sizes=((10, 20), (3, 5), (1, 2)), deep_sizes=((10, 20), (3, 5), (1, 2)), timed=2,
)  # fmt: skip


def test_times_go_into_the_provenance_and_values_into_the_record():
    process = finish(scaling.start(TINY, (100, 101)))
    assert process.total == 18
    record, timings = process.result(), process.timings()
    assert set(record) == {"fit_value", "trial_value"}
    assert all(np.isfinite(array).all() and array.shape == (2, 18) for array in record.values())
    assert np.shape(timings["scaling_policy_s"]) == (2, 18)
    assert np.min(timings["scaling_policy_s"]) > 0
    again = scaling.start(TINY, (101,))
    again.restore(again.state())
    np.testing.assert_array_equal(finish(again).result()["trial_value"][0], record["trial_value"][1])
    assert asdict(TINY)["deep"]["particles"] == 5


def test_one_axis_varies_at_a_time():
    for method, axis, sizes in variants.SCALING.points():
        assert method in scaling.METHODS
        others = [(size, usual) for i, (size, usual) in enumerate(zip(sizes, variants.SCALING.base, strict=True))]
        assert all(size == usual for i, (size, usual) in enumerate(others) if i != axis)


def test_times_are_taken_on_the_cpu():
    with pytest.raises(ValueError, match="times are taken on one thread of the CPU"):
        scaling.start(TINY, (100,), device="cuda")
    with pytest.raises(ValueError, match="got bfloat16"):
        scaling.start(TINY, (100,), precision="bfloat16")
    with pytest.raises(ValueError, match="at least one seed"):
        scaling.start(TINY, ())
