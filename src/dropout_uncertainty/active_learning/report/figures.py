"""Figures 5.1 and 5.2, the acquired digits and the digits that each function asks for: rows in, axes out."""

import itertools
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dropout_uncertainty.active_learning.experiment import ROWS
from dropout_uncertainty.active_learning.noisy_pools import Task
from dropout_uncertainty.active_learning.report import peaks
from dropout_uncertainty.active_learning.report.analysis import LABELS, Row, paired_curves
from dropout_uncertainty.active_learning.report.pools import Contrast, acquired
from dropout_uncertainty.errors import unknown
from dropout_uncertainty.page.curve_toggles import Curves
from dropout_uncertainty.page.plotting import COLOURS, SMALL, band, missing
from dropout_uncertainty.stats import t_interval

__all__ = [
    "asked_for", "bought", "class_shares", "differences", "digits", "figure_5_1", "figure_5_2", "forest",
    "learning_curves", "minibatches", "picked", "pool_curves", "to_choose",
]  # fmt: skip


def _check(names: Sequence[str], known: Collection[str]) -> None:
    """Raise ValueError for a name that no row has: it would be left out without a word."""
    for name in names:
        if name not in known:
            raise ValueError(unknown("row", name, known))


def colour(name: str) -> str:
    """Return the colour of a row: that of its acquisition function."""
    return COLOURS[name.rpartition("/")[2]]


def dash(name: str) -> str:
    """Return the dashes of a row: those of what scores the pool."""
    return {"softmax": "--", "ensemble": ":"}.get(name.partition("/")[0], "-")


def learning_curves(
    ax: Axes, rows: Mapping[str, Row], names: Sequence[str], *, original: Mapping[str, Row] | None = None
) -> Axes:
    """Draw test error against acquired points for the named rows; dashed lines are Softmax rows, dotted ones ensembles.

    With ``original``, the means of the curves that the original program recorded stand behind as thin lines.
    """
    for name in names:
        if original and name in original:
            row = original[name]
            ax.plot(row.labels - row.labels[0], row.error.mean(0), dash(name), color=colour(name), linewidth=0.7)
        if name in rows:
            row = rows[name]
            band(ax, row.labels - row.labels[0], row.error, colour=colour(name), label=row.label, linestyle=dash(name))
    ax.set(xlabel="points acquired from the pool", ylabel="test error [%]", yscale="log")
    _plain_ticks(ax)
    ax.legend()
    return ax


def _plain_ticks(ax: Axes) -> None:
    ticks = [tick for tick in (1, 2, 3, 5, 10, 20, 40, 60, 80) if ax.get_ylim()[0] <= tick <= ax.get_ylim()[1]]
    ax.set_yticks(ticks, [str(tick) for tick in ticks])
    ax.set_yticks([], minor=True)


def differences(ax: Axes, rows: Mapping[str, Row], names: Sequence[str]) -> Axes:
    """Draw the test error of the named rows less that of Random, paired by seed; the line at 0 is Random."""
    ax.axhline(0, color=COLOURS["random"], linewidth=1.2)
    for name in (name for name in names if {name, "random"} <= rows.keys() and name != "random"):
        acquired, curves = paired_curves(rows[name], rows["random"])
        band(ax, acquired, curves, colour=colour(name), label=rows[name].label, linestyle=dash(name))
    ax.set(xlabel="points acquired from the pool", ylabel="error minus Random [points]")
    return ax


