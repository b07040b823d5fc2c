"""A small book in a temporary folder, for the tests of what makes books."""

from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def small_book(tmp_path, monkeypatch):
    """Return a function that writes notebooks, given by name, into a repository with the real configuration."""
    from dropout_uncertainty.page import book  # late, so that shapes are checked

    monkeypatch.setattr(book, "_repository", lambda: tmp_path)
    (tmp_path / "notebooks").mkdir()
    pages = tmp_path / "book"
    pages.mkdir()
    (tmp_path / "_config.yml").write_text((ROOT / "_config.yml").read_text())
    (pages / "references.bib").write_text("")
    (pages / "_static").mkdir()
    (pages / "_static" / "favicon.svg").write_text("<svg/>")

    def write(**books):
        for name, content in books.items():
            nbformat.write(content, tmp_path / "notebooks" / f"{name}.ipynb")
        toc = ["format: jb-book", "root: index", "chapters:", *(f"- file: {name}" for name in books)]
        (pages / "_toc.yml").write_text("\n".join(toc))
        return tmp_path

    return write
