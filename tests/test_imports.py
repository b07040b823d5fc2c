"""What a run may import: no plots, no notebook, no book; and what is said where an import is missing.

The import-linter contracts say the former of single modules.
"""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from dropout_uncertainty.errors import UserError

PACKAGE = Path(__file__).parents[1] / "src" / "dropout_uncertainty"
FOR_READERS = {"page", "chapter", "toys", "answers", "figures", "animation", "drawing", "environment"}
UNWANTED = ["matplotlib", "IPython", "ipykernel", "papermill", "nbformat", "sphinx", "markdown_it", "pandas"]


def run_modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if not FOR_READERS & set(parts) and not parts[-1].startswith("__"):
            yield ".".join(parts)


def test_runs_import_nothing_that_only_readers_need():
    modules = list(run_modules())
    assert "dropout_uncertainty.runs.execute" in modules
    program = f"import sys, {', '.join(modules)}; print(*sorted(set({UNWANTED}) & set(sys.modules)))"
    outcome = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.split() == []


@pytest.mark.parametrize("world", ["data_efficiency.plant", "exploration.foraging", "exploration.deep_sea"])
def test_without_gymnasium_an_environment_says_what_to_install(world, monkeypatch):
    name = f"dropout_uncertainty.{world}.environment"
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(UserError, match="needs Gymnasium, which is not installed: pip install '"):
        importlib.import_module(name)
    monkeypatch.delitem(sys.modules, name, raising=False)
