import re

import pytest
from bs4 import BeautifulSoup

from dropout_uncertainty.page.curve_toggles import Curves


@pytest.fixture
def curves():
    curves = Curves("Two lines that cross & part")
    with curves.group("Falling <fast>"):
        curves.ax.plot([0, 1, 2], [3, 1, 0], color="#D55E00", label="falling")
        curves.ax.plot([0, 1, 2], [3, 2, 0], color="#0072B2", linewidth=0.5)
    with curves.group("Rising", shown=False):
        curves.ax.plot([0, 1, 2], [0, 1, 3], "--", color="#009E73")
        curves.ax.fill_between([0, 1, 2], [0, 0, 2], [1, 2, 4])
        curves.ax.legend()
    return curves


def page(curves):
    return BeautifulSoup(curves._repr_mimebundle_()["text/html"], "html.parser")


def test_every_group_has_a_box_with_its_colour_and_dashes(curves):
    falling, rising = page(curves).find_all("label")
    assert falling.get_text(strip=True) == "Falling <fast>"
    assert falling.input.has_attr("checked")
    assert falling.path["stroke"] == "#d55e00"
    assert not falling.path.has_attr("stroke-dasharray")
    assert not rising.input.has_attr("checked")
    assert rising.path["stroke"] == "#009e73"
    assert rising.path.has_attr("stroke-dasharray")


def test_everything_drawn_in_a_group_is_hidden_by_its_box(curves):
    soup = page(curves)
    name = soup.div["id"]
    assert [tag["data-curve"] for tag in soup.find_all(attrs={"data-curve": True})].count("0") == 2
    assert [tag["data-curve"] for tag in soup.find_all(attrs={"data-curve": True})].count("1") == 2
    for number, label in enumerate(soup.find_all("label")):
        assert label.input["value"] == str(number)
        rule = f"#{name}:has(input[value='{number}']:not(:checked)) [data-curve='{number}'] {{ display: none; }}"
        assert rule in soup.style.string
    without_sheets = {tag["data-curve"]: tag.get("display") for tag in soup.find_all(attrs={"data-curve": True})}
    assert without_sheets == {"0": None, "1": "none"}


def test_the_picture_says_what_is_to_be_seen_and_needs_nothing_from_elsewhere(curves):
    picture = page(curves).find("svg", class_="picture")
    assert picture["role"] == "img"
    assert picture["aria-label"] == "Two lines that cross & part"
    assert not picture.find_all(["image", "script", "metadata"])
    assert "legend" not in str(picture)


def test_two_figures_on_a_page_share_no_id(curves):
    other = Curves("One more")
    with other.group("Line"):
        other.ax.plot([0, 1], [0, 1])
    ids = [re.findall(r' id="([^"]+)"', c.html()) for c in (curves, other)]
    assert all(len(found) == len(set(found)) for found in ids)
    assert not set(ids[0]) & set(ids[1])


def test_the_same_figure_is_the_same_text(curves):
    assert curves.html() == curves.html()


def test_an_empty_group_is_refused(curves):
    with pytest.raises(ValueError, match="nothing was drawn for 'Forgotten'"), curves.group("Forgotten"):
        pass
