"""The three pictures of the first page and the README, drawn from the records as SVG files that need nothing else."""

import base64
import io
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import image
from numpy.typing import NDArray

from dropout_uncertainty.active_learning import mnist
from dropout_uncertainty.active_learning.report import analysis as active_learning
from dropout_uncertainty.data_efficiency.report import analysis as data_efficiency
from dropout_uncertainty.exploration.foraging import drawing
from dropout_uncertainty.exploration.foraging import world as w
from dropout_uncertainty.exploration.report import analysis as exploration
from dropout_uncertainty.exploration.report import animation
from dropout_uncertainty.page.plotting import COLOURS
from dropout_uncertainty.page.svg import Group, Shape, circle, group, path, text
from dropout_uncertainty.runs.records import Record

__all__ = ["PICTURES", "agent", "cartpole", "digits"]

SIZE = 350, 250
#: An animation stands still for readers who want less motion; the attributes of each shape are its first moment.
FILE = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" font-family="sans-serif">
<title>{title}</title>
<desc>{origin}</desc>
<style>{style}@media (prefers-reduced-motion: reduce) {{ * {{ animation: none !important; }} }}</style>
<rect width="{width}" height="{height}" rx="6" fill="white"/>
{body}
</svg>
"""


def digits(folder: Path | None = None) -> str | None:
    """Return the last digits that random acquisition and BALD asked labels for, side by side; None without records."""
    rows = active_learning.load_rows("ours", folder)
    chosen = {"taken at random": "random", "asked for by BALD": "dropout/bald"}
    if not set(chosen.values()) <= rows.keys():
        return None
    images, records, shapes = mnist.load().train_images.numpy(), [], []
    for number, (title, name) in enumerate(chosen.items()):
        record = rows[name].records[0]
        points = record.arrays["points"][0, -24:]
        tiles = images[points].reshape(6, 4, 28, 28).transpose(0, 2, 1, 3).reshape(6 * 28, 4 * 28)
        left = 20 + 165 * number
        shapes += [
            text(left + 72, 22, title, text_anchor="middle", font_size=14),
            Shape("image", {"x": left, "y": 30, "width": 145, "height": 212, "href": _png(1 - tiles)}),
        ]
        records.append(record)
    return _file("Handwritten digits: on the left ordinary ones, on the right unusual ones", records, shapes)


def agent(folder: Path | None = None) -> str | None:
    """Return a trained agent that wanders through the 2D world for ten seconds; None without a record."""
    curves = exploration.load("ours-thompson", folder).get("thompson")
    if curves is None or curves.record is None:
        return None
    scenes = [moment.scene for moment in animation.run(animation.TrainedAgent(curves.record))]
    style, items = _items(scenes)
    blue = COLOURS["thompson"]
    # drawn facing down, as an agent at angle 0 does; SVG turns the other way round
    turns = -np.degrees(np.unwrap([scene.angle[0] for scene in scenes]))
    places = [
        f"translate({s.x[0]:.1f}px,{s.y[0]:.1f}px) rotate({a:.0f}deg)" for s, a in zip(scenes, turns, strict=True)
    ]
    style += _keyframes("walk", places) + "#agent { animation: walk 10s linear infinite; }\n"
    angles = scenes[0].eye_angle[0] - scenes[0].angle[0]
    eyes = "".join(f"M0,0L{w.EYE_RANGE * np.sin(a):.0f},{w.EYE_RANGE * np.cos(a):.0f}" for a in angles)
    walls = "".join(f"M{x1:g},{y1:g}L{x2:g},{y2:g}" for x1, y1, x2, y2 in w.WALLS)
    body = group(path("M-10,6L0,24L10,6"), circle(0, 0, 13), fill=blue)
    walker = group(path(eyes, stroke="#9a9a9a", stroke_width=2), body, id="agent", transform=_still(places[0]))
    field = path(walls, stroke="#444444", stroke_width=5, stroke_linecap="round")
    title = "A walled field with red discs and green rings; a blue agent with nine eyes moves through it"
    return _file(title, [curves.record], [group(field, *items, walker, transform="scale(0.5)")], style)


def _items(scenes: Sequence[drawing.Scene]) -> tuple[str, list[Shape]]:
    """Return style and shapes of all items that are there at some time, each shown as long as it is there."""
    last = len(scenes)
    style: list[str] = []
    shapes: list[Shape] = []
    for slot in range(len(scenes[0].item_kind)):
        states = [(s.item_x[slot], s.item_y[slot], s.item_kind[slot]) for s in scenes]
        starts = [0, *(i for i in range(1, last) if states[i] != states[i - 1]), last]
        for start, end in itertools.pairwise(starts):
            x, y, kind = states[start]
            if kind == w.NOTHING:
                continue
            colour, name = drawing.KIND_COLOURS[kind], f"i{len(shapes)}"
            hidden = {"opacity": 0} if start else {}
            if kind == w.FOOD:
                shapes.append(circle(round(x), round(y), 10, id=name, fill=colour, **hidden))
            else:
                ring = circle(round(x), round(y), 8, id=name, fill="none", stroke=colour, stroke_width=4, **hidden)
                shapes.append(ring)
            changes = [(0, int(start == 0)), *[(start, 1)] * (start > 0), *[(end, 0)] * (end < last)]
            steps = "".join(f"{100 * time / last:.1f}%{{opacity:{shown}}}" for time, shown in changes)
            style.append(f"@keyframes {name}{{{steps}}}#{name}{{animation:{name} 10s step-end infinite}}\n")
    return "".join(style), shapes


def cartpole(folder: Path | None = None) -> str | None:
    """Return PILCO's first solved trial, in real time and again and again; None without a record or a solved trial."""
    learning = data_efficiency.load("pilco-paper", folder)
    if learning is None or not np.isfinite(learning.first_solved).any():
        return None
    replica = int(np.argmin(learning.first_solved))
    trial = int(learning.first_solved[replica])
    states, plant = learning.arrays["states"][replica, trial], learning.plant
    scale, pause = 130, 1.5
    length, seconds = scale * plant.pole_length, plant.dt * plant.steps
    share = seconds / (seconds + pause)
    # counter-clockwise is positive; SVG turns clockwise since its y axis points down
    x = [f"translateX({scale * value:.1f}px)" for value in states[:, 0]]
    turn = [f"rotate({-math.degrees(value):.1f}deg)" for value in states[:, 3]]
    style = _keyframes("cart", x, share) + _keyframes("pole", turn, share)
    for name in ("cart", "pole"):
        style += f"#{name} {{ animation: {name} {seconds + pause:g}s linear infinite; }}\n"
    rod = path(f"M0,0V{-length:g}", stroke=COLOURS["pilco"], stroke_width=6, stroke_linecap="round")
    pole = group(rod, id="pole", transform=_still(turn[0]))
    wagon = path("M-22,-9h44v18h-44z", fill="#BBBBBB", stroke="#333333")
    goal = path(f"M-7,{-length - 7:g}l14,14m0,-14l-14,14", stroke="black", stroke_width=4)
    cart = group(wagon, pole, id="cart", transform=_still(x[0]))
    scene = group(path("M-165,9H165", stroke="#999999"), goal, cart, transform="translate(175,140)")
    record = next(r for r in learning.records if learning.seeds[replica] in r.seeds)
    shapes: list[Shape | Group] = [text(12, 24, f"trial {trial}", font_size=14), scene]
    return _file("A cart swings a hanging pole up and balances it on a cross", [record], shapes, style)


