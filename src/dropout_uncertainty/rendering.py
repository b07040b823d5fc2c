"""Pictures of the environments, for Gymnasium's ``render``."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import UInt8

from dropout_uncertainty.errors import UserError

__all__ = ["RENDERING", "check_render_mode", "pixels"]

#: What the environments can be drawn as, and how many steps a second an animation of them shows.
RENDERING: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}
DOTS = 100  # per inch


def check_render_mode(mode: str | None) -> str | None:
    """Return the mode; raises UserError for one in which nothing can be drawn."""
    if mode not in (None, *RENDERING["render_modes"]):
        raise UserError(f"expected the render mode rgb_array or None, got {mode!r}")
    return mode


def pixels(draw: Callable[[Any], Any], width: float, height: float) -> UInt8[np.ndarray, "H W 3"]:
    """Return what ``draw`` puts on axes that fill a picture of so many inches.

    Raises:
        UserError: without matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise UserError("pictures need matplotlib, which is not installed: pip install matplotlib") from None
    canvas = FigureCanvasAgg(Figure((width, height), dpi=DOTS))
    axes = canvas.figure.add_axes((0.0, 0.0, 1.0, 1.0))
    draw(axes)
    axes.set_axis_off()
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
