"""Trials of the cart-pole, and what was predicted of them, as animations for a page (see ``page.svg_animation``)."""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float

from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole, tip
from dropout_uncertainty.data_efficiency.plant.drawing import CART
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.page.plotting import COLOURS
from dropout_uncertainty.page.svg import SHOWN, Shape, circle, letters, line, polygon, polyline, text
from dropout_uncertainty.page.svg_animation import Player

__all__ = ["predictions", "swing_up"]

SCALE = 100  # units of the drawing per metre
#: A panel shows no more of the track than this on either side of its middle [m]; a cart may leave it.
FURTHEST = 1.2
#: Frames per control interval: between its ends the state is drawn on a straight line.
SMOOTH = 2
HEAD = 34
#: Drawing of the predictions: size, space at the left and below, and the angles shown [rad].
WIDE, HIGH, LEFT, BELOW = SHOWN, 320, 60, 40
LOWEST, HIGHEST = -1.5 * np.pi, 4.5 * np.pi


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
    size = (2 * half * len(trials), height + SCALE * (plant.pole_length + 0.15))
    background = [
        shape
        for middle, title in zip(middles, trials, strict=True)
        for shape in _still(plant, title, middle, half, height, letters(size[0]))
    ]
    description = f"The cart-pole in {len(trials)} trials side by side: {', '.join(trials)}; a cross marks the goal"
    labels = [f"{plant.dt * t:.2f} s" for t in times]
    return Player(frames, size, description, labels, background=background, rate=SMOOTH / plant.dt)


def _still(plant: CartPole, title: str, middle: float, half: float, height: float, letter: float) -> list[Shape]:
    """Return title, track and goal of a panel."""
    track, goal = height + SCALE * CART[1] / 2, height - SCALE * plant.pole_length
    return [
        text(middle - half + 10, letter, title, font_size=letter),
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


def predictions(learning: Learning, replica: int) -> Player:
    """Return Figure 5.8 for every trial of a repetition, to slide over: prediction in blue, true angle in green.

    The band is two standard deviations wide to either side, as in ``figures.figure_5_8``.
    """
    steps = learning.plant.steps
    x = LEFT + (WIDE - LEFT - 10) * np.arange(steps + 1) / steps
    frames, labels = [], []
    for trial in range(1, learning.trials + 1):
        mean = learning.arrays["predicted_mean"][replica, trial, :, 3].astype(float)
        std = learning.predicted_std[replica, trial, :, 3]
        true = learning.arrays["states"][replica, trial, :, 3].astype(float)
        upper, lower = (list(zip(x, _height(mean + sign * std), strict=True)) for sign in (2, -2))
        blue, green = COLOURS["deep-pilco"], "#117733"
        frames.append(
            [
                polygon(upper + lower[::-1], fill=blue, fill_opacity=0.35),
                polyline(list(zip(x, _height(mean), strict=True)), stroke=blue, stroke_width=2),
                polyline(list(zip(x, _height(true), strict=True)), stroke=green, stroke_width=2),
            ]
        )
        outcome = "solved" if learning.solved[replica, trial] else "not solved"
        costs = learning.predicted_costs[replica, trial], learning.trial_costs[replica, trial]
        labels.append(f"Trial {trial}: cost {costs[1]:.2f} per step, {costs[0]:.2f} predicted; {outcome}")
    description = (
        f"The predicted angle over {steps} steps as a blue band and the true angle as a green line, one picture per "
        f"trial from 1 to {learning.trials}; dotted lines are upright"
    )
    return Player(frames, (WIDE, HIGH), description, labels, background=_axes(x), rate=2)


def _height(angle: np.ndarray) -> np.ndarray:
    """Return where an angle stands in the drawing of the predictions; far ones stay outside of it."""
    share = (np.clip(angle, LOWEST - np.pi, HIGHEST + np.pi) - LOWEST) / (HIGHEST - LOWEST)
    return (HIGH - BELOW) * (1 - share)


def _axes(x: np.ndarray) -> list[Shape]:
    shapes = [line(x[0], 0, x[0], HIGH - BELOW), line(x[0], HIGH - BELOW, x[-1], HIGH - BELOW)]
    turns = np.arange(-1, 5)
    for half_turns, y in zip(turns.tolist(), _height(turns * np.pi).tolist(), strict=True):
        name = {0: "0", 1: "π", -1: "−π"}.get(half_turns, f"{half_turns}π")
        shapes.append(text(x[0] - 10, y + 5, name, text_anchor="end", font_size=letters(WIDE)))
        if half_turns % 2 == 0:
            shapes.append(line(x[0], y, x[-1], y, stroke_dasharray="2 5"))
    for step in range(0, len(x), 5):
        shapes.append(text(x[step], HIGH - BELOW + 17, str(step), text_anchor="middle", font_size=letters(WIDE)))
    shapes.append(text(x[len(x) // 2], HIGH - 5, "time step", text_anchor="middle", font_size=letters(WIDE)))
    shapes.append(text(0, 14, "angle", font_size=letters(WIDE)))
    return shapes
