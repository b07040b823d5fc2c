"""The machinery that makes the book, and the HTML that it made."""

import os
import re
import shutil
from functools import cache
from pathlib import Path
from urllib.parse import unquote, urlsplit

import nbformat
import pytest
from bs4 import BeautifulSoup
from filelock import FileLock
from pybtex.database import parse_file

from dropout_uncertainty.errors import UserError
from dropout_uncertainty.page import book, plotting, sphinx_ext, tables

ROOT = Path(__file__).parents[2]
HTML = ROOT / "_build" / "html"


# --- the machinery, on small books


def notebook(*sources, parameters="profile = 'recorded'"):
    cells = [nbformat.v4.new_code_cell(parameters, metadata={"tags": ["parameters"]})]
    return nbformat.v4.new_notebook(
        cells=[*cells, *map(nbformat.v4.new_code_cell, sources)],
        metadata={"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}},
    )


def test_unknown_profile_and_notebook_are_refused_before_anything_runs(small_book):
    small_book(one=notebook("1/0"))
    with pytest.raises(UserError, match="unknown profile 'fast', choose one of recorded, quick, full"):
        book.run_notebooks("fast")
    with pytest.raises(UserError, match="there is no notebook 'two', choose from one"):
        book.run_notebooks("quick", ["two"])


def test_failing_cell_is_named_with_its_error(small_book):
    folder = small_book(one=notebook("x = 1", "y = x / 0  # the culprit"))
    with pytest.raises(book.BookError) as caught:
        book.run_notebooks("quick")
    assert str(caught.value) == (
        "notebooks/one.ipynb stopped in its cell 3 (`y = x / 0  # the culprit`): ZeroDivisionError: division by zero"
    )
    assert not (folder / "_build/notebooks/one.ipynb").exists()


@pytest.mark.parametrize("pause", [0, 1])  # the kernel may say that it has begun the cell, or not come to that
def test_kernel_that_dies_is_reported_with_its_cell(small_book, pause):
    folder = small_book(one=notebook("x = 1", f"import os, time; time.sleep({pause}); os._exit(1)", "y = 2"))
    with pytest.raises(
        book.BookError, match=r"one\.ipynb stopped in its cell 3 \(`import os, time; .*`\): Kernel died"
    ):
        book.run_notebooks("quick")
    assert not (folder / "_build/notebooks/one.ipynb").exists()


def test_notebook_without_a_kernel_is_refused(small_book):
    content = notebook("x = 1")
    content.metadata["kernelspec"]["name"] = "octave"
    small_book(one=content)
    with pytest.raises(book.BookError, match=r"one\.ipynb stopped before its first cell: No such kernel named octave"):
        book.run_notebooks("quick")


def test_second_process_is_refused(small_book):
    folder = small_book(one=notebook("1/0"))
    (folder / "_build").mkdir()
    with FileLock(folder / "_build" / ".lock"), pytest.raises(book.BookError, match="another process"):
        book.run_notebooks()


def test_notebook_that_was_not_run_is_not_published(small_book):
    small_book(one=notebook("1"))
    with pytest.raises(book.BookError, match=r"notebooks/one.ipynb has not been run"):
        book.build(run=False)


def test_notebooks_of_another_profile_are_not_published(small_book, monkeypatch, capsys):
    folder = small_book(one=notebook("1"))
    ran = notebook("1")
    ran.metadata["papermill"] = {"parameters": {"profile": "quick"}}
    (folder / "_build/notebooks").mkdir(parents=True)
    nbformat.write(ran, folder / "_build/notebooks/one.ipynb")
    monkeypatch.setattr(book, "_build_html", lambda: None)
    with pytest.raises(
        book.BookError, match=r"one.ipynb was last run in profile quick, not recorded: leave --skip-run"
    ):
        book.build("recorded", run=False)
    for profile in ("quick", None):
        book.build(profile, run=False)
        assert "as last run, in profile quick" in capsys.readouterr().out


PICTURE = "import matplotlib.pyplot as plt; plt.plot([1, 2]); plt.show()"
ALGORITHM = "```{prf:algorithm} Steps\n:label: steps\n\nDo it.\n```\n\n{prf:ref}`steps` and {numref}`fig-5-1`"


def test_small_book_from_interrupted_run_to_html(small_book, monkeypatch, capsys):
    pages = notebook(PICTURE, "import os; print(profile, other, os.path.basename(os.getcwd()))")
    pages.cells[0].source = "profile = 'recorded'\nother = [1, 'two']"
    pages.cells[1].metadata["mystnb"] = {
        "figure": {"caption": "A line.", "name": "fig-5-1"},
        "image": {"alt": "a line"},
    }
    pages.cells += [nbformat.v4.new_markdown_cell("# A page\n\n[a record](../records/x/0.npz)\n\n" + ALGORITHM)]
    folder = small_book(one=pages)
    (folder / "records" / "x").mkdir(parents=True)
    (folder / "records" / "x" / "0.npz").write_bytes(b"numbers")
    (folder / "book" / "index.md").write_text("# Small\n\n$x^2$ in {numref}`Table %s <tab-5-1>`\n\n" + TABLE)
    for left in ("notebooks/gone.ipynb", "running/one.ipynb", "source/gone.md", "html/gone.html"):
        (folder / "_build" / left).parent.mkdir(parents=True, exist_ok=True)
        (folder / "_build" / left).write_text("half a file")
    monkeypatch.chdir("/")
    monkeypatch.delenv("MPLBACKEND", raising=False)

    page = book.build("quick")

    assert page == folder / "_build/html/index.html"
    assert f"open {page}" in capsys.readouterr().out
    assert not (folder / "_build/html/gone.html").exists()
    executed = nbformat.read(folder / "_build/notebooks/one.ipynb", as_version=4)
    assert executed.cells[3].outputs[0].text == "quick [1, 'two'] notebooks\n"
    assert str(folder) not in (folder / "_build/notebooks/one.ipynb").read_text()
    took = book.times()["quick"]["one"]
    assert took["seconds"] > took["cpu_seconds"] / took["cores"] > 0
    assert 20 < took["megabytes"] < 2000
    text = " ".join(BeautifulSoup((folder / "_build/html/one.html").read_text(), "html.parser").get_text().split())
    assert "Figure 5.1 A line." in text
    assert "Algorithm 3 (Steps)" in text
    assert "Algorithm 3 and Figure 5.1" in text
    assert (folder / "_build/html/_static/mathjax/tex-svg.js").exists()
    assert [path.read_bytes() for path in (folder / "_build/html/_downloads").rglob("0.npz")] == [b"numbers"]


TABLE = "```{table} A caption.\n:name: tab-5-1\n\n| a |\n| - |\n| 1 |\n```"


def test_warning_stops_the_build_and_names_the_page(small_book):
    folder = small_book(one=notebook("1"))
    (folder / "_build/notebooks").mkdir(parents=True)
    nbformat.write(notebook("1"), folder / "_build/notebooks/one.ipynb")
    (folder / "book" / "index.md").write_text("# Small\n\n[](nowhere.md)")
    with pytest.raises(book.BookError, match=r"index.md:3: WARNING: .*nowhere"):
        book.build(run=False)


@pytest.mark.slow
def test_the_whole_book_is_one_pdf(small_book):
    if not any(map(shutil.which, book.CHROMIUM)):
        pytest.skip("there is no Chromium")
    page = notebook("1")
    page.cells += [nbformat.v4.new_markdown_cell("# A page")]
    folder = small_book(one=page)
    (folder / "_build/notebooks").mkdir(parents=True)
    nbformat.write(page, folder / "_build/notebooks/one.ipynb")
    (folder / "records").mkdir()
    (folder / "records" / "0.npz").write_bytes(b"numbers")
    links = "[a page](one.ipynb), [a record](../records/0.npz), [elsewhere](https://example.org/)"
    (folder / "book" / "index.md").write_text(f"# Small\n\n{links}")
    book.build(run=False)
    content = book.print_pdf().read_bytes()
    assert content.startswith(b"%PDF")
    assert b"/Title (A page)" in content  # of the outline
    assert b"https://example.org/" in content
    assert b"document-one" in content
    assert b"file:" not in content
    assert '<a href="book.pdf">' in (folder / "_build/html/index.html").read_text()


def test_paper_leaves_out_what_would_double_it():
    text = (
        '<p>see <a class="x" href="one.html#a">one</a>, <a href="api/core.html#dropout_uncertainty.bayes">bayes</a></p>'
        f"<details><summary>{tables.ORIGIN}: seeds 0-9</summary><pre>settings</pre></details>"
        "<details><summary>Solution</summary>yes</details>"
        '<span id="document-api/core"></span><p>MLP</p><span id="document-api/more"></span><p>Q</p>'
        '<span id="document-citing"></span><p>Cite</p>'
    )
    assert book._for_paper(text) == (
        '<p>see <a class="x" href="#a">one</a>, <a >bayes</a></p>'
        f"<p>{tables.ORIGIN}: seeds 0-9</p><details><summary>Solution</summary>yes</details>"
        '<span id="document-citing"></span><p>Cite</p>'
    )


def test_a_pdf_needs_a_book_and_a_browser(small_book, monkeypatch):
    small_book(one=notebook("1"))
    monkeypatch.setenv("CHROMIUM", "chromium")
    with pytest.raises(book.BookError, match="has not been built"):
        book.print_pdf()
    monkeypatch.delenv("CHROMIUM")
    monkeypatch.setattr(book, "CHROMIUM", ())
    with pytest.raises(book.BookError, match="Chromium prints the PDF: install it"):
        book.print_pdf()


def test_modules_of_a_package_are_listed_for_the_api_pages():
    text = sphinx_ext.module_sections("dropout_uncertainty")
    assert "## bayes\n\n```{eval-rst}\n.. automodule:: dropout_uncertainty.bayes\n   :members:\n```" in text
    assert "__main__" not in text


def test_what_the_api_pages_link_to_is_there(small_book):
    folder = small_book()
    shutil.copytree(ROOT / "book" / "api", folder / "book" / "api")
    pages = sorted(page.stem for page in (folder / "book" / "api").iterdir())
    (folder / "book" / "_toc.yml").write_text("\n".join(["format: jb-book", "root: api/core", "chapters:",
        *(f"- file: api/{page}" for page in pages if page != "core")]))  # fmt: skip
    assert book.build(run=False).exists()


def test_references_are_labelled_as_the_text_cites():
    entries = sphinx_ext.Names().sort(parse_file(str(ROOT / "book" / "references.bib")).entries.values())
    labels = list(sphinx_ext.NameLabels().format_labels(entries))
    assert len(set(labels)) == len(entries)
    assert {"Gal, 2016", "Bulò et al., 2016", "Press and Wolf, 2017", "Gal and Ghahramani, 2016b"} <= set(labels)


# --- the HTML of the book itself


def pages():
    if not (HTML / "index.html").exists():
        if os.environ.get("CI") == "true":
            pytest.fail("the book has not been built: run `make book`")
        pytest.skip("the book has not been built: `make book` builds it")
    return sorted(path for path in HTML.rglob("*.html") if "_static" not in path.parts)


@cache
def soup(path):
    return BeautifulSoup(path.read_text(encoding="utf-8"), "html.parser")


@cache
def anchors(path):
    return {tag["id"] for tag in soup(path).find_all(id=True)} | {
        tag["name"] for tag in soup(path).find_all("a", {"name": True})
    }


def test_internal_links_and_fragments_lead_somewhere():
    broken, checked = [], 0
    for page in pages():
        for tag in soup(page).find_all("a", href=True):
            link = urlsplit(tag["href"])
            if link.scheme or link.netloc:
                continue
            target = (page.parent / unquote(link.path)).resolve() if link.path else page
            checked += 1
            if not target.exists() or (
                link.fragment and target.suffix == ".html" and unquote(link.fragment) not in anchors(target)
            ):
                broken.append(f"{page.name}: {tag['href']}")
    assert checked > 100
    assert not broken


def test_every_picture_exists_and_says_what_is_to_be_seen():
    found = [(page, image) for page in pages() for image in soup(page).find_all("img")]
    assert found
    for page, image in found:
        assert (page.parent / unquote(image["src"])).exists(), f"{page.name}: {image['src']} is missing"
        assert re.search(r"\w+ \w+", image.get("alt", "")), f"{page.name}: describe {image['src']}"


def test_no_page_shows_the_warnings_of_a_program():
    shown = [(page.name, text.get_text()[:80]) for page in pages() for text in soup(page).select(".output.stderr")]
    assert not shown


def test_no_figure_is_wider_than_the_column_of_text():
    images = [(page, image) for page in pages() for image in soup(page).select(".cell_output img")]
    assert images
    for page, image in images:
        width = re.search(r"width: (\d+)px", image["style"])
        assert int(width[1]) <= 96 * plotting.WIDTH + 1, f"{page.name}: {image['alt']}"


def test_nothing_is_loaded_from_another_host():
    loaded, own = [], set()
    for page in pages():
        for tag in soup(page).find_all(["script", "img", "iframe", "source", "video", "audio", "embed", "link"]):
            address = tag.get("src") or tag.get("href") or ""
            if address.startswith(("http:", "https:", "//")):
                loaded.append(f"{page.name}: {address}")
            elif address:
                own.add(tag.name)
        loaded += [f"{page.name}: {script.string[:80]}" for script in soup(page).find_all("script") if _fetches(script)]
    for sheet in (HTML / "_static").rglob("*.css"):
        loaded += re.findall(r"(?:@import|url\()\s*['\"]?(?:https?:)?//[^)'\"]*", sheet.read_text(encoding="utf-8"))
    assert {"script", "img", "link"} <= own, "addresses have been looked at"
    assert any((HTML / "_static").rglob("*.css"))
    assert not loaded


def _fetches(script):
    return script.string is not None and re.search(r"['\"](https?:)?//\w", script.string) is not None


def test_captions_carry_the_numbers_of_the_thesis():
    kinds = {"fig": "Figure", "tab": "Table"}
    named = [tag for page in pages() for tag in soup(page).find_all(id=re.compile(r"^(fig|tab)-5-\d+$"))]
    assert {tag["id"][:3] for tag in named} == set(kinds)
    for tag in named:
        kind, number = tag["id"].split("-5-")
        caption = tag.find(class_="caption-number").get_text(strip=True)
        assert caption == f"{kinds[kind]} 5.{number}"
    numbered = [tag for page in pages() for tag in soup(page).find_all(class_="caption-number")]
    strangers = [
        tag.get_text(strip=True) for tag in numbered if tag.find_parent(id=re.compile(r"^(fig|tab)-5-\d+$")) is None
    ]
    assert len(numbered) > len(strangers) > 0
    assert all(text.startswith("Algorithm") for text in strangers), (
        "pictures without a number of the thesis carry no caption"
    )
