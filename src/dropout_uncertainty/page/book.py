"""Make the book: run the notebooks, lay the pages out and build the HTML.

Everything made here lies under ``_build/``: ``notebooks/`` (executed), ``source/`` (the prose of ``book/`` and the
executed notebooks side by side) and ``html/``; of a book with a public address also ``launch/`` (see ``public``), for
the PDF ``singlehtml/``, and for e-readers ``epub/``. What an interrupted run leaves behind is removed by the next one.
"""

import ast
import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from dropout_uncertainty import folders
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.page import dark_pages, profiles, public, tables
from dropout_uncertainty.runs import executors, records

__all__ = ["BookError", "build", "build_epub", "notebooks", "print_pdf", "run_notebooks", "times"]

# all relative to the repository: papermill and Sphinx write the paths they are given into the published pages
NOTEBOOKS, PROSE, CONFIG = Path("notebooks"), Path("book"), Path("_config.yml")
BUILD = Path("_build")
EXECUTED, RUNNING, SOURCE, HTML = BUILD / "notebooks", BUILD / "running", BUILD / "source", BUILD / "html"
LAUNCHABLE = BUILD / "launch"
#: The figures for dark pages.
SECOND = BUILD / "dark"
SINGLE, PDF = BUILD / "singlehtml", HTML / "book.pdf"
PACKED, EPUB = BUILD / "epub", HTML / "book.epub"
# beside the source as beside the notebooks, so that the same links lead to them from both
RECORDS, COPIED = Path("records"), BUILD / "records"
LOG = BUILD / "jupyter-book.log"
TIMES = BUILD / "times.json"
#: Chromium by the names that systems give it, and how it prints without a window.
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
PRINTS = (
    "--headless",
    "--no-sandbox",  # containers run as root
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--force-prefers-reduced-motion",  # animations stay at their first frame
    "--virtual-time-budget=120000",  # until all formulas are drawn
    "--no-pdf-header-footer",
    "--generate-pdf-document-outline",
)
#: The notebook that shows what the others took, and runs after them.
LAST = "scoreboard"


class BookError(UserError):
    """The book could not be made; the message says which notebook or page and why."""


def notebooks() -> list[str]:
    """Return the names of the notebooks of the repository, without suffix, in the order in which they run."""
    names = [path.stem for path in (_repository() / NOTEBOOKS).glob("*.ipynb")]
    return sorted(names, key=lambda name: (name == LAST, name))


def times() -> dict[str, dict[str, dict[str, Any]]]:
    """Return what the last run of each notebook in each profile took here, by profile and name.

    Each has ``seconds``, ``cpu_seconds``, ``megabytes`` (the most that the notebook and its workers held at once),
    ``processor``, ``cores`` and ``date``.
    """
    with contextlib.suppress(FileNotFoundError, json.JSONDecodeError):
        return json.loads((_repository() / TIMES).read_text(encoding="utf-8"))
    return {}


def run_notebooks(profile: str = "recorded", names: Sequence[str] | None = None) -> dict[str, float]:
    """Run notebooks from top to bottom in the given profile and return the seconds each took.

    Args:
        profile: one of ``profiles.PROFILES``.
        names: notebooks to run, without suffix; all of them by default.

    Raises:
        UserError: if the profile or a name is unknown, or the folder of the records is not there.
        BookError: if a cell fails, naming notebook and cell; the notebook up to there is kept in ``_build/running``.
    """
    profiles.check(profile)
    with _only_one():
        return _run_notebooks(profile, names)


def build(profile: str | None = None, *, run: bool = True) -> Path:
    """Run all notebooks (unless ``run`` is false), build the HTML and return the path of its first page.

    Args:
        profile: that of the run, by default "recorded"; without a run that of the last one, by default whatever it was.
        run: whether the notebooks are run.

    Raises:
        UserError: if the profile is unknown, the folder of the records is not there, or the public address is none.
        BookError: if a notebook fails, was not run before or in another profile, or jupyter-book reports an error or a
            warning.
    """
    if profile is not None:
        profiles.check(profile)
    address = public.repository()
    begin = time.monotonic()
    with _only_one():
        if run:
            _run_notebooks(profile or "recorded", None)
        else:
            _check_profile(profile)
        _assemble()
        _build_html()
        if address:
            public.write_launchable(NOTEBOOKS, LAUNCHABLE)
        page = HTML.resolve() / "index.html"
    print(f"The book is ready after {_duration(time.monotonic() - begin)}; open {page}")
    return page


