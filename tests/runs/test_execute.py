"""Runs survive kills, full disks and each other, and end with the same arrays."""

import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import toy

from dropout_uncertainty import folders
from dropout_uncertainty.runs import checkpoints, execute, records, unit
from dropout_uncertainty.runs.records import RecordError
from dropout_uncertainty.runs.unit import RunError, check_device, precision_dtype

HERE = Path(__file__).parents[1]


@pytest.fixture
def every_step(monkeypatch):
    monkeypatch.setattr(execute, "CHECKPOINT_SECONDS", -1.0)


def child(folder, body):
    """Start a Python process that works on toy units, with a checkpoint after every step."""
    code = "from pathlib import Path\nimport toy\nfrom dropout_uncertainty.runs import execute"
    code += f"\nfolder = Path({str(folder)!r})\nexecute.CHECKPOINT_SECONDS = -1.0\n{body}"
    return subprocess.Popen([sys.executable, "-c", code], cwd=HERE, stderr=subprocess.PIPE, text=True)


def test_a_finished_unit_is_not_computed_again(tmp_path):
    first = execute.run([toy.unit()], folder=tmp_path, progress=False)[0]
    written = first.path.stat().st_mtime_ns
    assert first.arrays["path"].shape == (2, 40)
    assert execute.run_unit(toy.unit(), tmp_path).path.stat().st_mtime_ns == written
    assert not list((tmp_path / ".partial").glob("*.pt"))


def test_killed_at_any_moment_it_continues_to_the_same_arrays(tmp_path):
    expected = execute.run_unit(toy.unit(seconds=0.02), tmp_path / "whole").header["payload"]
    kills = 0
    for pause in (0.0, 0.1, 0.25, 0.05):
        process = child(tmp_path / "killed", "execute.run_unit(toy.unit(seconds=0.02), folder)")
        deadline = time.monotonic() + 60
        while not list(tmp_path.glob("killed/.partial/*.pt")) and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(pause)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        kills += process.returncode == -signal.SIGKILL
    record = execute.run_unit(toy.unit(seconds=0.02), tmp_path / "killed")
    assert kills >= 2
    assert record.header["provenance"]["interruptions"] >= 1
    assert record.header["payload"] == expected


@pytest.fixture
def checkpoint(tmp_path, every_step):
    """Return the path of the checkpoint of a run that stopped after ten steps."""

    class Stop(Exception):
        pass

    def stopping(config, seeds, **options):
        process = toy.start(config, seeds, **options)
        advance = process.advance

        def until_ten():
            if process.done == 10:
                raise Stop
            return advance()

        process.advance = until_ten
        return process

    with pytest.raises(Stop):
        execute.run_unit(replace(toy.unit(), start=stopping), tmp_path)
    (path,) = (tmp_path / ".partial").glob("*.pt")
    return path


def test_a_run_begun_by_code_that_rounds_otherwise_says_so(tmp_path, checkpoint, monkeypatch):
    monkeypatch.setattr(toy.RandomWalk, "ROUNDING", 2, raising=False)
    assert execute.run_unit(toy.unit(), tmp_path).header["provenance"]["rounding"] == 1
    assert execute.run_unit(toy.unit(), tmp_path / "other").header["provenance"]["rounding"] == 2


def test_a_resumed_run_names_every_commit_it_ran_under(tmp_path, checkpoint, monkeypatch):
    before = records.provenance()
    monkeypatch.setattr(records, "provenance", lambda device="cpu": {**before, "commit": "f" * 40, "dirty": True})
    origin = execute.run_unit(toy.unit(), tmp_path).header["provenance"]
    assert [sitting["commit"] for sitting in origin["commits"]] == [before["commit"], "f" * 40]
    assert (origin["commit"], origin["dirty"], origin["commits"][0]["dirty"]) == ("f" * 40, True, before["dirty"])
    assert origin["commits"][0]["torch"] == before["torch"]
    monkeypatch.undo()
    alone = execute.run_unit(toy.unit(), tmp_path / "other").header
    assert [sitting["commit"] for sitting in alone["provenance"]["commits"]] == [before["commit"]]
    assert alone["parents"] == []


