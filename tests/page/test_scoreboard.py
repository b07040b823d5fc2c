"""The scoreboard counts, explains and links the statements, and adds up what records and pages took."""

import re
from pathlib import Path

import matplotlib.pyplot as plt

from dropout_uncertainty.judging.statements import Measured, Statement, judge
from dropout_uncertainty.page import book, scoreboard
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Estimate

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
NOTEBOOK = (NOTEBOOKS / "5_2_active_learning.ipynb").read_text(encoding="utf-8")


def record(name, seeds, cpu_s, *, device="cpu", wall_s=0.0, experiment="active_learning"):
    origin = {"cpu_s": cpu_s, "wall_s": wall_s, "processor": "a processor"}
    header = {"experiment": experiment, "name": name, "seeds": seeds, "device": device, "provenance": origin}
    return Record(header, {}, NOTEBOOKS / f"{seeds[0]:03d}.npz")


def judged(*verdicts, found=(), where="Table 5.1", prefix="AL", n=10, **more):
    """Return comparisons with these verdicts, AL1 on."""
    ends = {"supported": (1.0, 3.0), "contradicted": (-3.0, -1.0), "no difference": (-0.2, 0.2)}
    statements = []
    for place, verdict in enumerate(verdicts, 1):
        low, high = ends.get(verdict, (-2.0, 2.0))
        difference = Estimate((low + high) / 2, low, high, low, high, 0.04, 3 if verdict == "untested" else n)
        measured = Measured(difference, difference.interval, found, {"last point": difference.interval})
        statements.append(
            Statement(f"{prefix}{place}", "A is more than B.", where, "more", 0.5, lambda _, m=measured: m,
                      unit="points", chapter="5_2_active_learning", **more)
        )  # fmt: skip
    return judge(statements)


FOUND = [record("ours/a", [0], 60.0), record("ours/a", [1], 120.0), record("ours/b", [0], 3600.0)]


def test_every_statement_is_counted_once_by_section_and_kind():
    some = [*judged("supported", "inconclusive"), *judged("untested", "supported", prefix="DE")]
    heads, rows = scoreboard.tally(some)
    assert heads == ["section", "kind", "statements", "verdicts"]
    assert rows == [
        ["5.2 Active learning", "comparisons", 2, "1 supported, 1 inconclusive"],
        ["5.4 Data efficiency", "comparisons", 2, "1 supported, 1 untested"],
        ["all", "comparisons", 4, "2 supported, 1 inconclusive, 1 untested"],
    ]


def test_a_chapter_groups_statements_under_their_place_and_says_why_something_is_open():
    table = scoreboard.verdicts(judged("supported", "inconclusive", "untested")).markdown
    assert table.count("Table 5.1") == 1
    assert "2 [1,\u00a03] points; last point: 2 [1,\u00a03]" in table
    assert "**inconclusive**; differences below 2 points could not be seen" in table
    assert "**untested**; 3 of 5 repetitions" in table


def test_a_primary_statement_shows_both_verdicts():
    first, _ = judged("supported", "supported", n=20, primary=True)
    assert "**inconclusive (by itself supported)**" in scoreboard.said(first)


def test_the_board_filters_without_a_script_and_links_to_what_the_book_has():
    html = scoreboard.Board(judged("supported", "supported", "inconclusive", found=FOUND, where="Figure 5.1")).html()
    assert "<script" not in html
    assert re.findall(r'value="([a-z ]+)"', html) == ["all", "supported", "inconclusive"]
    assert html.count('<tr data-verdict="supported">') == 2
    assert '<a href="5_2_active_learning.ipynb#fig-5-1">Figure 5.1</a>' in html
    assert "dropout-uncertainty run active_learning --config ours/a --seeds 0-1" in html
    assert "active_learning/ours/b" in html


def test_the_figure_turns_claims_to_the_right_and_leaves_out_what_is_untested():
    found = [*judged("supported", "untested"), *judged("contradicted", prefix="DE")]
    figure, ax = plt.subplots()
    scoreboard.at_a_glance(ax, found)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["AL1", "DE1"]
    plt.close(figure)


def test_every_claim_of_version_1_says_what_changed():
    rows = scoreboard.since_version_1(judged("supported"))[1]
    assert len(rows) == 26
    assert rows[0][2:] == ["partly", "1 supported", "printed minima were compared with last points"]
    assert all(row[-1] for row in rows)


def test_costs_add_up_and_processors_of_two_kinds_stay_apart():
    gpu = record("ours/a", list(range(2, 12)), 500.0, device="cuda", wall_s=600.0)
    _, rows = scoreboard.costs([*FOUND, gpu, record("as-demo", [0, 1], 7200.0, experiment="exploration")])
    assert [row[:-1] for row in rows] == [
        ["active_learning", "ours/…", 3, "21.0", "1.05", None],
        ["active_learning", "ours/…", 10, None, "0.00", "1.0"],
        ["active_learning", "**all**", 13, None, "1.05", None],
        ["exploration", "as-demo", 2, "60.0", "2.00", None],
        ["exploration", "**all**", 2, None, "2.00", None],
    ]


def test_run_times_come_in_the_order_of_the_pages():
    took = {
        "seconds": 61.4, "cpu_seconds": 99.6, "megabytes": 700.2, "cores": 2, "processor": "x", "date": "2026-01-02T03",
    }  # fmt: skip
    _, rows = scoreboard.run_times({"quick": {"b": took, "a": took}, "recorded": {"a": took}}, ["a", "b", "c"])
    assert [row[:2] for row in rows] == [["a", "quick"], ["a", "recorded"], ["b", "quick"]]
    assert rows[0][2:] == [61, 100, 700, "2 × x", "2026-01-02"]


def test_how_long_says_what_was_measured_and_what_was_not():
    times = {"recorded": {"5_2_active_learning": {"seconds": 61.4}}, "quick": {"a": {"seconds": 300.0}}}
    _, rows = scoreboard.how_long(times, ["5_2_active_learning", "a"], FOUND)
    assert rows == [
        ["[5_2_active_learning](5_2_active_learning.ipynb)", "61 s", "not run here", "1.1 core-hours", "not measured"],
        ["[a](a.ipynb)", "not run here", "5 min", None, None],
    ]
    names = ["5_2_active_learning", "5_2_ours"]  # a notebook with a family of configs of its own
    assert [row[3] for row in scoreboard.how_long({}, names, FOUND)[1]] == [None, "1.1 core-hours"]
    gpu = record("ours/a", [0], 1.0, device="cuda", wall_s=7200.0)
    assert scoreboard.how_long(times, ["5_2_active_learning"], [gpu])[1][0][3:] == [None, "2.0 h"]


def test_every_family_of_records_belongs_to_a_notebook_that_there_is():
    found = records.find("active_learning") + records.find("data_efficiency") + records.find("exploration")
    shown = {row[0].split("]")[0][1:] for row in scoreboard.how_long({}, book.notebooks(), found)[1] if row[3]}
    families = {record.header["name"].split("/")[0].replace("-", "_") for record in found}
    assert set(scoreboard.SHOWN.values()) <= shown
    assert {scoreboard.SHOWN[family] for family in families & set(scoreboard.SHOWN)} == set(scoreboard.SHOWN.values())


def test_the_scoreboard_runs_last():
    assert book.notebooks()[-1] == book.LAST == "scoreboard"


def test_the_page_shows_every_section():
    text = (NOTEBOOKS / "scoreboard.ipynb").read_text(encoding="utf-8")
    for letters, title in scoreboard.SECTIONS.items():
        assert f'startswith(\\"{letters}\\")' in text, title
        assert f"## {title}" in text
