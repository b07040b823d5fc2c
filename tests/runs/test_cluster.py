"""Units on a Dask cluster of separate worker processes: same records, and a lost worker loses nothing."""

import gc
import os
import signal
import socket
import threading
import time

import distributed
import pytest
import toy
from test_cli import command
from typer.testing import CliRunner

from dropout_uncertainty import cli
from dropout_uncertainty.runs import execute, executors, records
from dropout_uncertainty.runs.executors import cluster
from dropout_uncertainty.runs.unit import RunError


@pytest.fixture
def scheduler(tmp_path, monkeypatch):
    """Start a cluster of two worker processes with records of their own and return the address of its scheduler."""
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_RECORDS", str(tmp_path / "workers"))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as local:
        with distributed.Client(local.scheduler_address, set_as_default=False) as client:
            client.run(toy.checkpoint_often)
        yield local.scheduler_address


@pytest.fixture
def nowhere():
    """Return an address at which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


def kill_the_worker_at(folder, scheduler, killed):
    """Kill the process that computes the first unit of which there is a checkpoint, and note its number."""
    with distributed.Client(scheduler, set_as_default=False) as client:
        deadline = time.monotonic() + 60
        while not list(folder.glob(".partial/*.pt")) and time.monotonic() < deadline:
            time.sleep(0.02)
        busy = next(worker for worker, tasks in client.processing().items() if tasks)
        killed.append(client.run(os.getpid, workers=[busy])[busy])
        os.kill(killed[0], signal.SIGKILL)


def test_a_worker_killed_in_the_middle_of_a_unit_loses_nothing(tmp_path, scheduler):
    unit, killed = toy.unit(seconds=0.1), []
    killer = threading.Thread(target=kill_the_worker_at, args=(tmp_path, scheduler, killed))
    killer.start()
    with cluster(scheduler) as executor:
        (found,) = execute.run([unit], executor=executor, folder=tmp_path, progress=False)
        killer.join()
    assert len(killed) == 1
    assert found.header["provenance"]["interruptions"] == 1
    assert found.header["payload"] == execute.run_unit(unit, tmp_path / "alone").header["payload"]
    assert not list(tmp_path.glob(".partial/*.pt"))


def test_the_command_leaves_records_here_though_workers_have_disks_of_their_own(tmp_path, scheduler, monkeypatch):
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_RECORDS", str(tmp_path / "here"))
    monkeypatch.setitem(cli.EXPERIMENTS, "toy", ("toy",))
    outcome = CliRunner().invoke(
        cli.app, ["run", "toy", "--config", "long", "--seeds", "100-101", "--scheduler", scheduler]
    )
    assert outcome.exit_code == 0, outcome.output
    path = tmp_path / "here" / "toy" / "long" / "100-101.npz"
    assert str(path) in outcome.output
    (unit,) = toy.units("long", (100, 101))
    assert records.read(path).header["payload"] == execute.run_unit(unit, tmp_path / "alone").header["payload"]
    assert (tmp_path / "workers" / "toy" / "long" / "100-101.npz").exists()


def test_a_scheduler_that_is_not_there_is_one_sentence(nowhere):
    outcome = command("run", "exploration", "--config", "narrow", "--seeds", "100", "--scheduler", nowhere)
    assert outcome.returncode == 2
    assert outcome.stderr.strip().splitlines() == [
        f"error: no Dask scheduler answers at {nowhere}: is it running, and is the address right?"
    ]


@pytest.mark.parametrize("address", ["tcp://", "host", "ftp://host:1", "tls://127.0.0.1:1", "inproc://1", "ucx://x:1"])
@pytest.mark.filterwarnings("error")  # also what a client says when it is deleted
def test_an_address_that_is_none(address, monkeypatch):
    monkeypatch.setattr(executors, "CONNECT_SECONDS", 0.5)
    with pytest.raises(RunError, match=f"no Dask scheduler answers at {address}") as refused, cluster(address):
        pass
    assert ("certificates" in str(refused.value)) == address.startswith("tls")
    del refused
    gc.collect()


def test_workers_of_two_kinds_are_refused():
    outcome = command(
        "run", "exploration", "--config", "narrow", "--seeds", "100", "--workers", "2", "--scheduler", "tcp://x:1"
    )
    assert outcome.returncode == 2
    assert "choose one" in outcome.stderr
