"""The command line: what it prints, and one sentence with exit status 2 for a mistake."""

import json
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from dropout_uncertainty import cli
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_hash


def command(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "dropout_uncertainty", *arguments],
        capture_output=True,
        text=True,
        check=False,
        **options,
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "chess", "--config", "ours", "--seeds", "0"], "unknown experiment 'chess'"),
        (["run", "active-learning", "--config", "mine", "--seeds", "0"], "unknown config 'mine'"),
        (["run", "exploration", "--config", "quick/ours-thomson", "--seeds", "0"], "did you mean quick/ours-thompson?"),
        (["run", "active-learning", "--config", "ours", "--seeds", "4-0"], "seeds are given like"),
        (["run", "active-learning", "--config", "ours", "--seeds", "0", "--device", "tpu"], "unknown device 'tpu'"),
        (["run", "active-learning", "--config", "ours", "--seeds", "0", "--precision", "half"], "unknown precision"),
        (["run", "exploration", "--config", "wide", "--seeds", "100", "--precision", "bfloat16"], "float32 or float64"),
        (["run", "data-efficiency", "--config", "pilco-paper", "--seeds", "100", "--precision", "float32"], "runs in"),
        (["run", "exploration", "--config", "wide", "--seeds", "0-99999999999"], "at most 100,000 seeds"),
        (["run", "exploration", "--config", "wide", "--seeds", "0-999999999999999999"], "at most 100,000 seeds"),
        (["run", "exploration", "--config", "wide", "--seeds", 5000 * "9"], "seeds are given like"),
        (["book", "--profile", "fast"], "unknown profile 'fast'"),
    ],
)
def test_a_mistake_is_one_sentence(arguments, message):
    outcome = command(*arguments)
    assert outcome.returncode == 2
    assert message in outcome.stderr
    assert "Traceback" not in outcome.stderr
    assert len(outcome.stderr.strip().splitlines()) == 1


def test_results_are_json_with_the_agreed_fields():
    outcome = command("results", "--json")
    assert outcome.returncode == 0, outcome.stderr
    found = json.loads(outcome.stdout)
    fields = {"id", "unit", "statistic", "thesis", "ours", "low", "high", "seeds", "config", "verdict", "records", "n"}
    assert all(set(result) >= fields for result in found)
    more = {"kind", "primary", "plain", "margin"}
    assert all(set(result) >= fields | more for result in found if result["id"].startswith("statement/"))
    identifiers = [result["id"] for result in found]
    assert len(set(identifiers)) == len(identifiers)
    assert {"table-5.1/random", "table-5.2/dropout/bald", "table-5.1/random/minimum", "statement/AL1a"} <= set(
        identifiers
    )
    lines = dict(line.split(": ", 1) for line in command("results").stdout.splitlines())
    assert all(f"; {result['n']} repetitions)" in lines[result["id"]] for result in found)
    assert all(len(set(result["seeds"])) == len(result["seeds"]) for result in found)
    pairs = {result["id"]: result["n"] for result in found}
    assert (pairs["two-by-two/contrast/acting"], pairs["ends/naf/terminal/difference"]) == (20, 5)


def test_a_broken_record_is_named(tmp_path):
    import os

    (tmp_path / "active_learning" / "ours" / "random").mkdir(parents=True)
    (tmp_path / "active_learning" / "ours" / "random" / "000.npz").write_bytes(b"not a record")
    environment = {**os.environ, "DROPOUT_UNCERTAINTY_RECORDS": str(tmp_path)}
    for arguments, status in ((["results"], 2), (["records", "verify"], 1)):
        outcome = command(*arguments, env=environment)
        assert outcome.returncode == status
        assert "000.npz cannot be read" in outcome.stderr


def test_a_bug_shows_where_it_is(monkeypatch):
    def broken():
        raise ValueError("a bug")

    monkeypatch.setattr(cli, "app", broken)
    with pytest.raises(ValueError, match="a bug"):
        cli.main()


def test_records_without_provenance_are_listed(tmp_path, monkeypatch):
    header = {
        "experiment": "toy", "name": "walk", "seeds": [100], "config": {}, "config_hash": config_hash({}),
        "device": "cpu", "precision": "float32", "provenance": {},
    }  # fmt: skip
    path = records.write(tmp_path / "toy" / "walk" / "100.npz", {"x": np.zeros(1)}, header).path
    path.with_name("100 (copy).npz").write_bytes(path.read_bytes())
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_RECORDS", str(tmp_path))
    listed = CliRunner().invoke(cli.app, ["records", "list"], catch_exceptions=False)
    assert "toy/walk/100.npz  time unknown  unknown  unknown" in listed.output
    verified = CliRunner().invoke(cli.app, ["records", "verify"])
    assert verified.exit_code == 1
    assert "1 of 2 records are intact" in verified.output
    assert "give it back its name, or delete it if a copy" in verified.output


def test_another_precision_is_computed_beside_a_record(tmp_path, monkeypatch):
    monkeypatch.setitem(cli.EXPERIMENTS, "toy", ("toy",))
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_RECORDS", str(tmp_path))
    run = ["run", "toy", "--config", "walk", "--seeds", "100-101"]
    names = []
    for options in ([], ["--precision", "float64"], ["--precision", "float64"], []):
        outcome = CliRunner().invoke(cli.app, [*run, *options], catch_exceptions=False)
        names.append("nothing" if "Nothing to do" in outcome.output else outcome.output.split("/")[-1].strip())
    assert names == ["100-101.npz", "100-101.float64.npz", "nothing", "nothing"]


def test_seed_lists():
    assert cli.seed_list("0-2,7") == [0, 1, 2, 7]
    for bad in ("", "a", "-3", "3-1", "1,,2"):
        with pytest.raises(UserError):
            cli.seed_list(bad)


def test_a_run_for_a_gpu_without_one_says_how_to_try_it(tmp_path, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    outcome = CliRunner().invoke(cli.app, ["gpu", "--out", str(tmp_path)])
    assert isinstance(outcome.exception, UserError)
    assert "--tiny tries everything without one" in str(outcome.exception)
    assert not list(tmp_path.iterdir())
