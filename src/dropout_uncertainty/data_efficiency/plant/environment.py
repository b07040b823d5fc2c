"""The cart-pole swing-up as a Gymnasium environment, for learners from elsewhere; needs the extra ``gym``."""

from typing import Any

import numpy as np
import torch

from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.errors import UserError

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as missing:
    raise UserError("the environment needs Gymnasium, which is not installed: pip install 'gymnasium>=1'") from missing

__all__ = ["CartPoleSwingUp"]


class CartPoleSwingUp(gymnasium.Env):
    """One trial of the plant per episode.

    Observation: the noisy state (x [m], v [m/s], w [rad/s], theta [rad], 0 upright, not wrapped). Action: the force
    as a share of the plant's limit, in [-1, 1]. Reward: 1 - cost of the true next state, in [0, 1]. The episode is
    truncated after the plant's number of steps and never terminates before. ``info["state"]`` is the true state.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - Gymnasium's interface

    def __init__(self, preset: str = "paper") -> None:
        self.plant = cartpole.preset(preset)
        self.observation_space = spaces.Box(-np.inf, np.inf, (4,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self._state: torch.Tensor | None = None
        self._steps = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Draw a start state; return its observation and the true state."""
        super().reset(seed=seed)
        mean = torch.tensor(self.plant.start_mean, dtype=torch.float64)
        self._state = state = mean + self.plant.start_std * torch.from_numpy(self.np_random.standard_normal(4))
        self._steps = 0
        return self._observe(state), {"state": state.numpy().copy()}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Apply a force for one control interval.

        Raises:
            UserError: before the first ``reset``, or if the action is not one number in [-1, 1].
        """
        if self._state is None:
            raise UserError("the environment has no state yet: call reset first")
        share = np.asarray(action, dtype=np.float64).reshape(-1)
        if share.size != 1 or not abs(share[0]) <= 1:  # NaN is not
            limit = self.plant.force_limit
            raise UserError(f"expected an action of one number in [-1, 1], the share of {limit:g} N, got {action!r}")
        force = self.plant.force_limit * torch.from_numpy(share)[0]
        self._state = state = cartpole.step(self.plant, self._state, force)
        self._steps += 1
        reward = 1 - cost(self.plant, state).item()
        return self._observe(state), reward, False, self._steps >= self.plant.steps, {"state": state.numpy().copy()}

    def _observe(self, state: torch.Tensor) -> np.ndarray:
        return state.numpy() + self.plant.observation_noise * self.np_random.standard_normal(4)
