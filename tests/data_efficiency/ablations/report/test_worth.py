"""What doubt is worth, from small made-up records: pairs, promises, coverage, both directions, clouds, pictures."""

import io
from dataclasses import replace

import matplotlib
import numpy as np
import pytest

matplotlib.use("agg")
import matplotlib.pyplot as plt
from drawn import dots, labelled

from dropout_uncertainty.data_efficiency.ablations.gradients import ESTIMATES
from dropout_uncertainty.data_efficiency.ablations.report.worth import analysis as worth
from dropout_uncertainty.data_efficiency.ablations.report.worth import chapter, figures
from dropout_uncertainty.data_efficiency.configs import CONFIGS
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.judging.collect import STATEMENTS
from dropout_uncertainty.judging.statements import judge
from dropout_uncertainty.page import plotting
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_dict, config_hash
from dropout_uncertainty.stats import difference_of_shares, in_words, paired_difference, t_interval

RUNS, STEPS = 40, PAPER.steps
rng = np.random.default_rng(100)


def write(folder, name, arrays, runs=RUNS):
    plain = config_dict(CONFIGS[name])
    header = {
        "experiment": "data_efficiency", "name": name, "seeds": list(range(runs)), "config": plain,
        "config_hash": config_hash(plain), "device": "cpu", "precision": "float32", "provenance": {},
    }  # fmt: skip
    records.write(folder / "data_efficiency" / name / f"000-{runs - 1:03d}.npz", arrays, header)


