"""The book for e-readers: Sphinx's EPUB builder, with formulas as MathML and without what needs a script."""

import re
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx
from sphinx.builders.epub3 import Epub3Builder
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number

__all__ = ["EpubBuilder", "for_readers", "mathml", "setup"]

#: What a reader cannot use there: toys, scripts, the buttons of an animation, choices of curves and rows, style sheets.
#: Curves that are not chosen leave the legend; without its style sheet an animation shows its first and last frame.
LIVE = re.compile(
    r'<figure class="toy".*?</figure>|<script.*?</script>|<style>.*?</style>|<div class="controls".*?</div>'
    r"|<fieldset><legend>Show</legend>.*?</fieldset>|<legend>Choose the curves:</legend>"
    r'|<label><input type="checkbox" value="\d+"/>.*?</label>|<input [^>]*>',
    re.DOTALL,
)
#: A folded cell has two titles, in paragraphs, of which style sheets show one.
FOLDED = re.compile(r"(<summary[^>]*>)\s*<p[^>]*>([^<]*)</p>.*?(?=</summary>)", re.DOTALL)
STYLE = """<style>
img, svg { max-width: 100%; height: auto; }
pre { white-space: pre-wrap; }
table { font-size: 0.8em; border-collapse: collapse; }
th, td { padding: 0.2em 0.4em; border-bottom: 1px solid #999999; text-align: left; vertical-align: top; }
code { overflow-wrap: anywhere; }
.eqno { float: right; }
.colon, .tag_parameters { display: none; }
.player p { white-space: pre-line; }
.swatch { width: 2em; height: 1em; }
</style>"""
#: Properties that the list of files states of a page, by what the page then holds.
PROPERTIES = {"mathml": "<math", "svg": "<svg"}
#: Commands that docutils does not know, and what says the same to it or nearly so; sizes of brackets and fractions
#: follow from where they stand.
KNOWN = {
    r"\\tfrac(?![a-zA-Z])": r"\\frac",
    r"\\[bB]ig+[lr]?(?![a-zA-Z])|\\textstyle": "",
    r"\\dots(?![a-zA-Z])": r"\\ldots",
    r"^\^": "{}^",
}

#: Words below a brace, which docutils writes as an index behind it.
BRACED = re.compile(r"<msub>(\s*<munder>.*?⏟</mo>\s*</munder>\s*<m\w+>[^<]*</m\w+>\s*)</msub>", re.DOTALL)


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the parts to Sphinx."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.add_builder(EpubBuilder, override=True)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


class EpubBuilder(Epub3Builder):
    """Sphinx's builder; its pages are XML, stand still, and link to nothing outside the book but public addresses."""

    @property
    def math_renderer_name(self) -> str:
        """The renderer of formulas: e-readers run no MathJax."""
        return "mathml"

    def add_css_file(self, filename: str, **kwargs: Any) -> None:
        """Keep the style sheets of the theme alone: others are for browsers."""
        if filename in ("epub.css", "pygments.css"):
            super().add_css_file(filename, **kwargs)

    def copy_html_static_files(self, context: dict[str, Any]) -> None:
        """Leave out what the pages of the website use."""

    def handle_page(self, pagename: str, addctx: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        """Write a page, its style sheets in its head."""
        addctx["metatags"] = addctx.get("metatags", "") + STYLE
        addctx["body"] = for_readers(addctx.get("body", ""))
        super().handle_page(pagename, addctx, *args, **kwargs)

    def build_content(self) -> None:
        """Write the list of files, with the properties that Sphinx leaves out."""
        super().build_content()
        listed = Path(self.outdir, "content.opf")
        text = listed.read_text(encoding="utf-8")
        listed.write_text(re.sub(r'(?<=<item )[^>]*href="([^"]*\.xhtml)"', self._described, text), encoding="utf-8")

    def _described(self, item: re.Match) -> str:
        page = Path(self.outdir, item[1])
        text = page.read_text(encoding="utf-8") if page.exists() else ""  # the contents are written later
        held = " ".join(name for name, tag in PROPERTIES.items() if tag in text)
        return item[0] + (f' properties="{held}"' if held else "")


def for_readers(body: str) -> str:
    """Return a page that stands still, with links to notebooks leading to their pages and none to files beside them."""
    body = FOLDED.sub(r"\1\2", LIVE.sub("", body)).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ')
    body = re.sub(r'href="(\w+)\.ipynb', r'href="\1.xhtml', body)
    return re.sub(r'(<a [^>]*?)href="(?!#|https?:|mailto:|[\w./]+\.xhtml)[^"]*"', r"\1", body)


def visit_inline(self: Any, node: nodes.math) -> None:
    """Write a formula in a line of text."""
    self.body.append(_formula(node, block=False))
    raise nodes.SkipNode


def visit_block(self: Any, node: nodes.math_block) -> None:
    """Write a formula of its own, with its number."""
    self.body.append(self.starttag(node, "div", CLASS="math"))
    if node["number"]:
        self.body.append(f'<span class="eqno">({get_node_equation_number(self, node)})</span>')
    self.body.append(_formula(node, block=True) + "</div>")
    raise nodes.SkipNode


def _formula(node: nodes.Element, *, block: bool) -> str:
    try:
        return mathml(node.astext(), block=block)
    except ValueError as error:
        logging.getLogger(__name__).warning("%s", error, location=node)
        return escape(node.astext())


def mathml(tex: str, *, block: bool) -> str:
    """Return a formula as an element of a page; raises ValueError if docutils does not read it."""
    tex = tex.strip()
    for unknown, known in KNOWN.items():
        tex = re.sub(unknown, known, tex)
    try:
        formula = latex2mathml.tex2mathml(tex, as_block=block)
    except (ValueError, LookupError) as error:
        raise ValueError(f"docutils does not read the formula {tex!r}: {error}") from error
    formula = BRACED.sub(r"<munder>\1</munder>", formula)
    return formula.replace("&ApplyFunction;", "&#x2061;")  # which XML does not know
