"""Statements of a section together: plain verdicts, and primary ones adjusted for each other."""

import math

import pytest

from dropout_uncertainty.judging.statements import Measured, Statement, judge, nothing
from dropout_uncertainty.stats import Estimate, Interval


def statement(name, kind, p=0.02, value=-2.0, **more):
    difference = Estimate(value, value - 1.0, value + 1.0, value - 0.8, value + 0.8, p, 20)
    measured = Measured(difference, Interval(value, value - 1.0, value + 1.0, 20), [])
    return Statement(name, "", "", kind, 0.5, lambda _: measured, chapter="chapter", **more)


def test_a_statement_is_judged_by_its_kind():
    judged = judge(
        [statement("a", "less"), statement("b", "more"), statement("c", "value"), statement("d", "equality")]
    )
    assert [j.verdict for j in judged] == ["supported", "contradicted", "differs", "contradicted"]
    audits = judge([statement("e", "audit", value=1.0), statement("f", "audit", value=0.0)])
    assert [j.verdict for j in audits] == ["confirmed", "refuted"]


def test_a_primary_statement_needs_20_repetitions_and_40_in_section_5_4():
    judged = judge([statement("EX7", "less", primary=True), statement("DE7", "less", primary=True)])
    assert [(j.plain, j.why) for j in judged] == [("supported", ""), ("untested", "20 of 40 repetitions")]
    assert statement("DE7", "less").least == 5


def test_what_is_never_reached_has_a_verdict_and_a_reason():
    def censored(low, high=math.inf, value=math.inf):
        difference = Estimate(value, low, high, low, high, 0.01, 20)
        return Measured(difference, Interval(value, low, high, 20))

    cases = [
        ("value", censored(3.0), "differs", "only a lower limit"),
        ("value", censored(-3.0), "imprecise", "only a lower limit"),
        ("more", censored(3.0), "supported", "only a lower limit"),
        ("less", censored(3.0), "contradicted", "only a lower limit"),
        ("less", censored(-3.0), "inconclusive", "only a lower limit"),
        ("equality", censored(3.0), "contradicted", "only a lower limit"),
        ("value", censored(-3.0, value=1.0), "imprecise", "no upper limit"),
    ]
    for kind, measured, verdict, reason in cases:
        (judged,) = judge([Statement("DE2c", "", "", kind, 0.5, lambda _, m=measured: m, chapter="chapter")])
        assert (judged.verdict, reason in judged.why) == (verdict, True), kind


def test_primary_statements_pay_for_each_other_and_secondary_ones_do_not():
    family = [statement(name, "less", p, primary=True) for name, p in [("a", 0.01), ("b", 0.02), ("c", 0.03)]]
    judged = {j.statement.id: j for j in judge([*family, statement("d", "less", 0.04)])}
    assert [judged[name].plain for name in "abcd"] == ["supported"] * 4
    assert [judged[name].p for name in "abcd"] == pytest.approx([0.03, 0.04, 0.04, 0.04])
    assert [judged[name].verdict for name in "abcd"] == ["supported"] * 4
    weaker = {j.statement.id: j for j in judge([*family, statement("e", "less", 0.045, primary=True)])}
    assert weaker["b"].verdict == "inconclusive"
    assert weaker["b"].plain == "supported"


def test_without_records_a_statement_is_untested_and_still_counts_in_its_family():
    missing = Statement("x", "", "", "less", 0.5, nothing, chapter="chapter", primary=True, would_test="not run yet")
    judged = judge([missing, statement("a", "less", 0.03, primary=True)])
    assert judged[0].verdict == "untested"
    assert math.isnan(judged[0].p)
    assert judged[1].p == pytest.approx(0.06)
    assert judged[1].verdict == "inconclusive"
