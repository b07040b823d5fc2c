"""Ctrl-C, TERM and a closed terminal end a command within seconds, with one sentence and the usual exit status."""

import contextlib
import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

__all__ = ["GRACE", "Stopped", "hush_tracker", "one_sentence"]

#: Seconds that a command has to put its things away after a signal; then it is ended.
GRACE = 2.0
QUIET = "ignore::UserWarning:multiprocessing.resource_tracker"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Stopped(SystemExit):
    """A signal asked this process to end; the exit status is what a shell makes of that signal."""

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        self.number = number


def hush_tracker() -> None:
    """Let the standard library put away in silence what ended processes leave behind, the lock of a bar among it.

    Takes effect where its tracker has not been started yet.
    """
    if QUIET not in sys.warnoptions:
        sys.warnoptions.append(QUIET)


@contextlib.contextmanager
def one_sentence() -> Iterator[None]:
    """Answer signals that end a process by ``Stopped`` in the main thread, and say how to go on.

    The first signal counts, later ones are ignored. Where the main thread does not come to its end within ``GRACE``
    (it may be inside a long call of a library), the process ends without it: nothing depends on its last words, since
    checkpoints and records are written whole, locks are the system's, and workers end with their parent.
    """
    numbers = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]  # as nohup asks
    unsaid = threading.Lock()

    def end(number: int) -> None:
        if unsaid.acquire(blocking=False):
            print(f"\nstopped by {signal.Signals(number).name}; go on with: {_again()}", file=sys.stderr, flush=True)
            os._exit(128 + number)  # interpreters with PyTorch inside take their time to end

    def stop(number: int, _: object) -> None:
        for each in numbers:
            signal.signal(each, signal.SIG_IGN)
        raise Stopped(number)

    def end_at_last() -> None:
        while (number := os.read(arrived, 1)[0]) not in numbers:
            pass
        time.sleep(GRACE)
        end(number)

    hush_tracker()
    # the system writes the number of a signal here at once, whatever the main thread is doing
    arrived, noted = os.pipe()
    os.set_blocking(noted, False)
    signal.set_wakeup_fd(noted)
    for number in numbers:
        signal.signal(number, stop)
    threading.Thread(target=end_at_last, daemon=True).start()
    try:
        yield
    except Stopped as stopped:
        end(stopped.number)


def _again() -> str:
    """Return the command that started this process."""
    program = Path(sys.argv[0])
    start = ["python", "-m", "dropout_uncertainty"] if program.name == "__main__.py" else [str(program)]
    return shlex.join([*start, *sys.argv[1:]])
