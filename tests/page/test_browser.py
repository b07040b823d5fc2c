"""Every page of the built book, as a reader's browser shows it."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import pytest
from browser import HTML, PATIENCE, built_pages, chromium, served

from dropout_uncertainty.page.curve_toggles import Curves

pytestmark = pytest.mark.slow

PHONE, DESK = {"width": 400, "height": 800}, {"width": 1000, "height": 800}
LAPTOP = {"width": 1300, "height": 800}
PAPER = {"width": 718, "height": 1047}  # A4 within margins of 1 cm
GUIDELINES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
COLOUR_RULES = ["color-contrast", "link-in-text-block"]  # nothing else changes with the colours
MEGABYTE = 2**20
MATHJAX = "/mathjax/"


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def site():
    built_pages()
    with served(HTML) as address:
        yield address


@dataclass
class Visit:
    """What happened while a page was opened, and what its tests need to know of it."""

    complaints: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)
    requests: list = field(default_factory=list)
    size: int = 0
    maths: dict = field(default_factory=dict)
    overflow: list[str] = field(default_factory=list)
    shrunk: list[str] = field(default_factory=list)
    cut: list[str] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)


@pytest.fixture(scope="module")
def visits(site):
    """Return what was seen on each page; each is opened once, since opening takes longest, by a browser per core."""
    names, browsers = built_pages(), os.cpu_count() or 1

    def some(first):
        with chromium() as browser:
            return {name: visit(browser, site, name) for name in names[first::browsers]}

    with ThreadPoolExecutor(browsers) as pool:
        return {name: seen for part in pool.map(some, range(browsers)) for name, seen in part.items()}


def visit(browser, site, name):
    """Open a page with nothing in the cache, as on a phone, then as on a desk in light and in dark."""
    seen = Visit()
    # colours that fade into each other would be measured half-way
    context = browser.new_context(viewport=PHONE, color_scheme="light", reduced_motion="reduce")
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    watch(page, site, seen)
    page.goto(f"{site}/{name}")
    page.evaluate("() => window.MathJax?.startup?.promise")
    page.wait_for_load_state("networkidle")
    seen.size = sum(request.sizes()["responseBodySize"] for request in seen.requests if MATHJAX not in request.url)
    seen.maths = page.evaluate(MATHS)
    page.evaluate("document.querySelectorAll('details').forEach(details => details.open = true)")
    seen.overflow = page.evaluate(OVERFLOW)
    seen.violations += violations(page, "phone", ["scrollable-region-focusable"])
    page.set_viewport_size(DESK)
    for scheme, rules in (("light", GUIDELINES), ("dark", COLOUR_RULES)):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_function("scheme => document.documentElement.dataset.theme === scheme", arg=scheme)
        seen.violations += violations(page, scheme, rules)
    page.set_viewport_size(LAPTOP)
    seen.shrunk = page.evaluate(SHRUNK)
    page.set_viewport_size(PAPER)
    page.emulate_media(media="print")
    seen.cut = page.evaluate(CUT)
    context.close()
    return seen


def watch(page, site, seen):
    """Write down what a page requests and complains about."""
    page.on("request", lambda r: None if r.url.startswith((site, "data:", "blob:")) else seen.foreign.append(r.url))
    page.on("requestfinished", lambda request: seen.requests.append(request))
    page.on("requestfailed", lambda request: seen.complaints.append(f"failed: {request.url}"))
    page.on("response", lambda r: seen.complaints.append(f"{r.status}: {r.url}") if r.status >= 400 else None)
    page.on("pageerror", lambda error: seen.complaints.append(str(error)))
    page.on("console", lambda m: seen.complaints.append(m.text) if m.type in ("error", "warning") else None)


MATHS = """() => {
  const formulas = [...document.querySelectorAll('.math')];
  return {
    formulas: formulas.length,
    plain: formulas.filter(f => !f.querySelector('mjx-container svg')).map(f => f.textContent),
    errors: [...document.querySelectorAll('[data-mml-node=merror]')].map(e => e.textContent),
  };
}"""
# What makes the page wider than the screen: it sticks out and no part of the page scrolls or clips it.
OVERFLOW = """() => {
  const width = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth <= width) return [];
  const held = (e) => e && (getComputedStyle(e).overflowX !== 'visible' || held(e.parentElement));
  const out = [...document.querySelectorAll('article *')]
    .filter((e) => e.getBoundingClientRect().right > width + 1 && !held(e.parentElement));
  return [`${document.documentElement.scrollWidth} px wide`, ...out.map((e) => e.outerHTML.slice(0, 120))];
}"""
# Figures for which the column is too narrow: their letters would be smaller than those of the others.
SHRUNK = """() => [...document.querySelectorAll('.cell_output :is(img, svg.picture)')].flatMap((e) => {
  if (!e.checkVisibility()) return [];  // the picture for the other ground
  const drawn = e.style.width || e.style.maxWidth, shown = e.getBoundingClientRect().width;
  const wanted = drawn.endsWith('pt') ? parseFloat(drawn) * 96 / 72 : parseFloat(drawn);
  return shown >= wanted - 1 ? [] : [`drawn ${wanted} px wide, shown ${shown}: ${e.outerHTML.slice(0, 120)}`];
})"""
# What would have to be scrolled on paper, and parts of the screen that are of no use there. MathJax's copy of each
# formula for screen readers takes no room.
CUT = """() => {
  document.querySelectorAll('mjx-assistive-mml').forEach((e) => e.remove());
  const shown = (e) => e.checkVisibility() && e.getBoundingClientRect().width > 0;
  const all = (selector) => [...document.querySelectorAll(selector)].filter(shown);
  const wide = all('article *').filter(
    (e) => getComputedStyle(e).overflowX !== 'visible' && e.clientWidth && e.scrollWidth > e.clientWidth + 1);
  const useless = all('nav, button, .bd-sidebar-primary, .bd-sidebar-secondary, .bd-header-article');
  return [...wide, ...useless].map((e) => e.outerHTML.slice(0, 120));
}"""


def violations(page, scheme, rules):
    """Return what axe finds against rules, or groups of rules, of the guidelines at levels A and AA."""
    from axe_playwright_python.sync_playwright import Axe

    found = (
        Axe().run(page, options={"runOnly": rules, "preload": False, "reporter": "no-passes"}).response["violations"]
    )
    return [
        f"{scheme}, {rule['id']}: {node['html'][:150]} ({node['failureSummary'].splitlines()[-1].strip()[:150]})"
        for rule in found
        for node in rule["nodes"]
    ]


def collect(visits, attribute):
    """Return one line for each thing that was found on any page."""
    return [f"{name}: {thing}" for name, seen in visits.items() for thing in getattr(seen, attribute)]


def test_no_page_complains(visits):
    assert not collect(visits, "complaints")


def test_no_page_asks_another_host_for_anything(visits):
    assert not collect(visits, "foreign")


def test_formulas_are_drawn(visits):
    assert sum(seen.maths["formulas"] for seen in visits.values()) > 40
    wrong = {name: seen.maths for name, seen in visits.items() if seen.maths["plain"] or seen.maths["errors"]}
    assert not wrong


def test_a_phone_does_not_scroll_sideways(visits):
    assert not collect(visits, "overflow")


def test_letters_have_one_size_in_all_figures(visits):
    assert not collect(visits, "shrunk")


def test_paper_shows_all_of_a_page_and_nothing_else(visits):
    assert not collect(visits, "cut")


def test_guidelines_on_accessibility_are_kept_in_light_and_dark(visits):
    assert not collect(visits, "violations")


def test_pages_and_book_are_light(visits):
    heavy = {name: seen.size for name, seen in visits.items() if seen.size > 3 * MEGABYTE}
    assert not heavy
    files = [path for path in HTML.rglob("*") if path.is_file() and path.suffix not in (".pdf", ".epub")]
    assert sum(path.stat().st_size for path in files) <= 40 * MEGABYTE


def test_search_finds_bald(browser, site):
    page = browser.new_page()
    page.goto(f"{site}/search.html?q=BALD")
    page.locator("#search-results a[href*='5_2_active_learning.html']").first.wait_for(timeout=PATIENCE)
    page.close()


def test_printing_from_the_dark_gives_light_paper_with_everything_unfolded(browser, site):
    context = browser.new_context(color_scheme="dark")
    page = context.new_page()
    page.goto(f"{site}/5_2_active_learning.html", timeout=PATIENCE)
    folded = "document.querySelectorAll('details:not([open], td details)').length"
    state = f"({{theme: document.documentElement.dataset.theme, folded: {folded}}})"
    before = page.evaluate(state)
    assert before["theme"] == "dark"
    assert before["folded"] > 0
    page.evaluate(f"addEventListener('beforeprint', () => window.printed = {state})")
    assert page.pdf(format="A4").startswith(b"%PDF")
    assert page.evaluate("window.printed") == {"theme": "light", "folded": 0}
    assert page.evaluate(state) == before
    context.close()


@pytest.mark.parametrize("scripts", [True, False], ids=["scripts on", "scripts off"])
def test_curves_are_chosen_with_the_keyboard(browser, scripts):
    curves = Curves("Two lines")
    for label, shown in (("Falling", True), ("Rising", False)):
        with curves.group(label, shown=shown):
            curves.ax.plot([0, 1], [shown, 1 - shown])
    context = browser.new_context(java_script_enabled=scripts)
    page = context.new_page()
    page.set_content(f"<html lang='en'><title>Curves</title><main><h1>Curves</h1>{curves.html()}</main></html>")
    falling, rising = (page.locator(f"[data-curve='{number}']") for number in range(2))
    assert (falling.is_visible(), rising.is_visible()) == (True, False)
    for _ in range(2):
        page.keyboard.press("Tab")
        page.keyboard.press("Space")
    assert (falling.is_visible(), rising.is_visible()) == (False, True)
    if scripts:
        assert not violations(page, "light", GUIDELINES)
    context.close()


def test_animations_of_the_book_play_and_step(browser, site):
    names = [name for name in built_pages() if 'class="player"' in (HTML / name).read_text(encoding="utf-8")]
    if not names:
        pytest.skip("no page has an animation yet")
    context = browser.new_context(reduced_motion="reduce")  # it waits for the reader
    page = context.new_page()
    for name in names:
        page.goto(f"{site}/{name}", timeout=PATIENCE)
        for player in page.locator("figure.player").all():
            time = player.get_by_label("time")
            assert time.input_value() == "0", name
            player.get_by_role("button", name="Step").click()
            assert time.input_value() == "1", name
            before = player.locator("svg").first.inner_html()
            player.get_by_role("button", name="Play").click()
            page.wait_for_function("slider => slider.value > 3", arg=time.element_handle(), timeout=PATIENCE)
            player.get_by_role("button", name="Pause").click()
            assert player.locator("svg").first.inner_html() != before, name
    context.close()
