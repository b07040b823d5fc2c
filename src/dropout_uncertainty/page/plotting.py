"""The look of the book's figures: one style, one colour per method everywhere, mean and band."""

import base64
import contextlib
import importlib
import io
import os
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from dropout_uncertainty.page import dark_figures, dark_pages
from dropout_uncertainty.stats import t_interval

__all__ = ["COLOURS", "SMALL", "WIDTH", "band", "legend_above", "missing", "small_png", "style", "use_style"]

#: Width of the widest figures [inches]: at 96 dots per inch the column of text on a screen of 1300 pixels. The page
#: would shrink wider ones, and their letters with them.
WIDTH = 7.15
#: Size of letters beside those of the axes [points]: legends, ticks, numbers in a picture.
SMALL = 9

#: With fewer repetitions than this an interval around a curve says little, and may reach below zero.
FEW = 5

#: One colour per method, from the colour-blind safe palettes of Okabe and Ito (2008) and Tol (2021).
COLOURS: dict[str, str] = {
    "random": "#6c6c6c",
    "max-entropy": "#E69F00",
    "variation-ratios": "#0072B2",
    "bald": "#D55E00",
    "mean-std": "#CC79A7",
    "least-confidence": "#009E73",
    "margin": "#56B4E9",
    "batch-bald": "#882255",
    "power-bald": "#117733",
    "thompson": "#0072B2",
    "epsilon-greedy": "#117733",
    "boltzmann": "#E69F00",
    "annealed-thompson": "#882255",
    "greedy": "#6c6c6c",
    "pilco": "#B8860B",
    "deep-pilco": "#0072B2",
    "deep-pilco-as-written": "#56B4E9",
    "ddpg": "#117733",
    "naf": "#882255",
    "thesis": "#222222",
}

RC: dict[str, Any] = {
    "figure.figsize": (WIDTH, 4.2),
    "figure.dpi": 96,  # as the pixels of style sheets: a point in a figure is a point on the page
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "savefig.bbox": "tight",
    "savefig.pad_inches": 0.04,  # what the layout keeps free, so that trimming adds nothing
    "font.size": 10,
    "axes.titlesize": 10,
    "legend.fontsize": SMALL,
    "legend.title_fontsize": SMALL,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Return a context in which figures have the style of the book."""
    with mpl.rc_context(RC):  # type: ignore[arg-type]  # matplotlib lists every key
        yield


def use_style() -> None:
    """Set the style of the book for the rest of a notebook; its figures are shown as ``small_png`` makes them."""
    from IPython import get_ipython

    plt.rcParams.update(RC)  # type: ignore[arg-type]
    if shell := get_ipython():
        # the backend sets a formatter of its own when it is first imported
        importlib.import_module("matplotlib_inline.backend_inline")
        shell.display_formatter.formatters["image/png"].for_type(Figure, small_png)


def small_png(figure: Figure) -> tuple[str, dict[str, Any]] | None:
    """Return a figure as base64 of a PNG, and its width and height on the page [px]; None for an empty one.

    It has two dots per pixel, for paper and sharp screens, and the 256 colours that suit it best, which need a quarter
    of the bytes of all colours. While the book is made the metadata also hold the picture for `dark_pages`.
    """
    light = _drawn(figure, "white")
    if light is None or not os.environ.get(dark_pages.TWICE):
        return light
    with dark_figures.darkened(figure):
        second = _drawn(figure, dark_figures.GROUND)
    return light[0], {**light[1], dark_pages.KEY: second[0] if second else None}


def _drawn(figure: Figure, ground: str) -> tuple[str, dict[str, Any]] | None:
    from IPython.core.pylabtools import retina_figure

    picture = retina_figure(figure, base64=False, bbox_inches="tight")
    if picture is None:
        return None
    full, size = Image.open(io.BytesIO(picture[0])).convert("RGB"), picture[1]
    # an octree would be quicker, but takes pale grounds of a dark picture for its ground
    few, file = full.quantize(method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE), io.BytesIO()
    parts = [round(255 * part) for part in mpl.colors.to_rgb(ground)]
    palette = np.array(few.getpalette()).reshape(-1, 3)
    palette[np.abs(palette - parts).max(1) < 4] = parts  # the ground stays what it is
    few.putpalette(palette.ravel().tolist())
    few.save(file, "png", optimize=True)
    return base64.b64encode(file.getvalue()).decode(), size


def legend_above(*axes: Axes) -> None:
    """Put what these axes show in one row above all panels of their figure, which are too narrow for a legend."""
    figure = axes[0].figure
    for earlier in figure.legends:
        earlier.remove()
    handles = [handle for ax in axes for handle in ax.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), columnspacing=1.4)


def band(ax: Axes, x: np.ndarray, curves: Float[np.ndarray, "R T"], *, colour: str, label: str, **line: Any) -> None:
    """Draw the mean of R curves with its 95 % t interval; with fewer than five, the curves themselves, thin."""
    ax.plot(x, curves.mean(0), color=colour, label=label, **line)
    if len(curves) < FEW:
        ax.plot(x, curves.T, color=colour, linewidth=0.7, alpha=0.6)
    else:
        limits = np.array([t_interval(column)[1:3] for column in curves.T])
        ax.fill_between(x, limits[:, 0], limits[:, 1], color=colour, alpha=0.18, linewidth=0)


def missing(ax: Axes, names: Sequence[str]) -> None:
    """Say above a picture which of the things that belong in it have not been run."""
    if names:
        letters = int(14 * ax.get_window_extent().width / ax.figure.dpi)  # that fit in a line
        words = textwrap.fill(f"Not run yet: {'; '.join(names)}", letters)
        ax.set_title(words, loc="left", fontsize=SMALL, color="#6c6c6c")
