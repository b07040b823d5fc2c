"""The built book in a real browser: Chromium, pages served from this machine, names of other hosts resolved to none."""

import contextlib
import functools
import os
import shutil
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

HTML = Path(__file__).parents[1] / "_build" / "html"

PATIENCE = 120_000  # ms, for a machine that is busy with something else

#: Chromium by the names that systems give it; Playwright would otherwise look for one that it downloads.
NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--no-sandbox",  # containers run as root
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
)


def need(condition, message):
    """Skip the test if something is missing, except in continuous integration, where that is a failure."""
    if not condition:
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(message)


def built_pages():
    """Return the addresses of all pages of the built book, relative to its first."""
    need((HTML / "index.html").exists(), "the book has not been built: `make book` builds it")
    found = [path.relative_to(HTML) for path in HTML.rglob("*.html")]
    return sorted(path.as_posix() for path in found if path.parts[0] not in ("_static", "_sources"))


@contextlib.contextmanager
def chromium():
    """Yield a Chromium without a window and with an empty profile."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        need(False, "Playwright is not installed: `pip install -e '.[test]'` installs it")
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    need(program, "Chromium was not found: install it, or name the program in the environment variable CHROMIUM")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


class QuietHandler(SimpleHTTPRequestHandler):
    """Serves a folder without a line for every request."""

    def log_message(self, *_):
        """Say nothing."""


@contextlib.contextmanager
def served(folder):
    """Serve a folder on a free port of this machine and yield its address."""
    handler = functools.partial(QuietHandler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()
