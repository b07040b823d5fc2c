"""Records: what is written comes back, and what cannot be trusted is refused with a sentence."""

import errno
import io
import os
import shutil
import zipfile

import numpy as np
import pytest
from stored import ARRAYS, CONFIG, header, rewrite

from dropout_uncertainty import cli
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import RecordError
from dropout_uncertainty.runs.unit import differing
from dropout_uncertainty.settings import config_hash


@pytest.fixture
def path(tmp_path):
    return records.write(tmp_path / "toy" / "ours" / "a" / "100-101.npz", ARRAYS, header()).path


def test_what_is_written_comes_back(path, tmp_path):
    record = records.read(path)
    assert record.seeds == [100, 101]
    assert record.label == "toy/ours/a/100-101.npz"
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(record.arrays[name], array)
    assert [r.path for r in records.find("toy", CONFIG, folder=tmp_path)] == [path]
    assert records.find("toy", {"rounds": 4}, folder=tmp_path) == []
    assert not list(tmp_path.rglob(".*")), "a temporary file was left"


def test_a_file_is_read_once_as_long_as_it_is_the_same(path, tmp_path):
    (first,), (second,) = (records.find("toy", folder=tmp_path) for _ in range(2))
    for name, array in first.arrays.items():
        assert array is second.arrays[name]
        assert not array.flags.writeable
    second.header["seeds"].append(102)
    second.arrays.clear()
    (third,) = records.find("toy", folder=tmp_path)
    assert (third.seeds, third.arrays.keys()) == ([100, 101], ARRAYS.keys()), "what a reader changes is its own"
    path.write_bytes(b"damaged")
    with pytest.raises(RecordError, match="cannot be read"):
        records.find("toy", folder=tmp_path)


def test_seeds_with_a_record_are_not_missing_whatever_their_unit(path, tmp_path):
    assert records.missing_seeds("toy", "ours/a", CONFIG, range(99, 103), tmp_path) == [99, 102]
    assert records.missing_seeds("toy", "ours/a", {"rounds": 4}, (100, 101), tmp_path) == [100, 101]
    assert records.missing_seeds("toy", "ours/b", CONFIG, (100, 101), tmp_path) == [100, 101]


def stored(folder, seeds, config=CONFIG, name="ours/a", **changes):
    """Write a record under the name that its header asks for."""
    full = header(seeds=list(seeds), name=name, config=config, config_hash=config_hash(config), **changes)
    precision = full["precision"] if full["precision"] != "float32" else None
    file = f"{records.file_name(seeds, full['device'], precision)}.npz"
    return records.write(folder / "toy" / name / file, {"x": np.array(seeds, float)}, full)


def test_names_of_files_say_which_seeds_precision_and_device():
    names = {
        (7,): "007", tuple(range(10)): "000-009", (100, 103): "100+103", (100, 101, 102, 103): "100-103",
        (0, 1, 2, 5): "000-002+005", (103, 100): "103+100", (1500,): "1500",
    }  # fmt: skip
    assert {seeds: records.file_name(seeds, "cpu") for seeds in names} == names
    assert records.file_name((1, 2), "cuda", "float64") == "001-002.float64.cuda"
    odd, other = (records.file_name(range(start, 101, 2), "cpu") for start in (1, 3))
    assert odd.startswith("001-099+")
    assert len(odd) < records.LONGEST
    assert records.file_name([*range(1, 90, 2), 92, *range(93, 101, 2)], "cpu") != odd
    assert other != odd


def test_a_copy_or_a_record_in_the_wrong_place_is_refused(path, tmp_path):
    for copy in (
        path.with_name("100-101 (copy).npz"), path.with_name("100.npz"), path.with_name("100-101.cuda.npz"),
        path.parents[1] / "b" / path.name, tmp_path / "toy" / "x" / "toy" / "ours" / "a" / path.name,
    ):  # fmt: skip
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
        with pytest.raises(RecordError, match=r"is the record toy/ours/a/100-101\.npz: give it back its name"):
            records.find("toy", folder=tmp_path)
        assert [problem is None for _, problem in sorted(records.verify(tmp_path), key=lambda x: x[0] != path)] == [
            True, False,
        ]  # fmt: skip
        copy.unlink()
    assert len(records.find("toy", folder=tmp_path)) == 1


