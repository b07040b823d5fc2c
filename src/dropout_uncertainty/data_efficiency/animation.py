"""Trials of the cart-pole that move: one SVG, a few kilobytes, which plays in real time when it is clicked.

The picture needs no script and no other file; what does not play it shows the start of the trial.
"""

from collections.abc import Mapping
from html import escape

import numpy as np
from jaxtyping import Float

from dropout_uncertainty.data_efficiency.cartpole import CartPole

__all__ = ["SwingUp"]

SCALE = 100  # pixels per metre
CART = (0.3, 0.12)  # width and height of the drawn cart [m]
#: A panel shows no more of the track than this on either side of its middle [m]; a cart may leave it.
FURTHEST = 1.2
MOVE = (
    '<animateTransform attributeName="transform" type="{kind}" values="{values}" dur="{duration:g}s" '
    'begin="{name}.click" fill="freeze" additive="replace"/>'
)


class SwingUp:
    """Trials side by side, with the goal of each as a black cross.

    Args:
        plant: the cart-pole, drawn to scale.
        trials: true states [T + 1, 4] by the title of the panel.
        name: identifier of the picture, letters only, one per page.

    Raises:
        ValueError: if the states are not [T + 1, 4] of the plant.
    """

    def __init__(
        self, plant: CartPole, trials: Mapping[str, Float[np.ndarray, "times 4"]], name: str = "swingup"
    ) -> None:
        for states in trials.values():
            if np.shape(states) != (plant.steps + 1, 4):
                raise ValueError(f"expected states of shape {(plant.steps + 1, 4)}, got {np.shape(states)}")
        self.plant, self.trials, self.name = plant, dict(trials), name
        furthest = max(float(np.abs(states[:, 0]).max()) for states in self.trials.values())
        self.width = 2 * min(furthest + plant.pole_length + 0.1, FURTHEST)

    def _repr_html_(self) -> str:
        """Return the picture; a notebook shows it."""
        total, height = SCALE * self.width * len(self.trials), SCALE * (2 * self.plant.pole_length + 0.5)
        panels = "".join(self._panel(i, *item) for i, item in enumerate(self.trials.items()))
        label = f"The cart-pole in {len(self.trials)} trials: {', '.join(self.trials)}. Click to play."
        look = f"width:100%;max-width:{total:.0f}px;background:white;cursor:pointer"
        return (
            f'<svg id="{self.name}" viewBox="0 0 {total:.0f} {height:.0f}" role="img" aria-label="{escape(label)}" '
            f'font-family="sans-serif" style="{look}">{panels}</svg>'
        )

    def _panel(self, number: int, title: str, states: np.ndarray) -> str:
        length, width = SCALE * self.plant.pole_length, SCALE * self.width
        box = f"{-width / 2:.0f} {-length - 30:.0f} {width:.0f} {2 * length + 50:.0f}"
        wide, high = SCALE * CART[0], SCALE * CART[1]
        cross = f"M-6,{-length - 6:g}l12,12m0,-12l-12,12"
        x = [f"{SCALE * value:.1f},0" for value in states[:, 0]]
        # counter-clockwise is positive; SVG turns clockwise since its y axis points down
        turn = [f"{-np.degrees(value):.1f}" for value in states[:, 3]]
        return (
            f'<svg x="{number * width:.0f}" width="{width:.0f}" height="{2 * length + 50:.0f}" viewBox="{box}">'
            f'<text y="{-length - 16:g}" text-anchor="middle" font-size="13">{escape(title)}</text>'
            f'<path d="M{5 - width / 2:.0f},{high / 2:g}H{width / 2 - 5:.0f}" stroke="#999999"/>'
            f'<path d="{cross}" stroke="black" stroke-width="4"/>'
            f'<g transform="translate({x[0]})">{self._move("translate", x)}'
            f'<rect x="{-wide / 2:g}" y="{-high / 2:g}" width="{wide:g}" height="{high:g}" fill="#BBBBBB" '
            f'stroke="#333333"/><g transform="rotate({turn[0]})">{self._move("rotate", turn)}'
            f'<path d="M0,0V{-length:g}" stroke="#333333" stroke-width="5" stroke-linecap="round"/></g></g></svg>'
        )

    def _move(self, kind: str, values: list[str]) -> str:
        duration = self.plant.dt * self.plant.steps
        return MOVE.format(kind=kind, values=";".join(values), duration=duration, name=self.name)
