import numpy as np
import pytest
from matplotlib import colors
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from dropout_uncertainty.page.dark_figures import GROUND, dark, darkened
from dropout_uncertainty.page.plotting import COLOURS


def contrast(first, second):
    """Return the contrast of two colours as the guidelines for accessible pages define it."""
    rgb = np.array([colors.to_rgb(first), colors.to_rgb(second)])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    low, high = sorted(linear @ [0.2126, 0.7152, 0.0722])
    return (high + 0.05) / (low + 0.05)


def test_white_is_the_ground_and_black_can_be_read_on_it():
    assert dark("white")[0] == pytest.approx(colors.to_rgba(GROUND), abs=0.01)
    assert contrast(dark("black")[0][:3], GROUND) > 7
    assert dark((0, 0, 0, 0.3))[0, 3] == 0.3
    greys = [colors.to_rgb(str(x)) for x in (0, 0.3, 0.6, 0.9, 1)]
    assert (np.diff(dark(greys)[:, :3].sum(1)) < 0).all()


def test_curves_keep_their_hue_and_stand_out():
    for colour in COLOURS.values():
        before, after = colors.to_rgb(colour), dark(colour)[0][:3]
        assert contrast(after, GROUND) > 3
        assert np.ptp(before) < 0.2 or np.argmax(before) == np.argmax(after)
    shown = dark(sorted(set(COLOURS.values())))[:, :3]
    apart = np.abs(shown[:, None] - shown).sum(-1)[~np.eye(len(shown), dtype=bool)]
    assert apart.min() > 0.2


def test_afterwards_a_figure_is_what_it_was():
    figure = Figure()
    canvas, ax = FigureCanvasAgg(figure), figure.add_subplot()
    ax.plot([0, 1], "o-", color="#222222", markerfacecolor="white", label="curve")
    ax.fill_between([0, 1], [0, 1], color="#0072B2", alpha=0.2)
    ax.scatter([0], [1], edgecolors="none", color="black")
    ax.annotate("note", (0, 0), (1, 1), arrowprops={"color": "black"}, bbox={"facecolor": "white"})
    ax.legend(frameon=True, edgecolor="none", framealpha=1)
    canvas.draw()
    before = np.asarray(canvas.buffer_rgba()).copy()
    with darkened(figure):
        assert ax.get_legend().get_frame().get_edgecolor()[3] == 0
        canvas.draw()
        night = np.asarray(canvas.buffer_rgba()).copy()
    canvas.draw()
    assert (np.asarray(canvas.buffer_rgba()) == before).all()
    assert (before[:, :, :3] > 200).all(-1).mean() > 0.8
    assert not (night[:, :, :3] > 230).all(-1).any()


def test_colours_that_are_numbers_stay():
    figure = Figure()
    left, right = figure.subplots(1, 2)
    points = left.scatter([0, 1], [0, 1], c=[0.0, 1.0], cmap="gray")
    right.imshow(np.eye(2), cmap="gray")
    written = right.text(0, 0, "1", color="white")
    figure.canvas.draw()
    before = points.get_facecolor().copy()
    with darkened(figure):
        figure.canvas.draw()
        assert isinstance(points, PathCollection)
        assert (points.get_facecolor() == before).all()
        assert written.get_color() == "white"
        assert right.title.get_color() != "black"
