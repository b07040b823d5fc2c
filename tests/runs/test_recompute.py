"""Recomputed units agree with their records bit for bit, and a record that does not is found out."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
import toy
from test_cli import command

from dropout_uncertainty import cli
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import execute, records
from dropout_uncertainty.runs.recompute import choose, recompute
from dropout_uncertainty.settings import config_dict, config_hash


@pytest.fixture
def record(tmp_path):
    return execute.run_unit(toy.unit(), tmp_path)


def changed(record, path=None, **origin):
    """Return the record with another path of the walk, or another origin."""
    header = {**record.header, "provenance": {**record.header["provenance"], **origin}}
    return replace(record, header=header, arrays=record.arrays if path is None else {"path": path})


def test_a_whole_unit_and_its_first_steps_agree_bit_for_bit(record):
    whole = recompute(toy.unit(), record, progress=False)
    assert (whole.steps, whole.problems) == (40, [])
    assert str(whole).endswith("all 1 arrays agree bit for bit")
    first = recompute(toy.unit(), record, seconds=0.0, progress=False)
    assert (first.steps, first.arrays, first.problems) == (2, ["path"], [])


def test_a_step_may_settle_several_entries(record):
    class Blocks(toy.RandomWalk):
        """The same walk in steps of four."""

        PER_STEP = 4

        def __init__(self, config, seeds):
            super().__init__(config, seeds)
            self.total //= self.PER_STEP

        def advance(self):
            before = self.done
            for place in range(self.PER_STEP):
                self.done = before * self.PER_STEP + place
                super().advance()
            self.done = before + 1

    unit = replace(toy.unit(), start=lambda config, seeds, **options: Blocks(config, seeds))
    for seconds, steps in ((0.0, 2), (np.inf, 10)):
        found = recompute(unit, record, seconds, progress=False)
        assert (found.steps, found.arrays, found.problems) == (steps, ["path"], [])


def test_a_difference_in_the_first_steps_is_found_and_located(record):
    path = record.arrays["path"].copy()
    path[1, 1] += 1e-12
    comparison = recompute(toy.unit(), changed(record, path), seconds=0.0, progress=False)
    (problem,) = comparison.problems
    assert problem.startswith("path differs in 25.00%, first at (1, 1)")
    path = record.arrays["path"].copy()
    path[1, 2] += 1.0  # later than what is recomputed
    assert not recompute(toy.unit(), changed(record, path), seconds=0.0, progress=False).problems


def test_elsewhere_rounding_is_forgiven_and_another_walk_is_not(record):
    there = {"processor": "another processor"}
    path = record.arrays["path"] * (1 + 1e-9)
    comparison = recompute(toy.unit(), changed(record, path, **there), progress=False)
    assert comparison.unequal
    assert not comparison.problems
    assert "processor another processor there" in str(comparison)
    comparison = recompute(toy.unit(), changed(record, path + 30, **there), progress=False)
    assert "path is -30 off on average" in comparison.problems[0]


def test_a_change_of_the_code_that_rounds_otherwise_is_forgiven_too(record, monkeypatch):
    assert record.header["provenance"]["rounding"] == 1
    path = record.arrays["path"] * (1 + 1e-9)
    assert recompute(toy.unit(), changed(record, path), progress=False).problems
    monkeypatch.setattr(toy.RandomWalk, "ROUNDING", 2, raising=False)
    comparison = recompute(toy.unit(), changed(record, path), progress=False)
    assert not comparison.problems
    assert comparison.elsewhere == ["rounding 1 there, 2 here"]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_sittings_with_other_numbers_of_threads_round_otherwise(record):
    path = record.arrays["path"] + 1e-12
    sittings = [{**record.header["provenance"]["commits"][0], "threads": threads} for threads in (2, 1)]
    found = recompute(toy.unit(), changed(record, path, commits=sittings), progress=False)
    assert "threads 1 and 2 there" in found.elsewhere
    assert not found.problems
    assert recompute(toy.unit(), changed(record, path, commits=sittings[:1]), progress=False).problems


def test_without_a_gpu_the_record_of_one_is_recomputed_on_the_cpu(record):
    unit = replace(toy.unit(), device="cuda")
    made = {**record.header, **unit.identity}
    made["provenance"] = {**record.header["provenance"], "processor": "a GPU"}
    comparison = recompute(unit, replace(record, header=made), progress=False)
    assert not comparison.problems
    assert any("processor a GPU there" in phrase for phrase in comparison.elsewhere)


def test_arrays_of_another_type_or_not_computed_any_more(record):
    single = changed(record, record.arrays["path"].astype(np.float32))
    assert "path was float32 (2, 40), is float64" in recompute(toy.unit(), single, progress=False).problems[0]
    lost = replace(record, arrays={**record.arrays, "speed": np.zeros((2, 40))})
    (problem,) = recompute(toy.unit(), lost, progress=False).problems
    assert "speed was float64 (2, 40), is float64 (0,)" in problem
    assert recompute(toy.unit(), lost, seconds=0.0, progress=False).problems
    later = replace(record, arrays={**record.arrays, "place": np.zeros((2, 7))})  # of no step, so may come at the end
    assert not recompute(toy.unit(), later, seconds=0.0, progress=False).problems


def test_nothing_to_compare_is_a_problem(record):
    final = replace(record, arrays={"path": record.arrays["path"][:, :7]})
    assert "nothing can be compared" in recompute(toy.unit(), final, seconds=0.0, progress=False).problems[0]


def test_a_record_of_another_unit_is_refused(record):
    with pytest.raises(ValueError, match="other config"):
        recompute(toy.unit(steps=41), record, progress=False)


def test_the_draw_is_at_random_and_repeatable(record):
    found = [replace(record, path=record.path.with_name(f"{i:03d}.npz")) for i in range(20)]
    draws = [[r.label for r in choose(found, 3, seed)] for seed in range(5)]
    assert draws[0] == [r.label for r in choose(found[::-1], 3, 0)]
    assert len({tuple(draw) for draw in draws}) == 5
    assert all(len(set(draw)) == 3 for draw in draws)
    assert len(choose(found, 99, 0)) == 20
    assert choose([], 1, 0) == []


def test_every_published_record_has_its_unit():
    for path, _ in records.verify():
        header = records.read(path).header
        unit = cli.recorded_unit(header)
        assert {key: header[key] for key in unit.identity} == unit.identity


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "ours/gone"}, "no config of that name any more"),
        ({"config": {"rounds": 1}, "config_hash": config_hash({"rounds": 1})}, "its config has changed since"),
    ],
)
def test_a_record_whose_config_is_gone_is_named(changes, message):
    header = {
        "experiment": "active_learning", "name": "ours/random", "seeds": [100], "device": "cpu",
        "precision": "bfloat16", "config": {}, "config_hash": "", **changes,
    }  # fmt: skip
    with pytest.raises(UserError, match=message):
        cli.recorded_unit(json.loads(json.dumps(header)))


def test_verify_recomputes_and_says_what_fails(tmp_path, monkeypatch):
    """A short run of section 5.3 whose record is altered: intact by its checksum, but not what the code computes."""
    from dropout_uncertainty.exploration import experiment

    (unit,) = experiment.units("quick/ours-greedy", [100])
    process = experiment.start(replace(unit.config, ticks=3500), [100])  # the burn-in and a block
    while process.done < process.total:
        process.advance()
    arrays = process.result()
    blocks = unit.config.ticks // experiment.BLOCK
    places = [0] * (blocks - process.total) + list(range(process.total))  # the first block is right
    longer = {name: array[..., places] for name, array in arrays.items()}
    header = {**unit.identity, "config": config_dict(unit.config), "provenance": records.provenance()}
    path = tmp_path / f"{unit.label}.npz"
    records.write(path, longer, header)
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_RECORDS", str(tmp_path))
    outcome = command("records", "verify", "--recompute", "1", "--seconds", "0.001")
    assert outcome.returncode == 1
    assert "1 of 1 records are intact" in outcome.stdout
    assert f"quick/ours-greedy/100.npz: 2 of {blocks} steps again" in outcome.stderr
    assert "reward differs" in outcome.stderr


def test_bfloat16_is_recomputed_in_float32_where_the_cpu_has_none_of_it(monkeypatch, tmp_path):
    begun = []

    def start(config, seeds, *, device, precision):
        begun.append(precision)
        return toy.start(config, seeds)

    unit = replace(toy.unit(), start=start, precision="bfloat16", published="bfloat16")
    record = execute.run_unit(unit, tmp_path)
    for capability, expected in (("AVX2", "float32"), ("AVX512", "bfloat16")):
        monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda name=capability: name)
        found = recompute(unit, record, progress=False)
        assert begun[-1] == expected
        said = "precision bfloat16 there, float32 here" in found.elsewhere
        assert said == (expected == "float32")
