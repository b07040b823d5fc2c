"""Sentences about agents are as strong as their verdicts; published verdicts are what the page was written for."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dropout_uncertainty.exploration.report import analysis, answers
from dropout_uncertainty.exploration.report.deep_sea import dives
from dropout_uncertainty.exploration.report.deep_sea.dives import Dives
from dropout_uncertainty.exploration.report.statements import STATEMENTS
from dropout_uncertainty.judging.statements import KINDS, Judged, Measured
from dropout_uncertainty.stats import mean_estimate

BY_ID = {statement.id: statement for statement in STATEMENTS}


def judged(name, values):
    statement = BY_ID[name]
    if values is None:
        return Judged(statement, None, "untested", "untested", math.nan, False)
    difference = mean_estimate(values)
    verdict = statement.verdict(difference)
    return Judged(statement, Measured(difference, difference.interval), verdict, verdict, difference.p, False)


def about(mean, spread, n=20):
    return mean + spread * np.linspace(-1, 1, n)


def sea(agent, solved, found=None, n=40):
    """An agent that has solved so many of n seas of size 10 in episode 500, and found the treasure in so many."""
    when = np.where(np.arange(n) < solved, 500.0, np.inf)
    first = np.where(np.arange(n) < (found or solved), 400.0, np.inf)
    again = np.where(np.isfinite(first), 0.25, np.nan)
    return Dives(agent, 10, tuple(range(n)), first, again, when, np.full(n, 1e4), np.zeros((n, 10, 10)))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (about(0.1, 0.01), "earns **more** than"),
        (about(-0.1, 0.01), "earns **less** than"),
        (about(0.001, 0.01), "earns as much as"),
        (about(0.02, 0.2), "these runs do not tell"),
        (about(0.1, 0.01, n=3), "too few runs to tell"),
        (None, "not run yet"),
    ],
)
@pytest.mark.parametrize("name", sorted(name for name in answers.COMPARED if name.startswith("EX7") or name == "EX3c"))
def test_a_sentence_is_as_strong_as_its_verdict(name, values, words):
    said = answers.sentence(judged(name, values))
    assert words in said
    strong = ("**more**", "**less**", "as much as")
    assert sum(word in said for word in strong) == (words.startswith("earns"))
    assert said[0].isupper()
    assert said.endswith(".")


def test_a_sentence_carries_its_numbers():
    said = answers.sentence(judged("EX7a", about(-0.1, 0.01)))
    assert "(−0.100 a move, 95 % interval −0.103 to −0.097, 20 seeds)" in said
    level = answers.sentence(judged("EX7a", about(0.0, 0.01)))
    assert "to within 0.02 (+0.000 a move, 90 % interval −0.002 to +0.002, 20 seeds)" in level
    small = replace(judged("EX7a", about(0.01, 0.001)), small=True)
    assert "too little to matter" in answers.sentence(small)


def test_every_statement_of_the_page_has_a_sentence_and_every_verdict_a_reading():
    own = {s.id for s in STATEMENTS if s.chapter == "5_3_is_it_exploration"}
    assert set(answers.COMPARED) == own
    for readings in answers.READINGS.values():
        assert set(readings) == set(KINDS["comparisons"][1])


def test_the_answer_follows_the_seas():
    against = judged("EX9", about(-0.5, 0.1))
    dives = {(d.agent, d.size): d for d in (sea("dropout-per-episode", 2, found=8), sea("epsilon-greedy", 25))}
    alone = answers.exploration({"EX9": against}, dives)
    assert "So holding a draw is not enough" in alone
    assert "in 20 % of 40 seas" in alone
    assert "fewer than the 86 %" in alone
    assert alone.count("not run yet") == 2
    assert "can explore" not in alone
    dives["ensemble-priors", 10] = sea("ensemble-priors", 40)
    assert "can explore, if they come from another belief" in answers.exploration({"EX9": against}, dives)
    dives["ensemble-priors", 10] = sea("ensemble-priors", 27)
    level = answers.exploration({"EX9": against}, dives)
    assert "neither visibly more seas nor fewer" in level
    assert "can explore" not in level
    assert "is still open" in answers.exploration({"EX9": judged("EX9", None)}, {})
    late = answers.answer({"EX3c": judged("EX3c", about(-0.1, 0.01))}, "EX3c")
    assert late.endswith("it earns less.")


def test_what_priors_add_is_said_where_both_ensembles_have_run():
    dives = {("ensemble", 10): sea("ensemble", 30)}
    assert answers.without_priors(dives) == ""
    dives["ensemble-priors", 10] = sea("ensemble-priors", 10)
    assert answers.without_priors(dives) == (
        "Seas that the ensemble solves, and the median episode: without priors 30 of 40, 500 [500, 500]; "
        "with them 10 of 40."
    )


def test_what_was_found_stands_beside_a_coin():
    assert answers.found({}, 10) == "Not run yet."
    said = answers.found({("greedy", 10): sea("greedy", 0), ("boltzmann", 10): sea("boltzmann", 5, found=10)}, 10)
    assert said.startswith("A coin at every move would find the treasure in 86 % of the seas.")
    assert "- No exploration: found in 0 of 40 seas\n" in said
    assert "found in 10 of 40 seas, then again in 25.0 % of the episodes" in said


#: What the published records say where the page's prose was written for it. Where this changes, read the page again.
PINNED = {
    "EX3c": "contradicted", "EX7a": "inconclusive", "EX7b": "contradicted", "EX7c": "contradicted",
    "EX7d": "contradicted", "EX7e": "supported", "EX7f": "contradicted", "EX7g": "contradicted", "EX7h": "contradicted",
    "EX7i": "contradicted", "EX9": "contradicted", "EX9b": "no difference",
}  # fmt: skip


def test_published_verdicts_are_what_the_page_was_written_for():
    found = answers.judged()
    assert {name: found[name].verdict for name in PINNED} == PINNED


def test_published_seas_are_what_the_page_was_written_for():
    found = {agent: dive for (agent, size), dive in dives.load().items() if size == 10}
    assert {name: found[name].within().sum() for name in ("ensemble", "ensemble-priors")} == {
        "ensemble": 40, "ensemble-priors": 40
    }  # fmt: skip
    assert "fewer than the" in answers.beside_a_coin(dives.load())


def test_published_meals_are_what_the_first_page_of_the_section_was_written_for():
    shared, own = analysis.load("as-demo"), analysis.load("ours")

    def times(agents, ticks, what):
        eaten = [agents[name].mean(*ticks, what).mean() for name in ("epsilon-greedy", "thompson")]
        return eaten[0] / eaten[1]

    assert times(shared, (200_000, 1_000_000), "food") == pytest.approx(2, abs=0.1)
    assert times(shared, (200_000, 1_000_000), "poison") < 1
    assert 1 < times(own, analysis.LATE, "food") < 1.3
