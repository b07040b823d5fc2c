"""Statements are all there, follow their rules, and change when the records do."""

import numpy as np
import pytest

from dropout_uncertainty.active_learning.experiment import CONFIGS
from dropout_uncertainty.active_learning.report.analysis import (
    EARLY,
    END,
    against_deterministic,
    early_rows,
    load_rows,
    original_rows,
    paired_error,
    table_settings,
)
from dropout_uncertainty.active_learning.report.statements import lowest
from dropout_uncertainty.judging.collect import STATEMENTS, collect, judged, number
from dropout_uncertainty.judging.results import thesis_value
from dropout_uncertainty.judging.statements import judge, nothing
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_dict, config_hash

#: Plausible curves: where each row ends in %, so that every claim of the thesis holds.
ENDS = {
    "random": 4.57, "softmax/max-entropy": 2.18, "softmax/variation-ratios": 4.57, "softmax/bald": 4.57,
    "softmax/least-confidence": 2.2, "dropout/max-entropy": 1.74, "dropout/variation-ratios": 1.64,
    "dropout/bald": 1.72,
}  # fmt: skip


def write_row(folder, name, end, seed, *, tied=False, family="ours"):
    config = config_dict(CONFIGS[f"{family}/{name}"])
    labels = np.arange(20, 1001, 10, dtype=np.int32)
    noise = 0.02 * np.random.default_rng([seed, len(name)]).standard_normal(99)
    error = (end + 30 * np.exp(-(labels - 20) / (60 * end)) + noise)[None].astype(np.float32)
    labels, error = labels[: config["rounds"] + 1], error[:, : config["rounds"] + 1]
    arrays = {
        "labels": labels, "error": error, "mc_error": error - 0.1, "all_tied": np.full((1, 98), tied),
        "tied": np.ones((1, 98), np.int32), "points": np.arange(1000, dtype=np.int32)[None],
    }  # fmt: skip
    header = {
        "experiment": "active_learning", "name": f"{family}/{name}", "seeds": [seed], "config": config,
        "config_hash": config_hash(config), "device": "cpu", "precision": "bfloat16", "provenance": {},
    }  # fmt: skip
    records.write(folder / "active_learning" / family / name / f"{seed:03d}.npz", arrays, header)


def world(folder, seeds=6, **changes):
    """Write records in which the claims hold, but for the named changes."""
    for name, end in (ENDS | changes).items():
        for seed in range(seeds):
            write_row(folder, name, end, seed, tied=name in ("softmax/bald", "softmax/variation-ratios"))
    return folder


def verdicts(folder, *names):
    return [judge([STATEMENTS[name]], folder)[0].verdict for name in names]


def test_what_holds_is_supported(tmp_path):
    world(tmp_path)
    assert set(verdicts(tmp_path, "AL3b", "AL3d", "AL5a", "AL5c", "AL6b", "AL6c")) == {"supported"}
    assert verdicts(tmp_path, "AL7a", "AL7b", "AL8a", "AL8b", "AL8c", "AL8d") == ["confirmed"] * 6
    assert verdicts(tmp_path, "AL9c") == ["supported"]  # averaging brings 0.1 points, within the margin


def test_what_fails_is_contradicted(tmp_path):
    worse = dict.fromkeys(["dropout/bald", "dropout/variation-ratios"], 6.0)
    assert verdicts(world(tmp_path / "1", **worse), "AL3b", "AL3d") == ["contradicted"] * 2
    assert verdicts(tmp_path / "1", "AL6b") == ["inconclusive"], "neither row reaches 5 %"
    assert verdicts(world(tmp_path / "2", random=1.0), "AL5a", "AL5d") == ["contradicted"] * 2


def test_a_softmax_row_that_can_choose_refutes_the_audit(tmp_path):
    for seed in range(5):
        write_row(tmp_path, "softmax/bald", 2.0, seed, tied=False)
    assert verdicts(tmp_path, "AL7a") == ["refuted"]


