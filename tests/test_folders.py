"""Folders that the environment names, that are not there, or that cannot be written; and a package without a clone."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from test_cli import command

import dropout_uncertainty
from dropout_uncertainty import folders
from dropout_uncertainty.active_learning import mnist
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.page import book, landing, profiles
from dropout_uncertainty.runs import records

ROOT = Path(__file__).parents[1]


def python(code, folder, **environment):
    outcome = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return outcome.stdout.splitlines()


def test_relative_names_are_meant_from_where_the_program_was_started(tmp_path):
    code = (
        "import dropout_uncertainty, os, subprocess, sys; os.chdir('/')\n"
        "again = 'from dropout_uncertainty import folders as f; print(f.named(f.RECORDS)); print(f.named(f.DATA))'\n"
        "subprocess.run([sys.executable, '-c', again], check=True)"
    )
    found = python(code, tmp_path, DROPOUT_UNCERTAINTY_RECORDS="mine", DROPOUT_UNCERTAINTY_DATA="../data")
    assert found == [str(tmp_path / "mine"), str(tmp_path / ".." / "data")]


@pytest.mark.parametrize(
    "reader",
    [
        lambda: records.find("exploration"),
        records.verify,
        lambda: book.run_notebooks("recorded", ["scoreboard"]),
        landing.write,
    ],
)
def test_a_folder_that_is_not_there_is_an_error_for_every_reader(tmp_path, monkeypatch, reader):
    monkeypatch.setenv(folders.RECORDS, str(tmp_path / "typo"))
    with pytest.raises(UserError, match=f"there is no folder {tmp_path / 'typo'} of records"):
        reader()
    assert not (tmp_path / "typo").exists()


def test_the_data_too(tmp_path, monkeypatch):
    monkeypatch.setenv(folders.DATA, str(tmp_path / "typo"))
    with pytest.raises(UserError, match=f"there is no folder {tmp_path / 'typo'} of data"):
        mnist.load()


def test_nothing_is_not_intact(tmp_path):
    outcome = command("records", "verify", env={**os.environ, folders.RECORDS: str(tmp_path)})
    assert outcome.returncode == 2
    assert outcome.stderr == f"error: there are no records below {tmp_path}\n"


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """Return a folder with a README that the package takes for its clone."""
    shutil.copy(ROOT / "README.md", tmp_path)
    (tmp_path / "_config.yml").touch()
    monkeypatch.setattr(folders, "checkout", lambda: tmp_path)
    return tmp_path


def test_published_numbers_are_not_replaced_by_fewer(clone, tmp_path_factory, monkeypatch):
    text = (clone / "README.md").read_text(encoding="utf-8")
    monkeypatch.setattr(landing, "collect", lambda _: [])
    with pytest.raises(
        UserError, match=r"README\.md has \d+ repetitions of .*, the records in .* 0: it stays as it is"
    ):
        landing.write(tmp_path_factory.mktemp("nothing"))
    assert (clone / "README.md").read_text(encoding="utf-8") == text
    assert sorted(clone.iterdir()) == [clone / "README.md", clone / "_config.yml"]


def test_what_cannot_be_written_is_one_sentence(clone, monkeypatch):
    (clone / "_build").write_text("in the way")
    with pytest.raises(UserError, match=f"cannot write in {clone / '_build'}"):
        book.run_notebooks()
    monkeypatch.setattr(landing, "readme", lambda text, found: text)
    monkeypatch.setattr(landing, "PICTURES", {})
    monkeypatch.setattr(landing, "collect", lambda _: [])
    (clone / "book").write_text("in the way")
    with pytest.raises(UserError, match=f"cannot write {clone / 'book'}"):
        landing.write()
    with pytest.raises(UserError, match="cannot make the folder"):
        folders.create(clone / "_build" / "records")


# --- installed elsewhere, as from a wheel


@pytest.fixture
def installed(tmp_path):
    """Return the command line of a copy of the package that has no clone around it, in an empty folder."""
    shutil.copytree(ROOT / "src" / "dropout_uncertainty", tmp_path / "site" / "dropout_uncertainty")
    (tmp_path / "work").mkdir()

    def run(*arguments, **environment):
        environment = {**os.environ, **environment, "PYTHONPATH": str(tmp_path / "site")}
        return command(*arguments, cwd=tmp_path / "work", env=environment)

    return run


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["results"], "there is no table {work}/records/thesis.csv: a clone of the repository has it;"),
        (["book"], "the book is made in a clone of the repository"),
        (["front"], "a clone of the repository has it"),
    ],
)
def test_a_package_without_a_clone_says_what_it_needs(installed, tmp_path, arguments, message):
    outcome = installed(*arguments)
    assert outcome.returncode == 2
    assert message.format(work=tmp_path / "work") in outcome.stderr
    assert len(outcome.stderr.splitlines()) == 1


@pytest.mark.slow
def test_a_package_without_a_clone_reads_the_records_of_one(installed):
    assert "table-5.1/random" in installed("results", DROPOUT_UNCERTAINTY_RECORDS=str(ROOT / "records")).stdout


@pytest.mark.slow
def test_a_package_without_a_clone_writes_into_the_current_folder(installed, tmp_path):
    outcome = installed("run", "exploration", "--config", "quick/narrow", "--seeds", "100")
    assert outcome.returncode == 0, outcome.stderr
    (record,) = (tmp_path / "work" / "records").rglob("*.npz")
    assert str(record) in outcome.stdout
    assert not list((tmp_path / "site").rglob("*.npz"))


# --- profiles and version


@pytest.mark.parametrize("profile", ["Quick", "", "recorded "])
def test_a_profile_that_is_none(profile):
    with pytest.raises(UserError, match=r"unknown profile .*, choose one of recorded, quick, full"):
        profiles.check(profile)
    with pytest.raises(UserError, match="unknown profile"):
        book.build(profile, run=False)


def test_the_version_is_printed():
    assert command("--version").stdout.strip() == dropout_uncertainty.__version__


def test_a_shell_completes_commands():
    asked = {
        "_DROPOUT_UNCERTAINTY_COMPLETE": "complete_bash",
        "COMP_WORDS": "dropout-uncertainty re",
        "COMP_CWORD": "1",
    }
    script = Path(sys.executable).with_name("dropout-uncertainty")
    outcome = subprocess.run([script], env={**os.environ, **asked}, capture_output=True, text=True, check=True)
    assert sorted(outcome.stdout.split()) == ["records", "results"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["records", "list"], "there is no folder {name} of records"),
        (["run", "exploration", "--config", "wide", "--seeds", "100"], "cannot tell where the folder {name} is"),
    ],
)
def test_a_name_that_leads_nowhere(arguments, message):
    name = "~nobody-of-this-name/records"
    outcome = command(*arguments, env={**os.environ, "DROPOUT_UNCERTAINTY_RECORDS": name})
    assert (outcome.returncode, outcome.stdout) == (2, "")
    assert outcome.stderr.startswith(f"error: {message.format(name=name)}")
