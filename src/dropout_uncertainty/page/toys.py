"""Pictures of the toys of the page *The one idea: a draw of the weights*: curves in, axes out."""

from collections.abc import Mapping, Sequence

from jaxtyping import Float
from matplotlib.axes import Axes
from torch import Tensor

from dropout_uncertainty.page.plotting import COLOURS

__all__ = ["STEPS", "functions", "spread", "walks"]

#: Steps of training by profile.
STEPS = {"recorded": 2000, "quick": 600, "full": 6000}
DRAWS, DATA = "#0072B2", COLOURS["bald"]


def functions(
    axes: Sequence[Axes],
    grid: Float[Tensor, " N"],
    curves: Mapping[int, Float[Tensor, "S N"]],
    deterministic: Mapping[int, Float[Tensor, " N"]],
    points: Mapping[int, tuple[Tensor, Tensor]],
) -> None:
    """Draw, for each number of data points, twelve functions, the deterministic pass and the data, one panel each."""
    for ax, n in zip(axes, curves, strict=True):
        ax.plot(grid, curves[n][:12].T, color=DRAWS, alpha=0.45, linewidth=1)
        ax.plot(grid, deterministic[n], color="#222222", label="deterministic pass")
        ax.plot(*(values.flatten() for values in points[n]), ".", color=DATA, label="data")
        ax.set(title=f"{n} points", xlabel="x", ylim=(-3, 3))
    axes[0].set_ylabel("y")
    axes[0].legend()


def spread(ax: Axes, grid: Float[Tensor, " N"], spreads: Mapping[int, Float[Tensor, " N"]], noise: float) -> Axes:
    """Draw the standard deviation of functions for each number of data points, beside that of the noise."""
    for (n, std), colour in zip(spreads.items(), ("#56B4E9", DRAWS), strict=False):
        ax.plot(grid, std, color=colour, label=f"epistemic, {n} points")
    ax.axhline(noise, color=DATA, linestyle="--", label="aleatoric (the noise)")
    for start in (-2.5, 1.0):
        ax.axvspan(start, start + 1.5, color="#dddddd", alpha=0.5, linewidth=0)
    ax.set(xlabel="x", ylabel="standard deviation of y", ylim=(0, 0.8))
    ax.legend()
    return ax


def walks(axes: Sequence[Axes], path: Float[Tensor, " N"], heights: Mapping[bool, Float[Tensor, "S N"]]) -> None:
    """Draw the heights of thirty walkers who hold one draw, and of thirty who draw at every step."""
    for ax, (hold, height) in zip(axes, heights.items(), strict=True):
        ax.plot(path, height[:30].T, color=DRAWS, alpha=0.35, linewidth=1)
        ax.set(title="draw held by each walker" if hold else "fresh draw at every step", xlabel="x")
    axes[0].set_ylabel("height")
