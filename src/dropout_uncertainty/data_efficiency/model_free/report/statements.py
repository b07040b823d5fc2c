"""The statements about learners without a model: what the thesis says, and how it is judged."""

from functools import partial

from dropout_uncertainty.data_efficiency.report.statements import DEEPER, INTRODUCTION, RESULT, times_as_many
from dropout_uncertainty.data_efficiency.report.statements import stated as of_section
from dropout_uncertainty.judging.statements import NEAR, Statement

__all__ = ["STATEMENTS"]

stated = partial(of_section, chapter="5_4_without_a_model")

STATEMENTS: list[Statement] = [
    stated(f"DE9{letter}", f"{learner} needs more than {words} times as many trials as Deep PILCO.",
           f"{INTRODUCTION}, {RESULT}", "more", NEAR * times,
           partial(times_as_many, learner.lower(), DEEPER[0], times), unit="times", thesis=times,
           would_test=f"runs of {learner} on this cart-pole; the printed trials are of others")
    for letter, learner, words, times in (
        ("a", "DDPG", "ten", 10.0), ("b", "NAF", "ten", 10.0),
        ("c", "DDPG", "a hundred", 100.0), ("d", "NAF", "a hundred", 100.0),
    )
]  # fmt: skip
