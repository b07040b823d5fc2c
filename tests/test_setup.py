"""What is said in several places about versions: they agree with ``pyproject.toml``."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = ["3.11", "3.12", "3.13", "3.14"]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_citation_names_the_version():
    assert f"\nversion: {PROJECT['version']}\n" in text("CITATION.cff")


def test_one_set_of_pythons_is_named_everywhere():
    assert PROJECT["requires-python"] == ">=3.11,<3.15"
    for page in ("README.md", "book/how_to_run.md"):
        assert "You need Python 3.11, 3.12, 3.13 or 3.14" in text(page)
    makefile = text("Makefile")
    assert "(3, 11) <= sys.version_info < (3, 15)" in makefile
    assert sorted(re.findall(r"python(3\.\d+)", makefile)) == PYTHONS
    assert set(re.findall(r'"(3\.\d+)"', text(".github/workflows/book.yml"))) <= set(PYTHONS)


@pytest.mark.parametrize("python", PYTHONS)
def test_one_torch_that_the_package_allows_is_pinned_for_each_python(python):
    lines = [line for line in text("constraints.txt").splitlines() if line.startswith("torch==")]
    pinned = [pin for pin in map(Requirement, lines) if pin.marker.evaluate({"python_version": python})]
    (allowed,) = (need for need in map(Requirement, PROJECT["dependencies"]) if need.name == "torch")
    ((version,),) = ([specifier.version for specifier in pin.specifier] for pin in pinned)
    assert allowed.specifier.contains(version)
