"""What an EPUB of the book needs beyond Sphinx: formulas as MathML, pages that stand still, all files listed."""

import json
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import nbformat
import pytest
from markdown_it import MarkdownIt
from mdit_py_plugins.amsmath import amsmath_plugin
from mdit_py_plugins.dollarmath import dollarmath_plugin

from dropout_uncertainty.page import book, epub
from dropout_uncertainty.page.sliders import Slider, Toy
from dropout_uncertainty.page.svg import circle
from dropout_uncertainty.page.svg_animation import Player

ROOT = Path(__file__).parents[2]
MATHML = "{http://www.w3.org/1998/Math/MathML}"


def formulas():
    """Yield every formula of the book, and whether it stands by itself."""
    reader = MarkdownIt("commonmark").enable("table").use(dollarmath_plugin).use(amsmath_plugin)
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "book").glob("*.md")]
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        texts += ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
    for text in texts:
        for token in reader.parse(text):
            for part in (token, *(token.children or ())):
                if part.type.startswith(("math_", "amsmath")):
                    yield part.content, not part.type.startswith("math_inline")


def test_every_formula_of_the_book_is_read():
    drawn = [ElementTree.fromstring(epub.mathml(tex, block=block)) for tex, block in formulas()]
    assert len(drawn) > 100
    assert all(formula.tag == f"{MATHML}math" and len(formula) for formula in drawn)


def test_commands_that_docutils_does_not_know_are_said_otherwise():
    drawn = ElementTree.fromstring(epub.mathml(r"\log\big(x_1, \dots\big)", block=False))
    assert "".join(drawn.itertext()).replace("\u2061", "").split() == ["log", "(", "x", "1", ",", "…", ")"]
    assert ElementTree.fromstring(epub.mathml("^a", block=False)).find(f".//{MATHML}msup") is not None
    words = ElementTree.fromstring(epub.mathml(r"\underbrace{x_1 + y}_{\text{sum}}", block=True))[0]
    assert [part.tag for part in words] == [f"{MATHML}munder", f"{MATHML}mtext"]
    assert words.tag == f"{MATHML}munder"


def test_a_formula_that_cannot_be_read_is_named():
    with pytest.raises(ValueError, match=r"docutils does not read the formula '\\\\nonsense x'"):
        epub.mathml(r"\nonsense x", block=False)


@pytest.mark.slow
def test_the_book_as_an_epub(small_book):
    player = Player([[circle(1, 1, 1)], [circle(3, 1, 1)]], (4, 2), "a disk", ["early", "late"])
    toy = Toy("Play.", "a toy", "() => 0", [Slider("p", "p", 0, 0, 1, 0.1)])
    page = nbformat.v4.new_notebook(metadata={"kernelspec": {"name": "python3", "display_name": "Python 3"}})
    page.cells = [nbformat.v4.new_markdown_cell(
        "# A page\n\n$x^2$ and\n\n$$\n\\log x\n$$ (eq)\n\n[first](index.md), [a record](../records/0.npz), {eq}`eq`"
    )]  # fmt: skip
    for shown in (player, toy):
        output = nbformat.v4.new_output("display_data", {"text/html": shown._repr_html_()})
        page.cells.append(nbformat.v4.new_code_cell("shown", outputs=[output]))
    folder = small_book(one=page)
    (folder / "_build/notebooks").mkdir(parents=True)
    nbformat.write(page, folder / "_build/notebooks/one.ipynb")
    (folder / "records").mkdir()
    (folder / "records" / "0.npz").write_bytes(b"numbers")
    (folder / "book" / "index.md").write_text("# Small\n\n[elsewhere](https://example.org/)")
    with pytest.raises(book.BookError, match="has not been built"):
        book.build_epub()
    book.build(run=False)

    packed = book.build_epub()

    assert '<a href="book.epub">' in (folder / "_build/html/index.html").read_text()
    with zipfile.ZipFile(packed) as pages:
        text, listed = pages.read("one.xhtml").decode(), pages.read("content.opf").decode()
    drawn = ElementTree.fromstring(text)
    assert len(drawn.findall(f".//{MATHML}math")) == 2
    assert len(drawn.findall(".//{http://www.w3.org/2000/svg}circle")) == 2  # the first and the last frame
    assert not re.search("<script|<button|<input|Play\\.|0\\.npz", text)
    assert re.search('href="one.xhtml"[^>]* properties="mathml svg"', listed)
    if checker := shutil.which("epubcheck"):
        command = ["java", "-jar", checker] if zipfile.is_zipfile(checker) else [checker]  # Debian's is a Java archive
        outcome = subprocess.run([*command, packed], capture_output=True, text=True, check=False)
        assert outcome.returncode == 0, outcome.stderr
