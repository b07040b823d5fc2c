"""The README's examples run as they stand, each pasted by itself; what takes minutes is made shorter."""

import re
from pathlib import Path

import pytest
from sklearn.datasets import load_digits
from sklearn.linear_model import LogisticRegression

from dropout_uncertainty.active_learning import EnsembleLearner, SklearnLearner, simulate

TEXT = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
#: A word of each example, what is put in the place of what, and what the last line then printed looks like.
EXAMPLES = {
    "load_digits": ({"rounds=15": "rounds=2"}, r"bald: 40 labels, test error \d+\.\d %"),
    "CNNLearner": (
        {"range(3)": "range(2)", "draws=50, subset=1_000": "draws=5, subset=100"},
        r"label these: \[\d+(, \d+){9}\]",
    ),
    "exploration": ({"20_000": "3_500"}, r".+"),  # the burn-in and a block: seven lines
    "deep_pilco": ({"trials=10": "trials=1, model_steps=2, policy_steps=2, guard=1.0"}, r"cost .+"),
}


@pytest.mark.parametrize("word", EXAMPLES)
def test_an_example_runs_when_pasted(word, capsys):
    (snippet,) = (snippet for snippet in SNIPPETS if word in snippet)
    shorter, last = EXAMPLES[word]
    for before, after in shorter.items():
        assert before in snippet
        snippet = snippet.replace(before, after)
    exec(snippet, {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == (7 if word == "exploration" else 2)
    assert re.fullmatch(last, lines[-1])


def test_bald_over_a_bootstrap_of_logistic_regressions_is_worse_than_random_on_the_digits():
    data = load_digits()
    error = {}
    for acquisition in ("bald", "random", "margin"):
        learner = EnsembleLearner(SklearnLearner(LogisticRegression(max_iter=300)), 5, bootstrap=True)
        options = {"acquisition": acquisition, "rounds": 10, "seed": 100, "progress": False}
        error[acquisition] = simulate(learner, data.images / 16, data.target, **options).error.mean()
    assert error["bald"] > error["random"] + 3 > error["random"] > error["margin"] + 1


def test_every_example_is_tried():
    assert len(SNIPPETS) == len(EXAMPLES)
