"""The records as one archive that describes itself, an RO-Crate (https://w3id.org/ro/crate); needs the extra ``crate``.

Its ``ro-crate-metadata.json`` names every file with its size and SHA-256 and, for each record, the run that made it:
experiment, config, seeds and the program's commits. Unpacked, the archive is a folder of records like any other.
"""

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import dropout_uncertainty
from dropout_uncertainty import folders
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import records

if TYPE_CHECKING:
    from rocrate.model import Entity
    from rocrate.rocrate import ROCrate

__all__ = ["write"]

LICENCES = "https://spdx.org/licenses/"
NPZ = "https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html"
#: The folder of numbers that are not ours, and on what terms they are here.
ORIGINAL, QUOTED = "original", "Numbers that the original programs recorded or print when run, quoted as data."


def write(path: Path, repository: str) -> Path:
    """Write the records and tables of the records folder into a ZIP file that describes them, and return its path.

    Title, authors and licence are those of ``.zenodo.json``. An archive that is there is replaced.

    Args:
        path: where the archive is to be.
        repository: the public address of the repository, which holds the commits that made the records.

    Raises:
        UserError: if rocrate is not installed, the package does not run from a clone of the repository, a record cannot
            be trusted, or the archive cannot be written.
    """
    crate = _crate(records.root(), repository)
    folders.create(path.absolute().parent)
    unfinished = path.with_name(f".{path.name}")
    try:
        crate.write_zip(unfinished)
        unfinished.replace(path)
    except OSError as error:
        raise UserError(f"cannot write the archive {path} ({error.strerror or error}): is the disk full?") from error
    finally:
        unfinished.unlink(missing_ok=True)
    return path


def _crate(folder: Path, repository: str) -> "ROCrate":
    try:
        from rocrate.rocrate import ROCrate
    except ImportError:
        raise UserError("the archive needs the package rocrate: `pip install 'rocrate>=0.16'`") from None
    about, version = _about(), dropout_uncertainty.__version__
    found = records.verify(folder)
    if problems := [problem for _, problem in found if problem is not None]:
        raise UserError(problems[0])
    crate = ROCrate()
    crate.name, crate.keywords = f"Records of {about['title']}", about["keywords"]
    crate.description = (
        "Results of the runs, as NumPy arrays with settings and origin, and the tables that they are judged by."
    )
    crate.license = _add(crate, LICENCES + about["license"], "CreativeWork", name=about["license"])
    names = [creator["name"] for creator in about["creators"]]
    authors = [_add(crate, f"#author-{i}", "Organization", name=name) for i, name in enumerate(names, start=1)]
    _add(crate, NPZ, "WebPage", name="NumPy's format for arrays")
    _add(crate, f"#{ORIGINAL}", "CreativeWork", name="Quoted data", description=QUOTED)
    for table in sorted(folder.rglob("*.csv")):
        terms = {"license": {"@id": f"#{ORIGINAL}"}} if table.parent.name == ORIGINAL else {}
        _add_file(crate, folder, table, encodingFormat="text/csv", **terms)
    runs = [_add_run(crate, folder, records.read(path), repository) for path, _ in found]
    release = _add_program(crate, records.provenance()["commit"], repository)
    release["version"] = version
    root = crate.root_dataset
    root["version"], root["author"], root["mentions"] = version, _one_or_more(authors), [release, *runs]
    return crate


def _about() -> dict[str, Any]:
    clone = folders.checkout()
    if clone is None:
        raise UserError("the archive is written from a clone of the repository: run the command of one")
    return json.loads((clone / ".zenodo.json").read_text(encoding="utf-8"))


def _one_or_more(items: list[Any]) -> Any:
    """Return what JSON-LD has for a list: what stands in it, if that is one."""
    return items[0] if len(items) == 1 else items


def _add(crate: "ROCrate", identifier: str, kind: str, /, **properties: Any) -> "Entity":
    """Return the entity of that identifier; it is added if there is none yet."""
    return crate.get(identifier) or crate.add_jsonld({"@id": identifier, "@type": kind, **properties})


def _add_program(crate: "ROCrate", commit: str | None, repository: str) -> "Entity":
    place, known = f"{repository}/tree/{commit}" if commit else repository, commit or "unknown"
    words = {"name": "dropout-uncertainty", "url": place, "version": known, "identifier": known}
    return _add(crate, place, "SoftwareApplication", **words, license=crate.license)


def _add_file(crate: "ROCrate", folder: Path, path: Path, **properties: Any) -> "Entity":
    place, content = path.relative_to(folder).as_posix(), path.read_bytes()
    known = {"name": place, "contentSize": str(len(content)), "sha256": hashlib.sha256(content).hexdigest()}
    return crate.add_file(path, place, properties=known | properties)


def _add_run(crate: "ROCrate", folder: Path, record: records.Record, repository: str) -> "Entity":
    """Add a record, and return the run that made it."""
    header, origin = record.header, record.header["provenance"]
    name, settings = f"{header['experiment']}/{header['name']}", json.dumps(header["config"])
    config = _add(crate, f"#{name}", "PropertyValue", name=name, identifier=header["config_hash"], value=settings)
    seeds = ", ".join(map(str, record.seeds))
    words = f"Seeds {seeds} of the config {name}, computed in {header['precision']} on {header['device']}."
    file = _add_file(crate, folder, record.path, description=words, encodingFormat=["application/zip", {"@id": NPZ}])
    commits = dict.fromkeys(sitting.get("commit") for sitting in origin.get("commits", [origin]))
    programs = _one_or_more([_add_program(crate, commit, repository) for commit in commits])
    known = {"name": f"Run of {record.label}"}
    return crate.add_action(programs, f"#run/{record.label}", object=config, result=file, properties=known)
