"""What users pass without thinking, to be run as they run it: without the type checks that tests have.

Prints a JSON object: for each case "fine", or kind and message of the error.
"""

import json
from dataclasses import replace

import numpy as np

from dropout_uncertainty.exploration.experiment import AS_DEMO, OURS, AgentConfig, start
from dropout_uncertainty.exploration.foraging.environment import ForagingWorld
from dropout_uncertainty.exploration.foraging.world import ITEMS, Rules, World
from dropout_uncertainty.exploration.policies import policy
from dropout_uncertainty.exploration.replay import ReplayMemory
from dropout_uncertainty.settings import config_hash

GREEDY = OURS["greedy"]
LAYOUT = np.zeros((1, ITEMS, 3))


def moves(actions):
    world = World(LAYOUT)
    world.step(actions)
    assert world.clock == 1


def env_step(action):
    env = ForagingWorld()
    env.reset(seed=100)
    env.step(action)


CASES = {
    "an environment's action of any width": lambda: env_step(np.uint64(2)),
    "an environment's action as an array of no axes": lambda: env_step(np.array(2)),
    "an environment's action as a float": lambda: env_step(2.0),
    "an environment's action as an array": lambda: env_step(np.array([2])),
    "an environment's ticks as a float": lambda: ForagingWorld(2.5),
    "agents alone": lambda: replace(GREEDY, agents=AgentConfig("greedy")),
    "agents by name": lambda: replace(GREEDY, agents=("greedy",)),
    "agents as a list": lambda: config_hash(replace(GREEDY, agents=[AgentConfig("greedy")])),
    "one drop probability": lambda: replace(GREEDY, agents=(AgentConfig("greedy", 0.2),)),
    "drop probabilities as an array": lambda: config_hash(
        replace(GREEDY, agents=(AgentConfig("greedy", np.array([0.0, 0.2, 0.0])),))
    ),
    "ticks as a float": lambda: replace(GREEDY, ticks=2e5),
    "ticks as text": lambda: replace(GREEDY, ticks="9000"),
    "ticks from NumPy": lambda: config_hash(replace(GREEDY, ticks=np.int64(9000))),
    "negative ticks": lambda: replace(GREEDY, ticks=-500),
    "one width": lambda: replace(GREEDY, hidden=50),
    "widths as a list": lambda: config_hash(replace(GREEDY, hidden=[50, 50])),
    "rate from NumPy": lambda: config_hash(replace(GREEDY, learning_rate=np.float32(0.01))),
    "rate as text": lambda: replace(GREEDY, learning_rate="0.01"),
    "hold as a float": lambda: replace(AS_DEMO, agents=(AgentConfig("thompson", (0.0, 0.2, 0.0), hold=10.0),)),
    "rules as a table": lambda: replace(GREEDY, rules={"first_eye": -1.0}),
    "a policy of no name": lambda: policy(None),
    "one seed": lambda: start(GREEDY, 100),
    "seeds from NumPy": lambda: start(replace(GREEDY, memory=1001), np.arange(100, 102)),
    "a range of seeds": lambda: start(replace(GREEDY, memory=1001), range(100, 102)),
    "seeds as floats": lambda: start(GREEDY, [100.0]),
    "a layout as a list": lambda: World(LAYOUT.tolist()),
    "a layout without replicas": lambda: World(LAYOUT[0]),
    "a float number of agents": lambda: World(LAYOUT, agents=1.0),
    "agents from NumPy": lambda: World(LAYOUT, agents=np.int64(2)),
    "actions as a list": lambda: moves([[0]]),
    "float actions": lambda: moves(np.array([[0.0]])),
    "actions without agents": lambda: moves(np.array([0])),
    "a negative action": lambda: moves(np.array([[-1]])),
    "small integers as actions": lambda: moves(np.array([[4]], dtype=np.int8)),
    "rules of a world": lambda: World(LAYOUT, rules=Rules(first_eye=np.float64(-1))),
    "no replicas in memory": lambda: ReplayMemory(0, 10, 3, 2),
}


def outcome(case):
    try:
        case()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "fine"


if __name__ == "__main__":
    print(json.dumps({name: outcome(case) for name, case in CASES.items()}))
