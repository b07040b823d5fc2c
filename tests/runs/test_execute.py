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
import toy

from dropout_uncertainty.runs import execute, records
from dropout_uncertainty.runs.execute import RunError
from dropout_uncertainty.runs.records import RecordError

HERE = Path(__file__).parent


@pytest.fixture
def every_step(monkeypatch):
    monkeypatch.setattr(execute, "CHECKPOINT_SECONDS", -1.0)


def child(folder, body):
    """Start a Python process that works on toy units, with a checkpoint after every step."""
    code = f"from pathlib import Path; import toy; from dropout_uncertainty import runs; folder = Path({str(folder)!r})"
    code += f"\nruns.CHECKPOINT_SECONDS = -1.0\n{body}"
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
        process = child(tmp_path / "killed", "runs.run_unit(toy.unit(seconds=0.02), folder)")
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


def test_a_damaged_checkpoint_means_starting_again(tmp_path, checkpoint):
    checkpoint.write_bytes(checkpoint.read_bytes()[:-20])
    resumed = execute.run_unit(toy.unit(), tmp_path)
    assert resumed.header["payload"] == execute.run_unit(toy.unit(), tmp_path / "other").header["payload"]


def test_two_processes_do_not_compute_the_same_unit(tmp_path):
    process = child(tmp_path, "runs.run_unit(toy.unit(seconds=0.3), folder)")
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob(".partial/*.pt")) and time.monotonic() < deadline:
        time.sleep(0.02)
    with pytest.raises(RunError, match="another process is computing toy/walk/100-101"):
        execute.run_unit(toy.unit(seconds=0.3), tmp_path)
    process.kill()
    process.communicate()


def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (600, 600))"
    attempt = "try:\n    runs.run_unit(toy.unit(), folder)\nexcept runs.RecordError as e:\n    raise SystemExit(str(e))"
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
        def submit(self, function, unit, folder):
            return super().submit(function, unit, tmp_path / "elsewhere")

    units = [replace(toy.unit(), seeds=(seed,)) for seed in (100, 101)]
    execute.run_unit(units[0], tmp_path)
    with Elsewhere(1) as pool:
        found = execute.run(units, executor=pool, folder=tmp_path, progress=False)
    assert [record.path.parents[2] for record in found] == [tmp_path, tmp_path]
    assert [path.name for path in (tmp_path / "elsewhere").rglob("*.npz")] == ["101.npz"], "what is here is not sent"
    shutil.rmtree(tmp_path / "elsewhere")
    assert records.verify(tmp_path) == [(record.path, None) for record in found]


def test_devices_and_precisions():
    assert execute.check_device("cpu") == "cpu"
    with pytest.raises(RunError, match="unknown device"):
        execute.check_device("tpu")
    with pytest.raises(RunError, match="unknown precision"):
        execute.precision_dtype("float16")
    if not execute.torch.cuda.is_available():
        with pytest.raises(RunError, match="no CUDA GPU"):
            execute.check_device("cuda")


def test_the_provenance_says_where_a_record_comes_from():
    origin = records.provenance()
    assert {"commit", "dirty", "torch", "processor", "date"} <= origin.keys()
    if os.path.isdir(HERE.parent / ".git"):
        assert len(origin["commit"]) == 40
