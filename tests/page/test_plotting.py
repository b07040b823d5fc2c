import base64
import io

import matplotlib as mpl
import numpy as np
from IPython.core import pylabtools
from IPython.core.pylabtools import retina_figure
from matplotlib.figure import Figure
from PIL import Image

from dropout_uncertainty.page import dark_pages, plotting


def test_a_small_png_looks_like_a_large_one(monkeypatch):
    pictures = []

    def kept(*args, **options):
        pictures.append(retina_figure(*args, **options))
        return pictures[-1]

    monkeypatch.setattr(pylabtools, "retina_figure", kept)
    with plotting.style():
        figure = Figure()
        ax = figure.add_subplot()
        for shift, (name, colour) in enumerate(plotting.COLOURS.items()):
            plotting.band(ax, np.arange(9), np.random.default_rng(0).random((5, 9)) + shift, colour=colour, label=name)
        ax.legend()
        encoded, size = plotting.small_png(figure)
    large = pictures[0][0]
    small, full = Image.open(io.BytesIO(base64.b64decode(encoded))), Image.open(io.BytesIO(large)).convert("RGB")
    assert small.size == full.size
    assert (size["width"], size["height"]) == (small.width // 2, small.height // 2)
    assert 3 * len(base64.b64decode(encoded)) < len(large)
    small, full = (np.asarray(image.convert("RGB"), dtype=int) for image in (small, full))
    assert (small[0] == 255).all()
    away = np.abs(small - full).max(-1)
    assert (away > 24).mean() < 3e-3  # at the edges of all methods in one picture; less in any of the book
    shades = {tuple(round(255 * part) for part in mpl.colors.to_rgb(colour)) for colour in plotting.COLOURS.values()}
    for shade in shades:  # colours carry meaning
        assert away[(full == shade).all(-1)].max() <= 8


def test_a_pale_ground_is_to_be_seen_on_dark_pages_too(monkeypatch):
    monkeypatch.setenv(dark_pages.TWICE, "1")
    with plotting.style():
        figure = Figure(figsize=(7, 3))
        for ax in figure.subplots(1, 2):
            ax.axvspan(-0.05, 0.05, color="#eeeeee")
            for row, colour in enumerate(plotting.COLOURS.values()):
                ax.plot([-0.1, 0.2], [row, row + 0.5], "o-", color=colour)
        light, metadata = plotting.small_png(figure)
    for encoded, ground in ((light, 255), (metadata[dark_pages.KEY], 18)):
        shades = np.asarray(Image.open(io.BytesIO(base64.b64decode(encoded))).convert("L"), dtype=int)
        pale = (np.abs(shades - ground) > 8) & (np.abs(shades - ground) < 20)
        assert pale.mean() > 0.1, ground


def test_an_empty_figure_is_not_shown():
    assert plotting.small_png(Figure()) is None
