"""Learning runs: data kept, continued, batched and reported as they should be."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode
from toy import finish

from dropout_uncertainty.data_efficiency import configs, policies
from dropout_uncertainty.data_efficiency.gaussians import moments, squared_exponential
from dropout_uncertainty.data_efficiency.minimise.batched import Minimum
from dropout_uncertainty.data_efficiency.pilco import gaussian_process as gp
from dropout_uncertainty.data_efficiency.pilco import learner, planning
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cartpole import MATLAB, PAPER, features, step
from dropout_uncertainty.data_efficiency.plant.cost import cost, solved
from dropout_uncertainty.data_efficiency.policies import force
from dropout_uncertainty.rng import generator
from dropout_uncertainty.runs import execute
from dropout_uncertainty.runs.recompute import recompute
from dropout_uncertainty.runs.unit import RunError, Unit

#: Two short trials with the least work that goes through every part.
SHORT = replace(
    learner.PILCO_PAPER,
    plant=replace(PAPER, steps=6, solved_steps=2),
    trials=2,
    basis=3,
    policy_iterations=3,
    model_iterations=10,
)


longer = partial(learner.start, kind=learner.ContinuedPilco)


@pytest.fixture(scope="module")
def finished():
    return finish(learner.start(SHORT, (100, 101)))


def test_a_state_belongs_to_no_process():
    process = learner.start(SHORT, (100, 101))
    process.advance()
    state = process.state()
    first, second = (learner.start(SHORT, (100, 101)) for _ in range(2))
    for other in (first, second):
        other.restore(state)
    first.log["costs"][:] = 2.0
    assert not (state["log"]["costs"] == 2.0).any()
    assert not (second.log["costs"] == 2.0).any()


def test_record_holds_consistent_trials(finished):
    record = finished.result()
    states, forces = (torch.from_numpy(record[name]).double() for name in ("states", "forces"))
    assert states.shape == (2, 3, 7, 4)
    moved = step(SHORT.plant, states[:, :, :-1], forces)
    torch.testing.assert_close(moved, states[:, :, 1:], rtol=0, atol=1e-4)
    torch.testing.assert_close(cost(SHORT.plant, states[:, :, 1:]).float(), torch.from_numpy(record["costs"]))
    assert np.abs(record["forces"]).max() <= 10
    noise = record["observed"] - record["states"]
    assert 0.007 < noise.std() < 0.013
    assert np.isnan(record["predicted_mean"][:, 0]).all()
    assert np.isfinite(record["predicted_mean"][:, 1:]).all()
    assert (record["predicted_variance"][:, 1:] >= 0).all()
    assert (record["policy_line_searches"][:, 1:] >= 1).all()
    assert (record["search_gradient"][:, 1:] > 0).all()
    assert (record["search_gradient_sure"][:, 1:] > 0).all()
    assert (record["search_variance"][:, 1:, 1:] > 0).all()
    small = record.keys() - set(finished.CONTINUED)
    assert all(record[name].dtype in (np.float32, np.int32) for name in small)
    assert all(record[name].dtype == np.float64 for name in finished.CONTINUED)


def test_models_learn_from_every_transition_seen(finished):
    record = finished.result()
    assert finished.inputs.shape == (2, 18, 6)
    seen = features(torch.from_numpy(record["observed"][1, 2, 3]).double())
    torch.testing.assert_close(finished.inputs[1, 15, :5], seen, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(finished.inputs[1, 15, 5], torch.tensor(record["forces"][1, 2, 3]))


def test_the_recorded_policy_gives_the_recorded_forces(finished):
    record = finished.result()
    policy = finished.shape.policy(torch.from_numpy(record["policy"][:, 2]).double())
    again = force(policy, SHORT.plant, torch.from_numpy(record["observed"][:, 2, :-1]).double())
    np.testing.assert_allclose(again.numpy(), record["forces"][:, 2], rtol=0, atol=2e-2)


def test_continued_equals_uninterrupted(finished, tmp_path):
    half = learner.start(SHORT, (100, 101))
    for _ in range(2):
        half.advance()
    torch.save(half.state(), tmp_path / "state.pt")
    other = learner.start(SHORT, (100, 101))
    other.restore(torch.load(tmp_path / "state.pt", weights_only=True))
    finish(other)
    for name, expected in finished.result().items():
        np.testing.assert_array_equal(other.result()[name], expected, err_msg=name)


@pytest.fixture
def shorter(tmp_path, monkeypatch):
    """Return the record of one trial less, in a folder of its own and known by its name."""
    config = replace(SHORT, trials=SHORT.trials - 1)
    monkeypatch.setitem(learner.CONFIGS, "short", config)
    unit = Unit("data_efficiency", "short", learner.start, config, (100, 101), "cpu", "float64")
    return execute.run_unit(unit, tmp_path / "given")


def test_a_longer_run_goes_on_from_the_records_of_the_folder_that_it_is_given(finished, shorter, tmp_path):
    seconds = shorter.header["provenance"]["policy_cpu_s"]
    process = longer(SHORT, (100, 101))
    assert process.done == 0, "a cold start, until it is told to inherit"
    (parent,) = process.inherit(tmp_path / "given")
    assert (parent["record"], parent["checksum"]) == (shorter.label, shorter.header["checksum"])
    assert process.done == SHORT.trials
    assert process.seconds["policy"][: SHORT.trials] == pytest.approx(seconds)
    for name, expected in finish(process).result().items():
        np.testing.assert_array_equal(expected, finished.result()[name], err_msg=name)
    alone = longer(SHORT, (101,))
    (half,) = alone.inherit(tmp_path / "given")
    assert alone.seconds["policy"][1] == pytest.approx(seconds[1] / 2)
    assert half["cpu_s"] == pytest.approx(shorter.header["provenance"]["cpu_s"] / 2)
    (tmp_path / "empty").mkdir()
    for config, seeds, device, folder in (
        (SHORT, (101, 102), "cpu", "given"),  # nothing is known of 102
        (replace(SHORT, basis=4), (100, 101), "cpu", "given"),
        (SHORT, (100, 101), "cuda", "given"),  # not from records of a CPU
        (SHORT, (100, 101), "cpu", "empty"),
    ):
        cold = longer(config, seeds, device=device)
        assert (cold.inherit(tmp_path / folder), cold.done) == ([], 0)


def test_its_record_names_the_parent_counts_the_whole_cost_and_is_recomputed_from_a_cold_start(shorter, tmp_path):
    unit = Unit("data_efficiency", "longer", longer, SHORT, (100, 101), "cpu", "float64")
    record = execute.run_unit(unit, tmp_path / "given")
    (parent,), origin = record.header["parents"], record.header["provenance"]
    assert (parent["record"], parent["checksum"]) == ("data_efficiency/short/100-101.npz", shorter.header["checksum"])
    for clock in ("cpu_s", "wall_s"):
        assert parent[clock] == shorter.header["provenance"][clock] > 0
        assert origin[f"whole_{clock}"] == pytest.approx(origin[clock] + parent[clock])
    again = recompute(unit, record, progress=False)
    assert (again.steps, again.problems) == (SHORT.trials + 1, [])
    wrong = {**record.arrays, "costs": record.arrays["costs"].copy()}
    wrong["costs"][0, 1] += 1  # in a trial of the parent
    assert recompute(unit, replace(record, arrays=wrong), progress=False).problems


def test_a_repetition_alone_equals_the_same_among_others(finished):
    alone = finish(learner.start(SHORT, (101,))).result()
    for name in ("states", "forces", "predicted_mean", "hyper", "policy"):
        np.testing.assert_allclose(alone[name][0], finished.result()[name][1], rtol=1e-5, atol=1e-5, err_msg=name)


def test_inducing_inputs_come_into_use():
    config = replace(SHORT, inducing=8, inducing_iterations=2)
    process = finish(learner.start(config, (100,)))
    assert process.inducing.shape == (1, 8, 6)
    assert np.isfinite(process.result()["costs"]).all()


def test_a_policy_that_cannot_be_evaluated_is_redrawn_and_counted(finished):
    process = learner.start(SHORT, (100, 101))
    process.advance()
    process.policy[1] = math.nan
    process.advance()
    record = process.result()
    assert record["policy_redrawn"][:, 1].tolist() == [0, 1]
    assert np.isfinite(record["policy"][:, 1]).all()
    np.testing.assert_allclose(record["policy"][0, 1], finished.result()["policy"][0, 1], rtol=1e-5, atol=1e-5)


class Answers(TorchDispatchMode):
    """Tensors without numbers say no to "is any of you", and 1 when asked for a value."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        if func in (torch.ops.aten._local_scalar_dense.default, torch.ops.aten.allclose.default):
            return not hasattr(args[0], "of_any") and (args[0].dtype == torch.bool or 1.0)
        result = func(*args, **(kwargs or {}))
        if func is torch.ops.aten.any.default:
            result.of_any = True
        return result