@pytest.mark.parametrize("moved", ["toy", "toy/ours", "toy/ours/a"])
def test_a_folder_that_is_a_link_to_another_disk(path, tmp_path, moved):
    folder, disk = tmp_path / moved, tmp_path.with_name(f"{tmp_path.name}-disk")
    shutil.move(folder, disk)
    folder.symlink_to(disk)
    (disk / "round").symlink_to(disk)  # has no end
    assert records.verify(tmp_path) == [(path, None)]
    for name in (None, "ours/a"):
        assert [record.path for record in records.find("toy", name=name, folder=tmp_path)] == [path]


def test_a_folder_that_cannot_be_looked_into_is_not_an_empty_one(path, tmp_path, monkeypatch):
    def refuse(folder):
        raise PermissionError(errno.EACCES, "Permission denied", str(folder))

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.raises(RecordError, match=r"cannot look for records in .* \(Permission denied\)"):
        records.find("toy", folder=tmp_path)


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ({"seeds": [101]}, "both hold the seeds 101: move one of them"),
        ({"seeds": [101, 102]}, "both hold the seeds 101"),
        ({"seeds": [101, 102], "device": "cuda"}, "both hold the seeds 101"),
        ({"seeds": [102], "config": {"rounds": 4}}, r"configs that differ \(rounds, drop\)"),
    ],
)
def test_no_seed_counts_twice_and_no_two_configs_share_a_name(path, tmp_path, second, message):
    other = stored(tmp_path, **second).path
    with pytest.raises(RecordError, match=message) as error:
        records.find("toy", name="ours/a", folder=tmp_path)
    assert str(path) in str(error.value)
    assert str(other) in str(error.value)
    assert [problem for _, problem in records.verify(tmp_path) if problem] == [str(error.value)]


def test_of_two_devices_and_precisions_one_counts(path, tmp_path):
    """The section's precision; of records that both hold all seeds of one, that of the CPU, or the larger one."""
    gpu = stored(tmp_path, [100, 101], device="cuda").path
    exact = stored(tmp_path, [100], precision="float64").path

    def found(**which):
        return [record.path for record in records.find("toy", folder=tmp_path, **which)]

    assert found() == [path]
    assert found(device="cuda") == [gpu]
    assert found(precision="float64") == [exact]
    stored(tmp_path, [105], device="cuda")
    many = stored(tmp_path, [104, 105], device="cpu").path
    assert found() == [path, many]
    assert [problem for _, problem in records.verify(tmp_path) if problem] == []


def test_what_is_missing_depends_on_precision_and_device(path, tmp_path):
    missing = lambda **which: records.missing_seeds("toy", "ours/a", CONFIG, [100, 102], tmp_path, **which)  # noqa: E731
    assert missing() == missing(precision="float32") == missing(device="cpu") == [102]
    assert missing(precision="float64") == missing(device="cuda") == [100, 102]


def test_a_record_of_the_first_schema_is_refused_with_a_sentence(path):
    rewrite(path, schema=1)
    with pytest.raises(RecordError, match="schema version 1, this program reads 2"):
        records.read(path)


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


def test_only_records_of_one_config_are_joined(path, tmp_path):
    other = records.write(tmp_path / "toy" / "ours" / "b" / "100-101.npz", ARRAYS, {**header(), "name": "ours/b"})
    assert records.joined([records.read(path)])[0] == (100, 101)
    for found in ([], [records.read(path), other]):
        with pytest.raises(RecordError, match="expected records of one config and precision"):
            records.joined(found)


def test_a_missing_record_and_an_unwritable_folder(tmp_path):
    with pytest.raises(RecordError, match="there is no record"):
        records.read(tmp_path / "none.npz")
    (tmp_path / "toy").write_text("in the way")
    with pytest.raises(RecordError, match="cannot write the record"):
        records.write(tmp_path / "toy" / "ours" / "a" / "100-101.npz", ARRAYS, header())


def test_every_published_record_is_intact_and_of_the_config_of_its_name():
    found = records.verify()
    assert [problem for _, problem in found if problem] == []
    assert len(found) >= 92
    for path, _ in found:
        record = records.read(path)
        unit = cli.recorded_unit(record.header)  # raises where the config is another one today
        assert f"{unit.label}.npz" == record.label
        assert differing(unit, record) == []
