"""What a reader sees first is what the records say: nine statements, three pictures, sentences of the first page."""

import base64
import io
import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from dropout_uncertainty.active_learning import mnist
from dropout_uncertainty.active_learning.report import analysis as active_learning
from dropout_uncertainty.data_efficiency.plant.cost import SOLVED_BELOW
from dropout_uncertainty.data_efficiency.report import analysis as data_efficiency
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.report import analysis as exploration
from dropout_uncertainty.exploration.report.deep_sea import dives
from dropout_uncertainty.judging.collect import STATEMENTS, collect
from dropout_uncertainty.judging.statements import StatementResult, judge
from dropout_uncertainty.page import landing, pictures, scoreboard

ROOT = Path(__file__).parents[2]
GLUED = r"{glue:text}`scoreboard\.ipynb::(\w+):s`"


@pytest.fixture(scope="module")
def results():
    return collect()


def test_nine_statements_three_a_section(results):
    _, rows = landing.numbers(results, "{}")
    primary = [statement for statement in STATEMENTS.values() if statement.primary]
    assert [row[0] for row in rows] == [
        f"[{section}]({statement.chapter})"
        for section, statement in zip(sorted(3 * ("5.2", "5.3", "5.4")), primary, strict=True)
    ]
    computed = [r for r in results if isinstance(r, StatementResult) and r.primary]
    assert [re.match(r"\*\*(.*?)\*\*", row[2])[1] for row in rows] == [r.verdict for r in computed]
    assert [int(row[4]) for row in rows] == [r.n for r in computed]
    for row, r in zip(rows, computed, strict=True):
        assert (r.verdict == "untested") == (": " in row[2]), "what is untested says why"


def test_without_results_a_statement_is_untested():
    _, rows = landing.numbers([])
    assert {row[2].split(":")[0] for row in rows} == {"**untested**"}


def test_the_tally_counts_statements_by_kind(results):
    text = landing.tally(results)
    found = [r for r in results if isinstance(r, StatementResult)]
    assert sum(int(n) for n in re.findall(r"(\d+) (?:printed values|comparisons|equalities|audits)", text)) == len(
        found
    )
    assert landing.tally([]) == "Of all statements: ."


# --- a headline may not be stronger than its statement

#: What the sentences of the first page were written for. Where this changes, write them again.
HEADLINES = {
    "AL3f": "no difference", "AL3g": "inconclusive", "AL7a": "confirmed", "AL7b": "confirmed", "AL8a": "confirmed",
    "EX3a": "supported", "EX3c": "contradicted", "EX3e": "refuted", "EX4": "refuted", "EX7e": "supported",
    "EX7f": "contradicted", "DE2d": "supported", "DE3h": "inconclusive", "DE6b": "supported", "DE6c": "no difference",
    "DE7a": "supported", "DE7b": "supported", "DE7c": "supported", "DE11a": "contradicted",
}  # fmt: skip


def test_headlines_give_the_computed_verdicts(facts):
    assert {name: facts[name] for name in landing.SAID} == HEADLINES


def test_no_verdict_on_the_first_page_is_typed():
    page = (ROOT / "book" / "index.md").read_text(encoding="utf-8")
    text = page[page.index("## What we did not expect") : page.index("None of this says")]
    assert not re.search(r"\b(supported|contradicted|no difference|inconclusive|confirmed|refuted)\b", text)


# --- files that are written from the records, and must be written again when these change


REMEDY = "the records have changed: run `dropout-uncertainty front`"


def test_readme_has_the_numbers_of_the_records(results):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert text == landing.readme(text, results), REMEDY


def test_a_readme_without_the_marks_is_refused():
    with pytest.raises(UserError, match="the README must hold the lines"):
        landing.readme("# A title", [])


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_picture_is_small_and_from_records_that_are_there(name):
    svg = (ROOT / landing.FOLDER / f"{name}.svg").read_text(encoding="utf-8")
    assert len(svg) < 50_000
    assert "prefers-reduced-motion" in svg
    assert not re.search(r"<script|(?:href|src)=\"(?!data:)|@import|url\(", svg), "a picture must need nothing else"
    drawn = pictures.PICTURES[name](None)
    if drawn is not None:
        assert _origin(svg) == _origin(drawn), REMEDY


def _origin(svg):
    return re.search(r"<desc>(Made from .*)</desc>", svg)[1]


