"""Types and shapes that users of NumPy pass without thinking, each taken as it is or refused in one sentence."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

TAKEN = {
    "an environment's action of any width", "an environment's action as an array of no axes",
    "agents as a list", "drop probabilities as an array", "ticks from NumPy", "widths as a list", "rate from NumPy",
    "seeds from NumPy", "a range of seeds", "a layout as a list", "agents from NumPy", "actions as a list",
    "small integers as actions", "rules of a world",
}  # fmt: skip
REFUSED = {
    "an environment's action as a float": "expected an action from 0 to 4, got 2.0",
    "an environment's action as an array": "expected an action from 0 to 4, got array([2])",
    "an environment's ticks as a float": "an episode has a whole number of ticks, at least one, got 2.5",
    "agents alone": "agents must be a tuple, got AgentConfig(",
    "agents by name": "agents must be of type AgentConfig, got 'greedy'",
    "one drop probability": "drop must be a tuple, got 0.2",
    "ticks as a float": "ticks must be a whole number, got 200000.0",
    "ticks as text": "ticks must be a whole number, got '9000'",
    "negative ticks": "ticks must be at least 1, got -500",
    "one width": "hidden must be a tuple, got 50",
    "rate as text": "learning_rate must be a finite number, got '0.01'",
    "hold as a float": "hold must be a whole number, got 10.0",
    "rules as a table": "rules must be of type Rules, got {'first_eye': -1.0}",
    "a policy of no name": "unknown policy None, choose one of",
    "one seed": "expected seeds as a list of integers, got 100",
    "seeds as floats": "expected seeds as a list of integers, got [100.0]",
    "a layout without replicas": "expected uniform numbers [R, 30, 3] for the first items, got shape [30, 3]",
    "a float number of agents": "a world needs a whole number of agents, at least one, got 1.0",
    "float actions": "expected actions as whole numbers of shape (1, 1), got float64 of shape (1, 1)",
    "actions without agents": "expected actions as whole numbers of shape (1, 1), got int64 of shape (1,)",
    "a negative action": "expected actions from 0 to 4, got -1 to -1",
    "no replicas in memory": "a replay memory holds at least one transition of one replica",
}


@pytest.fixture(scope="module")
def outcomes():
    """Return what became of each case, in a process without the type checks that tests have."""
    pytest.importorskip("gymnasium")
    script = Path(__file__).with_name("what_users_pass.py")
    found = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    return json.loads(found.stdout)


def test_every_case_has_an_expectation(outcomes):
    assert set(outcomes) == TAKEN | set(REFUSED)


@pytest.mark.parametrize("case", sorted(TAKEN))
def test_what_can_be_meant_is_taken(outcomes, case):
    assert outcomes[case] == "fine"


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_what_cannot_is_refused_in_a_sentence(outcomes, case):
    kind = "UserError" if case.startswith("an environment") else "ValueError"
    assert outcomes[case].startswith(f"{kind}: {REFUSED[case]}")