def test_a_unit_that_shares_a_seed_or_a_name_gets_its_own_record(tmp_path):
    units = [replace(toy.unit(), seeds=(100, 103)), replace(toy.unit(), seeds=(104, 105, 106, 107))]
    units.append(replace(units[1], precision="float64", published="float32"))
    found = execute.run(units, folder=tmp_path, progress=False)
    assert [record.path.name for record in found] == ["100+103.npz", "104-107.npz", "104-107.float64.npz"]
    assert [record.seeds for record in found] == [list(unit.seeds) for unit in units]
    assert [record.header["precision"] for record in found] == ["float32", "float32", "float64"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"precision": "float64"}, "another precision than"), ({"config": toy.Walk(steps=41)}, "another config than")],
)
def test_the_whole_identity_is_compared(tmp_path, changes, message):
    execute.run_unit(toy.unit(), tmp_path)
    with pytest.raises(RunError, match=message):
        execute.run_unit(replace(toy.unit(), **changes), tmp_path)


@pytest.mark.parametrize("seeds", [(), (1, 1), (-1, 0), (True,)])
def test_a_unit_needs_seeds_that_differ(seeds):
    with pytest.raises(RunError, match="seeds that differ"):
        replace(toy.unit(), seeds=seeds)


def test_numbers_from_numpy_make_the_same_unit(tmp_path):
    code = """
import sys, numpy as np, toy
from dataclasses import replace
from pathlib import Path
from dropout_uncertainty.runs import execute
theirs = replace(toy.unit(steps=np.int64(40)), seeds=np.arange(100, 102))
assert theirs.identity == toy.unit().identity
execute.run_unit(theirs, Path(sys.argv[1]))
"""  # without the type checks that tests have
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "theirs")], cwd=HERE, check=True)
    record = records.read(tmp_path / "theirs" / "toy" / "walk" / "100-101.npz")
    assert record.header["payload"] == execute.run_unit(toy.unit(), tmp_path).header["payload"]


def test_a_unit_that_does_not_fit_into_memory_is_refused_before_it_starts(tmp_path, monkeypatch):
    monkeypatch.setattr(unit, "free_memory", lambda device: 2e9)
    message = r"toy/walk/100-101 takes about 3\.0 GB of memory for 2 seeds, and 2\.0 GB are free: ask for fewer seeds"
    with pytest.raises(RunError, match=message):
        execute.run_unit(replace(toy.unit(), memory=3e9), tmp_path)
    assert execute.run_unit(replace(toy.unit(), memory=1e9), tmp_path).seeds == [100, 101]


def test_a_damaged_checkpoint_means_starting_again(tmp_path, checkpoint):
    checkpoint.write_bytes(checkpoint.read_bytes()[:-20])
    resumed = execute.run_unit(toy.unit(), tmp_path)
    assert resumed.header["payload"] == execute.run_unit(toy.unit(), tmp_path / "other").header["payload"]


@pytest.mark.parametrize("content", [{"state": {"finished": 3}}, {"other": 1}, {"state": np.float64(3.0)}])
def test_a_checkpoint_of_another_version_is_kept_and_named(tmp_path, checkpoint, content):
    checkpoints.save(checkpoint, content)
    before = checkpoint.read_bytes()
    with pytest.raises(RunError, match=r"\.pt is of a version that kept other things .*go on with that version"):
        execute.run_unit(toy.unit(), tmp_path)
    assert checkpoint.read_bytes() == before


class Holding(toy.RandomWalk):
    """A process whose state cannot be read again."""

    def state(self):
        return {**super().state(), "position": np.zeros(2)}


