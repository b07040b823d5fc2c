"""Pictures of the cart-pole on the axes of a figure; only methods of the axes are called."""

from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float

from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole, tip

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CART = (0.3, 0.12)  # width and height of the drawn cart [m]
DARK = "#333333"


def cart_pole(ax: "Axes", plant: CartPole, state: Float[np.ndarray, " 4"], *, alpha: float = 1.0) -> "Axes":
    """Draw cart and pole of a state (x [m], v, w, theta [rad]) to scale, the pivot at height 0."""
    x = float(state[0])
    end = tip(plant, torch.as_tensor(np.asarray(state, float))).numpy()
    sides, heights = x + np.array([-1, 1, 1, -1]) * CART[0] / 2, np.array([-1, -1, 1, 1]) * CART[1] / 2
    ax.fill(sides, heights, facecolor="#BBBBBB", edgecolor=DARK, alpha=alpha, zorder=2)
    ax.plot([x, end[0]], [0, end[1]], color=DARK, linewidth=4, alpha=alpha, solid_capstyle="round", zorder=3)
    ax.plot(x, 0, "o", color=DARK, markersize=5, alpha=alpha, zorder=4)
    ax.set_aspect("equal")
    return ax


def goal(ax: "Axes", plant: CartPole) -> None:
    """Draw the track and the black cross, where the tip shall stand."""
    ax.axhline(-CART[1] / 2, color="#999999", linewidth=1, zorder=1)
    ax.plot(0, plant.pole_length, "x", color="black", markersize=12, markeredgewidth=3, zorder=5)