def print_pdf() -> Path:
    """Print the book as it was last built, all pages as one PDF; return its path, to which the first page then links.

    Raises:
        BookError: if the book has not been built, jupyter-book reports a warning, or Chromium is missing or fails.
    """
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, CHROMIUM)), None)
    if program is None:
        raise BookError("Chromium prints the PDF: install it, or name it in the environment variable CHROMIUM")
    begin = time.monotonic()
    with _only_one(), tempfile.TemporaryDirectory() as scratch:
        _check_built()
        shutil.rmtree(SINGLE, ignore_errors=True)
        _jupyter_book("singlehtml")
        page = SINGLE / "index.html"
        page.write_text(_for_paper(page.read_text(encoding="utf-8")), encoding="utf-8")
        command = [program, *PRINTS, f"--user-data-dir={scratch}", f"--print-to-pdf={PDF.resolve()}"]
        outcome = subprocess.run([*command, page.resolve().as_uri()], capture_output=True, text=True, check=False)
        if outcome.returncode != 0 or not PDF.exists():
            raise BookError(f"{program} could not print the book: {outcome.stderr.strip()[-500:]}")
        _link(PDF, "The whole book as one PDF")
        path = PDF.resolve()
    print(f"The PDF is ready after {_duration(time.monotonic() - begin)}; open {path}")
    return path


def build_epub() -> Path:
    """Make an EPUB of the book as it was last built; return its path, to which the first page then links.

    Raises:
        BookError: if the book has not been built, or jupyter-book reports a warning.
    """
    begin = time.monotonic()
    with _only_one():
        _check_built()
        shutil.rmtree(PACKED, ignore_errors=True)
        _jupyter_book("custom", "--custom-builder", "epub")
        shutil.copyfile(PACKED / EPUB.name, EPUB)
        _link(EPUB, "The whole book for e-readers (EPUB)")
        path = EPUB.resolve()
    print(f"The EPUB is ready after {_duration(time.monotonic() - begin)}: {path}")
    return path


def _check_built() -> None:
    if not (HTML / "index.html").exists():
        raise BookError("the book has not been built: `make book` builds it")


def _for_paper(text: str) -> str:
    """Return the page with links to other pages leading to their place in it, and without those to files beside it.

    The pages on the API, and the settings and files of every stored run, would fill twice as many pages as all others.
    """
    text = re.sub(r'<span id="document-api/.*?(?=<span id="document-(?!api/))', "", text, flags=re.DOTALL)
    text = re.sub(
        rf"<details><summary>({tables.ORIGIN}.*?)</summary>.*?</details>", r"<p>\1</p>", text, flags=re.DOTALL
    )
    text = re.sub(r'href="([\w/]+)\.html(#[^"]*)?"', lambda link: f'href="{link[2] or "#document-" + link[1]}"', text)
    left_out = "#(?:document-api/|(?:module-)?dropout_uncertainty)"
    return re.sub(rf'(<a [^>]*?)href="(?:{left_out}|(?!#|https?:|mailto:))[^"]*"', r"\1", text)


def _link(file: Path, words: str) -> None:
    """Name a file below the title of the first page."""
    page = HTML / "index.html"
    text, link = page.read_text(encoding="utf-8"), f'<p><a href="{file.name}">{words}</a></p>'
    if link not in text:
        page.write_text(text.replace("</h1>", f"</h1>\n{link}", 1), encoding="utf-8")


def _check_profile(profile: str | None) -> None:
    """Say in which profiles the notebooks were last run; raises BookError if in another one than the one asked for."""
    last = {}
    for name in notebooks():
        with contextlib.suppress(FileNotFoundError, KeyError):
            content = json.loads((EXECUTED / f"{name}.ipynb").read_text(encoding="utf-8"))
            last[name] = content["metadata"]["papermill"]["parameters"]["profile"]
    for name, ran in last.items():
        if profile not in (None, ran):
            raise BookError(
                f"{NOTEBOOKS / name}.ipynb was last run in profile {ran}, not {profile}: leave --skip-run out, or ask "
                f"for --profile {ran}"
            )
    print(f"The notebooks are as last run, in profile {' and '.join(sorted(set(last.values()))) or 'unknown'}")


