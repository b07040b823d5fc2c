"""Figures with sliders: what the page holds, and in a browser that their numbers are those of the package."""

import ast
import base64
from pathlib import Path

import nbformat
import numpy as np
import pytest
import torch
from browser import chromium
from bs4 import BeautifulSoup

from dropout_uncertainty.active_learning import acquisition
from dropout_uncertainty.active_learning.report.toys import play_unsure
from dropout_uncertainty.bayes import MLP
from dropout_uncertainty.exploration.report.toys import play_machines
from dropout_uncertainty.page import toys
from dropout_uncertainty.page.sliders import Slider, Toy, floats

NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "5_3_exploration.ipynb"
GRID = torch.linspace(-4, 4, 17)
PICTURE = """() => ({ size, shift }, random) => ({
  panels: [{
    x: { low: 0, high: 1, ticks: [0, 1], label: "x" }, y: { low: 0, high: 1, ticks: [0, [1, "one"]], label: "y" },
    paths: [{ x: [0, 1], y: [0, size], stroke: "red", label: "a line" }],
  }],
  words: `size ${size}, chance ${random()}`,
})"""


@pytest.fixture
def toy():
    sliders = [Slider("size", "size & <shape>", 0.5, 0, 1, 0.5), Slider("shift", "shift", 0, 0, 1, 1)]
    return Toy("Move the slider.", "a line & its size", PICTURE, sliders)


def test_a_slider_reaches_where_it_starts():
    for start, wanted in (
        (0.6, (0, 0.6, 0.05)),
        (0.12, (0, 0.5, 0.01)),
        (-1, (-1, 0.5, 0.05)),
        (0.35, (0, 0.5, 0.05)),
        (1e-5, (0, 0.5, 1e-5)),
    ):
        slider = Slider("p", "drop probability", start, 0, 0.5, 0.05)
        assert (slider.low, slider.high, slider.step) == pytest.approx(wanted)


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture
def shown(browser):
    """Return a function that shows a toy in a browser and returns the page."""
    pages = []

    def show(toy, **options):
        context = browser.new_context(**options)
        pages.append(context.new_page())
        pages[-1].set_content(f"<!doctype html><html lang='en'><title>Toy</title><main>{toy._repr_html_()}</main>")
        return pages[-1]

    yield show
    for page in pages:
        page.context.close()


def computed(page, values, random=()):
    """Return what the page computes from values of the sliders and given random numbers."""
    return page.evaluate(
        "([values, random]) => document.querySelector('.toy').compute(values, () => random.shift())",
        [values, list(random)],
    )


def test_sliders_have_names_and_nothing_is_fetched(toy):
    page = BeautifulSoup(toy._repr_html_(), "html.parser")
    assert [label.span.string for label in page.find_all("label")] == ["size & <shape>", "shift"]
    assert page.find(role="img")["aria-label"] == "a line & its size"
    assert page.find("figcaption")["aria-live"] == "polite"
    assert "http" not in str(page)


def test_numbers_are_handed_over_in_single_precision():
    values = torch.tensor([[1.1, -2.2], [3.3, 1e-30]])
    assert np.frombuffer(base64.b64decode(floats(values)), "<f4").tolist() == values.flatten().tolist()


@pytest.mark.slow
def test_without_scripts_and_on_paper_there_is_no_toy(toy, shown):
    assert not shown(toy, java_script_enabled=False).locator(".toy").is_visible()
    page = shown(toy)
    assert page.locator(".toy").is_visible()
    page.emulate_media(media="print")
    assert not page.locator(".toy").is_visible()


@pytest.mark.slow
def test_keys_move_a_slider_and_draw_again(toy, shown):
    page = shown(toy)
    caption = page.locator("figcaption")
    before = caption.text_content()
    assert before.startswith("size 0.5, chance 0.")
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowRight")
    page.wait_for_function("() => document.querySelector('figcaption').textContent.startsWith('size 1')")
    assert page.locator("output").first.text_content() == "1"
    moved = caption.text_content()
    assert moved.split("chance")[1] == before.split("chance")[1]
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    page.keyboard.press("Space")
    page.wait_for_function("moved => document.querySelector('figcaption').textContent !== moved", arg=moved)
    assert page.locator("svg svg path").last.get_attribute("stroke") == "red"
    assert page.locator(".legend span").text_content() == "a line"


