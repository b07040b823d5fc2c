"""What stands in a picture, read back from its axes."""

import numpy as np


def labelled(ax):
    """Return the lines that have a label, by their labels."""
    return {line.get_label(): line for line in ax.lines if not line.get_label().startswith("_")}


def dots(ax, colour=None, marker="o"):
    """Return [x, y] of single points, of one colour if it is named, in the order of drawing."""
    lines = [line for line in ax.lines if line.get_marker() == marker and colour in {None, line.get_color()}]
    return np.array([line.get_xydata()[0] for line in lines])
