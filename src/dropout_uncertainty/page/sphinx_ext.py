"""What the book needs from Sphinx beyond its configuration: offline formulas, the thesis's numbers, clean roles."""

import pkgutil
import re
import shutil
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

from pybtex.plugin import register_plugin
from pybtex.style.formatting.alpha import Style as Alpha
from pybtex.style.labels import BaseLabelStyle
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.environment import BuildEnvironment

from dropout_uncertainty import __version__

__all__ = ["setup"]

#: The first algorithm of the chapter is Algorithm 3 of the thesis.
FIRST_ALGORITHM = 3

MATHJAX = "mathjax/tex-svg.js"
#: Builders of pages for browsers; an EPUB has no scripts.
WEBSITE = ("html", "singlehtml")
#: What the theme puts around a table that may be wider than the page.
SCROLLING = '<div class="pst-scrollable-table-container">'
SYSTEM_THEME = 'matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"'


class NameLabels(BaseLabelStyle):
    """Labels of the list of references as the text cites: names and year, with a letter where they are the same."""

    def format_labels(self, sorted_entries: Sequence[Any]) -> Iterator[str]:
        """Yield the label of each entry, e.g. "Houlsby et al., 2011"."""
        names = [f"{_names(entry)}, {entry.fields['year']}" for entry in sorted_entries]
        for place, name in enumerate(names):
            yield name + ("abcdefgh"[names[:place].count(name)] if names.count(name) > 1 else "")


def _names(entry: Any) -> str:
    last = [
        " ".join(map(str, person.rich_prelast_names + person.rich_last_names)) for person in entry.persons["author"]
    ]
    if len(last) > 2:
        return f"{last[0]} et al."
    return " and ".join(last)


class Names(Alpha):
    """The style of the list of references."""

    default_label_style = NameLabels


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the parts to Sphinx."""
    register_plugin("pybtex.style.formatting", "names", Names)
    app.connect("config-inited", set_what_is_known_here)
    app.connect("source-read", fill_in)
    app.connect("autodoc-process-docstring", keep_lines, priority=400)
    app.connect("autodoc-process-docstring", restore_lines, priority=600)
    app.connect("build-finished", copy_mathjax)
    app.connect("build-finished", slim_pages)
    app.connect("env-get-updated", number_algorithms, priority=900)
    app.connect("html-page-context", mend_roles, priority=900)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def set_what_is_known_here(app: Sphinx, config: Config) -> None:
    """Set the version of the book, which is that of the package, and where MathJax lies."""
    config.version, config.mathjax_path = __version__, MATHJAX


def fill_in(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace ``[modules of PACKAGE]`` by the documentation of its modules, and ``[version]`` by the package's.

    ``[modules below PACKAGE]`` takes those of the packages inside it, too; so none is forgotten.
    """
    source[0] = re.sub(
        r"^\[modules (of|below) ([\w.]+)\]$",
        lambda m: module_sections(m[2], below=m[1] == "below"), source[0], flags=re.MULTILINE,
    ).replace("[version]", __version__)  # fmt: skip


def module_sections(package: str, *, below: bool = False) -> str:
    """Return MyST text with one section for each module of a package, and (``below``) of the packages inside it."""
    walk = pkgutil.walk_packages if below else pkgutil.iter_modules
    found = [m.name for m in walk(import_module(package).__path__, f"{package}.") if not m.ispkg]
    section = "## {0}\n\n```{{eval-rst}}\n.. automodule:: {1}\n   :members:\n```\n"
    names = [name for name in found if not name.rpartition(".")[2].startswith("__")]
    return "\n".join(section.format(name.removeprefix(f"{package}."), name) for name in names)


def keep_lines(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Remember how a docstring reads before napoleon, which takes "Decay: c / N" for a type and its description."""
    app.env.temp_data["docstring"] = list(lines)


def restore_lines(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Give the description of an attribute its own words back; types come from the annotations.

    What Python itself says of the fields of a named tuple is left out: the class describes them.
    """
    if what in ("attribute", "data", "property"):
        words = app.env.temp_data["docstring"]
        lines[:] = [line for line in words if not line.startswith("Alias for field number")]


def copy_mathjax(app: Sphinx, exception: Exception | None) -> None:
    """Put the one MathJax file that draws formulas without fonts from elsewhere beside the pages.

    It must not lie in ``book/_static``: every script there is loaded by every page. The package's own extension would
    copy ten times as much.
    """
    if exception is None and app.builder.name in WEBSITE:
        target = Path(app.outdir, "_static", MATHJAX)
        target.parent.mkdir(parents=True, exist_ok=True)
        package = distribution("sphinx-mathjax-offline")
        shutil.copyfile(str(package.locate_file(f"sphinx-mathjax-offline/static/{MATHJAX}")), target)


def slim_pages(app: Sphinx, exception: Exception | None) -> None:
    """Take out of every page what it loads in vain, and of the book what no page loads.

    The theme's style sheet draws the icons from a font; its script of 1.5 MB would draw the same ones again. Sphinx
    loads MathJax on a page whose subpages hold formulas. Without a stored choice the theme starts with no colours and
    an error on the console; it shall follow the system.
    """
    if exception is not None or app.builder.name not in WEBSITE:
        return
    for page in Path(app.outdir).rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        text = re.sub(r"<script[^>]*fontawesome\.js[^>]*></script>\s*", "", text)
        if 'class="math' not in text:
            text = re.sub(r"<script[^>]*>\s*window\.MathJax.*?</script>\s*", "", text, flags=re.DOTALL)
            text = re.sub(r"<script[^>]*mathjax/[^>]*></script>\s*", "", text)
        text = text.replace('getItem("mode") || ""', 'getItem("mode") || "auto"')
        text = text.replace('getItem("theme") || ""', f'getItem("theme") || ({SYSTEM_THEME})')
        page.write_text(text, encoding="utf-8")
    static = Path(app.outdir, "_static")
    for unused in (*static.rglob("*.map"), static / "scripts" / "fontawesome.js"):
        unused.unlink(missing_ok=True)


def number_algorithms(app: Sphinx, env: BuildEnvironment) -> list[str]:
    """Number algorithms as the thesis does; sphinx-proof has no option for the first number."""
    for kinds in env.toc_fignumbers.values():
        for name, number in kinds.get("algorithm", {}).items():
            kinds["algorithm"][name] = (*number[:-1], number[-1] + FIRST_ALGORITHM - 1)
    return []


def mend_roles(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object) -> None:
    """Mend what readers stumble over: list roles without a list, an id used several times, tables wider than a phone.

    The theme puts every table of a page into a part that scrolls, but not a table that comes as HTML, as those glued
    from another page do; their links lead to notebooks, of which the book has pages.
    """
    body = context.get("body")
    if body:
        body = re.sub(r' role="(list|doc-biblioentry)"', "", body)
        table = rf'(?<!{SCROLLING})<table class="table".*?</table>'
        body = re.sub(table, lambda found: _table_of_a_page(found[0]), body, flags=re.DOTALL)
        context["body"] = body.replace(' id="proof-content"', "")


def _table_of_a_page(table: str) -> str:
    return SCROLLING + re.sub(r'href="(\w+)\.ipynb', r'href="\1.html', table) + "</div>"
