"""Trials of the cart-pole, side by side, as an animation for a page (see ``player``)."""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float

from dropout_uncertainty.data_efficiency.cartpole import CartPole, tip
from dropout_uncertainty.data_efficiency.figures import CART
from dropout_uncertainty.player import Player, Shape, circle, line, polygon, text

__all__ = ["swing_up"]

SCALE = 100  # units of the drawing per metre
#: A panel shows no more of the track than this on either side of its middle [m]; a cart may leave it.
FURTHEST = 1.2
#: Frames per control interval: between its ends the state is drawn on a straight line.
SMOOTH = 2
HEAD = 34


def swing_up(plant: CartPole, trials: Mapping[str, Float[np.ndarray, "times 4"]]) -> Player:
    """Return an animation, in real time, of true states [T + 1, 4] by the title of their panel; a cross is the goal.

    Raises:
        ValueError: if the states are not [T + 1, 4] of the plant.
    """
    for states in trials.values():
        if np.shape(states) != (plant.steps + 1, 4):
            raise ValueError(f"expected states of shape {(plant.steps + 1, 4)}, got {np.shape(states)}")
    furthest = max(float(np.abs(states[:, 0]).max()) for states in trials.values())
    half = SCALE * min(furthest + plant.pole_length + 0.1, FURTHEST)
    middles = [half * (2 * number + 1) for number in range(len(trials))]
    height = HEAD + SCALE * plant.pole_length
    times = np.arange(SMOOTH * plant.steps + 1) / SMOOTH
    smooth = [
        np.stack([np.interp(times, np.arange(plant.steps + 1), column) for column in np.asarray(states, float).T], -1)
        for states in trials.values()
    ]
    frames = [
        [
            shape
            for middle, states in zip(middles, smooth, strict=True)
            for shape in _moving(plant, states[i], middle, height)
        ]
        for i in range(len(times))
    ]
    background = [
        shape
        for middle, title in zip(middles, trials, strict=True)
        for shape in _still(plant, title, middle, half, height)
    ]
    description = f"The cart-pole in {len(trials)} trials side by side: {', '.join(trials)}; a cross marks the goal"
    labels = [f"{plant.dt * t:.2f} s" for t in times]
    size = (2 * half * len(trials), height + SCALE * (plant.pole_length + 0.15))
    return Player(frames, size, description, labels, background=background, rate=SMOOTH / plant.dt)


def _still(plant: CartPole, title: str, middle: float, half: float, height: float) -> list[Shape]:
    """Return title, track and goal of a panel."""
    track, goal = height + SCALE * CART[1] / 2, height - SCALE * plant.pole_length
    return [
        text(middle - half + 10, 16, title, font_size=15),
        line(middle - half + 5, track, middle + half - 5, track, stroke_opacity=0.5),
        line(middle - 6, goal - 6, middle + 6, goal + 6, stroke_width=4),
        line(middle + 6, goal - 6, middle - 6, goal + 6, stroke_width=4),
    ]


def _moving(plant: CartPole, state: np.ndarray, middle: float, height: float) -> list[Shape]:
    """Return cart, pole and pivot of a state."""
    x = middle + SCALE * state[0]
    wide, high = SCALE * CART[0] / 2, SCALE * CART[1] / 2
    end_x, end_y = SCALE * tip(plant, torch.from_numpy(state)).numpy()
    corners = [
        (x - wide, height - high),
        (x + wide, height - high),
        (x + wide, height + high),
        (x - wide, height + high),
    ]
    return [
        polygon(corners, fill="#999999", stroke="currentColor"),
        line(x, height, middle + end_x, height - end_y, stroke_width=5, stroke_linecap="round"),
        circle(x, height, 3.5, fill="currentColor"),
    ]
