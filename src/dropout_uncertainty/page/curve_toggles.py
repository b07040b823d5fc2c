"""A figure whose curves a reader switches on and off, on the page and in JupyterLab: style sheets do it, no script."""

import contextlib
import hashlib
import io
import re
from collections.abc import Iterator
from html import escape

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

__all__ = ["CONTROLS", "Curves"]

#: The look of a row of choices above what is chosen from.
CONTROLS = """
#{name} fieldset {{ border: 0; margin: 0 0 0.5rem; padding: 0; display: flex; flex-wrap: wrap; gap: 0 1.2rem; }}
#{name} legend {{ font-size: inherit; margin: 0; }}
#{name} label {{ display: inline-flex; align-items: center; gap: 0.4rem; min-height: 1.75rem; cursor: pointer; }}
"""
# Text stays text, in the font of the page; the picture keeps its white ground, as every picture of the book, and in
# the dark the theme puts a light ground below all of it.
SHEET = """
#{name} {{ color-scheme: light; }}
#{name} .swatch {{ width: 1.8rem; height: 0.9rem; background: white; border-radius: 2px; }}
#{name} .picture {{ display: block; width: 100%; height: auto; background: white; }}
#{name} .picture text {{ font-family: inherit !important; }}
#{name} [data-curve] {{ display: inline; }}
"""
HIDE = "#{name}:has(input[value='{number}']:not(:checked)) [data-curve='{number}'] {{ display: none; }}\n"
CHOICE = (
    '<label><input type="checkbox" value="{number}"{checked}/> '
    '<svg class="swatch" viewBox="0 0 24 12" aria-hidden="true"><path d="M0 6H24" stroke="{colour}" '
    'stroke-width="3"{dashes}/></svg> {label}</label>'
)


class Curves:
    """One pair of axes with groups of artists, each of which has a box to tick.

    Draw with ``group``; the last line of a cell then shows the object. The boxes are the legend, so the axes keep none.

    Args:
        alt: what is to be seen, for readers who cannot see it.
        figsize: width and height in inches; by default as every figure.

    Attributes:
        figure: the figure, which is not one of pyplot's: it is shown once, by this object.
        ax: its axes.
    """

    def __init__(self, alt: str, figsize: tuple[float, float] | None = None) -> None:
        self.alt = alt
        self.figure = Figure(figsize=figsize, layout="constrained")
        self.ax = self.figure.add_subplot()
        self._groups: list[tuple[str, bool, list[Artist]]] = []

    @contextlib.contextmanager
    def group(self, label: str, *, shown: bool = True) -> Iterator[None]:
        """Return a context in which everything drawn on ``ax`` belongs to the box ``label``.

        Args:
            label: the name beside the box.
            shown: whether the box is ticked at first.

        Raises:
            ValueError: if nothing was drawn.
        """
        before = self._artists()
        yield
        added = [artist for artist in self._artists() if artist not in before]
        if not added:
            raise ValueError(f"nothing was drawn for {label!r}: draw on the axes of this object inside the group")
        self._groups.append((label, shown, added))

    def _artists(self) -> list[Artist]:
        return [*self.ax.lines, *self.ax.collections, *self.ax.patches, *self.ax.texts]

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, str]:
        return {"text/html": self.html(), "text/plain": self.alt}

    def html(self) -> str:
        """Return boxes and picture as HTML that needs nothing else."""
        name = "curves-" + hashlib.sha256("\n".join([self.alt, *(g[0] for g in self._groups)]).encode()).hexdigest()[:8]
        rules = "".join(HIDE.format(name=name, number=number) for number in range(len(self._groups)))
        choices = "\n".join(
            CHOICE.format(number=number, checked=' checked=""' * shown, label=escape(label), **_stroke(artists))
            for number, (label, shown, artists) in enumerate(self._groups)
        )
        return (
            f'<div id="{name}">\n<style>{(CONTROLS + SHEET).format(name=name)}{rules}</style>\n'
            f"<fieldset>\n<legend>Choose the curves:</legend>\n{choices}\n</fieldset>\n{self._svg(name)}\n</div>"
        )

    def _svg(self, salt: str) -> str:
        """Return the picture; what belongs to a box says so in ``data-curve``."""
        if legend := self.ax.get_legend():
            legend.remove()
        for number, (_, _, artists) in enumerate(self._groups):
            for part, artist in enumerate(artists):
                artist.set_gid(f"curve-{number}-{part}")
        text, nothing = io.StringIO(), dict.fromkeys(("Creator", "Date", "Format", "Type"))
        with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": salt}):
            self.figure.savefig(text, format="svg", metadata=nothing)
        svg = _inline(text.getvalue(), self.alt)
        for number, (_, shown, _) in enumerate(self._groups):
            if not shown:  # nor without style sheets, as in an e-reader
                svg = svg.replace(f'data-curve="{number}"', f'data-curve="{number}" display="none"')
        return svg


def _inline(svg: str, alt: str) -> str:
    """Return an SVG file as an element of a page: as wide as drawn if there is room, and no id is given twice."""
    svg = svg[svg.index("<svg") :].strip()
    svg = re.sub(r'id="curve-(\d+)-\d+"', r'data-curve="\1"', svg)
    used = set(re.findall(r"#([\w-]+)", svg))
    svg = re.sub(r' id="([\w.-]+)"', lambda found: found[0] if found[1] in used else "", svg)
    svg = re.sub(r"(\d\.\d\d)\d+", r"\1", svg)
    return re.sub(
        r'<svg [^>]*?width="([^"]*)"[^>]*?(viewBox="[^"]*")[^>]*>',
        rf'<svg class="picture" style="max-width: \1" \2 role="img" aria-label="{escape(alt)}" '
        'xmlns:xlink="http://www.w3.org/1999/xlink">',
        svg,
        count=1,
    )


def _stroke(artists: list[Artist]) -> dict[str, str]:
    """Return colour and dashes of the thickest line of a group, for its swatch."""
    lines = [artist for artist in artists if isinstance(artist, Line2D)]
    if not lines:
        return {"colour": "#6c6c6c", "dashes": ""}
    line = max(lines, key=Line2D.get_linewidth)
    solid = line.get_linestyle() in ("-", "solid")
    return {"colour": mpl.colors.to_hex(line.get_color()), "dashes": "" if solid else ' stroke-dasharray="5 3"'}