def test_four_repetitions_and_none_are_untested_and_say_so(tmp_path):
    (found,) = judge([STATEMENTS["AL3b"]], world(tmp_path / "4", seeds=4))
    assert (found.verdict, found.why) == ("untested", "4 of 5 repetitions")
    (primary,) = judge([STATEMENTS["AL5b"]], world(tmp_path / "6"))
    assert (primary.verdict, primary.why) == ("untested", "6 of 20 repetitions")
    (tmp_path / "none").mkdir()
    (found,) = judge([STATEMENTS["AL3b"]], tmp_path / "none")
    assert (found.verdict, found.why) == ("untested", "no records yet")


def test_runs_that_end_early_count_where_no_more_is_asked(tmp_path):
    folder = world(tmp_path)
    for name in ("random", "dropout/variation-ratios"):
        for seed in range(4, 20):  # two of them are in both families
            write_row(folder, name, ENDS[name], seed, family="early")
    early, late, other = judge([STATEMENTS["AL5b"], STATEMENTS["AL5e"], STATEMENTS["AL5a"]], folder)
    assert (early.verdict, early.measured.difference.n, late.measured.difference.n) == ("supported", 20, 6)
    assert {record.header["name"] for record in other.measured.records} == {"ours/random", "ours/dropout/bald"}
    rows = early_rows(folder)
    assert (rows["random"].error.shape, rows["random"].labels[-1]) == ((20, 41), 420)
    assert sorted(rows["random"].seeds) == list(range(20))
    assert rows["dropout/bald"].error.shape == (6, 41)


def test_an_error_of_5_percent_that_is_never_reached_is_beyond_the_last_acquisition(tmp_path):
    folder = world(tmp_path, **{"dropout/bald": 20.0, "softmax/bald": 2.0})
    (found,) = judge([STATEMENTS["AL2g"]], folder)  # 36 are printed
    assert found.verdict == "differs"
    assert found.measured.ours[:3] == (np.inf, 99.0, np.inf)
    (found,) = judge([STATEMENTS["AL6c"]], folder)
    assert found.verdict == "contradicted"
    assert 0.8 < found.measured.ours.low < found.measured.ours.high == np.inf


def test_a_minimum_is_that_of_three_curves():
    curves = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    # triples: {0,1,2} and {0,1,3} have their minimum at 2/3, {0,2,3} and {1,2,3} at 2/3
    assert lowest(curves)(np.arange(4)) == pytest.approx(2 / 3)
    assert lowest(curves)(np.array([[0, 1, 2], [2, 3, 2], [0, 0, 0]])) == pytest.approx([2 / 3, 1, 0])


def test_development_seeds_do_not_count(tmp_path):
    write_row(tmp_path, "random", 4.57, 100)
    assert load_rows("ours", tmp_path) == {}


def test_table_5_1_is_the_minimum_of_the_recorded_mean_curves():
    minima = {name: round(row.minimum.value, 2) for name, row in original_rows().items()}
    assert minima == {name: thesis_value(f"table-5.1/{name}") for name in minima}
    assert len(minima) == 7


def test_settings_are_compared_where_a_row_has_been_run_in_more_than_one(tmp_path):
    world(tmp_path, seeds=2)
    assert table_settings(tmp_path)[1] == []
    write_row(tmp_path, "random", 6.0, 0, family="as-recorded")
    _, cells = table_settings(tmp_path)
    assert [line[:2] for line in cells] == [
        ["Random", "thesis, printed"],
        ["Random", "common"],
        ["Random", "as its script ran it"],
    ]
    (_, _, minimum, _, steps, repetitions) = cells[-1]
    assert float(minimum) == pytest.approx(8.0, abs=0.1)
    assert (steps, repetitions) == ("> 98", 1)


def test_the_chapter_says_what_searching_the_whole_pool_brings():
    written, common = (load_rows(family) for family in ("as-written", "ours"))
    later = {name: written[name].crossing().value - common[name].crossing().value for name in written}
    assert len(written["dropout/bald"].seeds) == len(written["dropout/variation-ratios"].seeds) == 1
    assert later["dropout/bald"] > later["dropout/variation-ratios"] > 0


