"""Records: one ``.npz`` file per finished unit of work, with its provenance inside.

A record is written once, atomically, and never overwritten. It holds plain arrays (no pickles) and a JSON header with
config, seeds, versions, times, its place below the records folder, and a checksum of all that. Reading verifies it:
what cannot be trusted is a ``RecordError`` that names the file and what to do.
"""

import contextlib
import csv
import datetime
import errno
import hashlib
import io
import itertools
import json
import os
import platform
import subprocess
import tempfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dropout_uncertainty import folders
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.settings import config_diff, config_hash

__all__ = [
    "Record", "RecordError", "checksum", "file_name", "find", "header_checksum", "joined", "missing_seeds", "parent",
    "provenance", "read", "root", "table", "verify", "write",
]  # fmt: skip

SCHEMA = 2
HEADER = "header.json"
#: What systems say on a disk without hard links.
NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)
#: Published seeds lie below this, those of development at it and above.
DEVELOPMENT = 100
#: Longest list of seeds in the name of a file.
LONGEST = 60
REMEDY = "restore it from version control, or delete it and run its unit again"
REQUIRED = {
    "schema": int, "label": str, "experiment": str, "name": str, "seeds": list, "device": str, "precision": str,
    "config": dict, "config_hash": str, "provenance": dict, "payload": str, "checksum": str,
}  # fmt: skip


class RecordError(UserError):
    """A record cannot be read, trusted or written."""


@dataclass(frozen=True)
class Record:
    """A verified record: ``header`` (see ``REQUIRED``), read-only ``arrays`` by name, and ``path``, its file."""

    header: dict[str, Any] = field(repr=False)
    arrays: dict[str, np.ndarray] = field(repr=False)
    path: Path

    @property
    def seeds(self) -> list[int]:
        """The seeds of the replicas, in the order of the arrays' leading axis."""
        return self.header["seeds"]

    @property
    def label(self) -> str:
        """Path of the file below the records folder."""
        return f"{self.header['experiment']}/{self.header['name']}/{self.path.name}"

    @property
    def published_precision(self) -> bool:
        """Whether it was computed in its section's own precision, so that its name does not say which."""
        return self.header["precision"] not in self.path.name.split(".")


def root() -> Path:
    """Return the folder of the records: ``DROPOUT_UNCERTAINTY_RECORDS`` if set, else ``records`` of the repository.

    Of a package that is installed elsewhere it is ``records`` in the current folder.
    """
    return folders.named(folders.RECORDS) or (folders.checkout() or Path.cwd()) / "records"


