"""What can go wrong between a run and its record: nothing is lost, and nothing wrong is taken for right."""

import contextlib
import errno
import io
import json
import os
import signal
import subprocess
import sys
import warnings
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import toy
from hypothesis import given, settings
from hypothesis import strategies as st
from stored import ARRAYS, CONFIG, header, rewrite
from test_cli import command

from dropout_uncertainty.runs import checkpoints, execute, records
from dropout_uncertainty.runs.records import RecordError

HERE = Path(__file__).parents[1]
#: The same examples each time, and no folder for those that failed.
steady = settings(deadline=None, derandomize=True, database=None)


def child(folder, body):
    """Run a Python program with ``write``, ``folder``, ``path`` and what the tests of records write."""
    code = f"""
import os, signal
from pathlib import Path
from stored import ARRAYS, header
from dropout_uncertainty.runs import records
folder = Path({str(folder)!r})
path = folder / "toy" / "ours" / "a" / "100-101.npz"
def write(arrays=ARRAYS): return records.write(path, arrays, header())
def kill(*_, **__): os.kill(os.getpid(), signal.SIGKILL)
{body}"""
    return subprocess.run([sys.executable, "-c", code], cwd=HERE, capture_output=True, text=True, check=False)


def files(folder):
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


# --- two writers


def test_of_many_writers_one_wins_and_the_others_hear_of_it(tmp_path):
    path = tmp_path / "toy" / "ours" / "a" / "100-101.npz"

    def write(value):
        with contextlib.suppress(RecordError):
            return records.write(path, {"x": np.full(1000, value)}, header()).arrays["x"][0]

    with ThreadPoolExecutor(8) as pool:
        winners = {value for value in pool.map(write, range(8)) if value is not None}
    assert winners == {records.read(path).arrays["x"][0]}
    assert files(tmp_path) == ["100-101.npz"]


@pytest.mark.parametrize("same", [True, False])
def test_a_writer_that_comes_between(tmp_path, monkeypatch, same):
    path, fsync = tmp_path / "toy" / "ours" / "a" / "100-101.npz", os.fsync
    first = ARRAYS if same else {"x": np.ones(2)}

    def quicker(descriptor):
        monkeypatch.setattr(os, "fsync", fsync)
        records.write(path, first, header())
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", quicker)
    with contextlib.nullcontext() if same else pytest.raises(RecordError, match="already holds another result"):
        records.write(path, ARRAYS, header())
    assert records.read(path).header["payload"] == records.checksum(first)
    assert files(tmp_path) == ["100-101.npz"]


def test_a_disk_without_hard_links(tmp_path, monkeypatch):
    def link(*_):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", link)
    path = tmp_path / "toy" / "ours" / "a" / "100-101.npz"
    records.write(path, ARRAYS, header())
    with pytest.raises(RecordError):
        records.write(path, {"x": np.ones(2)}, header())
    assert records.read(path).header["payload"] == records.checksum(ARRAYS)


# --- kills


@pytest.mark.parametrize(
    ("moment", "survives"), [("os.fsync = kill", False), ("os.link = kill", False), ("Path.unlink = kill", True)]
)
def test_a_kill_during_a_write_leaves_all_or_nothing(tmp_path, moment, survives):
    outcome = child(tmp_path, f"{moment}\nwrite()")
    assert outcome.returncode == -signal.SIGKILL, outcome.stderr
    path = tmp_path / "toy" / "ours" / "a" / "100-101.npz"
    assert path.exists() == survives
    assert files(tmp_path) != ["100-101.npz"], "the child left nothing behind: this test tests nothing"
    assert [problem for _, problem in records.verify(tmp_path)] == [None] * survives
    assert len(records.find("toy", folder=tmp_path)) == survives
    records.write(path, ARRAYS, header())
    assert files(tmp_path) == ["100-101.npz"]


# --- full disks


def test_a_disk_that_fills_up_at_any_byte(tmp_path):
    body = """
import resource
size = write().path.stat().st_size
path.unlink()
for limit in [0, 1, size // 3, size // 2, size - 1]:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        write()
    except records.RecordError as error:
        print(error)
    assert not [*path.parent.iterdir()], limit
resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
write()
"""
    outcome = child(tmp_path, body)
    assert outcome.returncode == 0, outcome.stderr
    lines = outcome.stdout.splitlines()
    assert len(lines) == 5
    assert all("cannot write the record" in line and "is the disk full?" in line for line in lines)
    assert records.read(tmp_path / "toy" / "ours" / "a" / "100-101.npz").seeds == [100, 101]


def test_a_disk_that_fills_up_in_the_middle_of_a_run_keeps_the_last_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr(execute, "CHECKPOINT_SECONDS", -1.0)
    save = checkpoints.save

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    def first(path, content):
        save(path, content)
        monkeypatch.setattr(checkpoints, "save", full)

    with monkeypatch.context() as disk:
        disk.setattr(np, "savez_compressed", full)
        monkeypatch.setattr(checkpoints, "save", first)
        with pytest.raises(RecordError, match="No space left on device"):
            execute.run_unit(toy.unit(), tmp_path)
    monkeypatch.setattr(checkpoints, "save", save)
    resumed = execute.run_unit(toy.unit(), tmp_path)
    assert resumed.header["provenance"]["interruptions"] == 1
    assert resumed.header["payload"] == execute.run_unit(toy.unit(), tmp_path / "other").header["payload"]