#: The pictures by the names of their files.
PICTURES: Mapping[str, Callable[[Path | None], str | None]] = {"digits": digits, "agent": agent, "cartpole": cartpole}


def _file(title: str, records: Sequence[Record], shapes: Sequence[Shape | Group], style: str = "") -> str:
    width, height = SIZE
    made = "Made from " + " and ".join(f"{record.label} {record.header['payload'][:16]}" for record in records)
    body = "\n".join(shape.svg() for shape in shapes)
    return FILE.format(width=width, height=height, title=escape(title), origin=escape(made), style=style, body=body)


def _keyframes(name: str, transforms: Sequence[str], share: float = 1.0) -> str:
    """Return a CSS animation that goes through transforms in the first ``share`` of its time and then stands still."""
    last = len(transforms) - 1
    steps = "".join(f"{100 * share * i / last:.2f}%{{transform:{t}}}" for i, t in enumerate(transforms))
    rest = "" if share == 1 else f"100%{{transform:{transforms[-1]}}}"
    return f"@keyframes {name}{{{steps}{rest}}}\n"


def _still(transform: str) -> str:
    """Return a transform of CSS as the attribute of an SVG element, which has no units."""
    return re.sub(r"translateX\((.*?)\)", r"translate(\1)", transform).replace("px", "").replace("deg", "")


def _png(grey: NDArray[Any]) -> str:
    """Return an image of values in [0, 1] as the address of a PNG that is part of the file."""
    file = io.BytesIO()
    image.imsave(file, grey, cmap="gray", vmin=0, vmax=1, format="png")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
