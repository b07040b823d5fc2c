"""Notebooks are committed as they should be read: no outputs, short cells, one place to choose the profile."""

import ast
import functools
import importlib
import re
import statistics
from pathlib import Path

import nbformat
import papermill
import pytest
import torch

from dropout_uncertainty.data_efficiency.deep_pilco import particles
from dropout_uncertainty.rng import generator

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
#: Lines of a cell of code: of the longest, and of the one in the middle. A notebook reads like a lecture.
LONGEST_CELL, MIDDLE_CELL = 20, 5
#: More lines than these of drawing belong to the package.
LONGEST_DRAWING = 6

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def code_cells(path):
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]


def test_there_are_notebooks():
    assert NOTEBOOKS


@every_notebook
def test_notebook_is_committed_without_outputs(path):
    for cell in code_cells(path):
        assert not cell.outputs, f"clear the outputs of {path.name}"
        assert cell.execution_count is None, f"clear the execution counts of {path.name}"


@every_notebook
def test_exactly_one_cell_holds_the_parameters(path):
    cells = [cell for cell in code_cells(path) if "parameters" in cell.metadata.get("tags", [])]
    assert len(cells) == 1
    names = {target.id for line in ast.parse(cells[0].source).body for target in line.targets}
    assert "profile" in names


@every_notebook
def test_the_profile_is_checked_before_any_work(path):
    """A cell with nothing but imports may come before, and in the cell itself nothing but imports."""
    cells = [cell.source for cell in code_cells(path) if "parameters" not in cell.metadata.get("tags", [])]
    lines = ast.parse("\n".join(cells[:2])).body
    done = [ast.unparse(line) for line in lines if not isinstance(line, ast.Import | ast.ImportFrom)]
    assert done[0] == "profiles.check(profile)"


def test_a_wrong_profile_is_one_sentence_in_a_notebook(tmp_path):
    path = ROOT / "notebooks" / "weight_draws.ipynb"
    with pytest.raises(papermill.PapermillExecutionError) as caught:
        papermill.execute_notebook(
            path, tmp_path / path.name, {"profile": "Quick"}, cwd=path.parent, progress_bar=False
        )
    assert caught.value.ename == "UserError"
    assert caught.value.traceback == ["UserError: unknown profile 'Quick', choose one of recorded, quick, full"]


@every_notebook
def test_cells_are_short(path):
    long = [cell.source.splitlines()[0] for cell in code_cells(path) if len(cell.source.splitlines()) > LONGEST_CELL]
    assert not long, f"cells of more than {LONGEST_CELL} lines: move the work to src/ ({long})"
    middle = statistics.median(len(cell.source.splitlines()) for cell in code_cells(path))
    assert middle <= MIDDLE_CELL, f"half of the cells of {path.name} have {middle} lines or more: move work to src/"


@every_notebook
def test_cells_that_draw_are_a_call(path):
    long = [
        cell.source.splitlines()[0]
        for cell in code_cells(path)
        if "subplots(" in cell.source and len(cell.source.splitlines()) > LONGEST_DRAWING
    ]
    assert not long, f"more than {LONGEST_DRAWING} lines that draw: move them to report/ ({long})"


@every_notebook
def test_cells_do_not_branch_on_the_profile(path):
    """What a profile computes and shows is one call; a cell only hands the profile on."""
    for cell in code_cells(path):
        asked: list[ast.AST] = []
        for node in ast.walk(ast.parse(cell.source)):
            match node:
                case ast.Compare():
                    asked += [node.left, *node.comparators]
                case ast.Match():
                    asked.append(node.subject)
                case ast.Subscript(value=ast.Dict()):
                    asked.append(node.slice)
        names = [ast.unparse(part) for part in asked]
        assert "profile" not in names, f"{path.name} branches on the profile: {cell.source.splitlines()[0]}"


@every_notebook
def test_the_first_cell_of_imports_is_folded(path):
    cell = next(cell for cell in code_cells(path) if "import " in cell.source)
    assert "hide-input" in cell.metadata.get("tags", [])


@every_notebook
def test_cells_that_draw_describe_the_picture(path):
    for cell in code_cells(path):
        if "subplots(" in cell.source or "figure" in cell.metadata.get("mystnb", {}):
            alt = cell.metadata.get("mystnb", {}).get("image", {}).get("alt", "")
            assert len(alt) > 30, f"{path.name}: say in the alt text what is to be seen: {cell.source.splitlines()[0]}"


@every_notebook
def test_names_in_the_prose_are_there(path):
    """`module.name` in inline code means what it would in a cell: exercises outlive a move of the code otherwise."""
    names, own = {}, set()
    for node in (node for cell in code_cells(path) for node in ast.walk(ast.parse(cell.source))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            exec(ast.unparse(node), names)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            own.add(node.id)
    prose = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "markdown"]
    for code in re.findall(r"(?<![`}])`([^`\n]+)`(?!`)", "\n".join(prose)):
        for dotted in re.findall(r"(?<![\w./])[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+(?![\w/])", code):
            head, *rest = dotted.split(".")
            if head not in own:
                found = names[head] if head in names else importlib.import_module(head)
                assert functools.reduce(getattr, rest, found) is not None


@every_notebook
def test_the_prose_names_no_colour_that_a_dark_page_turns_round(path):
    cells = nbformat.read(path, as_version=4).cells
    told = [cell.source if cell.cell_type == "markdown" else str(cell.metadata.get("mystnb")) for cell in cells]
    assert not re.findall(r"\b(?:black|white)\b(?!-)", "\n".join(told))


@every_notebook
def test_every_notebook_is_in_the_table_of_contents(path):
    assert f"file: {path.stem}\n" in (ROOT / "book" / "_toc.yml").read_text(encoding="utf-8")


def test_matching_makes_parting_expensive_and_its_gradient_rough_as_what_matters_says():
    toy = {"torch": torch, "generator": generator, "particles": particles, "double": {"dtype": torch.float64}}
    for cell in code_cells(ROOT / "notebooks" / "5_4_what_matters.ipynb"):
        if cell.source.startswith(("def roll", "def cost", "noise = ", "psi = ")):
            exec(cell.source, toy)
    place = (toy["psi"] - 0.2).abs().argmin()
    for free, fitted in zip(*toy["found"].values(), strict=True):  # expected cost, spread of its gradient
        assert fitted[place] > free[place]


@pytest.mark.slow  # continuous integration runs every notebook through `make quick`
@every_notebook
def test_notebook_runs_in_profile_quick(path, tmp_path):
    papermill.execute_notebook(path, tmp_path / path.name, {"profile": "quick"}, cwd=path.parent, progress_bar=False)
