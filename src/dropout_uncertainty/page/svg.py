"""SVG: shapes and groups of shapes, for the animations of a page and for pictures that are files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

__all__ = ["SHOWN", "Group", "Shape", "circle", "group", "letters", "line", "path", "polygon", "polyline", "text"]

#: Width of a drawing on the page [pixels of a style sheet]: that of the widest figures.
SHOWN = 686

Number = int | float
Value = str | Number


@dataclass(frozen=True)
class Shape:
    """An SVG element without children: its name, its attributes, and what is written in it."""

    tag: str
    attributes: Mapping[str, Value]
    content: str = ""

    def svg(self) -> str:
        """Return the element."""
        return f"<{self.tag}{_written(self.attributes)}>{escape(self.content)}</{self.tag}>"


@dataclass(frozen=True)
class Group:
    """Shapes and groups that are drawn, turned and moved together."""

    members: Sequence["Shape | Group"]
    attributes: Mapping[str, Value]

    def svg(self) -> str:
        """Return the element."""
        return f"<g{_written(self.attributes)}>{''.join(member.svg() for member in self.members)}</g>"


def group(*members: Shape | Group, **style: Value) -> Group:
    """Return a group; its style holds for all members that have none of their own."""
    return Group(members, _style(style))


def circle(x: Number, y: Number, radius: Number, **style: Value) -> Shape:
    """Return a circle. The style of this and other shapes: SVG attributes, with _ for -, such as ``stroke_width=2``."""
    return Shape("circle", {"cx": _short(x), "cy": _short(y), "r": _short(radius)} | _style(style))


def line(x1: Number, y1: Number, x2: Number, y2: Number, **style: Value) -> Shape:
    """Return a line from (x1, y1) to (x2, y2)."""
    ends = {"x1": x1, "y1": y1, "x2": x2, "y2": y2}
    return Shape("line", {name: _short(end) for name, end in ends.items()} | _style({"stroke": "currentColor"} | style))


def path(course: str, **style: Value) -> Shape:
    """Return a path of SVG's commands, such as M0,0L10,10."""
    return Shape("path", {"d": course} | _style(style))


def polygon(points: Sequence[tuple[Number, Number]], **style: Value) -> Shape:
    """Return a closed shape with the given corners."""
    return Shape("polygon", {"points": _points(points)} | _style(style))


def polyline(points: Sequence[tuple[Number, Number]], **style: Value) -> Shape:
    """Return an open line through the given points."""
    return Shape("polyline", {"points": _points(points), "fill": "none"} | _style({"stroke": "currentColor"} | style))


def _written(attributes: Mapping[str, Value]) -> str:
    return "".join(f' {name}="{escape(str(value))}"' for name, value in attributes.items())


def _points(points: Sequence[tuple[Number, Number]]) -> str:
    return " ".join(f"{_short(x)},{_short(y)}" for x, y in points)


def letters(width: Number) -> float:
    """Return the size of letters, in units of a drawing of this width, at which they are as large as in figures."""
    return round(13 * width / SHOWN, 1)


def text(x: Number, y: Number, content: str, **style: Value) -> Shape:
    """Return words, whose baseline starts at (x, y)."""
    return Shape("text", {"x": _short(x), "y": _short(y)} | _style({"fill": "currentColor"} | style), content)


def _short(number: Number) -> Number:
    """Return a number with one decimal, without it where it is 0: pages should be small."""
    rounded = round(float(number), 1)
    return int(rounded) if rounded == int(rounded) else rounded


def _style(style: Mapping[str, Value]) -> dict[str, Value]:
    return {name.replace("_", "-"): value for name, value in style.items()}
