"""Seeds are cut into units in one way, in every section."""

from dataclasses import replace

import pytest
import toy

from dropout_uncertainty.active_learning import experiment as active_learning
from dropout_uncertainty.data_efficiency import configs as data_efficiency
from dropout_uncertainty.exploration import experiment as exploration
from dropout_uncertainty.runs import execute
from dropout_uncertainty.runs.unit import RunError, missing

#: A config of each kind, the precision of its records, others that it runs in, one that it does not, seeds of a unit.
KINDS = [
    (active_learning, "ours/random", "bfloat16", ["float32", "float64"], None, 1),
    (exploration, "ours-thompson", "float32", ["float64"], "bfloat16", 20),
    (data_efficiency, "pilco-paper", "float64", [], "float32", 20),
    (data_efficiency, "pilco-paper-40", "float64", [], "bfloat16", 20),
    (data_efficiency, "deep-pilco-ours", "float32", ["float64"], "bfloat16", 20),
    (data_efficiency, "search/start", "float32", ["float64"], "bfloat16", 20),
    (data_efficiency, "what-matters/no-dropout", "float32", ["float64"], "bfloat16", 20),
    (data_efficiency, "what-matters/scaling", "float32", ["float64"], "bfloat16", 20),
]


@pytest.mark.parametrize(("module", "name", "own", "others", "wrong", "size"), KINDS)
def test_seeds_are_cut_and_precisions_show_in_the_name(module, name, own, others, wrong, size):
    units = module.units(name, range(100, 10_100))
    assert [unit.seeds for unit in units] == [tuple(range(i, i + size)) for i in range(100, 10_100, size)]
    assert {unit.precision for unit in units} == {own}
    plain = units[0].label
    assert plain == module.units(name, range(100, 10_100), precision=own)[0].label
    for other in others:
        (unit,) = module.units(name, range(100, 100 + size), precision=other)
        assert (unit.precision, unit.label) == (other, f"{plain}.{other}")
    if wrong:
        with pytest.raises(RunError, match=f"{name} runs in {own}.*, got the precision {wrong}"):
            module.units(name, [100], precision=wrong)


@pytest.mark.parametrize(("module", "name"), [kind[:2] for kind in KINDS])
def test_every_unit_has_an_estimate_of_its_memory_that_a_common_machine_can_give(module, name):
    (unit,) = module.units(name, [100])
    assert 1e6 < unit.memory < 4e9
    assert max(unit.memory for unit in module.units(name, range(100, 140))) < 8e9


def test_on_a_gpu_seeds_are_stacked_and_the_device_shows_in_the_name():
    assert [u.label for u in active_learning.units("ours/random", range(100, 115), device="cuda")] == [
        "active_learning/ours/random/100-109.cuda", "active_learning/ours/random/110-114.cuda",
    ]  # fmt: skip
    with pytest.raises(RunError, match="what-matters/scaling runs on cpu, got the device cuda"):
        data_efficiency.units("what-matters/scaling", [100], device="cuda")


def test_an_unknown_config_is_named():
    with pytest.raises(RunError, match="unknown config 'mine', choose one of as-demo"):
        exploration.units("mine", [100])
    with pytest.raises(RunError, match=r"did you mean ours-thompson\?"):
        exploration.units("ours/thompson", [100])


def test_a_unit_is_published_or_of_development():
    units = data_efficiency.units("deep-pilco-ours", range(95, 105))
    assert [unit.seeds for unit in units] == [tuple(range(95, 100)), tuple(range(100, 105))]
    with pytest.raises(RunError, match="below 100, or those of development, got both: 98 to 101"):
        replace(units[0], seeds=(98, 99, 100, 101))


def test_what_is_missing_of_units_is_asked_seed_by_seed(tmp_path, monkeypatch):
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_RECORDS", str(tmp_path))
    execute.run([toy.unit()])  # seeds 100 and 101
    wanted = [replace(toy.unit(), seeds=seeds, memory=8.0) for seeds in [(100, 101), (101, 102, 103, 104), (105,)]]
    assert [(unit.seeds, unit.memory) for unit in missing(wanted)] == [((102, 103, 104), 6.0), ((105,), 8.0)]