def test_digits_are_the_last_ones_asked_for():
    drawn = pictures.digits()
    assert "active_learning/ours/dropout/bald/000.npz" in drawn
    images, rows = mnist.load().train_images.numpy(), active_learning.load_rows("ours")
    shown = re.findall(r'href="data:image/png;base64,([^"]*)"', drawn)
    for picture, name in zip(shown, ("random", "dropout/bald"), strict=True):
        ink = 1 - plt.imread(io.BytesIO(base64.b64decode(picture)))[..., 0]
        tiles = ink.reshape(6, 28, 4, 28).swapaxes(1, 2).reshape(24, 28, 28)
        np.testing.assert_allclose(tiles, images[rows[name].records[0].arrays["points"][0, -24:]], atol=0.01)


def test_without_records_there_is_nothing_to_draw(tmp_path):
    assert [draw(tmp_path) for draw in pictures.PICTURES.values()] == [None, None, None]


# --- sentences of the first page; where one of these fails, the page must be read again


@pytest.fixture(scope="module")
def facts():
    return landing.facts()


def number(text):
    return float(text.split()[0].replace("−", "-"))


def interval(text):
    return [float(end) for end in re.search(r"\[(.*), (.*)\]", text.replace("−", "-")).groups()]


def test_held_draws_of_dropout_solve_fewer_seas_and_an_ensemble_with_priors_more(facts):
    held, epsilon, priors = (number(facts[f"sea_{name}"]) for name in ("held", "epsilon", "priors"))
    assert held < epsilon / 2 < epsilon < priors
    assert all(dives.load()[name, 10].within().all() for name in ("ensemble", "ensemble-priors"))


def test_the_first_page_uses_every_fact_and_no_other(facts):
    page = (ROOT / "book" / "index.md").read_text(encoding="utf-8")
    names, advice = re.findall(GLUED, page), {f"use_{name}" for name in landing.USED}
    assert sorted(name for name in names if name not in advice) == sorted(set(facts) - advice)
    held = {"AL3e", "AL11", "AL11d", "AL11l", "AL11m", "EX7a", "EX7b", "EX9", "DE2a", "DE7a", "DE7c"}
    held = {f"use_{identifier}" for identifier in held}
    assert {name for name in names if name in advice} == held, "held to ADVICE below"


#: What the lines of "What to use when" were written for. Where this changes, write them again.
ADVICE = {
    "AL3e": "no difference", "AL3f": "no difference", "AL3g": "inconclusive", "AL4a": "supported",
    "AL4b": "contradicted", "AL5b": "supported", "AL5c": "supported", "AL5e": "supported", "AL5f": "supported",
    "AL7a": "confirmed", "AL7b": "confirmed", "AL9c": "supported", "AL11": "supported", "AL11b": "supported",
    "AL11d": "contradicted", "AL11e": "supported", "AL11c": "inconclusive", "AL11i": "untested",
    "AL11l": "inconclusive", "AL11m": "supported", "EX2d": "supported", "EX5a": "supported", "EX5b": "supported",
    "EX6c": "contradicted", "EX7a": "inconclusive", "EX7b": "contradicted", "EX7f": "contradicted",
    "EX9": "contradicted", "DE1a": "supported", "DE2a": "contradicted", "DE2d": "supported", "DE2g": "supported",
    "DE3h": "inconclusive", "DE4a": "inconclusive", "DE4d": "no difference", "DE5b": "supported", "DE5d": "supported",
    "DE6b": "supported", "DE6c": "no difference", "DE7a": "supported", "DE7b": "supported", "DE7c": "supported",
    "DE8a": "differs", "DE8d": "agrees", "DE9a": "supported", "DE9b": "supported", "DE13": "supported",
    "DE13b": "inconclusive", "DE13e": "supported", "DE13f": "inconclusive", "DE14a": "supported", "DE15": "untested",
}  # fmt: skip


def test_advice_gives_the_computed_verdicts_and_says_what_has_not_been_run(facts):
    page = (ROOT / "book" / "what_to_use.md").read_text(encoding="utf-8")
    assert sorted(re.findall(GLUED, page)) == sorted(f"use_{name}" for name in landing.USED)
    for name, glued in re.findall(rf"(\w+) {GLUED}", page):
        assert glued == f"use_{name}", "the number stands behind the id of its statement"
    assert {name: re.split(r",| \(", facts[f"use_{name}"])[0] for name in landing.USED} == ADVICE
    assert not re.search(r"\b(supported|contradicted|inconclusive|confirmed|refuted)\b", re.sub(GLUED, "", page))
    for line in page.splitlines():
        if line.endswith("|") and "Nothing yet" in line:
            assert {ADVICE[name.removeprefix("use_")] for name in re.findall(GLUED, line)} == {"untested"}


