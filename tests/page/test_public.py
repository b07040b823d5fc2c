"""A book with a public address: buttons, cards, a sitemap and notebooks that start elsewhere."""

import json
import re

import nbformat
import pytest
from bs4 import BeautifulSoup

import dropout_uncertainty
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.page import book, public

URL = "https://github.com/someone/their-book"


@pytest.mark.parametrize("written", [URL, URL + "/", URL + ".git"])
def test_a_repository_is_named_in_any_usual_form(monkeypatch, written):
    monkeypatch.setenv(public.REPOSITORY, written)
    assert public.repository() == URL


@pytest.mark.parametrize("wrong", ["someone/their-book", "https://example.org/a/b", URL + "/tree/main"])
def test_an_address_that_is_none_is_refused_before_anything_runs(monkeypatch, wrong):
    monkeypatch.setenv(public.REPOSITORY, wrong)
    monkeypatch.setattr(book, "_run_notebooks", lambda *_: pytest.fail("a notebook ran"))
    with pytest.raises(UserError, match=r"names a repository like https://github\.com/OWNER/NAME, got"):
        book.build()


@pytest.mark.parametrize("empty", [None, ""])
def test_without_an_address_nothing_is_connected(monkeypatch, empty):
    monkeypatch.delenv(public.REPOSITORY, raising=False)
    if empty is not None:
        monkeypatch.setenv(public.REPOSITORY, empty)
    public.setup(None)  # would fail at the first thing to connect


def test_notebooks_install_the_package_only_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setenv(public.REPOSITORY, URL)
    cells = [nbformat.v4.new_markdown_cell("# A page – ω"), nbformat.v4.new_code_cell("1")]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), tmp_path / "one.ipynb")
    public.write_launchable(tmp_path, tmp_path / "launch")
    written = nbformat.read(tmp_path / "launch" / "one.ipynb", as_version=4)
    nbformat.validate(written)
    first, *others = written.cells
    assert [cell.source for cell in others] == [cell.source for cell in cells]
    assert f"git clone --quiet --depth 1 --branch launch {URL} book" in first.source
    plain = re.sub(r"^    [!%].*$", "    raise AssertionError", first.source, flags=re.MULTILINE)
    exec(plain, {})  # the package is there: nothing is installed


def test_a_public_book(small_book, monkeypatch):
    monkeypatch.setenv(public.REPOSITORY, URL)
    page = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell("# A *page*\n\nIt says “so”.")])
    folder = small_book(one=page)
    (folder / "_build/notebooks").mkdir(parents=True)
    nbformat.write(page, folder / "_build/notebooks/one.ipynb")
    (folder / "book" / "index.md").write_text("# Small & plain\n\nVersion [version].")

    book.build(run=False)

    found = {name: BeautifulSoup((folder / f"_build/html/{name}.html").read_text(), "html.parser") for name in PAGES}
    for name, (source, title) in PAGES.items():
        links = {link["href"] for link in found[name].find_all("a", href=True)}
        assert {URL, f"{URL}/edit/main/{source}"} <= links
        assert any(link.startswith(f"{URL}/issues/new?") for link in links)
        cards = {tag["property"]: tag["content"] for tag in found[name].find_all("meta", property=re.compile("^og:"))}
        assert (cards["og:title"], cards["og:site_name"]) == (title, "Dropout Uncertainty in Action")
        assert cards["og:url"] == f"https://someone.github.io/their-book/{name}.html"
        footer = found[name].find(class_="extra_footer")
        assert f"Version {dropout_uncertainty.__version__}, commit " in footer.get_text()
        assert footer.a["href"].startswith(f"{URL}/tree/")
    launched = {link["href"] for link in found["one"].find_all("a", href=re.compile("colab|binder"))}
    assert launched == {
        "https://colab.research.google.com/github/someone/their-book/blob/launch/notebooks/one.ipynb",
        "https://mybinder.org/v2/gh/someone/their-book/launch?urlpath=lab/tree/notebooks/one.ipynb",
    }
    assert f"Version {dropout_uncertainty.__version__}." in found["index"].get_text()
    sitemap = (folder / "_build/html/sitemap.xml").read_text()
    assert re.findall("<loc>(.*)</loc>", sitemap) == [f"https://someone.github.io/their-book/{n}.html" for n in PAGES]
    assert json.loads((folder / "_build/launch/one.ipynb").read_text())["cells"][0]["id"] == "install"


PAGES = {"index": ("book/index.md", "Small & plain"), "one": ("notebooks/one.ipynb", "A page")}
