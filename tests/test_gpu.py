"""The prepared run on a GPU, tried on a CPU at the least size."""

import json
import time

import pytest
import toy
from typer.testing import CliRunner

from dropout_uncertainty import cli, gpu
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import execute, records
from dropout_uncertainty.runs.unit import RunError


def states(report):
    return {name: part["state"] for name, part in report["parts"].items()}


@pytest.mark.slow
def test_every_part_is_done_once(tmp_path, capsys, monkeypatch):
    (empty := tmp_path / "none").mkdir()  # where everything is missing
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_RECORDS", str(empty))
    first = gpu.run(tmp_path, 600.0, device="cpu", tiny=True, workers=1)
    assert states(first) == dict.fromkeys(("bits", "pools", "tables", "deep-pilco", "pilco", "kernels"), "done")
    assert list(first["parts"]["bits"]["equal"].values()) == [True] * len(gpu.KERNELS)
    assert all(row["seconds"] > 0 for row in first["parts"]["kernels"]["steps"])
    assert json.loads((tmp_path / gpu.REPORT).read_text()) == first
    made = [name for part in first["parts"].values() for name in part.get("records", ())]
    assert len(made) == 6
    assert first["bytes"] == sum((tmp_path / name).stat().st_size for name in made)
    assert [problem for _, problem in records.verify(tmp_path)] == [None] * 6
    written = {name: (tmp_path / name).stat().st_mtime_ns for name in made}
    again = gpu.run(tmp_path, 600.0, device="cpu", tiny=True, workers=1)
    assert states(again) == states(first)
    assert {name: (tmp_path / name).stat().st_mtime_ns for name in made} == written
    assert "kernels: done after" in capsys.readouterr().out


def test_a_file_is_no_folder_for_records(tmp_path):
    (tmp_path / "lent").touch()
    with pytest.raises(UserError, match="cannot make the folder"):
        gpu.run(tmp_path / "lent", 0.0, device="cpu", tiny=True)


def test_without_time_nothing_begins(tmp_path):
    assert set(states(gpu.run(tmp_path, 0.0, device="cpu", tiny=True)).values()) == {"not begun"}


def test_a_part_that_fails_does_not_keep_the_next_from_its_turn(tmp_path, monkeypatch):
    def broken(*_, **__):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(gpu, "KERNELS", {})
    monkeypatch.setattr(execute, "run", broken)
    result = CliRunner().invoke(cli.app, ["gpu", "--tiny", "--out", str(tmp_path), "--workers", "1"])
    assert result.exit_code == 1
    report = json.loads((tmp_path / gpu.REPORT).read_text())
    assert report["parts"]["pools"]["error"] == "RuntimeError: out of memory"
    assert states(report) == {
        "bits": "done", "pools": "failed", "tables": "failed", "deep-pilco": "failed", "pilco": "failed",
        "kernels": "done",
    }  # fmt: skip


def test_a_run_that_is_out_of_time_goes_on_where_it_stopped(tmp_path):
    slow = toy.unit(seconds=0.02)
    expected = execute.run_unit(slow, tmp_path / "whole").header["payload"]
    with pytest.raises(execute.OutOfTime, match="after 0 of 40 steps"):
        execute.run_unit(slow, tmp_path / "late", until=0.0)
    with pytest.raises(RunError, match=r"after [1-9]\d? of 40 steps"):
        execute.run([slow], folder=tmp_path / "late", progress=False, until=time.time() + 0.1)
    assert execute.run_unit(slow, tmp_path / "late").header["payload"] == expected