def minibatches(axes: Sequence[Axes], found: Mapping[str, Row]) -> None:
    """Draw random acquisition with and without a small last minibatch (left), and the paired difference (right).

    Vertical lines stand at the peaks, where the last minibatch holds at most four images.
    """
    reach = min((len(row.labels) for row in found.values()), default=0)
    for (words, row), shade in zip(found.items(), (COLOURS["random"], COLOURS["variation-ratios"]), strict=False):
        band(axes[0], row.labels[:reach], row.error[:, :reach], colour=shade, label=words)
        for ax, labels in itertools.product(axes, row.labels[:reach][peaks.at_peaks(row.labels[:reach])]):
            ax.axvline(labels, color="#888888", linewidth=0.8, linestyle=":", zorder=0)
    if len(found) == 2:
        _, curves = paired_curves(*found.values())
        band(axes[1], row.labels[:reach], curves, colour=COLOURS["bald"], label="difference")
    axes[1].axhline(0, color="black", linewidth=0.8)
    missing(axes[1], [words for words in (peaks.TAIL, peaks.EVEN) if words not in found])
    axes[0].set(xlabel="labels", ylabel="test error of Random [%]", yscale="log")
    axes[1].set(xlabel="labels", ylabel="first less second [points]")
    _plain_ticks(axes[0])
    axes[0].legend()


def to_choose(rows: Mapping[str, Row], original: Mapping[str, Row] | None, shown: Sequence[str]) -> Curves:
    """Return the learning curves of the rows of the tables, each with a box to tick; those of ``shown`` are ticked.

    Raises:
        ValueError: for a name that is no row's.
    """
    _check(shown, ROWS)
    curves = Curves("Falling error curves on a logarithmic axis, one for each row; boxes choose which")
    for name in (name for name in rows if name in ROWS):
        with curves.group(rows[name].label, shown=name in shown):
            learning_curves(curves.ax, rows, [name], original=original)
    return curves


def asked_for(ax: Axes, points: Float[np.ndarray, "N 2"], classes: Int[np.ndarray, " N"], asked: np.ndarray) -> Axes:
    """Draw points of two classes in the plane, with circles around those whose labels were asked for."""
    x, y = points.T
    ax.scatter(x, y, c=classes, cmap="coolwarm", s=12, alpha=0.4)
    ax.scatter(x[asked], y[asked], facecolors="none", edgecolors="black", s=60, label="asked for")
    ax.set(xlabel="first input", ylabel="second input")
    ax.legend()
    return ax


def pool_curves(axes: Sequence[Axes], pools: Mapping[str, Mapping[str, Row]]) -> None:
    """Draw the learning curves of each kind of pool, one panel each."""
    for ax, (kind, rows) in zip(axes, pools.items(), strict=True):
        ax.set_title(kind)
        if rows:
            learning_curves(ax, rows, list(rows))
        else:
            ax.axis("off")
            ax.text(0.5, 0.5, "not run yet", ha="center", transform=ax.transAxes)


def bought(axes: Sequence[Axes], kind: str, rows: Mapping[str, Row], names: Sequence[str]) -> None:
    """Draw the first sixty images that some rows acquired from a kind of pool, one panel each; rows may be missing.

    Raises:
        ValueError: for a name that is no row's.
    """
    _check(names, LABELS)
    found = [rows[name] for name in names if name in rows]
    for ax in axes:
        ax.axis("off")
    for ax, row in zip(axes, found, strict=False):
        task, points = acquired(kind, row)
        picked(ax, task, points[:60], row.label)
    axes[0].figure.suptitle(kind)


def forest(ax: Axes, pairs: Sequence[Contrast], margin: float = 1.0) -> Axes:
    """Draw paired differences of test error with 95 % intervals and single seeds; the grey strip is ±``margin``."""
    ax.axvspan(-margin, margin, color="#eeeeee")
    ax.axvline(0, color="black", linewidth=0.8)
    for height, pair in enumerate(pairs):
        value, low, high, n = t_interval(pair.difference)
        ax.plot(pair.difference, np.full(n, height), "|", color=colour(pair.first), alpha=0.5)
        ax.plot([low, high], [height, height], color=colour(pair.first))
        ax.plot(value, height, "o", color=colour(pair.first))
    ax.set_yticks(range(len(pairs)), [f"{pair.kind}: {pair.label} ({len(pair.difference)})" for pair in pairs])
    ax.set_ylim(len(pairs) - 0.5, -0.5)
    ax.set(xlabel="difference of test error,\n100 to 300 acquired [points]")
    return ax


