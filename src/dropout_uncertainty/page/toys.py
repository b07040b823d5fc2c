"""The toys of the page *The one idea: a draw of the weights*: pictures (curves in, axes out), and one to play with."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from torch import Tensor

from dropout_uncertainty.bayes import MLP
from dropout_uncertainty.page.plotting import COLOURS
from dropout_uncertainty.page.sliders import FLOATS, Slider, Toy, floats

__all__ = ["STEPS", "functions", "play_functions", "spread", "walks"]

#: Steps of training by profile.
STEPS = {"recorded": 2000, "quick": 2000, "full": 6000}
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
    shades = np.linspace(0.5, 0.9, len(spreads))
    for (n, std), shade in zip(spreads.items(), shades, strict=True):
        ax.plot(grid, std, color=colormaps["Blues"](shade), label=f"epistemic, {n} points")
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


def play_functions(net: MLP, grid: Float[Tensor, " N"], points: tuple[Tensor, Tensor], noise: float) -> Toy:
    """Return a figure in which a reader draws functions from a trained network.

    Sliders set the drop probability wherever the network has dropout, the number of draws and the noise of a new
    observation; the weights stay.
    """
    trained = sorted({p for p in net.drop if p}) or [0.0]
    sliders = [
        Slider("p", "drop probability", trained[-1], 0, 0.5, 0.05),
        Slider("draws", "number of draws", 20, 2, 100, 1),
        Slider("noise", "noise (standard deviation)", noise, 0, 0.5, 0.05),
    ]
    layers = [[floats(part[0].detach()) for part in layer] for layer in zip(net.weights, net.biases, strict=True)]
    x, y = (values.flatten().tolist() for values in points)
    data = {
        "grid": grid.tolist(), "x": x, "y": y, "layers": layers, "activation": net.activation.__name__,
        "dropped": [p > 0 for p in net.drop], "colours": [DRAWS, DATA],
    }  # fmt: skip
    lead = (
        f"Draw functions yourself, from the network of {len(x)} points. Its weights stay as they were trained, with "
        f"drop probability {' and '.join(f'{p:g}' for p in trained)}. You set the drop probability of the draws, their "
        "number, and the noise of a new observation."
    )
    return Toy(lead, "Functions drawn from a dropout network, with the data.", FUNCTIONS, sliders, data)


FUNCTIONS = """
({ grid, x, y, layers, activation, dropped, colours: [blue, orange] }) => {
  const floats = FLOATS;
  const parts = layers.map(([weights, biases]) => [floats(weights), floats(biases)]);
  const activate = {
    relu: (unit) => Math.max(unit, 0), tanh: Math.tanh, sigmoid: (unit) => 1 / (1 + Math.exp(-unit)),
  }[activation];
  const dense = (units, [weights, biases]) => {
    const out = Float64Array.from(biases);
    for (let i = 0; i < units.length; i++) {
      if (units[i] === 0) continue;
      for (let j = 0; j < out.length; j++) out[j] += units[i] * weights[i * out.length + j];
    }
    return out;
  };
  const pass = (units, from, to, masks) => {
    for (let l = from; l < to; l++) {
      if (masks[l]) units = units.map((unit, i) => unit * masks[l][i]);
      units = dense(units, parts[l]);
      if (l + 1 < parts.length) units = units.map(activate);
    }
    return units;
  };
  const first = dropped.includes(true) ? dropped.indexOf(true) : parts.length;
  const count = ([weights, biases]) => weights.length / biases.length;
  const before = grid.map((at) => pass([at], 0, first, [])); // the same in every draw

  return ({ p, draws, noise }, random) => {
    const mask = (part) => Array.from({ length: count(part) }, () => (random() < p ? 0 : 1 / (1 - p)));
    const functions = Array.from({ length: draws }, () => {
      const masks = parts.map((part, l) => dropped[l] && mask(part)); // held: the same at every point of the grid
      return before.map((units) => pass(units, first, parts.length, masks)[0]);
    });
    const mean = grid.map((_, n) => functions.reduce((sum, f) => sum + f[n], 0) / draws);
    const variance = mean.map((m, n) => functions.reduce((sum, f) => sum + (f[n] - m) ** 2, 0) / (draws - 1));
    const std = variance.map((v) => Math.sqrt(v + noise ** 2));
    const edge = (sign) => mean.map((m, n) => m + sign * 2 * std[n]);
    const spread = (there) => {
      const inside = variance.filter((_, n) => there(Math.abs(grid[n])));
      const epistemic = inside.reduce((sum, v) => sum + v, 0) / inside.length;
      return `${Math.sqrt(epistemic).toFixed(3)} (${Math.sqrt(epistemic + noise ** 2).toFixed(3)})`;
    };
    const paths = [
      { x: [...grid, ...[...grid].reverse()], y: [...edge(1), ...edge(-1).reverse()], fill: orange,
        "fill-opacity": 0.25, label: "new observation, two std" },
      ...functions.map((f) => ({ x: grid, y: f, stroke: blue, "stroke-opacity": 0.6 })),
      { x: grid, y: mean, stroke: "currentColor", "stroke-width": 2, label: "their mean" },
      { x, y, dots: true, stroke: orange, "stroke-width": 6, label: "data" },
    ];
    paths[1].label = "functions";
    return {
      panels: [{
        x: { low: -4, high: 4, ticks: [-4, -2, 0, 2, 4], label: "x" },
        y: { low: -3, high: 3, ticks: [-3, -2, -1, 0, 1, 2, 3], label: "y" },
        paths,
      }],
      words: `Standard deviation of the functions, and in brackets of a new observation: `
        + `${spread((at) => at > 1 && at < 2.5)} where there are data, ${spread((at) => at <= 1)} in the gap, `
        + `${spread((at) => at >= 2.5 && at < 3.5)} beside them.`,
    };
  };
}""".replace("FLOATS", FLOATS)
