#!/usr/bin/env bash
# distributed 2026.8.0: `shutdown(wait=False)` calls work cancelled that is carried out to its end.
#
# Guess: `client.get_executor()` follows `concurrent.futures`: shutdown without waiting returns at
#   once, work that has begun is finished and its future gives the result, as with a process pool.
# Seen: the future of the task that is running raises CancelledError and its result is lost, yet the
#   function itself runs on to its last line and leaves its file behind. Code that runs a task again
#   because its future was cancelled runs it twice.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile distributed==2026.8.0 dask==2026.8.0
cd "$folder"
cat > compare.py <<'END'
import concurrent.futures
import pathlib
import tempfile
import time

from distributed import Client, LocalCluster


def work(folder):
    (folder / "begun").touch()
    time.sleep(3)
    (folder / "finished").touch()
    return 42


def wait_for(file, seconds=60):
    end = time.monotonic() + seconds
    while not file.exists() and time.monotonic() < end:
        time.sleep(0.05)
    return file.exists()


def outcome(executor):
    folder = pathlib.Path(tempfile.mkdtemp(dir="."))
    future = executor.submit(work, folder.resolve())
    if not wait_for(folder / "begun"):
        raise SystemExit("the work never began")
    executor.shutdown(wait=False)
    try:
        result = future.result(timeout=60)
    except concurrent.futures.CancelledError:
        result = "cancelled"
    except Exception as error:
        result = "cancelled" if "Cancelled" in type(error).__name__ else repr(error)
    return result, wait_for(folder / "finished", 15)


if __name__ == "__main__":
    pool = outcome(concurrent.futures.ProcessPoolExecutor(1))
    options = dict(n_workers=1, threads_per_worker=1, dashboard_address=None)
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        dask = outcome(client.get_executor())
    print(f"process pool: result {pool[0]}, finished {pool[1]}")
    print(f"Dask:         result {dask[0]}, finished {dask[1]}")
    raise SystemExit(0 if pool == (42, True) and dask == ("cancelled", True) else 1)
END
"$folder/venv/bin/python" compare.py