def _run_notebooks(profile: str, names: Sequence[str] | None) -> dict[str, float]:
    known = notebooks()
    if unknown := [name for name in names or () if name not in known]:
        raise UserError(f"there is no notebook {unknown[0]!r}, choose from {', '.join(known)}")
    if profile == "full":  # the one that computes records
        folders.create(records.root())
    folders.existing(records.root(), folders.RECORDS, "records")
    if names is None:
        shutil.rmtree(EXECUTED, ignore_errors=True)
    shutil.rmtree(RUNNING, ignore_errors=True)
    for folder in (EXECUTED, RUNNING):
        folder.mkdir(parents=True, exist_ok=True)
    chosen = known if names is None else list(names)
    took: dict[str, float] = {}
    for group in ([name for name in chosen if name != LAST], [name for name in chosen if name == LAST]):
        if group:
            took |= _side_by_side(group, profile)
    return {name: took[name] for name in chosen}


def _side_by_side(names: Sequence[str], profile: str) -> dict[str, float]:
    """Run notebooks that need nothing of each other and return the seconds each took, those that last longest first."""
    # those that start processes on every core share them with one other, those that compute records with none
    places = min({"recorded": os.cpu_count() or 1, "quick": 2, "full": 1}[profile], len(names))
    took_before = {name: entry["seconds"] for entries in times().values() for name, entry in entries.items()}
    took = {}
    with executors.processes(places) as pool, _nothing_left():
        order = sorted(names, key=lambda name: -took_before.get(name, 0.0))
        waiting = {pool.submit(_execute, name, profile, places): name for name in order}
        for future in as_completed(waiting):
            name = waiting[future]
            entry = future.result()
            took[name] = entry["seconds"]
            _note(profile, name, **entry)
            words = f"{NOTEBOOKS / name}.ipynb ran in profile {profile}: {_duration(took[name])}"
            print(f"{words}; its outputs are in {EXECUTED / name}.ipynb", flush=True)
    return took


