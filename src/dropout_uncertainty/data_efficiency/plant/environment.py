"""The cart-pole swing-up as a Gymnasium environment, for learners from elsewhere; needs the extra ``gym``."""

import math
from typing import Any

import numpy as np

from dropout_uncertainty import rendering
from dropout_uncertainty.data_efficiency.plant import cartpole, drawing
from dropout_uncertainty.data_efficiency.plant.extrapolation import State, step
from dropout_uncertainty.errors import UserError

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as missing:
    raise UserError("the environment needs Gymnasium, which is not installed: pip install 'gymnasium>=1'") from missing

__all__ = ["CartPoleSwingUp"]

#: What a force at its limit may lie above it after rounding.
ROUNDED = 1e-6


class CartPoleSwingUp(gymnasium.Env):
    """One trial of the plant per episode.

    Observation: the noisy state (x [m], v [m/s], w [rad/s], theta [rad], 0 upright, not wrapped). Action: the force
    as a share of the plant's limit, in [-1, 1]. Reward: 1 - cost of the true next state, in [0, 1]. The episode is
    truncated after the plant's number of steps and never terminates before. ``info["state"]`` is the true state.
    The plant moves as that of the learners does, within 1e-6 a step (`extrapolation.step`).

    Args:
        plant: a name in ``cartpole.PRESETS`` or a plant of your own.
        render_mode: "rgb_array" for ``render``, or None.

    Raises:
        ValueError: for an unknown plant.
        UserError: for an unknown render mode.
    """

    metadata = rendering.RENDERING

    def __init__(self, plant: str | cartpole.CartPole = "paper", render_mode: str | None = None) -> None:
        self.plant = plant if isinstance(plant, cartpole.CartPole) else cartpole.preset(plant)
        self.render_mode = rendering.check_render_mode(render_mode)
        self.observation_space = spaces.Box(-np.inf, np.inf, (4,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self._state: State | None = None
        self._steps = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Draw a start state; return its observation and the true state."""
        super().reset(seed=seed)
        state = np.array(self.plant.start_mean) + self.plant.start_std * self.np_random.standard_normal(4)
        self._state, self._steps = tuple(state.tolist()), 0
        return self._observe(state), {"state": state}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Apply a force for one control interval.

        Raises:
            UserError: before the first ``reset``, or if the action is not one number in [-1, 1].
        """
        if self._state is None:
            raise UserError("the environment has no state yet: call reset first")
        try:
            share = np.asarray(action, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):
            share = np.empty(0)
        if share.size != 1 or not abs(share[0]) <= 1 + ROUNDED:  # NaN is not
            limit = self.plant.force_limit
            raise UserError(f"expected an action of one number in [-1, 1], the share of {limit:g} N, got {action!r}")
        self._state = moved = step(self.plant, self._state, self.plant.force_limit * float(share[0].clip(-1, 1)))
        self._steps += 1
        state = np.array(moved)
        return self._observe(state), self._reward(moved), False, self._steps >= self.plant.steps, {"state": state}

    def render(self) -> np.ndarray | None:
        """Return a picture [H, W, 3] of the true state with the goal, as the book draws it; None without a mode."""
        if self.render_mode is None:
            return None
        if self._state is None:
            raise UserError("the environment has no state yet: call reset first")
        state, length = np.array(self._state), self.plant.pole_length
        reach = max(2.6 * length, abs(state[0]) + length)

        def draw(ax: Any) -> None:
            drawing.goal(ax, self.plant)
            drawing.cart_pole(ax, self.plant, state)
            ax.set(xlim=(-reach, reach), ylim=(-reach / 2, reach / 2), aspect="auto")

        return rendering.pixels(draw, 6.0, 3.0)

    def _observe(self, state: np.ndarray) -> np.ndarray:
        return state + self.plant.observation_noise * self.np_random.standard_normal(4)

    def _reward(self, state: State) -> float:
        """Return 1 - `cost.cost` of the true state."""
        x, _, _, theta = state
        length = self.plant.pole_length
        square = (x - length * math.sin(theta)) ** 2 + (length * (math.cos(theta) - 1)) ** 2
        return math.exp(-square / (2 * self.plant.cost_width**2))
