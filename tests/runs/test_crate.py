"""The archive of the records says what is in it, and unpacked it is a folder of records."""

import hashlib
import importlib.resources
import json
import sys
import types
import zipfile

import pytest
import yaml
from stored import ARRAYS, header
from typer.testing import CliRunner

from dropout_uncertainty import cli, folders
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.page import public
from dropout_uncertainty.runs import crate, records

URL = "https://github.com/someone/their-book"
COMMITS = [{"commit": "a" * 40, "dirty": False}, {"commit": "b" * 40, "dirty": False}]


def described(archive):
    """Return the files of an archive and what it says of them and of everything else, by identifier."""
    with zipfile.ZipFile(archive) as file:
        files = {name: file.read(name) for name in file.namelist()}
    return files, {entity["@id"]: entity for entity in json.loads(files.pop("ro-crate-metadata.json"))["@graph"]}


def at(reference):
    return reference["@id"]


def several(found):
    return found if isinstance(found, list) else [found]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with two records of one config, one of them made in two sittings, and two tables."""
    folder = tmp_path / "records"
    monkeypatch.setenv(folders.RECORDS, str(folder))
    origins = {100: {"commit": "a" * 40}, 101: {"commit": "b" * 40, "commits": COMMITS}}
    for seed, origin in origins.items():
        path = folder / "toy" / "ours" / "a" / f"{seed}.npz"
        records.write(path, ARRAYS, header(seeds=[seed], provenance=origin))
    (folder / "original").mkdir()
    for table in ("thesis.csv", "original/curves.csv"):
        (folder / table).write_text("id,value\n", encoding="utf-8")
    return folder


def test_every_stored_file_is_named_with_size_and_checksum_and_every_record_with_its_run(tmp_path):
    files, entities = described(crate.write(tmp_path / "records.zip", URL))
    places = [path.relative_to(records.root()) for path in records.root().rglob("*.*") if path.is_file()]
    stored = {place.as_posix() for place in places if ".partial" not in place.parts}
    assert set(files) == {at(part) for part in entities["./"]["hasPart"]} == stored
    for name, content in files.items():
        said = entities[name]
        assert (said["contentSize"], said["sha256"]) == (str(len(content)), hashlib.sha256(content).hexdigest())
    runs = {at(run["result"]): run for run in entities.values() if run["@type"] == "CreateAction"}
    assert set(runs) == {name for name in stored if name.endswith(".npz")}
    for path, _ in records.verify():
        record = records.read(path)
        run = runs[record.label]
        config = entities[at(run["object"])]
        assert config["name"] == f"{record.header['experiment']}/{record.header['name']}"
        assert config["identifier"] == record.header["config_hash"]
        assert json.loads(config["value"]) == record.header["config"]
        assert entities[at(several(run["instrument"])[-1])]["identifier"] == record.header["provenance"]["commit"]


def test_unpacked_it_is_a_folder_of_records(folder, tmp_path):
    with zipfile.ZipFile(crate.write(tmp_path / "new" / "records.zip", URL)) as archive:
        archive.extractall(tmp_path / "unpacked")
    assert [problem for _, problem in records.verify(tmp_path / "unpacked")] == [None, None]
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["records.zip"]


def test_a_run_names_the_commit_of_each_sitting(folder, tmp_path):
    _, entities = described(crate.write(tmp_path / "records.zip", URL))
    used = {
        label: list(map(at, several(entities[f"#run/toy/ours/a/{label}.npz"]["instrument"]))) for label in (100, 101)
    }
    assert used == {100: [f"{URL}/tree/{'a' * 40}"], 101: [f"{URL}/tree/{letter * 40}" for letter in "ab"]}


def test_what_is_quoted_is_not_said_to_be_under_our_licence(folder, tmp_path):
    _, entities = described(crate.write(tmp_path / "records.zip", URL))
    assert at(entities["./"]["license"]) == "https://spdx.org/licenses/MIT"
    assert "license" not in entities["thesis.csv"]
    assert entities[at(entities["original/curves.csv"]["license"])]["description"] == crate.QUOTED


def test_title_authors_and_licence_are_those_of_the_citation(folder, tmp_path):
    citation = yaml.safe_load((folders.checkout() / "CITATION.cff").read_text(encoding="utf-8"))
    _, entities = described(crate.write(tmp_path / "records.zip", URL))
    root = entities["./"]
    assert root["name"] == f"Records of {citation['title']}"
    assert root["version"] == citation["version"]
    assert entities[at(root["license"])]["name"] == citation["license"]
    assert [{"name": entities[at(one)]["name"]} for one in several(root["author"])] == citation["authors"]
    assert not any(entity["@type"] == "Person" for entity in entities.values())


def test_an_altered_record_is_not_packed(folder, tmp_path, monkeypatch):
    monkeypatch.setenv(public.REPOSITORY, URL)
    (folder / "toy" / "ours" / "a" / "100.npz").write_bytes(b"altered")
    outcome = CliRunner().invoke(cli.app, ["records", "crate", "--out", str(tmp_path / "records.zip")])
    assert isinstance(outcome.exception, UserError)
    assert "100.npz cannot be read" in str(outcome.exception)
    assert not (tmp_path / "records.zip").exists()


def test_without_an_address_it_says_how_to_name_one(folder, tmp_path, monkeypatch):
    monkeypatch.delenv(public.REPOSITORY, raising=False)
    outcome = CliRunner().invoke(cli.app, ["records", "crate", "--out", str(tmp_path / "records.zip")])
    assert isinstance(outcome.exception, UserError)
    assert f"name the repository in {public.REPOSITORY}" in str(outcome.exception)


def test_without_rocrate_it_says_what_to_install(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rocrate.rocrate", None)
    with pytest.raises(UserError, match="needs the package rocrate: `pip install"):
        crate.write(tmp_path / "records.zip", URL)


@pytest.mark.slow
def test_the_validator_of_ro_crates_finds_no_requirement_broken(folder, tmp_path, monkeypatch):
    """It asks for the context of RO-Crates, of which rocrate brings a copy."""
    services = pytest.importorskip("rocrate_validator.services", reason="roc-validator is not installed")
    from rocrate_validator.models import Severity
    from rocrate_validator.utils.http import HttpRequester

    text = importlib.resources.files("rocrate").joinpath("data", "ro-crate.jsonld").read_text(encoding="utf-8")
    kind = {"Content-Type": "application/ld+json"}
    answer = types.SimpleNamespace(status_code=200, headers=kind, text=text, json=lambda: json.loads(text))
    monkeypatch.setattr(HttpRequester, "get", lambda *_, **__: answer, raising=False)
    archive = crate.write(tmp_path / "records.zip", URL)
    settings = services.ValidationSettings(
        rocrate_uri=str(archive), requirement_severity=Severity.REQUIRED, offline=True, cache_path=tmp_path / "cache"
    )
    assert [issue.message for issue in services.validate(settings).get_issues()] == []
