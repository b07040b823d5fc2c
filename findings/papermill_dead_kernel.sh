#!/usr/bin/env bash
# papermill 2.7.0 with nbclient 0.10.2: cells that never ran are marked "completed" once the kernel has died.
#
# Guess: the error is raised, the cell during which the kernel died is marked "failed" and the later
#   ones stay "pending", as after an exception in a cell.
# Seen: the error is raised, but in the written notebook every cell has the status "completed", the
#   later ones without a start time, and the notebook's own `exception` is empty. Whoever reads the
#   statuses to see what has still to be done finds nothing.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile papermill==2.7.0 nbclient==0.10.2 nbformat==5.10.4 ipykernel==6.31.0
cd "$folder"
export JUPYTER_DATA_DIR="$folder/jupyter" IPYTHONDIR="$folder/ipython"
"$folder/venv/bin/python" -m ipykernel install --sys-prefix > /dev/null 2>&1
"$folder/venv/bin/python" -W ignore - 2> /dev/null <<'END'
import nbformat
import papermill

ENDS_ITS_KERNEL = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
RAISES = "raise RuntimeError"


def run(second):
    cells = [nbformat.v4.new_code_cell(source) for source in ("a = 1", second, "a = 3", "a = 4")]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), "in.ipynb")
    try:
        papermill.execute_notebook("in.ipynb", "out.ipynb", kernel_name="python3", progress_bar=False)
        raised = "nothing"
    except Exception as error:
        raised = type(error).__name__
    written = nbformat.read("out.ipynb", 4)
    cells = [c for c in written.cells if c.cell_type == "code"]
    return raised, [c.metadata.papermill.status for c in cells], written.metadata.papermill.exception


exception, dead = run(RAISES), run(ENDS_ITS_KERNEL)
print("an exception:  ", *exception)
print("a dead kernel: ", *dead)
expected = ["completed", "failed", "pending", "pending"]
seen = exception[1] == expected and dead == ("DeadKernelError", ["completed"] * 4, None)
raise SystemExit(0 if seen else 1)
END
