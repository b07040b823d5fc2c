"""What a run may import: no plots, no notebook, no book. The import-linter contracts say the same of single modules."""

import subprocess
import sys
from pathlib import Path

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
