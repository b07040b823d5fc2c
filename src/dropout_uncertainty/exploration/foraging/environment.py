"""The 2D world with one agent as a Gymnasium environment, for learners from elsewhere; needs the extra `gym`."""

from typing import Any

import numpy as np

from dropout_uncertainty import rendering
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.foraging import world as w
from dropout_uncertainty.exploration.foraging.drawing import draw_world
from dropout_uncertainty.exploration.foraging.world import Rules, World
from dropout_uncertainty.settings import of_type

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as missing:
    raise UserError("the environment needs Gymnasium, which is not installed: pip install 'gymnasium>=1'") from missing

__all__ = ["ForagingWorld"]

#: An item's displaced point may be sensed at this distance, in units of the range: see ``Rules.displaced_hits``.
FARTHEST = float(np.hypot(w.EYE_RANGE + 2 * w.ITEM_RADIUS, 2 * w.ITEM_RADIUS)) / w.EYE_RANGE


class ForagingWorld(gymnasium.Env):
    """A fixed number of ticks of the world per episode.

    Observation: per eye three numbers, for wall, food and poison: 1, or in the channel sensed the distance in units of
    the range. Action: one of the five moves. Reward: the demo's. The world has no end, so an episode never terminates
    but is truncated after ``ticks``. ``info`` counts what the move brought: food, poison and walls run into. The
    attribute ``world`` can be drawn with ``drawing.draw_world``.

    Raises:
        UserError: if ``ticks`` < 1, or for another render mode than None and "rgb_array".
    """

    metadata = rendering.RENDERING

    def __init__(self, ticks: int = 1000, rules: Rules | None = None, render_mode: str | None = None) -> None:
        if not isinstance(ticks, int | np.integer) or ticks < 1:
            raise UserError(f"an episode has a whole number of ticks, at least one, got {ticks!r}")
        self.ticks, self.rules = ticks, Rules() if rules is None else of_type(Rules, rules, "rules")
        self.render_mode = rendering.check_render_mode(render_mode)
        self.observation_space = spaces.Box(0.0, FARTHEST, (w.INPUTS,), np.float64)
        self.action_space = spaces.Discrete(len(w.ACTIONS))
        self.world: World | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Place items anew and put the agent back to its corner; return what it sees."""
        super().reset(seed=seed)
        self.world = World(self.np_random.random((1, w.ITEMS, 3)), rules=self.rules)
        return self._observe(self.world), {"food": 0, "poison": 0, "blocked": False}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Make one move.

        Raises:
            UserError: before the first `reset`, or if there is no such action.
        """
        if self.world is None:
            raise UserError("the environment has no state yet: call reset first")
        if getattr(action, "shape", ()) or not hasattr(action, "__index__") or int(action) not in range(len(w.ACTIONS)):
            raise UserError(f"expected an action from 0 to {len(w.ACTIONS) - 1}, got {action!r}")
        actions, readings = np.array([[int(action)]]), self._readings
        outcome = self.world.step(actions, self.np_random.random((1, w.ITEMS)), self.np_random.random((1, 4)))
        reward = self.world.reward(readings, actions, outcome)
        food, poison, blocked = outcome.food[0, 0], outcome.poison[0, 0], outcome.blocked[0, 0]
        info = {"food": int(food), "poison": int(poison), "blocked": bool(blocked)}
        return self._observe(self.world), float(reward[0, 0]), False, self.world.clock >= self.ticks, info

    def render(self) -> np.ndarray | None:
        """Return a picture [H, W, 3] of the world, as in Figure 5.3; None without a render mode."""
        if self.render_mode is None:
            return None
        if (world := self.world) is None:
            raise UserError("the environment has no state yet: call reset first")
        return rendering.pixels(lambda ax: draw_world(ax, world), w.WIDTH / 100, w.HEIGHT / 100)

    def _observe(self, world: World) -> np.ndarray:
        self._readings = world.sense()
        return world.inputs(self._readings)[0, 0]
