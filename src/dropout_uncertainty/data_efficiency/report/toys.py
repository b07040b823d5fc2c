"""Pictures of the toys of section 5.4, and of the expected cost: tensors and arrays in, axes out."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from torch import Tensor

from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian
from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole
from dropout_uncertainty.data_efficiency.plant.cost import mean_cost
from dropout_uncertainty.page.plotting import COLOURS, SMALL

__all__ = ["expected_cost", "look_ahead", "model", "walking_particles"]

PATHS = "#999999"


def model(
    ax: Axes,
    x: Float[Tensor, " N"],
    curves: tuple[Float[Tensor, " N"], Float[Tensor, " N"], Float[Tensor, "N N"]],
    seen: tuple[Float[Tensor, " M"], Float[Tensor, " M"]],
) -> Axes:
    """Draw a rule, a Gaussian process that has seen some of it (mean and covariance), and what it has seen."""
    rule, mean, cov = curves
    _band(ax, x, mean, cov.diagonal().clamp_min(0).sqrt(), COLOURS["pilco"], 0.25)
    ax.plot(x, rule, "k--", lw=1, label="the rule")
    ax.plot(x, mean, color=COLOURS["pilco"], label="Gaussian process, two std")
    ax.plot(*seen, "ko", label="seen")
    ax.set(xlabel="position", ylabel="next step", xlim=(-2.6, 5), ylim=(-0.8, 1.2))
    ax.legend(fontsize=SMALL, loc="upper left")
    return ax


def look_ahead(
    ax: Axes, truth: Sequence, sure: Sequence[float], walkers: Sequence[np.ndarray], gauss: Sequence[Gaussian]
) -> Axes:
    """Draw three ways to look ahead, from time 0 on: the mean taken for the truth, walkers, and matched Gaussians."""
    t, mean = np.arange(len(gauss)), np.array([float(g.mean) for g in gauss])
    ax.plot(t, np.array(walkers)[:, :60], color=PATHS, lw=0.4)
    _band(ax, t, mean, np.array([float(g.cov) for g in gauss]) ** 0.5, COLOURS["pilco"], 0.3)
    ax.plot(t, mean, color=COLOURS["pilco"], label="matched Gaussian, two std")
    ax.plot(t, sure, color=COLOURS["bald"], label="mean taken for the truth")
    ax.plot(t, truth, "k--", lw=1, label="what will happen")
    ax.set(xlabel="time", ylabel="position")
    ax.legend(fontsize=SMALL, loc="upper left")
    return ax


def expected_cost(ax: Axes, plant: CartPole, stds: Sequence[float]) -> Axes:
    """Draw the expected cost against the mean angle, for some standard deviations of the angle [rad]."""
    angle = torch.linspace(0, torch.pi, 100, dtype=torch.float64)
    mean, cov = angle.new_zeros(100, 4), angle.new_zeros(100, 4, 4)
    mean[:, 3] = angle
    for std, shade in zip(stds, np.linspace(1.0, 0.4, len(stds)), strict=True):
        cov[:, 3, 3] = std**2
        ax.plot(
            angle, mean_cost(plant, Gaussian(mean, cov)), color=COLOURS["pilco"], alpha=shade, label=f"std {std:g} rad"
        )
    ax.set(xlabel="mean angle [rad]; 0 is upright", ylabel="expected cost")
    ax.legend()
    return ax


def walking_particles(axes: Sequence[Axes], clouds: Mapping[str, Sequence[Tensor]], truth: Sequence) -> None:
    """Draw clouds of particles [1, K, 1] at times 0, 1, ... and two standard deviations; by the title of a panel."""
    for ax, (title, cloud) in zip(axes, clouds.items(), strict=True):
        t, paths = np.arange(len(cloud)), torch.stack(list(cloud))[:, 0, :, 0]
        mean = paths.mean(1)
        ax.plot(t, paths[:, :60], color=PATHS, lw=0.4)
        _band(ax, t, mean, paths.std(1), COLOURS["deep-pilco"], 0.25)
        ax.plot(t, mean, color=COLOURS["deep-pilco"], label="particles, two std")
        ax.plot(t, truth, "k--", lw=1, label="what will happen")
        ax.set(xlabel="time", title=title)
    axes[0].set_ylabel("position")
    axes[0].legend(fontsize=SMALL, loc="upper left")


def _band(ax: Axes, x: Any, mean: Any, std: Any, colour: str, alpha: float) -> None:
    ax.fill_between(x, mean - 2 * std, mean + 2 * std, color=colour, alpha=alpha, lw=0)
