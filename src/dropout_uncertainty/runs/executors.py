"""Executors of units: processes of this machine, which end with their parent, and the workers of a Dask cluster."""

import asyncio
import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from typing import Any

import torch
from tqdm.auto import tqdm

from dropout_uncertainty.runs.unit import RunError
from dropout_uncertainty.stopping import hush_tracker

__all__ = ["cluster", "processes"]

#: Seconds to wait for a scheduler's answer.
CONNECT_SECONDS = 5.0


def processes(workers: int | None = None) -> ProcessPoolExecutor:
    """Return an executor of single-threaded processes, by default one per core; use it as a context.

    An exception that leaves the context ends them at once, and so does the end of this process, whatever its cause.
    """
    hush_tracker()
    # Spawned, because a fork of a process that has started threads can hang.
    return _Processes(workers or os.cpu_count(), multiprocessing.get_context("spawn"), initializer=_become_worker)


class _Processes(ProcessPoolExecutor):
    def submit(self, *args: Any, **options: Any) -> Future:
        # Ctrl-C reaches every process of a terminal but is this one's to answer; those started here inherit the mask.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(*args, **options)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            for worker in list((self._processes or {}).values()):  # Python 3.14 has kill_workers() for this
                worker.kill()
        self.shutdown(cancel_futures=kind is not None)


def _become_worker() -> None:
    """Make a process that has just been started compute on one thread, and end when its parent does."""
    torch.set_num_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Give an executor that sends units to the workers of a Dask cluster with a scheduler at ``address``.

    A unit whose worker is lost goes to another one, which continues from the checkpoint if it shares the disk.

    Raises:
        RunError: if dask.distributed is not installed, no scheduler answers, it goes away, or a unit loses its workers
            again and again.
    """
    try:
        import distributed
    except ImportError:
        raise RunError("a Dask cluster needs the package distributed: `pip install 'distributed>=2024.8'`") from None
    try:
        asyncio.run(_greet(address))  # a client that cannot even begin complains when it is deleted
        client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        encrypted = address.startswith(("tls:", "wss:"))
        hint = " Do Dask's settings name its certificates (distributed.comm.tls)?" if encrypted else ""
        raise RunError(
            f"no Dask scheduler answers at {address}: is it running, and is the address right?{hint}"
        ) from error
    with client:
        if not client.nthreads():
            tqdm.write(f"the scheduler at {address} has no workers yet: units wait for one")
        try:
            # Not pure: a unit that failed is tried again when it is asked for again.
            yield client.get_executor(pure=False)
        except distributed.KilledWorker as error:
            raise RunError(f"workers died again and again of one unit; is their memory enough? {error}") from error
        except CancelledError:
            raise RunError(f"the scheduler at {address} is gone; the same command continues with another") from None


async def _greet(address: str) -> None:
    """Connect to a scheduler and go; raises OSError, ValueError or TypeError where that cannot be done."""
    import distributed

    secrets = distributed.Security().get_connection_args("client")
    await (await distributed.comm.connect(address, timeout=CONNECT_SECONDS, **secrets)).close()
