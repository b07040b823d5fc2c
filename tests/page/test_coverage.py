"""Every statement comes from a sentence of the chapter, and every sentence has statements or a reason."""

from dropout_uncertainty.judging.collect import SECTIONS, STATEMENTS
from dropout_uncertainty.judging.statements import judge
from dropout_uncertainty.page import coverage


def test_every_sentence_has_statements_or_a_reason():
    for row in coverage.rows():
        assert row["place"]
        assert row["words"]
        assert bool(row["statements"]) != bool(row["reason"]), row["words"]


def test_every_statement_is_in_the_table_and_no_other():
    named = {name for row in coverage.rows() for name in row["statements"].split()}
    assert named == set(STATEMENTS)


def test_the_page_shows_every_sentence_once_with_its_verdicts(tmp_path):
    found = judge(STATEMENTS.values(), tmp_path)
    cells = [row for title in SECTIONS.values() for row in coverage.sentences(title.split()[0], found)[1]]
    assert [row[1] for row in cells] == [row["words"] for row in coverage.rows()]
    (equation,) = (row for row in cells if "Equation 3.14" in row[1])
    assert equation[2] == "DE12 (confirmed)"