class Reading(toy.RandomWalk):
    """A process that needs a file that is not there."""

    def advance(self):
        return Path("nowhere", "data.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize(("kind", "message"), [(Holding, "cannot be read again: state"), (Reading, "nowhere")])
@pytest.mark.usefixtures("every_step")
def test_what_is_wrong_with_a_process_of_ones_own_is_said_at_once(tmp_path, kind, message):
    own = replace(toy.unit(), start=lambda config, seeds, **options: kind(config, seeds))
    with pytest.raises(RunError, match=message):
        execute.run_unit(own, tmp_path)


def test_a_unit_that_is_asked_for_twice_is_computed_once(tmp_path):
    with ThreadPoolExecutor(2) as pool:
        first, second = execute.run([toy.unit(), toy.unit()], executor=pool, folder=str(tmp_path), progress=False)
    assert first.path == second.path


def test_two_processes_do_not_compute_the_same_unit(tmp_path):
    process = child(tmp_path, "execute.run_unit(toy.unit(seconds=0.3), folder)")
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob(".partial/*.pt")) and time.monotonic() < deadline:
        time.sleep(0.02)
    with pytest.raises(RunError, match="another process is computing toy/walk/100-101"):
        execute.run_unit(toy.unit(seconds=0.3), tmp_path)
    process.kill()
    process.communicate()


def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (600, 600))"
    attempt = (
        "try:\n    execute.run_unit(toy.unit(), folder)\nexcept execute.RecordError as e:\n    raise SystemExit(str(e))"
    )
    body = f"{limit}\n{attempt}"
    process = child(tmp_path, body)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "cannot write" in errors.splitlines()[-1]
    assert not list(tmp_path.rglob("*.npz"))
    assert execute.run_unit(toy.unit(), tmp_path).arrays["path"].shape == (2, 40)


def test_an_output_folder_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RecordError, match="cannot write below"):
        execute.run_unit(toy.unit(), tmp_path / "file")


def test_a_record_of_another_config_is_not_passed_off(tmp_path):
    execute.run_unit(toy.unit(), tmp_path)
    with pytest.raises(RunError, match="another config"):
        execute.run_unit(toy.unit(steps=41), tmp_path)


@pytest.mark.parametrize("executor", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_any_executor_gives_the_same_records(tmp_path, executor):
    units = [replace(toy.unit(), seeds=(seed,)) for seed in (100, 101)]
    with executor(2) as pool:
        found = execute.run(units, executor=pool, folder=tmp_path, progress=False)
    together = execute.run_unit(toy.unit(), tmp_path)
    for replica, record in enumerate(found):
        np.testing.assert_array_equal(record.arrays["path"][0], together.arrays["path"][replica])


def test_records_made_on_another_disk_are_brought_here(tmp_path):
    class Elsewhere(ThreadPoolExecutor):
        def submit(self, function, unit, folder, **options):
            return super().submit(function, unit, tmp_path / "elsewhere", **options)

    units = [replace(toy.unit(), seeds=(seed,)) for seed in (100, 101)]
    execute.run_unit(units[0], tmp_path)
    with Elsewhere(1) as pool:
        found = execute.run(units, executor=pool, folder=tmp_path, progress=False)
    assert [record.path.parents[2] for record in found] == [tmp_path, tmp_path]
    assert [path.name for path in (tmp_path / "elsewhere").rglob("*.npz")] == ["101.npz"], "what is here is not sent"
    shutil.rmtree(tmp_path / "elsewhere")
    assert records.verify(tmp_path) == [(record.path, None) for record in found]


def test_devices_and_precisions():
    assert check_device("cpu") == "cpu"
    with pytest.raises(RunError, match="unknown device"):
        check_device("tpu")
    with pytest.raises(RunError, match="unknown precision"):
        precision_dtype("float16")
    if not torch.cuda.is_available():
        with pytest.raises(RunError, match="no CUDA GPU"):
            check_device("cuda")


def test_the_provenance_says_where_a_record_comes_from():
    origin = records.provenance()
    assert {"commit", "dirty", "torch", "processor", "date"} <= origin.keys()
    if os.path.isdir(HERE.parent / ".git"):
        assert len(origin["commit"]) == 40


def test_outside_a_clone_no_commit_is_named(monkeypatch):
    monkeypatch.setattr(folders, "checkout", lambda: None)  # git would find the repository around
    records._git.cache_clear()
    try:
        assert records.provenance()["commit"] is None
    finally:
        records._git.cache_clear()