def learned(folder, name, cost, said=None, off=0.0, runs=RUNS):
    """Write trials that cost so much and were said to cost ``said``; angles leave the prediction by ``off``."""
    trials = CONFIGS[name].trials + 1
    costs = cost + 0.01 * rng.standard_normal((runs, 1, 1)) * np.ones((1, trials, STEPS))
    states = np.zeros((runs, trials, STEPS + 1, 4))
    states[..., 3] = off
    arrays = {
        "costs": costs, "predicted_cost": np.full_like(costs, cost if said is None else said), "states": states,
        "predicted_mean": np.zeros_like(states),
    }  # fmt: skip
    arrays["predicted_variance" if "pilco-" in name.removeprefix("deep-") else "predicted_std"] = np.ones_like(states)
    write(folder, name, {key: value.astype(np.float32) for key, value in arrays.items()}, runs)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return records in which doubt is worth 0.1 a step to PILCO, nothing to Deep PILCO, and an ensemble costs less."""
    folder = tmp_path_factory.mktemp("worth")
    learned(folder, "pilco-paper-15", 0.5)
    learned(folder, "doubt/pilco-mean", 0.6, said=0.2, off=3.0)
    learned(folder, "deep-pilco-ours", 0.4)
    learned(folder, "doubt/mean-network", 0.4)
    learned(folder, "doubt/ensemble", 0.3)
    learned(folder, "what-matters/no-dropout", 0.5, runs=10)
    learned(folder, "deep-pilco-as-text", 0.9)
    learned(folder, "literal/add/matching", 0.7, runs=10)
    learned(folder, "literal/drop/matching", 0.5, runs=10)
    learned(folder, "literal/drop/clip", 0.4, runs=10)
    for matching, cost in (("off", 0.8), ("full", 0.6)):
        learned(folder, f"mchutchon/fixed-bfgs-{matching}", cost, runs=10)
    learned(folder, "mchutchon/fresh-adam-off", 0.6, runs=10)
    many = np.ones((10, 3, STEPS, 4), np.float32)
    few = np.stack((np.full_like(many, 0.1), many), 2)
    write(folder, "shrinking/ours", {"costs": many[..., 0], "many_variance": many, "mean_variance": few,
                                     "median_variance": few / 2}, 10)  # fmt: skip
    horizons = len(CONFIGS["gradients/pilco"].horizons)
    variance = np.exp(rng.standard_normal((10, 3, 1, 1)) + np.array([[2.0], [1.0], [0.0]]) * np.arange(horizons))
    arrays = {"costs": many[..., 0], "gradient_variance": variance.astype(np.float32)}
    norm = np.broadcast_to(np.array([[4.0], [4.0], [2.0]]), variance.shape).astype(np.float32)
    write(folder, "gradients/pilco", arrays | {"gradient_norm": norm}, 10)
    return folder


def test_every_pair_has_words_and_an_other():
    assert {f"doubt/{name}" for name in worth.PAIRS if name != worth.ALONE} == {
        name for name in CONFIGS if name.startswith("doubt/")
    }


def test_pairs_share_seeds_and_a_shorter_run_stands_in(folder):
    found = {pair.name: pair for pair in worth.pairs(worth.stored(folder))}
    assert set(found) == {"mean-network", "no-dropout", "pilco-mean", "ensemble"}  # the other ensemble is not run
    assert {name: (len(x.first.seeds), x.first.trials) for name, x in found.items()} == {
        "mean-network": (40, 25), "no-dropout": (10, 20), "pilco-mean": (40, 15), "ensemble": (40, 25),
    }  # fmt: skip
    assert found["pilco-mean"].cost_difference.value == pytest.approx(0.1, abs=0.02)


def test_numbers_have_their_ids(folder):
    ids = {result.id: result for result in worth.results(folder)}
    assert ids["doubt/pilco-mean/promise"].ours == pytest.approx(0.4, abs=0.01)
    assert ids["doubt/pilco-mean/promise/difference"].seeds == list(range(40))
    assert ids["doubt/pilco-mean/coverage"].ours == pytest.approx(0.75)  # all dimensions but the angle
    assert ids["doubt/ensemble/cost/difference"].high < 0
    assert ids["literal/add/matching/cost/difference"].ours == pytest.approx(-0.2, abs=0.02)
    assert ids["literal/drop/matching/cost/difference"].ours == pytest.approx(0.1, abs=0.02)
    assert ids["mchutchon/fixed-bfgs-full/cost"].ours == pytest.approx(0.6, abs=0.02)
    assert ids["mchutchon/fixed-bfgs-off/cost/difference"].ours == pytest.approx(0.2, abs=0.02)
    assert "mchutchon/fixed-bfgs-full/cost/difference" not in ids  # nothing to hold it against
    assert ids["shrinking/ours/plain"].ours == pytest.approx(0.1)
    assert ids["shrinking/ours/standardised"].ours == 1
    assert not any(name.startswith(("what-matters", "doubt/no-dropout")) for name in ids)
    growth = [ids[f"gradients/pilco/{name}/25"].ours - ids[f"gradients/pilco/{name}/5"].ours for name in ESTIMATES]
    np.testing.assert_allclose(growth, np.array([2.0, 1.0, 0.0]) * 4 * np.log10(np.e), rtol=1e-5)


def test_without_records_there_is_nothing_and_the_page_says_so(tmp_path):
    assert worth.results(tmp_path) == []
    empty = chapter.Runs.of(worth.stored(tmp_path), worth.clouds(tmp_path), worth.estimates(tmp_path))
    assert empty.missing("gradients").markdown == "*Not run yet: `gradients/pilco`.*"
    assert empty.missing("literal").markdown == "*Not run yet: 26 of the learners `literal/…`.*"
    assert empty.records == []
    for picture, of in (
        ("forest", empty.pairs), ("covered", empty.pairs), ("first_trials", empty.pilco), ("left", empty.clouds),
        ("both_ways", empty.literal), ("particles", empty.particles), ("estimates", empty.estimates),
    ):  # fmt: skip
        assert getattr(figures, picture)(of) is None
    assert chapter.trusted(empty.pilco).markdown == "*Not run yet: `doubt/pilco-mean`.*"
    assert chapter.choices(empty).markdown == chapter.clouds(empty).markdown == ""


def test_pictures_show_the_numbers(folder):
    found = chapter.Runs.of(worth.stored(folder), worth.clouds(folder), worth.estimates(folder))
    doubt, sure = figures.DOUBT, figures.SURE
    assert [pair.name for pair in found.pairs] == ["mean-network", "no-dropout", "pilco-mean", "ensemble"]
    dearer, broken = figures.forest(found.pairs).axes
    np.testing.assert_allclose(dots(dearer), [(0, 0), (0.1, 1), (0.1, 2), (-0.1, 3)], atol=0.02)
    np.testing.assert_allclose(dots(broken, doubt)[:, 0], [0, 0, 0, 0], atol=0.01)
    np.testing.assert_allclose(dots(broken, sure)[:, 0], [0, 0, 0.4, 0], atol=0.01)
    assert {label: line.get_color() for label, line in labelled(broken).items()} == {
        "what it is held against": doubt, "the learner named": sure,
    }  # fmt: skip
    panels = figures.covered(found.pairs).axes
    assert len(panels) == 4
    shown = [(line.get_label(), line.get_color(), line.get_ydata().mean()) for line in panels[2].lines[:2]]
    assert shown == [("what it is held against", doubt, 1), ("the learner named", sure, pytest.approx(0.75))]
    for ax, title, words in zip(
        figures.first_trials(found.pilco).axes, ("on its mean", "with its doubt"), ((0.2, 0.6), (0.5, 0.5)), strict=True
    ):
        assert ax.get_title() == title
        for label, cost in zip(("predicted", "realised"), words, strict=True):
            np.testing.assert_allclose(labelled(ax)[label].get_ydata(), cost, atol=0.02)
    axes = figures.both_ways(found.literal).axes
    names = [label.get_text() for label in axes[0].get_yticklabels()]
    expected = {"added to the text's": {"matching": -0.2}, "taken from ours": {"clip": 0, "matching": 0.1}}
    assert {ax.get_title(): {names[int(y)]: x for x, y in dots(ax)} for ax in axes} == {
        title: pytest.approx(costs, abs=0.02) for title, costs in expected.items()
    }
    (ax,) = figures.particles(found.particles).axes
    assert {label: (line.get_color(), line.get_xdata()[0]) for label, line in labelled(ax).items()} == {
        "fresh particles, Adam": (doubt, pytest.approx(0.6, abs=0.02)),
        "fixed particles, BFGS": (sure, pytest.approx(0.8, abs=0.02)),
    }
    plt.close("all")


def test_pictures_of_clouds_and_gradients_show_the_numbers(folder):
    (ax,) = figures.left(worth.clouds(folder)).axes
    (cloud,) = worth.clouds(folder)
    steps = np.arange(1, STEPS + 1)
    expected = {
        "plain noise, mean": 0.1, "plain noise, median": 0.05, "standardised noise, mean": 1.0,
        "standardised noise, median": 0.5, "a walk that does nothing": (1 - 1 / cloud.particles) ** steps,
    }  # fmt: skip
    assert set(labelled(ax)) == set(expected)
    for label, line in labelled(ax).items():
        np.testing.assert_allclose(line.get_ydata(), np.broadcast_to(expected[label], STEPS), rtol=1e-5)
    measured = worth.estimates(folder)
    lines = labelled(figures.estimates(measured).axes[0])
    assert list(lines) == [name.replace("-", " ") for name in ESTIMATES]
    for i, line in enumerate(lines.values()):
        np.testing.assert_allclose(line.get_ydata(), np.log10(measured.variance[:, :, i]).mean((0, 1)), rtol=1e-5)
        np.testing.assert_array_equal(line.get_xdata(), measured.horizons)
    plt.close("all")


def test_a_walk_follows_its_theory():
    count, factors = 10, rng.chisquare(9, size=(12, 100_000))
    walks = {f"1/{k}": np.cumprod(np.vstack((np.ones(100_000), factors / k)), 0) for k in (count, count - 1)}
    ax = figures.walk(plt.figure().subplots(), walks, count)
    theory = iter([line.get_ydata() for line in ax.lines if line.get_marker() == "."])
    for words, values in walks.items():
        for kind, drawn in (("mean", values.mean(1)), ("median", np.median(values, 1))):
            np.testing.assert_allclose(labelled(ax)[f"{words}, {kind}"].get_ydata(), drawn)
            np.testing.assert_allclose(next(theory), drawn[::4], rtol=0.1)
    plt.close("all")


def test_sentences_show_the_numbers(folder):
    found = chapter.Runs.of(worth.stored(folder), worth.clouds(folder), worth.estimates(folder))
    text = chapter.answers(found).markdown
    assert "**PILCO, planned on its mean** costs more" in text
    assert "**ensemble in the place of dropout** costs less" in text
    by = {pair.name: pair.first.trial_costs[:10, 1:21].mean(1) for pair in found.pairs}
    more = in_words(paired_difference(by["mean-network"], by["no-dropout"]))
    assert f"Beside no dropout at all, **Deep PILCO, planned on the mean network** costs {more} more" in text
    assert "In both directions: matching." in chapter.choices(found).markdown
    one_way = chapter.choices(replace(found, literal=found.literal | {"add": []})).markdown
    assert one_way.startswith("Of 2 taken from ours, these make it dearer: matching.")
    assert "added" not in one_way
    assert "0.10 [0.10, 0.10] with plain noise" in chapter.clouds(found).markdown
    assert "has 0.50 [0.50, 0.50] times the norm" in chapter.grown(found.estimates).markdown
    assert "expected of its first 5 trials 0.20" in chapter.trusted(found.pilco).markdown
    assert (
        found.missing("doubt").markdown
        == "*Not run yet: `doubt/no-dropout`, `doubt/ensemble-mean`, `doubt/as-text-mean`.*"
    )


def test_statements_are_judged_by_these_records(folder):
    verdicts = {name: judge([STATEMENTS[name]], folder)[0].plain for name in ("DE7c", "DE7d", "DE5c")}
    assert verdicts == {"DE7c": "supported", "DE7d": "no difference", "DE5c": "supported"}


def test_published_runs_are_what_the_page_was_written_for():
    pairs = {pair.name: pair for pair in worth.pairs(worth.stored())}
    on_mean, without = pairs["mean-network"], pairs["no-dropout"]
    assert on_mean.cost_difference.low > 0.05  # the margin of cost
    assert without.cost_difference.low > 0
    between = [pair.first.trial_costs[:, 1:26].mean(1) for pair in (on_mean, without)]
    assert paired_difference(*between).low > 0
    assert on_mean.trials_difference.low > 0 > without.trials_difference.low
    for pair in (on_mean, without):
        assert all((learning.first_solved <= 25).mean() > 0.9 for learning in (pair.first, pair.second))
        assert pair.first.broken_promise.mean() > 0.05
        assert pair.first.covered[:, 1:].mean() < 0.5
    disagreeing, alone = pairs["ensemble"], pairs[worth.ALONE]
    assert disagreeing.cost_difference.low < -0.05 < 0 < disagreeing.cost_difference.high < 0.05
    assert len(disagreeing.first.seeds) == 40
    assert -5 < disagreeing.trials_difference.low < disagreeing.trials_difference.high < 0
    assert disagreeing.first.covered[:, 1:].mean() < disagreeing.second.covered[:, 1:].mean() - 0.1
    assert alone.cost_difference.low > 0.05
    assert alone.first.kept.high < alone.second.kept.low
    for learning in (alone.first, alone.second):
        assert (learning.first_solved <= 25).mean() > 0.9
    assert 0 < disagreeing.first.broken_promise.mean() < 0.05
    assert "ensemble-mean" not in pairs


def test_what_is_left_of_a_cloud_and_the_texts_learner_are_what_the_page_says():
    def left(cloud, noise, of="left"):
        return t_interval(np.log(getattr(cloud, of)[noise][..., -1]).mean(1))

    text, paper, ours = worth.clouds()
    assert np.log(0.5) > max(left(cloud, "plain").high for cloud in (text, paper))
    for cloud in (text, paper, ours):
        assert left(cloud, "standardised").low < 0 < left(cloud, "standardised").high
        assert left(cloud, "standardised", "typical").high < 0
        assert left(cloud, "standardised", "typical").value == pytest.approx(np.log(0.8), abs=0.06)
    assert np.log(0.25) > max(left(cloud, "plain", "typical").high for cloud in (text, paper))
    learning = worth.stored()("deep-pilco-as-text")
    assert [(learning.first_solved <= trial).sum() for trial in (25, 40)] == [1, 4]
    assert (learning.kept.value, len(learning.seeds)) == (0, 10)
    taken = {pair.name: pair for pair in worth.literal_pairs(worth.stored())["drop"]}
    assert taken["matching"].cost_difference.low > 0 == taken["matching"].first.kept.value
    costs = {name: pair.cost_difference for name, pair in taken.items()}
    assert {name for name, cost in costs.items() if cost.low > 0} == {"angle-features", "particles", "matching"}
    assert costs["angle-features"].low > max(cost.value for name, cost in costs.items() if name != "angle-features")
    assert taken["angle-features"].trials_difference.low > 5


def test_a_sure_pilco_is_what_the_page_says():
    """Where this fails, read *Model bias, looked at* and *What it means* on *What is doubt worth?*."""
    pair = {found.name: found for found in worth.pairs(worth.stored())}["pilco-mean"]
    sure, doubting = pair.first, pair.second
    assert len(sure.seeds) == 40
    assert pair.cost_difference.low > 0.05
    assert sure.broken_promise.mean() > 0.1 > 0.05 > doubting.broken_promise.mean()
    assert sure.kept.high < doubting.kept.low
    assert pair.trials_difference.low > 0
    found = difference_of_shares(sure.first_solved <= 15, doubting.first_solved <= 15)
    assert found.low < 0 < found.high
    said, was = sure.predicted_costs[:, 1:6], sure.trial_costs[:, 1:6]
    assert said[:, 0].mean() < 0.8 < 0.95 < was[:, 0].mean()
    assert t_interval(was[:, 4] - said[:, 4]).low > 0.05
    assert 0.8 < doubting.predicted_costs[:, 1].mean() < doubting.trial_costs[:, 1].mean()
    assert t_interval(doubting.trial_costs[:, 1] - doubting.predicted_costs[:, 1]).high < 0.15


def test_the_pictures_of_the_stored_runs_fit_the_column():
    pairs = worth.pairs(worth.stored())
    with plt.rc_context():
        plotting.use_style()
        for draw in (figures.forest, figures.covered):
            file = io.BytesIO()
            draw(pairs).savefig(file, dpi=2 * 96)
            file.seek(0)
            assert plt.imread(file).shape[1] // 2 <= 96 * plotting.WIDTH + 1, draw.__name__
    plt.close("all")