@pytest.fixture
def no_constants():
    """Keep cached constant tensors from getting into the test or out of it."""
    modules = (policies, moments, squared_exponential)
    cached = [function for module in modules for function in vars(module).values() if hasattr(function, "cache_clear")]
    for function in cached:
        function.cache_clear()
    yield
    for function in cached:
        function.cache_clear()


@pytest.mark.usefixtures("no_constants")
@pytest.mark.parametrize("inducing", [0, 2])
def test_models_are_evaluated_on_their_device_and_all_else_stays_on_the_cpu(monkeypatch, inducing):
    """Shown without a GPU: on another device, whose tensors hold no numbers but do not mix with the CPU's.

    What is done about NaN (a policy redrawn, a fit begun anew, jitter) is not run here.
    """
    config = replace(SHORT, plant=replace(SHORT.plant, steps=3), trials=1, inducing=inducing)
    evaluated = []

    def evaluate_once(objective, start, iterations):
        assert start.device.type == "cpu"
        evaluated.extend(result.device.type for result in objective(start, list(range(len(start)))))
        none = torch.zeros(len(start), dtype=torch.int64)
        return Minimum(start, none.double(), none, none, none, none)

    for module in (gp, planning):
        monkeypatch.setattr(module, "minimise", evaluate_once)
    monkeypatch.setattr(gp, "initial_inducing", lambda inputs, count, seeds: inputs[:, :count])
    monkeypatch.setattr(squared_exponential, "BLOCK", {"lazy": 100})
    monkeypatch.setattr(cartpole, "step", lambda plant, state, force: state)  # would take most of the time
    monkeypatch.setattr(cartpole, "check_interval", lambda plant: None)
    with FakeTensorMode(), Answers():
        process = finish(learner.start(config, (100, 101), device="lazy:0"))
    kept = pytree.tree_leaves((process.state(), process.log, process.counts))
    assert {leaf.device.type for leaf in kept if isinstance(leaf, torch.Tensor)} == {"cpu"}
    assert evaluated == ["lazy"] * (6 if inducing else 4)