def picked(ax: Axes, task: Task, points: Int[np.ndarray, " n"], title: str) -> Axes:
    """Draw the images in the order of acquisition, ten in a row; a frame marks those that were wasted."""
    images = task.data.train_images[points].numpy()
    wasted = task.wasted(torch.from_numpy(points).long()).numpy()
    rows = -(-len(points) // 10)
    sheet = np.zeros((10 * rows, 28, 28), dtype=images.dtype)
    sheet[: len(points)] = images
    ax.imshow(sheet.reshape(rows, 10, 28, 28).swapaxes(1, 2).reshape(28 * rows, 280), cmap="gray_r")
    for row, column in (divmod(place, 10) for place in np.flatnonzero(wasted)):
        ax.add_patch(Rectangle((28.0 * column, 28.0 * row), 27, 27, fill=False, color=COLOURS["bald"], linewidth=1))
    ax.axis("off")
    ax.set_title(title)
    return ax


def figure_5_1(axes: np.ndarray, rows: Mapping[str, Row], original: Mapping[str, Row] | None = None) -> None:
    """Draw Figure 5.1 on axes [2, 2]: BALD and Variation Ratios, each with Dropout, Softmax and Random.

    Below them is the error less that of Random.
    """
    for (above, below), name in zip(axes.T, ("bald", "variation-ratios"), strict=True):
        names = ["random", f"softmax/{name}", f"dropout/{name}"]
        learning_curves(above, rows, names, original=original).set_title(LABELS[f"dropout/{name}"].partition(" ")[2])
        differences(below, rows, names)
        above.label_outer()
        below.label_outer()


def figure_5_2(axes: Sequence[Axes], rows: Mapping[str, Row], original: Mapping[str, Row] | None = None) -> None:
    """Draw Figure 5.2: the four acquisition functions with MC dropout; below less Random."""
    names = ["random", "dropout/bald", "dropout/variation-ratios", "dropout/max-entropy"]
    learning_curves(axes[0], rows, names, original=original).label_outer()
    differences(axes[1], rows, names)


def digits(figure: Figure, images: Float[np.ndarray, "N 28 28"], titles: Sequence[str]) -> np.ndarray:
    """Draw images in rows of ten, one title each, and return the axes."""
    axes = figure.subplots(-(-len(images) // 10), 10, squeeze=False)
    for ax in axes.flat:
        ax.axis("off")
    for ax, image, title in zip(axes.flat, images, titles, strict=False):
        ax.imshow(image, cmap="gray_r", vmin=0, vmax=1)
        ax.set_title(title, fontsize=SMALL)
    return axes


def class_shares(ax: Axes, rows: Mapping[str, Row], labels: Int[np.ndarray, " M"]) -> Float[np.ndarray, "rows 10"]:
    """Draw the share of each digit among the acquired points of each row; return the shares [rows, 10] in %.

    ``labels`` are those of the whole training set. The first 20 points of a row were not acquired.
    """
    shares = np.stack(
        [100 * np.bincount(labels[row.stack("points")[:, 20:]].ravel(), minlength=10) for row in rows.values()]
    ).astype(float)
    shares /= shares.sum(1, keepdims=True) / 100
    picture = ax.imshow(shares, cmap="cividis", aspect="auto")
    ax.set_xticks(range(10))
    ax.set_yticks(range(len(rows)), [row.label for row in rows.values()])
    ax.set(xlabel="digit")
    ax.grid(visible=False)
    ax.figure.colorbar(picture, ax=ax, label="share of acquired points [%]")
    for (i, j), share in np.ndenumerate(shares):
        light = share < shares.mean()
        ax.text(j, i, f"{share:.0f}", ha="center", va="center", fontsize=SMALL, color="white" if light else "black")
    return shares
