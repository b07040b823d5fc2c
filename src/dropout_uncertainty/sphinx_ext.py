"""What the book needs from Sphinx beyond its configuration: offline formulas, the thesis's numbers, clean roles."""

import pkgutil
import re
import shutil
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

__all__ = ["setup"]

#: The first algorithm of the chapter is Algorithm 3 of the thesis.
FIRST_ALGORITHM = 3

MATHJAX = "mathjax/tex-svg.js"
SYSTEM_THEME = 'matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"'


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the parts to Sphinx."""
    app.connect("config-inited", lambda _app, config: setattr(config, "mathjax_path", MATHJAX))
    app.connect("source-read", list_modules)
    app.connect("autodoc-process-docstring", keep_lines, priority=400)
    app.connect("autodoc-process-docstring", restore_lines, priority=600)
    app.connect("build-finished", copy_mathjax)
    app.connect("build-finished", slim_pages)
    app.connect("env-get-updated", number_algorithms, priority=900)
    app.connect("html-page-context", mend_roles, priority=900)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def list_modules(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the line ``[modules of PACKAGE]`` by the documentation of its modules, so that none is forgotten."""
    source[0] = re.sub(r"^\[modules of ([\w.]+)\]$", lambda m: module_sections(m[1]), source[0], flags=re.MULTILINE)


def module_sections(package: str) -> str:
    """Return MyST text with one section for each module of a package."""
    names = [module.name for module in pkgutil.iter_modules(import_module(package).__path__) if not module.ispkg]
    section = "## {0}\n\n```{{eval-rst}}\n.. automodule:: {1}.{0}\n   :members:\n```\n"
    return "\n".join(section.format(name, package) for name in names if not name.startswith("__"))


def keep_lines(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Remember how a docstring reads before napoleon, which takes "Decay: c / N" for a type and its description."""
    app.env.temp_data["docstring"] = list(lines)


def restore_lines(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Give the description of an attribute its own words back; types come from the annotations."""
    if what in ("attribute", "data", "property"):
        lines[:] = app.env.temp_data["docstring"]


def copy_mathjax(app: Sphinx, exception: Exception | None) -> None:
    """Put the one MathJax file that draws formulas without fonts from elsewhere beside the pages.

    It must not lie in ``book/_static``: every script there is loaded by every page. The package's own extension would
    copy ten times as much.
    """
    if exception is None and app.builder.format == "html":
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
    if exception is not None or app.builder.format != "html":
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

    The theme puts every table of a page into a part that scrolls, but not those that come as HTML or from other pages.
    """
    body = context.get("body")
    if body:
        body = re.sub(r' role="(list|doc-biblioentry)"', "", body)
        scrolling = '<div class="pst-scrollable-table-container">'
        table = rf'(?<!{scrolling})<table class="table".*?</table>'
        body = re.sub(table, rf"{scrolling}\g<0></div>", body, flags=re.DOTALL)
        context["body"] = body.replace(' id="proof-content"', "")
