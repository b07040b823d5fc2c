"""The command line: what it prints, and one sentence with exit status 2 for a mistake."""

import json
import subprocess
import sys

import pytest

from dropout_uncertainty import cli
from dropout_uncertainty.errors import UserError


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
        (["run", "active-learning", "--config", "ours", "--seeds", "4-0"], "seeds are given like"),
        (["run", "active-learning", "--config", "ours", "--seeds", "0", "--device", "tpu"], "unknown device 'tpu'"),
        (["run", "active-learning", "--config", "ours", "--seeds", "0", "--precision", "half"], "unknown precision"),
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
    fields = {"id", "unit", "statistic", "thesis", "ours", "low", "high", "seeds", "config", "verdict", "records"}
    assert all(set(result) == fields for result in found)
    identifiers = [result["id"] for result in found]
    assert len(set(identifiers)) == len(identifiers)
    assert {"table-5.1/random", "table-5.2/dropout/bald", "table-5.1/random/minimum", "claim/AL1"} <= set(identifiers)


def test_a_broken_record_is_named(tmp_path):
    import os

    (tmp_path / "active_learning" / "ours" / "random").mkdir(parents=True)
    (tmp_path / "active_learning" / "ours" / "random" / "000.npz").write_bytes(b"not a record")
    environment = {**os.environ, "DROPOUT_UNCERTAINTY_RECORDS": str(tmp_path)}
    for arguments, status in ((["results"], 2), (["records", "verify"], 1)):
        outcome = command(*arguments, env=environment)
        assert outcome.returncode == status
        assert "000.npz cannot be read" in outcome.stderr


def test_seed_lists():
    assert cli.seed_list("0-2,7") == [0, 1, 2, 7]
    for bad in ("", "a", "-3", "3-1", "1,,2"):
        with pytest.raises(UserError):
            cli.seed_list(bad)
