"""Deep Sea with one agent as a Gymnasium environment, for learners from elsewhere; needs the extra `gym`.

Its name is ``gymnasium.make("dropout_uncertainty/DeepSea-v0", size=10)``.
"""

from typing import Any

import numpy as np

from dropout_uncertainty import rendering
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.deep_sea.world import ACTIONS, DeepSea

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as missing:
    raise UserError("the environment needs Gymnasium, which is not installed: pip install 'gymnasium>=1'") from missing


class DeepSeaEnv(gymnasium.Env):
    """One sea, whose map of actions stays the same through all episodes.

    Observation: [N, N], 1 in the cell of the agent and 0 elsewhere; after the last move 0 everywhere, as in bsuite.
    Action: 0 or 1, of which one means right. ``info["found"]``: whether the move found the treasure.

    Args:
        size: the side N [cells].
        mapping_seed: of the map; another seed of ``reset`` does not change it.

    Raises:
        UserError: if ``size`` < 2, or for another render mode than None and "rgb_array".
    """

    metadata = rendering.RENDERING

    def __init__(self, size: int = 10, mapping_seed: int = 0, render_mode: str | None = None) -> None:
        if size < 2:
            raise UserError(f"a sea has at least 2 rows, got a size of {size}")
        chance = np.random.default_rng(mapping_seed)
        self.sea = DeepSea(chance.integers(ACTIONS, size=(1, size, size)))
        self.observation_space = spaces.Box(0.0, 1.0, (size, size), np.float32)
        self.action_space = spaces.Discrete(ACTIONS)
        self.render_mode = rendering.check_render_mode(render_mode)
        self.ready = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Bring the agent to the upper left cell; return what it sees."""
        super().reset(seed=seed)
        self.sea.reset()
        self.ready = True
        return self._observe(), {"found": False}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Make one move.

        Raises:
            UserError: before the first `reset`, after the last move of an episode, or if there is no such action.
        """
        if not self.ready or self.sea.over:
            raise UserError("no episode is under way: call reset first")
        if not self.action_space.contains(action):
            raise UserError(f"expected an action from 0 to {ACTIONS - 1}, got {action!r}")
        reward, found = self.sea.step(np.array([action]))
        return self._observe(), float(reward[0]), self.sea.over, False, {"found": bool(found[0])}

    def render(self) -> np.ndarray | None:
        """Return a picture [H, W, 3] of the cells that can be reached, with agent and treasure; None without a mode."""
        if self.render_mode is None:
            return None
        size, sea = self.sea.size, self.sea

        def draw(ax: Any) -> None:
            above = ~np.tri(size, dtype=bool)
            ax.imshow(np.ma.array(np.full((size, size), 0.15), mask=above), cmap="Blues", vmin=0, vmax=1)
            ax.plot(size - 1, size - 1, "*", color="#d3302f", markersize=150 / size)
            if not sea.over:
                ax.plot(sea.column[0], sea.row, "o", color="#0072B2", markersize=120 / size)

        return rendering.pixels(draw, 3.0, 3.0)

    def _observe(self) -> np.ndarray:
        seen = np.zeros((self.sea.size, self.sea.size), dtype=np.float32)
        if not self.sea.over:
            seen[self.sea.row, self.sea.column] = 1.0
        return seen