def table(name: str) -> list[dict[str, str]]:
    """Return the lines of a table of the repository's ``records``: what the thesis prints or an original program left.

    ``name`` is without suffix, such as "thesis" or "original/pilco_octave_cartpole". Outside a clone of the repository
    the table is looked for among the records.

    Raises:
        RecordError: if it is not there.
    """
    clone = folders.checkout()
    path = (clone / "records" if clone else root()) / f"{name}.csv"
    try:
        with open(path, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except FileNotFoundError:
        remedy = f"a clone of the repository has it; name its folder of records with {folders.RECORDS}"
        raise RecordError(f"there is no table {path}: {remedy}") from None


def checksum(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the SHA-256 over names, dtypes, shapes and bytes of arrays, the ``payload`` of a header."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape};".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def header_checksum(header: Mapping[str, Any]) -> str:
    """Return the SHA-256 over all of a header but its ``checksum``; the arrays count by their ``payload``."""
    content = {key: value for key, value in header.items() if key != "checksum"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def file_name(seeds: Sequence[int], device: str, precision: str | None = None) -> str:
    """Return what a record is called, without ``.npz``: its seeds, and what else is out of the ordinary.

    Seeds are "007", "000-009" if they follow each other, and otherwise such lists as "000-002+005", shortened to first,
    last and eight digits of a hash beyond ``LONGEST`` characters. ``precision`` is left out where it is the section's,
    ``device`` where it is "cpu".
    """
    starts = [i for i, seed in enumerate(seeds) if i == 0 or seed != seeds[i - 1] + 1]
    runs = [seeds[start:stop] for start, stop in itertools.pairwise([*starts, len(seeds)])]
    listed = "+".join(f"{run[0]:03d}" if len(run) == 1 else f"{run[0]:03d}-{run[-1]:03d}" for run in runs)
    if len(listed) > LONGEST:
        digest = hashlib.sha256(listed.encode()).hexdigest()[:8]
        listed = f"{seeds[0]:03d}-{seeds[-1]:03d}+{digest}"
    return ".".join([listed, *([precision] if precision else []), *([device] if device != "cpu" else [])])


@cache
def _git(*arguments: str) -> str | None:
    """Return what git says of the clone that the code is in, None where it is in none."""
    if (folder := folders.checkout()) is None:  # what git finds above belongs to somebody else
        return None
    try:
        return subprocess.run(
            ["git", *arguments], cwd=folder, capture_output=True, text=True, check=True, timeout=10
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def provenance(device: str = "cpu") -> dict[str, Any]:
    """Return where and with what this process computes: commit, dirty flag, versions, machine, date (UTC)."""
    import scipy
    import torch

    status = _git("status", "--porcelain", "--untracked-files=no", "--", "src", "pyproject.toml")
    return {
        "commit": _git("rev-parse", "HEAD"),
        "dirty": None if status is None else bool(status),
        "python": platform.python_version(),
        "torch": str(torch.__version__),  # plain, so that a checkpoint can hold it
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "system": f"{platform.system()} {platform.machine()}",
        "processor": torch.cuda.get_device_name() if device == "cuda" else _processor(),
        "processor_family": _processor_family(),
        "threads": torch.get_num_threads(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


@cache
def _cpuinfo() -> dict[str, str]:
    """Return what Linux says of the first processor, nothing elsewhere."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        return {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    return {}


def _processor() -> str:
    return _cpuinfo().get("model name") or platform.processor() or platform.machine()


def _processor_family() -> str:
    """Return what decides how results are rounded; virtual machines may hide it in the name of the processor."""
    import torch

    known = [f"{key.removeprefix('cpu ')} {_cpuinfo()[key]}" for key in ("cpu family", "model") if key in _cpuinfo()]
    return ", ".join([*known, torch.backends.cpu.get_cpu_capability()])


def parent(record: Record, seeds: Sequence[int]) -> dict[str, Any]:
    """Return how a record is named in the header of one that goes on from ``seeds`` of it, with their cost.

    That is their share of the record's own cost and of that of its parents.
    """
    origin = record.header["provenance"]
    share = len(set(seeds) & set(record.seeds)) / len(record.seeds)
    costs = {clock: share * origin.get(f"whole_{clock}", origin.get(clock, 0.0)) for clock in ("wall_s", "cpu_s")}
    code = {"commit": origin.get("commit"), "rounding": origin.get("rounding", 1)}
    return {"record": record.label, "checksum": record.header["checksum"], **code, **costs}


def write(path: Path, arrays: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> Record:
    """Write a record and return it; schema version, label and checksums are added to ``header``.

    The file appears under its name complete or not at all. If a record with the same arrays is already there it is left
    alone.

    Raises:
        RecordError: if another result is already at ``path``, the header is of another experiment or config than the
            path, or the file cannot be written.
    """
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    label = f"{header['experiment']}/{header['name']}/{_stem(path)}"
    full = json.loads(json.dumps({**header, "schema": SCHEMA, "label": label, "payload": checksum(arrays)}))
    full["checksum"] = header_checksum(full)
    _check_place(path, full)
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}-", delete=False) as file:
            temporary = Path(file.name)
            text = np.frombuffer(json.dumps(full, indent=1).encode(), np.uint8)
            np.savez_compressed(file, allow_pickle=False, **{HEADER: text}, **arrays)
            file.flush()
            os.fsync(file.fileno())
        _publish(temporary, path)
    except OSError as error:
        raise RecordError(f"cannot write the record {path} ({error.strerror or error}): is the disk full?") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
    record = read(path)
    for leftover in path.parent.glob(f".{path.name}-*"):  # of writers that were killed, or came too late
        leftover.unlink(missing_ok=True)
    if any(record.header[key] != full[key] for key in ("payload", "config_hash", "seeds")):
        raise RecordError(f"{path} already holds another result; move it away if you want to replace it")
    return record


def _publish(temporary: Path, path: Path) -> None:
    """Give a complete file its name, unless another writer was quicker."""
    with contextlib.suppress(FileExistsError, FileNotFoundError):  # not found: the quicker one has tidied up
        temporary.chmod(0o644)
        try:
            os.link(temporary, path)  # unlike a rename this never replaces a file
        except OSError as error:
            if error.errno not in NO_HARD_LINKS or path.exists():
                raise
            temporary.rename(path)


def read(path: Path | str, folder: Path | None = None) -> Record:
    """Return the record at ``path`` after verifying it; ``folder`` is the records folder, if that is known.

    Raises:
        RecordError: if it is missing, damaged, altered, not where it belongs, or of another schema version.
    """
    path = Path(path)
    try:
        header, arrays = _parse(path)
    except FileNotFoundError:
        raise RecordError(f"there is no record {path}") from None
    except (PermissionError, IsADirectoryError) as error:
        raise RecordError(f"the record {path} cannot be read ({error.strerror or error}): make it readable") from error
    except Exception as error:  # NumPy, zipfile and json do not say what damaged bytes make them raise
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise RecordError(f"the record {path} cannot be read ({reason}): {REMEDY}") from error
    if header.get("schema") != SCHEMA:
        raise RecordError(
            f"the record {path} has schema version {header.get('schema')}, this program reads {SCHEMA}: "
            "use a version to match"
        )
    if missing := [key for key in REQUIRED if key not in header]:
        raise RecordError(f"the header of {path} lacks {', '.join(missing)}: {REMEDY}")
    if wrong := [key for key, kind in REQUIRED.items() if not isinstance(header[key], kind)]:
        raise RecordError(f"the header of {path} has {', '.join(wrong)} of another type than expected: {REMEDY}")
    if header["payload"] != checksum(arrays):
        raise RecordError(f"the arrays of {path} do not match their checksum: {REMEDY}")
    if header["checksum"] != header_checksum(header):
        raise RecordError(f"the header of {path} does not match its checksum: {REMEDY}")
    if header["config_hash"] != config_hash(header["config"]):
        raise RecordError(f"the config of {path} does not match its hash: {REMEDY}")
    _check_place(path, header, folder)
    return Record(header, arrays, path)


def _stem(path: Path) -> str:
    return path.name.removesuffix(".npz")


def _check_place(path: Path, header: Mapping[str, Any], folder: Path | None = None) -> None:
    """Raise RecordError unless a file is where its header says: below ``folder``, or if that is None, anywhere."""
    *parts, name = f"{header['label']}.npz".split("/")
    place = path.relative_to(folder).parts if folder else path.absolute().parts[-len(parts) - 1 :]
    if place != (*parts, name):
        raise RecordError(f"{path} is the record {header['label']}.npz: give it back its name, or delete it if a copy")
    seeds, device, precision = (header[key] for key in ("seeds", "device", "precision"))
    names = [f"{file_name(seeds, device, other)}.npz" for other in (None, precision)]
    if parts != [header["experiment"], *header["name"].split("/")] or name not in names:
        raise RecordError(f"{path} is called otherwise than what it holds, {names[0]} of {header['name']}: {REMEDY}")


def _files(folder: Path) -> list[Path]:
    """Return the record files below a folder, also where a folder below it is a link to another disk."""
    found = []
    for place, below, names in os.walk(folder, followlinks=True, onerror=_unseen):
        found += [Path(place, name) for name in names if name.endswith(".npz") and not name.startswith(".")]
        here = Path(place).resolve()  # a link to what it lies in would have no end
        below[:] = [name for name in below if not here.is_relative_to(Path(place, name).resolve())]
    return sorted(found)


def _unseen(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError | NotADirectoryError):
        raise RecordError(f"cannot look for records in {error.filename} ({error.strerror}): make it readable")


def _parse(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return header and arrays of a file, whatever they say; raises anything where it is not such a file."""
    with zipfile.ZipFile(path) as archive:
        members = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
    arrays = {name: np.lib.format.read_array(io.BytesIO(content)) for name, content in members.items()}
    for array in arrays.values():
        array.flags.writeable = False
    header = json.loads(arrays.pop(HEADER).tobytes())
    if not isinstance(header, dict):
        raise ValueError("its header is no table")
    return header, arrays


def find(
    experiment: str,
    config: Any = None,
    *,
    name: str | None = None,
    folder: Path | str | None = None,
    precision: str | None = None,
    device: str | None = None,
    published: bool | None = None,
) -> list[Record]:
    """Return the records of an experiment, ordered by path; optionally of one named config or one config's content.

    No seed of a config comes twice. Only records in the section's own precision count, unless another ``precision`` is
    asked for, and those of every device type, unless one is ("cpu" or "cuda"): a record all of whose seeds have been
    computed on the other type too is left out, that of the GPU first. With ``published`` only records of published
    seeds count, below 100, or (False) only those of development, 100 and above.

    Raises:
        RecordError: if one of them cannot be trusted, seeds come twice, or configs of one name differ.
    """
    folder = folders.existing(Path(folder or root()), folders.RECORDS, "records")
    found = [_kept(path, folder) for path in _files(folder / experiment / (name or ""))]
    hashed = None if config is None else config_hash(config)
    asked = {"name": name, "config_hash": hashed, "precision": precision, "device": device}
    wanted = {key: value for key, value in asked.items() if value is not None}
    found = [record for record in found if all(record.header[key] == value for key, value in wanted.items())]
    if precision is None:
        found = [record for record in found if record.published_precision]
    if published is not None:
        found = [record for record in found if (max(record.seeds) < DEVELOPMENT) == published]
    counted = _counted(found)
    if clash := _clash(counted):
        raise RecordError(clash[1])
    return counted


def joined(
    found: Sequence[Record], names: Iterable[str] | None = None
) -> tuple[tuple[int, ...], dict[str, np.ndarray]]:
    """Return the seeds of records of one config, in their order, and their arrays (or those named), replicas first.

    Raises:
        RecordError: if there are no records, or they are of several configs.
    """
    if len({(r.header["name"], r.header["config_hash"], r.header["precision"]) for r in found}) != 1:
        several = sorted({record.label for record in found})
        raise RecordError(f"expected records of one config and precision, got {several or 'none'}")
    names = found[0].arrays if names is None else names
    arrays = {name: np.concatenate([record.arrays[name] for record in found]) for name in names}
    return tuple(seed for record in found for seed in record.seeds), arrays


def _kept(path: Path, folder: Path) -> Record:
    """Return the record at ``path`` as ``read`` does, from memory if this process has read this very file before."""
    try:
        found = path.stat()
    except FileNotFoundError:
        raise RecordError(f"there is no record {path}") from None
    record = _verified(path, folder, (found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns))
    # the arrays cannot be written to; what else could be changed is each reader's own
    return replace(record, header=json.loads(json.dumps(record.header)), arrays=dict(record.arrays))


@cache  # with a limit below the number of records every reading of all would read each again
def _verified(path: Path, folder: Path, _: tuple[int, ...]) -> Record:
    return read(path, folder)


def _same(first: Record, second: Record) -> bool:
    return all(first.header[key] == second.header[key] for key in ("experiment", "name", "precision"))


def _counted(found: Sequence[Record]) -> list[Record]:
    """Return the records without those whose seeds are all in others from another device type, GPUs first to go."""
    counted = list(found)
    for record in sorted(found, key=lambda r: r.header["device"] == "cpu"):
        others = [r for r in counted if _same(r, record) and r.header["device"] != record.header["device"]]
        if set(record.seeds) <= {seed for other in others for seed in other.seeds}:
            counted.remove(record)
    return counted


def _clash(found: Sequence[Record]) -> tuple[Record, str] | None:
    """Return the first record that cannot count beside an earlier one, and a sentence that says why and what to do."""
    for second, first in ((b, a) for i, b in enumerate(found) for a in found[:i] if _same(a, b)):
        if first.header["config_hash"] != second.header["config_hash"]:
            changed = ", ".join(key for key, *_ in config_diff(first.header["config"], second.header["config"]))
            problem = f"are of one name, but of configs that differ ({changed})"
        elif shared := sorted(set(first.seeds) & set(second.seeds)):
            problem = f"both hold the seeds {file_name(shared, 'cpu')}"
        else:
            continue
        return second, f"{first.path} and {second.path} {problem}: move one of them out of the records folder"
    return None


def missing_seeds(
    experiment: str,
    name: str,
    config: Any,
    seeds: Iterable[int],
    folder: Path | None = None,
    *,
    precision: str | None = None,
    device: str | None = None,
) -> list[int]:
    """Return the seeds that no record of this config has yet, whatever the units that its records were made in.

    As in ``find``, precision None is the section's own, and device None is any.

    Raises:
        RecordError: if one of the records cannot be trusted.
    """
    found = find(experiment, config, name=name, folder=folder, precision=precision, device=device)
    have = {seed for record in found for seed in record.seeds}
    return [seed for seed in seeds if seed not in have]


def verify(folder: Path | None = None) -> list[tuple[Path, str | None]]:
    """Return every record file below ``folder`` with None, or the sentence that says what is wrong with it."""
    folder = folders.existing(folder or root(), folders.RECORDS, "records")
    results: dict[Path, str | None] = {}
    intact = []
    for path in _files(folder):
        try:
            record = read(path, folder)
            results[path] = None
            intact.append(replace(record, arrays={}))
        except RecordError as error:
            results[path] = str(error)
    counted = _counted(intact)
    while clash := _clash(counted):
        counted.remove(clash[0])
        results[clash[0].path] = clash[1]
    return list(results.items())
