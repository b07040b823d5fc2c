"""The animation: what the page holds, and in a browser that it plays."""

import json
import re

import pytest
from browser import PATIENCE, chromium
from bs4 import BeautifulSoup

from dropout_uncertainty.page.svg import circle, line, polygon, text
from dropout_uncertainty.page.svg_animation import Player


def ball(frame):
    return [
        circle(10 * frame, 20.04, 5, fill="red" if frame < 2 else "none"),
        line(0, 50, 100, 50 + frame, stroke_dasharray="4 2"),
        text(0, 10, f"<{frame}>"),
    ]


@pytest.fixture
def player():
    frames = [ball(frame) for frame in range(4)]
    labels = [f"frame {number} </script>" for number in range(4)]
    wall = polygon([(0, 0), (100, 0), (50.26, 9)], fill="currentColor")
    return Player(frames, (100, 60), "a ball & a line", labels, background=[wall], rate=20)


def test_changes_lead_from_frame_to_frame(player):
    first, *later = player.changes()
    assert first[0] == {"cx": 0, "cy": 20, "r": 5, "fill": "red", "": ""}
    assert later[0] == {0: {"cx": 10}, 1: {"y2": 51}, 2: {"": "<1>"}}
    assert later[1][0] == {"cx": 20, "fill": "none"}
    state = {}
    for frame, changes in zip(player.frames, player.changes(), strict=True):
        for number, values in changes.items():
            state[number] = state.get(number, {}) | values
        assert [state[number] for number in range(3)] == [
            dict(shape.attributes) | {"": shape.content} for shape in frame
        ]


def test_without_scripts_the_page_shows_the_first_frame_and_no_controls(player):
    page = BeautifulSoup(player._repr_html_(), "html.parser")
    svg = page.find("svg")
    assert svg["aria-label"] == "a ball & a line"
    assert svg["viewbox"] == "0 0 100 60"
    assert svg.find("circle")["cx"] == "0"
    assert svg.find("text").string == "<0>"
    assert svg.find("polygon")["points"] == "0,0 100,0 50.3,9"
    assert page.find(class_="end").find("text").string == "<3>"
    assert page.find(class_="end").find("p").string.startswith("frame 3")
    assert page.find(class_="controls").has_attr("hidden")
    assert page.find(class_="label").string.startswith("frame 0")
    assert all(field.get("aria-label") or field.find_parent("label") for field in page.find_all(["input", "select"]))


def test_page_needs_nothing_from_elsewhere_and_data_cannot_end_the_script(player):
    html = player._repr_html_()
    assert "http" not in html
    assert len(re.findall("</script", html)) == 1
    data = BeautifulSoup(html, "html.parser").find("script").string.split("parentElement, ...")[1].removesuffix(")")
    assert json.loads(data)[1][0] == "frame 0 </script>"
    assert "prefers-reduced-motion" in html


def test_misuse_is_named():
    with pytest.raises(ValueError, match="at least one frame"):
        Player([], (1, 1), "nothing", [])
    with pytest.raises(ValueError, match="got 1 for 2 frames"):
        Player([ball(0), ball(1)], (1, 1), "a ball", ["one"])
    with pytest.raises(ValueError, match="frame 1 differs"):
        Player([ball(0), ball(1)[::-1]], (1, 1), "a ball", ["one", "two"])
    with pytest.raises(ValueError, match="frame 1 differs"):
        Player([[circle(0, 0, 1)], [circle(0, 0, 1, fill="red")]], (1, 1), "a ball", ["one", "two"])


#: What a reader would do, and what is to be seen after it; the page's title reports the first difference.
READER = """<script>
const find = (selector) => document.querySelector(selector);
const seen = () => [find("circle").getAttribute("cx"), find("text").textContent, find(".label").textContent[6],
                    find("input").value, find(".play").textContent].join();
const differences = [];
const expect = (what, value) => { if (seen() !== value) differences.push(`${what}: ${seen()} not ${value}`); };
expect("start", "0,<0>,0,0,Play");
find(".step").click(); find(".step").click();
expect("two steps", "20,<2>,2,2,Play");
if (find("circle").getAttribute("fill") !== "none") differences.push("fill");
find(".back").click();
expect("one back", "10,<1>,1,1,Play");
if (find("circle").getAttribute("fill") !== "red") differences.push("fill not restored");
find("input").value = 3; find("input").dispatchEvent(new Event("input"));
expect("slider", "30,<3>,3,3,Play");
find(".step").click();
expect("step past the end", "30,<3>,3,3,Play");
find(".play").click();
expect("from the start again", "0,<0>,0,0,Pause");
find(".play").click();
expect("paused", "0,<0>,0,0,Play");
find("select").value = "4"; find(".play").click();
setTimeout(() => { expect("played to its end", "30,<3>,3,3,Play");
                   document.title = differences.join("; ") || "as expected"; }, 1000);
</script>"""


@pytest.fixture
def opened(player, tmp_path):
    """Return a function that opens the player, with a script behind it, in a browser of such a reader."""
    with chromium() as browser:

        def show(script="", **reader):
            place = tmp_path / "page.html"
            place.write_text(f'<!doctype html><meta charset="utf-8">{player._repr_html_()}{script}', encoding="utf-8")
            page = browser.new_page(**reader)
            page.goto(place.as_uri())
            return page

        yield show


def test_in_a_browser_it_plays_steps_and_goes_back(opened):
    page = opened(READER, reduced_motion="reduce")
    page.wait_for_function("document.title", timeout=PATIENCE)
    assert page.title() == "as expected"


def test_starts_by_itself_but_for_readers_who_want_less_motion(opened):
    still = opened(reduced_motion="reduce")
    opened().wait_for_function("document.querySelector('input').value === '3'", timeout=PATIENCE)
    still.wait_for_timeout(1000)  # five times as long as it takes to play
    assert still.input_value("input") == "0"
