"""Signals as users and systems send them: the command ends at once, with one sentence, and leaves nothing behind."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import nbformat
import psutil
import pytest
import toy
from jupyter_client.manager import start_new_kernel

from dropout_uncertainty.runs import execute
from dropout_uncertainty.runs.executors import processes
from dropout_uncertainty.runs.unit import RunError

HERE = Path(__file__).parent
#: The command line with an experiment of slow steps, and what Python does with signals (shells and nohup may ask to
#: ignore them).
PROGRAM = """
import signal, sys
from pathlib import Path
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
from dropout_uncertainty import cli
if __name__ == "__main__":
    import toy
    from dropout_uncertainty.page import book
    book._repository = lambda: Path.cwd()
    toy.CONFIGS["slow"] = toy.Walk(steps=300, seconds=0.2)
    cli.EXPERIMENTS["toy"] = ("toy",)
    toy.units = toy.one_by_one
    cli.main()
"""
#: Seconds that a person waits without wondering.
SOON = 3.0


@pytest.fixture
def command(tmp_path):
    """Return a function that starts the command line in a group of its own, as a terminal does."""
    (tmp_path / "program.py").write_text(PROGRAM)
    started = []

    def start(*arguments):
        environment = {
            **os.environ,
            "DROPOUT_UNCERTAINTY_RECORDS": str(tmp_path / "records"),
            "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path]),
        }
        process = subprocess.Popen(
            [sys.executable, "program.py", *arguments],
            cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


def wait_for(found, what):
    deadline = time.monotonic() + 100
    while not found():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def at_work(folder, count):
    """Wait until there are checkpoints of this many units."""
    wait_for(lambda: len(list(folder.glob("**/.partial/*.pt"))) >= count, "no checkpoint")


def end(process, number, *, group=True, again=False):
    """Send a signal and return the exit status and the last line of what was said; nothing may be left soon after."""
    below = psutil.Process(process.pid).children(recursive=True)
    send = os.killpg if group else os.kill
    begin = time.monotonic()
    send(process.pid, number)
    if again:
        send(process.pid, number)
    status = process.wait(SOON)
    psutil.wait_procs(below, SOON + begin - time.monotonic())
    assert not [p for p in below if p.is_running() and p.status() != psutil.STATUS_ZOMBIE]
    said = process.stderr.read()
    assert "Traceback" not in said
    assert "Warning" not in said
    return status, said.splitlines()[-1] if said else ""


ONE = ["run", "toy", "--config", "slow", "--seeds", "100"]
SIX = ["run", "toy", "--config", "slow", "--seeds", "100-105", "--workers", "2"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_one_worker(command, tmp_path, number):
    process = command(*ONE)
    at_work(tmp_path, 1)
    sentence = f"stopped by {number.name}; go on with: program.py {' '.join(ONE)}"
    assert end(process, number) == (128 + number, sentence)


@pytest.mark.parametrize("group", [True, False])
def test_workers_end_and_what_waits_is_not_begun(command, tmp_path, group):
    process = command(*SIX)
    at_work(tmp_path, 2)
    status, sentence = end(process, signal.SIGINT, group=group, again=True)
    assert (status, sentence.startswith("stopped by SIGINT; go on with: ")) == (130, True)
    assert len(list(tmp_path.glob("**/.partial/*.pt"))) == 2
    # nobody holds the units: the same command goes on
    process = command(*ONE)
    (checkpoint,) = tmp_path.glob("**/.partial/*slow--100*.pt")
    before = checkpoint.stat().st_mtime_ns
    wait_for(lambda: checkpoint.stat().st_mtime_ns > before or process.poll() is not None, "it does not go on")
    assert process.poll() is None, process.stderr.read()


def test_workers_end_with_a_parent_that_is_killed(command, tmp_path):
    process = command(*SIX)
    at_work(tmp_path, 2)
    assert end(process, signal.SIGKILL, group=False)[0] == -signal.SIGKILL


def test_a_main_thread_that_does_not_listen(command, tmp_path):
    """A library may be busy for minutes without coming back to Python."""
    (tmp_path / "program.py").write_text(
        "import ctypes, sys\nfrom dropout_uncertainty import stopping\n"
        "with stopping.one_sentence():\n    print('ready', file=sys.stderr, flush=True)\n"
        "    while True: ctypes.CDLL(None).sleep(60)\n"
    )
    process = command()
    assert process.stderr.readline() == "ready\n"
    # ctypes comes back early where a signal interrupts the call, and calls again before Python looks
    status, sentence = end(process, signal.SIGTERM)
    assert (status, sentence) == (143, "stopped by SIGTERM; go on with: program.py")


def test_nohup_is_respected(command, tmp_path):
    (tmp_path / "program.py").write_text(
        "import signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from dropout_uncertainty import stopping\nwith stopping.one_sentence():\n"
        "    signal.raise_signal(signal.SIGHUP)\n"
    )
    assert command().wait(60) == 0


def failing(config, seeds, **options):
    if seeds == (101,):
        raise RuntimeError("this one fails")
    return toy.start(config, seeds, **options)


def test_a_unit_that_fails_is_reported_while_others_run(tmp_path):
    units = [replace(toy.unit(seconds=1.0), start=failing, seeds=(seed,)) for seed in (100, 101, 102)]
    with processes(2) as pool:
        assert pool.submit(os.getpid).result()  # the first worker is there
        begin = time.monotonic()
        with pytest.raises(RuntimeError, match="this one fails"), pool:
            execute.run(units, executor=pool, folder=tmp_path, progress=False)
    assert time.monotonic() - begin < 35, "the others need 40 seconds"
    assert not list(tmp_path.rglob("*.npz"))


def vanish():
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_worker_that_dies_is_one_sentence(tmp_path):
    with pytest.raises(RunError, match="a worker process died"), processes(1) as pool:
        execute.run([replace(toy.unit(), start=lambda *_, **__: vanish())], executor=_Vanishing(pool), folder=tmp_path)


class _Vanishing(ProcessPoolExecutor):
    """An executor whose workers are killed."""

    def __init__(self, pool):
        self.pool = pool

    def submit(self, *_, **__):
        return self.pool.submit(vanish)


NOTEBOOK = """
import toy
from pathlib import Path
from dropout_uncertainty.runs import execute, executors
toy.CONFIGS["slow"] = toy.Walk(steps=300, seconds=0.2)
with executors.processes(2) as executor:
    execute.run(toy.one_by_one("slow", range(100, 106)), executor=executor, folder=Path("../kernel"))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_notebook_leaves_neither_kernel_nor_workers(command, tmp_path, number):
    for folder in ("notebooks", "records"):
        (tmp_path / folder).mkdir()
    cells = [nbformat.v4.new_code_cell("profile = 'recorded'", metadata={"tags": ["parameters"]})]
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    page = nbformat.v4.new_notebook(cells=[*cells, nbformat.v4.new_code_cell(NOTEBOOK)], metadata=kernel)
    nbformat.write(page, tmp_path / "notebooks" / "one.ipynb")
    process = command("notebooks")
    at_work(tmp_path / "kernel", 2)
    status, sentence = end(process, number, group=number == signal.SIGINT)
    if number == signal.SIGINT:
        assert (status, sentence) == (130, "stopped by SIGINT; go on with: program.py notebooks")


def test_a_stopped_cell_leaves_no_worker_and_the_kernel_goes_on(tmp_path):
    manager, client = start_new_kernel(cwd=tmp_path, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    try:
        asked = client.execute(NOTEBOOK.replace("../kernel", "kernel"))
        at_work(tmp_path, 2)
        below = psutil.Process(manager.provisioner.pid).children()
        workers = [process for process in below if "spawn_main" in " ".join(process.cmdline())]
        assert len(workers) == 2
        manager.interrupt_kernel()  # the stop button of JupyterLab
        while (reply := client.get_shell_msg(timeout=2 * SOON))["parent_header"]["msg_id"] != asked:
            pass  # the answer to something asked before
        assert reply["content"]["ename"] == "KeyboardInterrupt"
        assert psutil.wait_procs(workers, SOON)[1] == []
        assert client.execute("1", reply=True, timeout=2 * SOON)["content"]["status"] == "ok"
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
