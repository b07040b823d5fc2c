"""Verdicts follow their rules, and change when the records do."""

import numpy as np
import pytest

from dropout_uncertainty.active_learning.experiment import CONFIGS
from dropout_uncertainty.active_learning.report.analysis import (
    against_deterministic,
    load_rows,
    original_rows,
    table_settings,
)
from dropout_uncertainty.judging.collect import CLAIMS, collect
from dropout_uncertainty.judging.results import combine, direction, same_value, thesis_value
from dropout_uncertainty.runs import records
from dropout_uncertainty.stats import Interval

#: Plausible curves: where each row ends in %, so that every claim of the thesis holds.
ENDS = {
    "random": 4.57, "softmax/max-entropy": 2.18, "softmax/variation-ratios": 4.57, "softmax/bald": 4.57,
    "softmax/least-confidence": 2.2, "dropout/max-entropy": 1.74, "dropout/variation-ratios": 1.64,
    "dropout/bald": 1.72,
}  # fmt: skip


def write_row(folder, name, end, seed, *, tied=False, family="ours"):
    config = records.config_dict(CONFIGS[f"{family}/{name}"])
    labels = np.arange(20, 1001, 10, dtype=np.int32)
    noise = 0.02 * np.random.default_rng([seed, len(name)]).standard_normal(99)
    error = (end + 30 * np.exp(-(labels - 20) / (60 * end)) + noise)[None].astype(np.float32)
    arrays = {
        "labels": labels, "error": error, "mc_error": error - 0.1, "all_tied": np.full((1, 98), tied),
        "tied": np.ones((1, 98), np.int32), "points": np.arange(1000, dtype=np.int32)[None],
    }  # fmt: skip
    header = {
        "experiment": "active_learning", "name": f"{family}/{name}", "seeds": [seed], "config": config,
        "config_hash": records.config_hash(config), "device": "cpu", "precision": "bfloat16", "provenance": {},
    }  # fmt: skip
    records.write(folder / "active_learning" / family / name / f"{seed:03d}.npz", arrays, header)


def world(folder, seeds=6, **changes):
    """Write records in which the claims hold, but for the named changes."""
    for name, end in (ENDS | changes).items():
        for seed in range(seeds):
            write_row(folder, name, end, seed, tied=name in ("softmax/bald", "softmax/variation-ratios"))
    return folder


@pytest.mark.parametrize("claim", ["AL3", "AL5", "AL6", "AL7"])
def test_claims_that_hold_are_replicated(tmp_path, claim):
    judgement = CLAIMS[claim].judge(world(tmp_path))
    assert judgement.verdict == "replicated", judgement.sentence
    assert judgement.records


@pytest.mark.parametrize(
    ("claim", "changes"),
    [
        ("AL3", {"dropout/bald": 6.0, "dropout/variation-ratios": 6.0}),
        ("AL5", {"random": 1.0}),
        ("AL6", dict.fromkeys(["softmax/max-entropy", "softmax/variation-ratios", "softmax/bald"], 0.8)),
    ],
)
def test_claims_that_fail_are_not(tmp_path, claim, changes):
    assert CLAIMS[claim].judge(world(tmp_path, **changes)).verdict == "not replicated"


def test_a_softmax_row_that_is_not_random_breaks_al7(tmp_path):
    assert CLAIMS["AL7"].judge(world(tmp_path, **{"softmax/bald": 2.0})).verdict == "partly"


def test_four_repetitions_decide_nothing(tmp_path):
    world(tmp_path, seeds=4)
    assert {CLAIMS[c].judge(tmp_path).verdict for c in ("AL1", "AL2", "AL3", "AL4", "AL5", "AL6")} == {"undecided"}
    assert "At least 5 repetitions" in CLAIMS["AL3"].judge(tmp_path).sentence


def test_without_records_every_claim_of_ours_is_undecided(tmp_path):
    assert CLAIMS["AL1"].judge(tmp_path).verdict == "undecided"
    assert CLAIMS["AL1"].judge(tmp_path).sentence == "No records yet."


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


def test_the_rules():
    assert same_value(Interval(1.7, 1.6, 1.8, 5), 1.64) == "replicated"
    assert same_value(Interval(1.7, 1.69, 1.71, 5), 1.64) == "partly"
    assert same_value(Interval(3.0, 2.9, 3.1, 5), 1.64) == "not replicated"
    assert same_value(Interval(1.7, 1.6, 1.8, 4), 1.7) == "undecided"
    assert direction(Interval(2, 1, 3, 5), expected="positive") == "replicated"
    assert direction(Interval(2, -1, 3, 5), expected="positive") == "partly"
    assert direction(Interval(2, 1, 3, 5), expected="negative") == "not replicated"
    assert direction(Interval(0.5, 0.4, 0.6, 5), expected="negative", null=1.0) == "replicated"
    assert combine(["replicated", "replicated"]) == "replicated"
    assert combine(["replicated", "not replicated"]) == "partly"
    assert combine(["replicated", "undecided"]) == "undecided"
    assert combine([]) == "undecided"


def test_all_claims_are_there_in_order_and_each_once():
    expected = [*(f"AL{i}" for i in range(1, 10)), *(f"EX{i}" for i in range(1, 7)), *(f"DE{i}" for i in range(1, 12))]
    assert list(CLAIMS) == expected


def test_without_records_every_claim_is_undecided_and_says_why(tmp_path):
    for claim in CLAIMS.values():
        judgement = claim.judge(tmp_path)
        assert judgement.verdict == "undecided", claim.id
        assert any(part.interval.n == 0 for part in judgement.parts), claim.id
    verdicts = {result.id: result.verdict for result in collect(tmp_path) if result.id.startswith("claim/")}
    assert verdicts == {f"claim/{name}": "undecided" for name in CLAIMS}


#: What the published records say. Where this changes, prose about it must be read again.
PINNED = {
    "AL1": "partly", "AL2": "partly", "AL3": "partly", "AL4": "partly", "AL5": "partly", "AL6": "partly",
    "AL7": "replicated", "AL8": "partly", "AL9": "replicated",
    "EX1": "replicated", "EX2": "partly", "EX3": "partly", "EX4": "partly", "EX5": "partly", "EX6": "partly",
    "DE1": "partly", "DE2": "partly", "DE3": "partly", "DE4": "partly", "DE5": "partly", "DE6": "partly",
    "DE7": "partly", "DE8": "partly", "DE9": "undecided", "DE10": "replicated", "DE11": "not replicated",
}  # fmt: skip


def test_published_verdicts_are_what_the_prose_was_written_for():
    assert {name: claim.judge().verdict for name, claim in CLAIMS.items()} == PINNED


def test_every_claim_says_where_and_how():
    for identifier, claim in CLAIMS.items():
        assert claim.id == identifier
        assert claim.text.endswith(".")
        assert claim.where
        assert claim.rule
