"""What a book with a public address has beside its pages: buttons, cards, a sitemap, notebooks that start elsewhere.

``DROPOUT_UNCERTAINTY_REPOSITORY`` names the repository, as https://github.com/OWNER/NAME; the book is meant to lie at
https://OWNER.github.io/NAME/. Without it nothing here does anything, and no page knows of another host.
"""

import html
import json
import os
import re
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import dropout_uncertainty
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs import records

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.config import Config

__all__ = ["LAUNCH", "REPOSITORY", "repository", "setup", "write_launchable"]

REPOSITORY = "DROPOUT_UNCERTAINTY_REPOSITORY"
SITEMAP = "http://www.sitemaps.org/schemas/sitemap/0.9"
#: The branch with the notebooks of ``write_launchable``, from which Colab and Binder start.
LAUNCH = "launch"
SERVICES = {
    "colab_url": "https://colab.research.google.com",
    "binderhub_url": "https://mybinder.org",
    "notebook_interface": "jupyterlab",
}
INSTALL = """\
# Where the package is missing, as on Colab, it is installed with the records and the data.
import importlib.util, os

if importlib.util.find_spec("dropout_uncertainty") is None:
    !git clone --quiet --depth 1 --branch {branch} {repository} book
    %pip install --quiet "./book[gym]" myst-nb
    os.environ["DROPOUT_UNCERTAINTY_RECORDS"] = os.path.abspath("book/records")
    os.environ["DROPOUT_UNCERTAINTY_DATA"] = os.path.abspath("book/data/mnist")"""


def repository() -> str | None:
    """Return the address of the public repository, None if it has none; raises UserError if it is not one of GitHub."""
    url = os.environ.get(REPOSITORY, "").removesuffix("/").removesuffix(".git")
    if url and not re.fullmatch(r"https://github\.com/[\w.-]+/[\w.-]+", url):
        raise UserError(f"{REPOSITORY} names a repository like https://github.com/OWNER/NAME, got {url!r}")
    return url or None


def write_launchable(notebooks: Path, folder: Path) -> None:
    """Write the notebooks of one folder into another, each with a first cell that installs the package if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    code = INSTALL.format(branch=LAUNCH, repository=repository())
    cell = {
        "cell_type": "code", "execution_count": None, "id": "install", "metadata": {"jupyter": {"source_hidden": True}},
        "outputs": [], "source": code.splitlines(keepends=True),
    }  # fmt: skip
    for path in notebooks.glob("*.ipynb"):
        content = json.loads(path.read_text(encoding="utf-8"))
        content["cells"].insert(0, cell)
        (folder / path.name).write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def setup(app: "Sphinx") -> dict[str, Any]:
    """Connect the parts to Sphinx, if there is a public address."""
    if repository():
        app.connect("config-inited", _set_addresses)
        app.connect("builder-inited", _launch_from_their_branch, priority=900)  # the theme has noted the one to edit
        app.connect("html-page-context", _place_page, priority=400)  # before the theme makes its buttons
        app.connect("build-finished", _write_sitemap)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def _set_addresses(app: "Sphinx", config: "Config") -> None:
    url, commit = str(repository()), str(records.provenance()["commit"])
    owner, name = url.split("/")[-2:]
    config.html_baseurl = f"https://{owner}.github.io/{name}/"
    buttons = dict.fromkeys(("use_repository_button", "use_edit_page_button", "use_issues_button"), True)
    config.html_theme_options |= buttons | {
        "repository_url": url,
        "repository_branch": "main",
        "launch_buttons": SERVICES,
        "extra_footer": f"Version {dropout_uncertainty.__version__}, "
        f'commit <a href="{url}/tree/{commit}">{commit[:8]}</a>',
    }


def _launch_from_their_branch(app: "Sphinx") -> None:
    app.config.html_theme_options["repository_branch"] = LAUNCH


def _place_page(app: "Sphinx", page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Say in which folder of the repository a page has its source, and what a card of it shows elsewhere."""
    folder = "notebooks" if context.get("page_source_suffix") == ".ipynb" else "book"
    context["doc_path"] = app.config.html_theme_options["path_to_docs"] = folder
    if doctree is not None:
        paragraph = next(iter(doctree.findall(lambda node: node.tagname == "paragraph")), None)
        card = {
            "title": html.unescape(re.sub(r"<[^>]*>", "", context["title"])),
            "type": "article",
            "url": app.config.html_baseurl + app.builder.get_target_uri(page),
            "site_name": app.config.html_title,
            "description": textwrap.shorten(paragraph.astext(), 200, placeholder=" …") if paragraph else "",
        }
        context["metatags"] = context.get("metatags", "") + "".join(
            f'\n<meta property="og:{key}" content="{html.escape(value)}" />' for key, value in card.items()
        )


def _write_sitemap(app: "Sphinx", exception: Exception | None) -> None:
    if exception is None and app.builder.format == "html":
        pages = [app.config.html_baseurl + app.builder.get_target_uri(page) for page in sorted(app.env.found_docs)]
        entries = "".join(f"<url><loc>{html.escape(page)}</loc></url>\n" for page in pages)
        text = f'<?xml version="1.0" encoding="utf-8"?>\n<urlset xmlns="{SITEMAP}">\n{entries}</urlset>\n'
        Path(app.outdir, "sitemap.xml").write_text(text, encoding="utf-8")
