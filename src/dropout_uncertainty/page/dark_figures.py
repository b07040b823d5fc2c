"""A figure in the colours of a dark page: dark ground and light letters, its curves as they are.

A style sheet's filter cannot do that: what makes white dark also makes a dark blue curve light and a light blue one
dark, so that they change places.
"""

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colors
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

__all__ = ["GROUND", "dark", "darkened"]

#: The ground of the theme's dark pages.
GROUND = "#121212"
#: Colours of less chroma than this are greys and pale grounds, whose lightness is turned round.
PALE = 0.06
#: Lightness of black on a dark page, and the least of a curve.
LETTERS, CURVE = 0.87, 0.6
#: Linear RGB to the cone responses of Oklab, and their cube roots to lightness and two colour axes (Ottosson, 2020).
CONES = np.array([
    [0.4122214708, 0.5363325363, 0.0514459929],
    [0.2119034982, 0.6806995451, 0.1073969566],
    [0.0883024619, 0.2817188376, 0.6299787005],
])  # fmt: skip
AXES = np.array([
    [0.2104542553, 0.7936177850, -0.0040720468],
    [1.9779984951, -2.4285922050, 0.4505937099],
    [0.0259040371, 0.7827717662, -0.8086757660],
])  # fmt: skip
PARTS = ("color", "facecolor", "edgecolor", "markerfacecolor", "markeredgecolor")


def _oklab(rgb: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return np.cbrt(linear @ CONES.T) @ AXES.T


def _rgb(oklab: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    linear = np.clip(np.linalg.solve(CONES, np.linalg.solve(AXES, oklab.T) ** 3).T, 0, 1)
    return np.clip(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055), 0, 1)


def dark(colour: Any) -> Float[np.ndarray, "N 4"]:
    """Return a colour, or several, as on a dark page: RGBA with the hue and the opacity that it has.

    White becomes the ground, black light, a grey or pale ground what lies as far between; of all others only those that
    are too dark for a curve become lighter.
    """
    rgba = np.atleast_2d(colors.to_rgba_array(colour)).astype(float)
    oklab = _oklab(rgba[:, :3])
    lightness, ground = oklab[:, 0].copy(), _oklab(colors.to_rgba_array(GROUND)[:, :3])[0, 0]
    turned = ground + (LETTERS - ground) * np.clip(1 - lightness, 0, 1) ** 0.7
    pale = np.hypot(*oklab[:, 1:].T) < PALE
    oklab[:, 0] = np.where(pale, turned, np.maximum(lightness, CURVE))
    rgba[:, :3] = _rgb(oklab)
    return rgba


@contextlib.contextmanager
def darkened(figure: Figure) -> Iterator[None]:
    """Colour a figure that has been drawn for a dark page, as long as the context lasts."""
    # all are read first: the edge of a marker follows the colour of its line
    found = [
        (change, before)
        for artist in _artists(figure)
        if not _is_data(artist)
        for part in PARTS
        if (change := getattr(artist, f"set_{part}", None)) and (get := getattr(artist, f"get_{part}", None))
        if not _is_none(before := get())
    ]
    try:
        for change, before in found:
            after = dark(before)
            change(after if np.ndim(before) == 2 else tuple(after[0]))
        yield
    finally:
        for change, before in reversed(found):
            change(before)


def _is_none(colour: Any) -> bool:
    """Return whether a part is not drawn, or in the colour of another part."""
    if isinstance(colour, str):
        return colour in ("none", "auto", "face")
    return not np.any(colors.to_rgba_array(colour)[:, 3])


def _artists(figure: Figure) -> Iterator[Artist]:
    """Yield all parts of a figure, with the boxes and arrows that texts do not count among theirs."""
    for artist in figure.findobj():
        yield artist
        if isinstance(artist, Text) and (box := artist.get_bbox_patch()):
            yield box
        if isinstance(artist, Annotation) and artist.arrow_patch:
            yield artist.arrow_patch


def _is_data(artist: Artist) -> bool:
    """Return whether colours of an artist stand for numbers, or whether it is written on such colours."""
    array = getattr(artist, "get_array", None)
    if array is not None and array() is not None:
        return True
    on = artist.axes
    return isinstance(artist, Text) and isinstance(on, Axes) and bool(on.images) and artist in on.texts
