"""Units on a Dask cluster of separate worker processes: same records, and a lost worker loses nothing."""

import os
import signal
import socket
import threading
import time
from dataclasses import replace

import distributed
import pytest
import toy
from test_cli import command

from dropout_uncertainty import runs
from dropout_uncertainty.runs import RunError


@pytest.fixture
def scheduler():
    """Start a cluster of two worker processes and return the address of its scheduler."""
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
    units = [toy.unit(seconds=0.1), replace(toy.unit(), name="short", seeds=(102,))]
    killed = []
    killer = threading.Thread(target=kill_the_worker_at, args=(tmp_path, scheduler, killed))
    killer.start()
    with runs.cluster(scheduler) as executor:
        found = runs.run(units[:1], executor=executor, folder=tmp_path, progress=False)
        killer.join()
        found += runs.run(units[1:], executor=executor, folder=tmp_path, progress=False)
    assert len(killed) == 1
    assert found[0].header["provenance"]["interruptions"] == 1
    for unit, record in zip(units, found, strict=True):
        assert record.header["checksum"] == runs.run_unit(unit, tmp_path / "here").header["checksum"]
    assert not list(tmp_path.glob(".partial/*.pt"))


def test_a_scheduler_that_is_not_there_is_one_sentence(nowhere):
    outcome = command("run", "exploration", "--config", "narrow", "--seeds", "100", "--scheduler", nowhere)
    assert outcome.returncode == 2
    assert outcome.stderr.strip().splitlines() == [
        f"error: no Dask scheduler answers at {nowhere}: is it running, and is the address right?"
    ]


@pytest.mark.parametrize("address", ["tcp://", "host", "ftp://host:1"])
def test_an_address_that_is_none(address, monkeypatch):
    monkeypatch.setattr(runs, "CONNECT_SECONDS", 0.5)
    with pytest.raises(RunError, match=f"no Dask scheduler answers at {address}"), runs.cluster(address):
        pass


def test_workers_of_two_kinds_are_refused():
    outcome = command(
        "run", "exploration", "--config", "narrow", "--seeds", "100", "--workers", "2", "--scheduler", "tcp://x:1"
    )
    assert outcome.returncode == 2
    assert "choose one" in outcome.stderr