def test_no_fact_is_without_records(facts, tmp_path):
    assert "–" not in facts.values()
    nothing = landing.facts(tmp_path)
    assert {name for name, fact in nothing.items() if fact != "–" and not fact.startswith("untested")} == {
        "cells_minimum", "cells_last", "AL8a", "EX4",
    }  # of the original  # fmt: skip


def test_the_two_rows_that_could_not_choose(facts):
    assert facts["tied"] == "100%"


def test_the_entropy_of_one_pass_keeps_up_with_that_of_weight_draws(facts):
    for name in ("entropy_early", "entropy_end"):
        low, high = interval(facts[name])
        assert low < 0 < high


def test_the_setting_of_its_script_holds_the_entropy_of_one_pass_back(facts):
    assert interval(facts["entropy_steps_recorded"])[0] > interval(facts["entropy_steps"])[1]
    low, high = interval(facts["entropy_steps_draws"])
    assert low <= number(facts["entropy_steps"]) <= high


def test_the_printed_errors_are_lowest_points(facts):
    assert facts["cells_minimum"] == "7 of 7"
    assert number(facts["cells_last"]) < 7


def test_an_agent_without_exploration_earns_more_than_thompson_sampling_early_and_late(facts):
    assert interval(facts["greedy_early"])[0] > 0
    assert interval(facts["greedy_late"])[0] > 0
    ours = exploration.load("ours")
    for first, last in exploration.BLOCKS:
        assert ours["greedy"].mean(first, last).mean() > ours["thompson"].mean(first, last).mean()


def test_thompson_sampling_departs_from_its_best_guess_to_the_end_and_the_texts_dropout_costs_reward(facts):
    assert int(facts["departs"].rstrip("%")) > 5
    assert number(facts["dropout_of_text"]) < number(facts["dropout_of_program"]) - 0.05


def test_deep_pilco_as_written_swings_the_pole_up_but_only_just(facts):
    solved = [number(facts[name]) / float(facts[name].split()[-1]) for name in ("solved_as_written", "solved_ours")]
    later = [int(facts[name].rstrip("%")) for name in ("later_as_written", "later_ours")]
    assert solved[0] > 0.5
    assert 40 < later[0] < 60
    assert solved[1] > 0.9 < later[1] / 100


def test_the_model_of_deep_pilco_as_written_is_right_and_its_policy_slow():  # said in section 5.4
    written, ours = (data_efficiency.load(f"deep-pilco-{name}") for name in ("as-written", "ours"))
    for learning in (written, ours):
        later = learning.later
        assert abs(learning.predicted_costs[later].mean() - learning.trial_costs[later].mean()) < 0.02
    up = [np.median((x.costs[x.later & x.solved] < SOLVED_BELOW).argmax(-1)) for x in (written, ours)]
    assert up[0] > 1.5 * up[1]
    assert written.trial_costs[:, 31:].mean() < written.trial_costs[:, 21:31].mean() - 0.02  # it still learns
    assert written.trial_costs[written.later].mean() > ours.trial_costs[ours.later].mean() + 0.2


def test_holding_the_draw_does_nothing_once_moments_are_matched(facts):
    assert interval(facts["held_free"])[0] > 1.5
    low, high = interval(facts["held_matched"])
    assert 0.95 < low < 1 < high < 1.05


def test_a_learner_without_dropout_pays_more_and_its_trials_settle_nothing(facts):
    low, high = interval(facts["no_dropout_trials"])
    assert low < 0 < high
    assert interval(facts["no_dropout_cost"])[0] > 0
    assert interval(facts["on_mean_cost"])[0] > 0.05
    low, high = interval(facts["ensemble_cost"])
    assert low < 0 < high < 0.05
    assert interval(facts["alone_cost"])[0] > 0.05


def test_a_sure_pilco_pays_more_and_its_first_trial_costs_far_more_than_it_said(facts):
    assert interval(facts["sure_pilco_cost"])[0] > 0.05
    assert interval(facts["sure_pilco_said"])[1] < interval(facts["sure_pilco_was"])[0] - 0.1


def test_steps_that_are_hard_to_predict_gain_weight_and_have_less_among_like_times(facts):
    assert interval(facts["doubt"])[0] > 0
    (found,) = judge([STATEMENTS["DE11a"]])
    against, itself = found.measured.beside.values()
    assert against.low > 0 > itself.high
    assert "; share itself, at equal time steps: −0." in scoreboard.with_beside(found)
