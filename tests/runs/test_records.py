"""Records: what is written comes back, and what cannot be trusted is refused with a sentence."""

import io
import json
import zipfile
from dataclasses import dataclass, field

import numpy as np
import pytest

from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import RecordError

ARRAYS = {"error": np.arange(6, dtype=np.float32).reshape(2, 3), "points": np.array([[1, 2]], np.int32)}
CONFIG = {"rounds": 3, "drop": [0.25, 0.5]}


def header(**changes):
    return {
        "experiment": "toy", "name": "ours/a", "seeds": [100, 101], "config": CONFIG,
        "config_hash": records.config_hash(CONFIG), "device": "cpu", "precision": "float32",
        "provenance": {}, **changes,
    }  # fmt: skip


@pytest.fixture
def path(tmp_path):
    return records.write(tmp_path / "toy" / "ours" / "a" / "100-101.npz", ARRAYS, header()).path


def rewrite(path, **changes):
    """Write the file again with another header, as somebody who edits it by hand would."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    changed = json.loads(arrays.pop(records.HEADER).tobytes()) | changes
    np.savez(path, **{records.HEADER: np.frombuffer(json.dumps(changed).encode(), np.uint8)}, **arrays)


def test_what_is_written_comes_back(path, tmp_path):
    record = records.read(path)
    assert record.seeds == [100, 101]
    assert record.label == "toy/ours/a/100-101.npz"
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(record.arrays[name], array)
    assert [r.path for r in records.find("toy", CONFIG, folder=tmp_path)] == [path]
    assert records.find("toy", {"rounds": 4}, folder=tmp_path) == []
    assert not list(tmp_path.rglob(".*")), "a temporary file was left"


@dataclass(frozen=True)
class Inner:
    x: float = 1.0
    late: str | None = field(default=None, metadata={"before": None})


@dataclass(frozen=True)
class Grown:
    rounds: int = 3
    drop: tuple[float, float] = (0.25, 0.5)
    late: int = field(default=7, metadata={"before": 5})
    inner: tuple[Inner, ...] = ()


def test_a_config_may_grow_without_losing_its_records():
    as_before = Grown(late=5, inner=(Inner(),))
    assert records.config_dict(as_before) == {"rounds": 3, "drop": [0.25, 0.5], "inner": [{"x": 1.0}]}
    assert records.config_hash(as_before) == records.config_hash({**CONFIG, "inner": [{"x": 1.0}]})
    assert records.config_hash(Grown()) != records.config_hash(Grown(late=5))
    assert records.config_hash(Grown(inner=(Inner(late="a"),))) != records.config_hash(Grown(inner=(Inner(),)))
    assert records.config_diff(Grown(late=5), Grown()) == [("late", 5, 7)]
    assert records.config_diff(CONFIG | {"inner": []}, Grown()) == [("late", 5, 7)], "a stored config and one of today"
    assert records.config_diff(CONFIG | {"inner": []}, Grown(late=5)) == []


def test_seeds_with_a_record_are_not_missing_whatever_their_unit(path, tmp_path):
    assert records.missing_seeds("toy", "ours/a", CONFIG, range(99, 103), tmp_path) == [99, 102]
    assert records.missing_seeds("toy", "ours/a", {"rounds": 4}, (100, 101), tmp_path) == [100, 101]
    assert records.missing_seeds("toy", "ours/b", CONFIG, (100, 101), tmp_path) == [100, 101]


def test_a_record_is_never_replaced(path):
    before = path.read_bytes()
    records.write(path, ARRAYS, header())
    with pytest.raises(RecordError, match="already holds another result"):
        records.write(path, {"error": np.ones(2)}, header())
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": 99}, "schema version 99"),
        *(
            (change, "header of .* does not match its checksum")
            for change in (
                {"checksum": "0" * 64},
                {"config": {"rounds": 4}},
                {"seeds": [100, 102]},
                {"device": "cuda"},
                {"precision": "float64"},
                {"name": "ours/b"},
                {"provenance": {"commit": "f" * 40}},
                {"label": "a"},
                {"experiment": "chess"},
                {"extra": 1},
            )
        ),
        ({"payload": "0" * 64}, "arrays of .* do not match their checksum"),
    ],
)
def test_an_edited_record_is_refused(path, changes, message):
    rewrite(path, **changes)
    with pytest.raises(RecordError, match=message):
        records.read(path)


def test_changed_numbers_are_refused(path):
    with np.load(path) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    arrays["error"][0, 0] = 1.7
    np.savez(path, **arrays)
    with pytest.raises(RecordError, match="do not match their checksum"):
        records.read(path)


def test_damaged_bytes_never_pass_and_never_crash(path):
    content, generator = path.read_bytes(), np.random.default_rng(100)
    for trial in range(150):
        damaged = bytearray(content)
        if trial % 3 == 0:
            del damaged[int(generator.integers(len(content))) :]
        elif trial % 3 == 1:
            damaged[int(generator.integers(len(content)))] ^= 1 << int(generator.integers(8))
        else:
            damaged = bytearray(generator.bytes(200))
        path.write_bytes(damaged)
        try:
            record = records.read(path)
        except RecordError:
            continue
        # A flipped bit in an unused field of the container is harmless: then everything must be as written.
        assert records.checksum(record.arrays) == records.checksum(ARRAYS)
        assert record.header["config"] == CONFIG


def test_pickles_are_not_loaded(path):
    buffer = io.BytesIO()
    np.save(buffer, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.json.npy", buffer.getvalue())
    with pytest.raises(RecordError, match="cannot be read"):
        records.read(path)


def test_a_missing_record_and_an_unwritable_folder(tmp_path):
    with pytest.raises(RecordError, match="there is no record"):
        records.read(tmp_path / "none.npz")
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RecordError, match="cannot write the record"):
        records.write(tmp_path / "file" / "a.npz", ARRAYS, header())


def test_every_published_record_is_intact():
    assert [problem for _, problem in records.verify() if problem] == []