def _execute(name: str, profile: str, places: int) -> dict[str, float]:
    """Run one notebook beside others and return what it took; an earlier result stays only if this one is complete."""
    papermill, failures = _papermill()
    source, running = NOTEBOOKS / f"{name}.ipynb", RUNNING / f"{name}.ipynb"
    (EXECUTED / running.name).unlink(missing_ok=True)
    print(f"{source} begins", flush=True)
    os.environ["OMP_NUM_THREADS"] = str(max(1, (os.cpu_count() or 1) // places))
    os.environ[dark_pages.TWICE] = "1"
    # every parameter is injected, so that the page can show the injected cell alone
    known = papermill.inspect_notebook(str(source))
    parameters = {key: ast.literal_eval(value["default"]) for key, value in known.items()} | {"profile": profile}
    begin, worked = time.monotonic(), _cpu_seconds()
    try:
        with _peak_megabytes() as peak:
            papermill.execute_notebook(
                str(source),
                str(running),
                parameters,
                cwd=str(NOTEBOOKS),  # as in JupyterLab
                progress_bar=places == 1 and sys.stderr.isatty(),
                extra_arguments=["--log-level=ERROR"],  # the kernel warns of every connection that is not encrypted
            )
    except papermill.PapermillExecutionError as error:
        cell = _cell(error.cell_index, error.source)
        raise BookError(f"{source} stopped in its {cell}: {error.ename}: {error.evalue}") from None
    except failures as error:
        raise BookError(f"{source} stopped {_last_begun(running)}: {error}") from None
    running.replace(EXECUTED / running.name)
    return {"seconds": time.monotonic() - begin, "cpu_seconds": _cpu_seconds() - worked, "megabytes": max(peak)}


def _cell(index: int, code: str) -> str:
    """Return the words for a cell; counted from 0 with the injected cell, its index is its number without that one."""
    return f"cell {index} (`{next(iter(code.strip().splitlines()), '')}`)"


def _last_begun(path: Path) -> str:
    """Return where a notebook came to: a kernel that dies names no cell, and papermill calls all of them completed."""
    with contextlib.suppress(OSError, ValueError):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        begun = [index for index, cell in enumerate(cells) if cell["metadata"]["papermill"]["start_time"]]
        if begun:
            return f"in its {_cell(begun[-1], ''.join(cells[begun[-1]]['source']))}"
    return "before its first cell"


@contextlib.contextmanager
def _nothing_left() -> Iterator[None]:
    """End what was started within, kernels and their workers too, where this is left by an exception."""
    import psutil

    before = psutil.Process().children()
    try:
        yield
    except BaseException:
        for process in psutil.Process().children(recursive=True):
            if process not in before:
                with contextlib.suppress(psutil.Error):  # it has just ended
                    process.kill()
        raise


def _note(profile: str, name: str, **took: float) -> None:
    """Keep what a notebook took for the page that shows it."""
    origin = records.provenance()
    found = times()
    entry = {**took, "cores": os.cpu_count(), "processor": origin["processor"], "date": origin["date"]}
    found.setdefault(profile, {})[name] = entry
    TIMES.write_text(json.dumps(found, indent=1, sort_keys=True), encoding="utf-8")


def _cpu_seconds() -> float:
    """Return the CPU time of all processes that this one has started and that have ended."""
    took = os.times()
    return took.children_user + took.children_system


@contextlib.contextmanager
def _peak_megabytes() -> Iterator[list[float]]:
    """Give a list of what the processes below this one hold together, looked at five times a second."""
    import psutil

    held, over = [0.0], threading.Event()

    def watch() -> None:
        while not over.wait(0.2):
            total = 0
            for process in psutil.Process().children(recursive=True):
                with contextlib.suppress(psutil.Error):  # it has just ended
                    total += process.memory_info().rss
            held.append(total / 1e6)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield held
    finally:
        over.set()
        watcher.join()


def _papermill() -> tuple:
    """Return papermill and the errors of a notebook other than that of a cell; imported late, runs need no book."""
    try:
        import papermill
        from jupyter_client.kernelspec import NoSuchKernel
        from nbclient.exceptions import CellControlSignal, DeadKernelError
        from nbformat.reader import NotJSONError
    except ImportError as error:
        raise BookError(
            f"the book needs the package {error.name!r}: install the extra with `pip install -e '.[book]'`"
        ) from None
    return papermill, (DeadKernelError, CellControlSignal, NoSuchKernel, NotJSONError)


def _assemble() -> None:
    """Lay prose and executed notebooks side by side, which gives short addresses and cross-references between them."""
    missing = [name for name in notebooks() if not (EXECUTED / f"{name}.ipynb").exists()]
    if missing:
        raise BookError(f"{NOTEBOOKS / missing[0]}.ipynb has not been run: run the notebooks before the build")
    for stale in (SOURCE, COPIED, SECOND):
        shutil.rmtree(stale, ignore_errors=True)
    shutil.copytree(PROSE, SOURCE)
    if RECORDS.exists():
        shutil.copytree(RECORDS, COPIED, ignore=shutil.ignore_patterns(".*"))
    for name in notebooks():
        executed = json.loads((EXECUTED / f"{name}.ipynb").read_text(encoding="utf-8"))
        text = json.dumps(dark_pages.taken_out(executed, SECOND), indent=1, ensure_ascii=False)
        (SOURCE / f"{name}.ipynb").write_text(text, encoding="utf-8")


def _build_html() -> None:
    """Build the HTML with every warning an error; what jupyter-book says goes to a log."""
    for stale in (HTML, BUILD / ".doctrees"):
        shutil.rmtree(stale, ignore_errors=True)
    _jupyter_book("html")
    dark_pages.offer(HTML, SECOND)


def _jupyter_book(builder: str, *options: str) -> None:
    # jupyter-book 1.x has no `python -m`: its script lies beside the interpreter
    script = Path(sys.executable).with_name("jupyter-book")
    arguments = ["build", str(SOURCE), "--config", str(CONFIG), "--path-output", ".", "--builder", builder]
    arguments += [*options, "-W", "--keep-going", "-n"]
    with LOG.open("w", encoding="utf-8") as log:
        outcome = subprocess.run([str(script), *arguments], stdout=log, stderr=subprocess.STDOUT, check=False)
    if outcome.returncode != 0:
        lines = re.sub(r"\x1b\[[\d;]*m", "", LOG.read_text(encoding="utf-8")).splitlines()
        reasons = [line for line in lines if "WARNING" in line or "ERROR" in line] or lines[-10:]
        raise BookError("\n".join([f"jupyter-book stopped; all it said is in {LOG}:", *reasons]))


def _repository() -> Path:
    """Return the folder that holds the notebooks; the book is made in a clone, not from an installed package."""
    folder = folders.checkout()
    if folder is None:
        raise BookError("the book is made in a clone of the repository: clone it and install with `pip install -e .`")
    return folder


@contextlib.contextmanager
def _only_one() -> Iterator[None]:
    """Work in the repository, refusing to start while another process makes the book there."""
    folder = _repository()
    lock = FileLock(folder / BUILD / ".lock")
    try:
        (folder / BUILD).mkdir(exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        raise BookError(f"another process is making the book in {folder / BUILD}: wait until it has finished") from None
    except OSError as error:
        raise BookError(f"cannot write in {folder / BUILD} ({error.strerror or error}): is it read-only?") from None
    with lock, contextlib.chdir(folder):
        yield


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
