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
MOVE = (
    '<animateTransform attributeName="transform" type="{kind}" values="{values}" dur="{duration:g}s" '
    'begin="{name}.click" fill="freeze" additive="replace"/>'
)


class SwingUp:
    """Trials side by side, with the goal of each as a black cross.

    Args:
        plant: the cart-pole, drawn to scale.
        trials: true states [T + 1, 4] by the title of the panel.
        name: identifier of the picture, one per page.

    Raises:
        ValueError: if the states are not [T + 1, 4] of the plant.
    """

    def __init__(
        self, plant: CartPole, trials: Mapping[str, Float[np.ndarray, "times 4"]], name: str = "swing-up"
    ) -> None:
        for states in trials.values():
            if np.shape(states) != (plant.steps + 1, 4):
                raise ValueError(f"expected states of shape {(plant.steps + 1, 4)}, got {np.shape(states)}")
        self.plant, self.trials, self.name = plant, dict(trials), name
        furthest = max(float(np.abs(states[:, 0]).max()) for states in self.trials.values())
        self.width = 2 * (furthest + plant.pole_length) + 0.2

    def _repr_html_(self) -> str:
        """Return the picture; a notebook shows it."""
        length = self.plant.pole_length
        total, height = self.width * len(self.trials), 2 * length + 0.5
        box = f"0 {-SCALE * (length + 0.3):.0f} {SCALE * total:.0f} {SCALE * height:.0f}"
        panels = "".join(self._panel(i, *item) for i, item in enumerate(self.trials.items()))
        label = f"The cart-pole in {len(self.trials)} trials: {', '.join(self.trials)}. Click to play."
        return (
            f'<svg id="{self.name}" viewBox="{box}" role="img" aria-label="{escape(label)}" font-family="sans-serif" '
            f'style="width:100%;max-width:{round(SCALE * total)}px;background:white;cursor:pointer">{panels}</svg>'
        )

    def _panel(self, number: int, title: str, states: np.ndarray) -> str:
        length, middle = SCALE * self.plant.pole_length, SCALE * self.width * (number + 0.5)
        left, right = -SCALE * self.width / 2 + 5, SCALE * self.width / 2 - 5
        wide, high = SCALE * CART[0], SCALE * CART[1]
        cross = f"M-6,{-length - 6:g}l12,12m0,-12l-12,12"
        x = [f"{SCALE * value:.1f},0" for value in states[:, 0]]
        # counter-clockwise is positive; SVG turns clockwise since its y axis points down
        turn = [f"{-np.degrees(value):.1f}" for value in states[:, 3]]
        return (
            f'<g transform="translate({middle:.0f},0)">'
            f'<text y="{-length - 16:g}" text-anchor="middle" font-size="13">{escape(title)}</text>'
            f'<path d="M{left:.0f},{high / 2:g}H{right:.0f}" stroke="#999999"/>'
            f'<path d="{cross}" stroke="black" stroke-width="4"/>'
            f'<g transform="translate({x[0]})">{self._move("translate", x)}'
            f'<rect x="{-wide / 2:g}" y="{-high / 2:g}" width="{wide:g}" height="{high:g}" fill="#BBBBBB" '
            f'stroke="#333333"/><g transform="rotate({turn[0]})">{self._move("rotate", turn)}'
            f'<path d="M0,0V{-length:g}" stroke="#333333" stroke-width="5" stroke-linecap="round"/></g></g></g>'
        )

    def _move(self, kind: str, values: list[str]) -> str:
        duration = self.plant.dt * self.plant.steps
        return MOVE.format(kind=kind, values=";".join(values), duration=duration, name=self.name)