# --- records from a newer version


def test_a_record_from_a_newer_version_is_neither_read_nor_replaced(tmp_path):
    record = execute.run_unit(toy.unit(), tmp_path)
    rewrite(record.path, schema=records.SCHEMA + 1, checksum=["of", "another", "kind"])
    content = record.path.read_bytes()
    message = "schema version 3, this program reads 2: use a version to match"
    for attempt in (
        lambda: records.read(record.path),
        lambda: records.find("toy", folder=tmp_path),
        lambda: execute.run_unit(toy.unit(), tmp_path),
        lambda: records.write(record.path, record.arrays, record.header),
    ):
        with pytest.raises(RecordError, match=message):
            attempt()
    assert record.path.read_bytes() == content
    outcome = command("records", "verify", env={**os.environ, "DROPOUT_UNCERTAINTY_RECORDS": str(tmp_path)})
    assert (outcome.returncode, message in outcome.stderr) == (1, True)


# --- fuzzing the reader


def content():
    """Return the bytes of a record."""
    buffer = io.BytesIO()
    full = {**header(), "schema": records.SCHEMA, "label": "toy/ours/a/100-101", "payload": records.checksum(ARRAYS)}
    full["checksum"] = records.header_checksum(full)
    text = np.frombuffer(json.dumps(full).encode(), np.uint8)
    np.savez_compressed(buffer, **{records.HEADER: text}, **ARRAYS)
    return buffer.getvalue()


WHOLE = content()


def check(folder, damaged):
    """Read the bytes as a record: a RecordError that names the file in one line, or exactly what was written."""
    path = folder / "100-101.npz"
    path.write_bytes(damaged)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of NumPy, about old headers
            record = records.read(path)
    except RecordError as error:
        sentence = str(error)
    else:
        sentence = None
    if sentence is not None:
        assert str(path) in sentence
        assert "\n" not in sentence
        return False
    assert records.checksum(record.arrays) == records.checksum(ARRAYS)
    assert {key: record.header[key] for key in header()} == header()
    return True


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("fuzzed") / "toy" / "ours" / "a"
    made.mkdir(parents=True)
    return made


def test_the_undamaged_bytes_are_read(folder):
    assert check(folder, WHOLE)


@steady
@given(junk=st.binary(max_size=300), keep=st.integers(0, len(WHOLE)))
def test_random_bytes(folder, junk, keep):
    assert not check(folder, junk)
    check(folder, WHOLE[:keep] + junk)
    check(folder, junk + WHOLE[keep:])
    check(folder, b"PK\x03\x04" + junk)
    check(folder, b"\x93NUMPY" + junk)


@steady
@given(size=st.integers(0, len(WHOLE) - 1))
def test_truncations(folder, size):
    assert not check(folder, WHOLE[:size])


@settings(steady, max_examples=400)
@given(flips=st.lists(st.integers(0, 8 * len(WHOLE) - 1), min_size=1, max_size=4))
def test_bit_flips(folder, flips):
    damaged = bytearray(WHOLE)
    for bit in flips:
        damaged[bit // 8] ^= 1 << bit % 8
    check(folder, bytes(damaged))


plain = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
anything = st.recursive(plain, lambda x: st.lists(x, max_size=3) | st.dictionaries(st.text(max_size=5), x, max_size=3))


@steady
@given(data=st.data(), whole=anything)
def test_headers_that_say_anything(folder, data, whole):
    """The container is sound, so nothing but the checks of the header stands between it and a reader."""
    with np.load(io.BytesIO(WHOLE)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    valid = json.loads(arrays.pop(records.HEADER).tobytes())
    key = data.draw(st.sampled_from([*records.REQUIRED]))
    for wrong in (whole, {**valid, key: whole}, {k: v for k, v in valid.items() if k != key}):
        buffer = io.BytesIO()
        np.savez(buffer, **{records.HEADER: np.frombuffer(json.dumps(wrong).encode(), np.uint8)}, **arrays)
        (folder / "100-101.npz").write_bytes(buffer.getvalue())
        with contextlib.suppress(RecordError):
            record = records.read(folder / "100-101.npz")
            assert all(isinstance(record.header[name], kind) for name, kind in records.REQUIRED.items())
            assert record.header["config"] == CONFIG


@steady
@given(name=st.sampled_from(["header.json.npy", "error.npy", "error", "more.npy"]), junk=st.binary(max_size=200))
def test_containers_that_hold_anything(folder, name, junk):
    buffer = io.BytesIO(WHOLE)
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "a") as archive:
        warnings.simplefilter("ignore")  # a name may be there twice
        archive.writestr(name, junk)
    assert not check(folder, buffer.getvalue())


@steady
@given(junk=st.binary(max_size=300), keep=st.integers(0, 400))
def test_damaged_checkpoints_are_not_continued(folder, junk, keep):
    path = folder / "checkpoint.pt"
    checkpoints.save(path, {"state": {"done": 3}})
    path.write_bytes(path.read_bytes()[:keep] + junk)
    assert execute._load(path) is None
