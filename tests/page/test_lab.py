"""A notebook as a person runs it: opened in JupyterLab, all cells run from the menu."""

import contextlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from browser import chromium, need

pytestmark = pytest.mark.slow

NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "weight_draws.ipynb"
PATIENCE = 180_000  # ms


@contextlib.contextmanager
def jupyterlab(folder):
    """Start JupyterLab in a folder, with settings of its own, and yield its address."""
    need(importlib.util.find_spec("jupyterlab"), "JupyterLab is not installed: `pip install -e '.[book]'` installs it")
    options = ["--no-browser", "--allow-root", "--ServerApp.port=0", "--IdentityProvider.token="]
    home = {name: str(folder / ".jupyter") for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "IPYTHONDIR")}
    server = subprocess.Popen(
        [sys.executable, "-m", "jupyterlab", *options, f"--ServerApp.root_dir={folder}"],
        env=os.environ | home,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        said = []
        for line in server.stdout:
            said.append(line)
            if address := re.search(r"http://(?:localhost|127\.0\.0\.1):(\d+)/lab", line):
                break
        assert address, "".join(said)
        yield f"http://127.0.0.1:{address[1]}"
    finally:
        server.terminate()
        server.communicate()  # kernels end with the server


def test_all_cells_run_in_jupyterlab_and_show_their_figures(tmp_path):
    copy = tmp_path / NOTEBOOK.name
    shutil.copy(NOTEBOOK, copy)
    figures = NOTEBOOK.read_text(encoding="utf-8").count("plt.show()")
    assert figures > 0
    with chromium() as browser, jupyterlab(tmp_path) as address:
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        page.set_default_timeout(PATIENCE)
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(f"{address}/lab/tree/{copy.name}?reset")
        kernel(page, "Idle").wait_for()
        page.get_by_role("menuitem", name="Run", exact=True).click()
        page.get_by_text("Run All Cells", exact=True).click()
        kernel(page, "Busy").wait_for()
        for _ in range(PATIENCE // 1000):  # between two cells the kernel is idle for a moment
            kernel(page, "Idle").wait_for()
            executed = saved(page, copy)
            if all(cell.execution_count for cell in executed.cells if cell.cell_type == "code"):
                break
        assert page.locator(".jp-OutputArea-output img").count() > 0
        assert not errors
    assert all(cell.execution_count for cell in executed.cells if cell.cell_type == "code")
    outputs = [output for cell in executed.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == figures


def kernel(page, status):
    """Return what the status bar says of a kernel; the toolbar shows a kernel that is not there yet as idle."""
    return page.locator("#jp-main-statusbar").get_by_text(re.compile(rf"\| {status}$"))


def saved(page, path):
    """Save the notebook with the keyboard and return what is then in its file."""
    before = path.stat().st_mtime
    page.locator(".jp-Notebook").press("Control+s")
    for _ in range(PATIENCE // 500):
        page.wait_for_timeout(500)
        with contextlib.suppress(nbformat.reader.NotJSONError):  # it is being written
            if path.stat().st_mtime > before:
                return nbformat.read(path, as_version=4)
    raise AssertionError("the notebook was not saved")
