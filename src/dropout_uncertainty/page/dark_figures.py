"""A figure in the colours of a dark page: dark ground and light letters, its curves as they are.

A style sheet's filter cannot do that: what makes white dark also makes a dark blue curve light and a light blue one
dark, so that they change places.
"""

import colorsys
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
#: Colours whose parts are less far apart are greys and pale grounds, whose lightness is turned round.
PALE = 0.22
#: Lightness of black on a dark page.
LETTERS = 0.85
#: Luma below which a curve cannot be told from the ground, and the least lightness of one that is so dark.
DIM, LIFTED = 0.3, 0.45
PARTS = ("color", "facecolor", "edgecolor", "markerfacecolor", "markeredgecolor")


def dark(colour: Any) -> Float[np.ndarray, "N 4"]:
    """Return a colour of matplotlib's, or N of them, as on a dark page: RGBA with the hue and the opacity that it has.

    White becomes the ground, black light, a grey or pale ground what lies as far between; of all others only those that
    are too dark for a curve become lighter.
    """
    rgba = np.atleast_2d(colors.to_rgba_array(colour)).astype(float)
    ground = colorsys.rgb_to_hls(*colors.to_rgb(GROUND))[1]
    for one in rgba:
        hue, lightness, saturation = colorsys.rgb_to_hls(*one[:3])
        if np.ptp(one[:3]) < PALE:
            lightness = LETTERS + (ground - LETTERS) * lightness
        elif colorsys.rgb_to_yiq(*one[:3])[0] < DIM:
            lightness = max(lightness, LIFTED)
        one[:3] = colorsys.hls_to_rgb(hue, lightness, saturation)
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