def test_weight_draws_are_held_against_the_scores_of_one_pass(tmp_path):
    heads, cells = against_deterministic(load_rows("ours", world(tmp_path, **{"dropout/bald": 3.2})))
    assert [line[0] for line in cells] == ["Dropout Max Entropy", "Dropout Variation Ratios", "Dropout BALD"]
    difference = cells[-1][heads.index("minus Softmax Least Confidence, 960 to 980")]
    assert float(difference.split()[0]) == pytest.approx(1.2, abs=0.1)


def test_all_statements_are_there_in_order_and_each_once():
    ids = list(STATEMENTS)
    assert ids == sorted(ids, key=number)
    numbers = {name[:2]: sorted({number(n)[1] for n in ids if n[:2] == name[:2]}) for name in ids}
    assert numbers == {"AL": list(range(1, 13)), "EX": list(range(1, 10)), "DE": list(range(1, 17))}
    primary = [name for name in ids if STATEMENTS[name].primary]
    assert primary == ["AL3e", "AL5b", "AL11", "EX7a", "EX7b", "EX9", "DE4a", "DE7a", "DE7c"]


def test_every_statement_says_what_where_and_how_large_a_difference_matters():
    for name, statement in STATEMENTS.items():
        assert statement.text.endswith("."), name
        assert statement.where, name
        assert statement.margin >= 0, name
        if statement.kind != "audit" and statement.measure is not nothing:
            assert statement.margin > 0, name
        assert (statement.kind == "value") <= (statement.thesis is not None), name
        assert statement.would_test or statement.measure is not nothing, name


def test_without_records_nothing_but_what_the_repository_shows_is_judged(tmp_path):
    found = judged(tmp_path)
    assert {j.statement.id for j in found if j.verdict != "untested"} == {
        "AL8a", "AL8b", "AL8c", "AL8d", "EX4", "DE12",
    }  # fmt: skip
    assert all(j.why for j in found if j.verdict == "untested")
    assert {r.verdict for r in collect(tmp_path) if not r.id.startswith("statement/")} <= {None}


#: What the published records say where prose was written for it. Where this changes, read the prose again.
PINNED = {
    "AL1b": "differs", "AL3a": "inconclusive", "AL3f": "no difference", "AL3g": "inconclusive", "AL4a": "supported",
    "AL4b": "contradicted", "AL5d": "supported", "AL6a": "contradicted", "AL7a": "confirmed", "AL8a": "confirmed",
    "EX1b": "contradicted", "EX2c": "differs", "EX2d": "supported", "EX3a": "supported", "EX3b": "no difference",
    "EX3e": "refuted", "EX4": "refuted", "EX6c": "contradicted",
    "DE1a": "supported", "DE2d": "supported", "DE3h": "inconclusive", "DE4b": "supported", "DE6a": "supported",
    "DE6b": "supported", "DE6c": "no difference", "DE7b": "supported", "DE11a": "contradicted",
    "DE11b": "no difference", "DE12": "confirmed",
}  # fmt: skip


def test_published_verdicts_are_what_the_prose_was_written_for():
    found = {name: judge([STATEMENTS[name]])[0].verdict for name in PINNED}
    assert found == PINNED


def test_a_fair_comparison_says_what_the_stored_rows_say():
    rows = load_rows("ours")
    scores = {"entropy": "dropout/max-entropy", "votes": "dropout/variation-ratios", "bald": "dropout/bald"}
    early, end = (
        {name: paired_error(rows[row], rows["softmax/least-confidence"], *acquired) for name, row in scores.items()}
        for acquired in (EARLY, END)
    )
    assert paired_error(rows[scores["votes"]], rows["softmax/max-entropy"], *EARLY).high < 0
    assert early["votes"].low < 0 < early["votes"].high
    assert min(found.low for found in (early["entropy"], early["bald"], end["bald"])) > 0


def test_verdicts_of_version_1_are_kept():
    rows = records.table("verdicts-v1")
    claims = [row["verdict"] for row in rows if not row["part"]]
    assert [claims.count(v) for v in ("replicated", "partly", "not replicated", "undecided")] == [4, 20, 1, 1]
    assert len(rows) - len(claims) == 120