@pytest.mark.slow
@pytest.mark.parametrize(
    "network",
    [
        MLP((1, 100, 100, 1), (0.0, 0.2, 0.2), seeds=[100]),
        MLP((1, 40, 1), (0.2, 0.2), seeds=[100], activation="tanh"),
        MLP((1, 30, 20, 10, 1), (0.0, 0.0, 0.2, 0.0), seeds=[100], activation="sigmoid"),
        MLP((1, 20, 1), (0.0, 0.0), seeds=[100]),
    ],
)
def test_page_draws_the_functions_of_the_package(network, shown):
    network.requires_grad_(False)
    toy = toys.play_functions(network, GRID, (torch.zeros(1, 2, 1), torch.zeros(1, 2, 1)), noise=0.1)
    masks = network.draw(5, "test")
    held = tuple(m if m is None else m.repeat_interleave(len(GRID), dim=1) for m in masks)
    curves = network(GRID.repeat(5).reshape(1, -1, 1), held).reshape(5, -1)
    kept = torch.cat([m[0] > 0 for m in masks if m is not None] or [torch.zeros(5, 0)], dim=-1).flatten()
    picture = computed(shown(toy), {"p": 0.2, "draws": 5, "noise": 0.3}, kept.double().tolist())
    band, *drawn, mean, _ = picture["panels"][0]["paths"]
    np.testing.assert_allclose([path["y"] for path in drawn], curves, atol=2e-6)
    np.testing.assert_allclose(mean["y"], curves.mean(0), atol=2e-6)
    total = (curves.var(0) + 0.3**2).sqrt()
    np.testing.assert_allclose(band["y"][: len(GRID)], curves.mean(0) + 2 * total, atol=1e-5)
    gap = curves.var(0)[GRID.abs() <= 1].mean()
    assert f"{gap**0.5:.3f} ({(gap + 0.3**2) ** 0.5:.3f}) in the gap" in picture["words"]
    without = computed(shown(toy), {"p": 0, "draws": 2, "noise": 0}, [0.0] * 400)["panels"][0]["paths"]
    np.testing.assert_allclose(without[1]["y"], network(GRID.reshape(1, -1, 1)).flatten(), atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draws", "other", "sure"), [(3, 1, 0.99), (1, 0, 0.9), (20, 10, 0.6), (5, 0, 0.5), (4, 9, 0.8)]
)
def test_page_scores_an_image_as_the_package(draws, other, sure, shown):
    first = torch.tensor([sure if s < draws - other else 1 - sure for s in range(draws)], dtype=torch.float64)
    log_probs = torch.stack([first, 1 - first], -1).log()[:, None]
    names = ("max-entropy", "bald", "variation-ratios")
    wanted = [acquisition.ACQUISITIONS[name](log_probs).item() for name in names]
    picture = computed(shown(play_unsure()), {"draws": draws, "other": other, "sure": sure})
    assert [path["y"][1] for path in picture["panels"][1]["paths"]] == pytest.approx(wanted, abs=1e-12)
    assert all(f"{value:.3f}" in picture["words"] for value in wanted)


@pytest.mark.slow
def test_no_more_draws_are_counted_than_there_are(shown):
    page = shown(play_unsure())
    few, all_of_them = (computed(page, {"draws": 3, "other": other, "sure": 0.9}) for other in (20, 3))
    assert few["panels"] == all_of_them["panels"]
    assert "No more than 3 of 3 draws can be for the second class, not 20." in few["words"]
    assert "No more" not in all_of_them["words"]


@pytest.mark.slow
def test_page_plays_the_machines_as_the_notebook(shown):
    """The random numbers differ, so the shares differ by what 1000 and 4000 repetitions leave to chance."""
    rules = {"np": np}
    for cell in nbformat.read(NOTEBOOK, as_version=4).cells:
        if cell.cell_type == "code" and cell.source.startswith(("def play", "def thompson", "def epsilon_greedy")):
            exec(compile(ast.parse(cell.source), NOTEBOOK.name, "exec"), rules)
    values = {"first": 0.3, "second": 0.6, "epsilon": 0.2, "repetitions": 1000}
    page = shown(play_machines())
    picture = page.evaluate(
        """(values) => {
          let state = 1; // Park and Miller (1988)
          const random = () => (state = (48271 * state) % 2147483647) / 2147483647;
          return document.querySelector(".toy").compute(values, random);
        }""",
        values,
    )
    thompson, greedy = (np.array(path["y"]) for path in picture["panels"][0]["paths"])
    play = {"repetitions": 4000, "pays": (0.3, 0.6)}
    for share, wanted in (
        (thompson, rules["play"](rules["thompson"], **play)),
        (greedy, rules["play"](lambda *state: rules["epsilon_greedy"](*state, epsilon=0.2), **play)),
    ):
        error = np.sqrt(np.maximum(wanted * (1 - wanted), 0.01) * (1 / 1000 + 1 / 4000))
        assert (np.abs(share - wanted) < 5 * error).all()
    won = sum(0.6 * share + 0.3 * (1 - share) for share in thompson)
    assert f"{won:.1f} (Thompson sampling)" in picture["words"]
    assert "pays 180." in picture["words"]
