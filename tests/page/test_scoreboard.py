"""The scoreboard counts, explains and links what the claims say, and adds up what records and pages took."""

import re
from dataclasses import replace
from pathlib import Path

from dropout_uncertainty.judging.collect import CLAIMS
from dropout_uncertainty.judging.results import Claim, Part, missing
from dropout_uncertainty.page import book, scoreboard
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Interval

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
NOTEBOOK = (NOTEBOOKS / "5_2_active_learning.ipynb").read_text(encoding="utf-8")


def record(name, seeds, cpu_s, *, device="cpu", wall_s=0.0, experiment="active_learning"):
    origin = {"cpu_s": cpu_s, "wall_s": wall_s, "processor": "a processor"}
    header = {"experiment": experiment, "name": name, "seeds": seeds, "device": device, "provenance": origin}
    return Record(header, {}, NOTEBOOKS / f"{seeds[0]:03d}.npz")


def judged(*parts, found=(), where="Table 5.1", identifier="AL1"):
    claim = Claim(identifier, "A claim.", where, "a rule", "5_2_active_learning", lambda _: (list(parts), list(found)))
    return claim.judge()


def part(verdict, n=10, value=1.0):
    return Part("something", Interval(value, value - 0.5, value + 0.5, n), "points", verdict)


FOUND = [record("ours/a", [0], 60.0), record("ours/a", [1], 120.0), record("ours/b", [0], 3600.0)]


def test_every_claim_is_counted_once_by_section_and_verdict():
    some = [
        judged(part("replicated"), identifier="AL1"),
        judged(part("replicated"), part("not replicated"), identifier="AL2"),
        judged(missing("it"), identifier="DE1"),
    ]
    heads, rows = scoreboard.tally(some)
    assert heads == ["section", "replicated", "partly", "not replicated", "undecided", "claims"]
    assert [row[1:] for row in rows] == [[1, 1, 0, 0, 2], [0, 0, 0, 0, 0], [0, 0, 0, 1, 1], [1, 1, 0, 1, 3]]
    _, rows = scoreboard.tally([claim.judge(NOTEBOOKS) for claim in CLAIMS.values()])
    assert rows[-1][-1] == len(CLAIMS)


def test_two_parts_are_said_and_more_are_counted():
    two = judged(part("partly"), part("replicated", value=2.0), found=FOUND)
    assert "something: 1 [0.5, 1.5] points; something: 2 [1.5, 2.5] points" in scoreboard.sentence(two)
    more = judged(part("replicated"), part("undecided", n=3), missing("it"), found=FOUND)
    assert scoreboard.sentence(more) == (
        "3 parts: 1 replicated, 2 undecided (no records yet for 1; fewer than 5 repetitions for 1)."
    )
    assert scoreboard.sentence(judged(missing("it"))) == "No records yet."


def test_a_claim_links_to_what_the_book_has():
    assert '"fig-5-1"' in NOTEBOOK
    _, ((_, _, where, verdict, _),) = scoreboard.verdicts([judged(part("partly"), where="Figure 5.1 and Figure 5.9")])
    assert where == "[Figure 5.1](#fig-5-1) and Figure 5.9 ([chapter](5_2_active_learning.ipynb))"
    assert verdict == "**partly**"
    nowhere = judged(part("partly"))
    nowhere = replace(nowhere, claim=replace(nowhere.claim, chapter="5_9_none"))
    assert scoreboard.verdicts([nowhere])[1][0][2] == "Table 5.1"


def test_behind_a_claim_stand_its_files_and_the_commands_that_make_them():
    text = scoreboard.behind([judged(part("partly"), found=FOUND), judged(missing("it"), identifier="DE1")])
    assert text.split("\n\n") == [
        "**AL1** is judged by: a rule.",
        "- something: 1 [0.5, 1.5] points (*partly*)",
        "Records: [active_learning/ours/a/000.npz](../records/active_learning/ours/a/000.npz), "
        "[active_learning/ours/a/001.npz](../records/active_learning/ours/a/001.npz), "
        "[active_learning/ours/b/000.npz](../records/active_learning/ours/b/000.npz)",
        "```console\n"
        "$ dropout-uncertainty run active_learning --config ours/a --seeds 0-1\n"
        "$ dropout-uncertainty run active_learning --config ours/b --seeds 0\n```",
        "**DE1** is judged by: a rule.",
        "- it: no records yet (*undecided*)",
    ]


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


def test_the_scoreboard_runs_last():
    assert book.notebooks()[-1] == book.LAST == "scoreboard"


def test_the_page_shows_every_section():
    text = (NOTEBOOKS / "scoreboard.ipynb").read_text(encoding="utf-8")
    for letters, title in scoreboard.SECTIONS.items():
        assert len(re.findall(rf'section\(\\"{letters}\\"\)', text)) == 2, f"verdicts and what is behind them: {title}"
        assert f"## {title}" in text