def test_units_cut_seeds_into_batches_and_presets_differ_in_the_plant_only():
    units = configs.units("pilco-paper", range(100, 145))
    assert [len(unit.seeds) for unit in units] == [20, 20, 5]
    assert [len(unit.seeds) for unit in configs.units("pilco-paper", device="cuda")] == [40]
    assert units[0].label == "data_efficiency/pilco-paper/100-119"
    assert replace(learner.PILCO_PAPER, plant=MATLAB) == learner.PILCO_MATLAB


def test_record_says_where_the_computing_time_went(tmp_path):
    unit = Unit("data_efficiency", "short", learner.start, SHORT, (100, 101), "cpu", "float64")
    origin = execute.run_unit(unit, tmp_path).header["provenance"]
    parts = {name: origin[f"{name}_cpu_s"] for name in ("model", "gradients", "policy", "trial")}
    assert {len(part) for part in parts.values()} == {SHORT.trials + 1}
    assert parts["model"][0] == parts["policy"][0] == 0  # the random trial needs neither model nor policy
    assert min(parts["policy"][1:]) > 0
    assert sum(map(sum, parts.values())) <= origin["cpu_s"] + 0.1


def test_bad_input_is_named():
    with pytest.raises(RunError, match=r"unknown config 'pilco', choose one of pilco-paper, pilco-matlab"):
        configs.units("pilco")
    with pytest.raises(ValueError, match="at least one seed"):
        learner.start(SHORT, ())
    with pytest.raises(ValueError, match="trials must be at least 1, got 0"):
        replace(SHORT, trials=0)
    with pytest.raises(ValueError, match="float64, got float32"):
        learner.start(SHORT, (100,), precision="float32")


def test_first_centres_come_from_the_start_distribution():
    shape = planning.PolicyShape(400)
    parameters = shape.initial(PAPER, 0.1, (0.0,) * 5, generator(100))
    centres = parameters[5:-400].reshape(400, 5)
    np.testing.assert_allclose(centres.mean(0), [0, 0, 0, 0, -1], atol=0.01)
    np.testing.assert_allclose(centres[:, :4].std(0), 0.02, rtol=0.2)


@pytest.mark.slow
def test_learns_to_swing_up_and_balance():
    """At least one of two repetitions is solved within five trials, with less than half of the line searches."""
    process = learner.start(replace(learner.PILCO_PAPER, trials=5, policy_iterations=60), (100, 101))
    while process.done < process.total and not solved(PAPER, process.log["costs"]).any():
        process.advance()
    assert solved(PAPER, process.log["costs"]).any()
