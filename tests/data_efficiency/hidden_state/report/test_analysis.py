"""Where the state is hidden, from small made-up records: scores, verdicts, words and pictures."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest

matplotlib.use("agg")
import matplotlib.pyplot as plt
from drawn import labelled
from scipy.stats import norm

from dropout_uncertainty import stats
from dropout_uncertainty.data_efficiency.configs import CONFIGS
from dropout_uncertainty.data_efficiency.hidden_state.report import analysis, chapter, figures
from dropout_uncertainty.data_efficiency.hidden_state.report.analysis import CONTROL, LANGUAGES, MODELS, SEEN
from dropout_uncertainty.data_efficiency.report import analysis as of_section
from dropout_uncertainty.data_efficiency.report.statements import MARGIN_LOG
from dropout_uncertainty.judging.collect import STATEMENTS
from dropout_uncertainty.judging.statements import judge
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_dict, config_hash

RUNS = 20


def write(folder, name, arrays):
    plain, runs = config_dict(CONFIGS[name]), len(next(iter(arrays.values())))
    header = {
        "experiment": "data_efficiency", "name": name, "seeds": list(range(runs)), "config": plain,
        "config_hash": config_hash(plain), "device": "cpu", "precision": "float32",
        "provenance": {"cpu_s": 50.0} | {f"{part}_cpu_s": [10.0] * 26 for part in ("model", "policy", "trial")},
    }  # fmt: skip
    arrays = {key: value.astype(np.float32) for key, value in arrays.items()}
    records.write(folder / "data_efficiency" / name / f"000-{runs - 1:03d}.npz", arrays, header)


def predicted(folder, name, std, off=1.0):
    """Write predictions that are wrong by ``off`` of their standard deviations, which differ a little by seed."""
    shape = RUNS, 3, 5, 25, 2
    spread = std * np.exp(0.01 * np.random.default_rng(100).standard_normal((RUNS, 1, 1, 1, 1))) * np.ones(shape)
    arrays = {"observed": off * spread, "predicted_mean": np.zeros(shape), "predicted_std": spread}
    write(folder, f"hidden/{name}", arrays)


def read(folder, masks, end):
    passes = CONFIGS[f"hidden/language-{masks}"].passes
    way = np.linspace(3, end, passes) + 0.001 * np.arange(5)[:, None]
    test = np.minimum(way, 2.2) if end > 2.2 else way
    test[:, -1] = end
    write(folder, f"hidden/language-{masks}", {"train": way - 0.5, "test": test})


def learned(folder, name, cost, runs):
    """Write trials of which each costs the same, a little more with each seed; half of that is what was predicted."""
    shape = runs, 26, 25
    costs = cost + 0.001 * np.arange(runs)[:, None, None] + np.zeros(shape)
    write(folder, name, {"costs": costs, "predicted_cost": costs / 2})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return records in which the LSTM with held masks is twice as sharp as one observation and as four, and learns."""
    folder = tmp_path_factory.mktemp("hidden")
    predicted(folder, "last-one", 0.2)
    predicted(folder, "last-four", 0.1)
    predicted(folder, "lstm-held", 0.1)
    predicted(folder, "lstm-fresh", 0.05, off=3.0)
    read(folder, "held", 2.0)
    read(folder, "fresh", 2.3)
    learned(folder, "hidden/control-last-one", 0.9, 10)
    learned(folder, "hidden/control-lstm-held", 0.1, 10)
    learned(folder, "deep-pilco-ours", 0.05, 20)
    return folder


def verdict(folder, name):
    return judge([STATEMENTS[name]], folder)[0].verdict


def test_every_config_is_shown():
    shown = {f"hidden/{name}" for name in (*MODELS, *LANGUAGES)}
    assert shown | {*CONTROL.values()} - {"deep-pilco-ours"} == {*chapter.CONFIGS}


def test_the_log_density_is_that_of_a_gaussian(folder):
    run = analysis.load("last-one", folder)
    expected = -0.5 * np.log(2 * np.pi) - np.log(0.2) - 0.5
    assert run.log_density.mean() == pytest.approx(expected, abs=0.01)
    assert run.covered.all()
    assert not analysis.load("lstm-fresh", folder).covered.any()


def test_verdicts(folder):
    assert verdict(folder, "DE13") == "supported"  # log 2 nats
    assert verdict(folder, "DE13b") == "no difference"
    assert verdict(folder, "DE13c") == "supported"  # a sharper prediction that is wrong is worse
    assert verdict(folder, "DE13d") == "untested"
    assert verdict(folder, "DE13e") == "supported"
    assert verdict(folder, "DE13f") == "untested"
    assert verdict(folder, "DE16a") == "supported"
    assert verdict(folder, "DE16b") == "untested"


def test_numbers_have_their_names(folder):
    found = {result.id: result for result in analysis.results(folder)}
    assert found["hidden/lstm-held/log-density"].seeds == list(range(20))
    assert found["hidden/lstm-held/log-density/10"].ours == pytest.approx(-0.92 - np.log(0.1) - 0.5, abs=0.02)
    assert found["hidden/last-one/coverage"].ours == 1
    assert found["hidden/language-fresh/lost"].ours == pytest.approx(0.1, abs=0.01)
    assert "hidden/lstm-no-dropout/log-density" not in found
    assert found["hidden/lstm-held/trials-to-solve"].ours == 1
    assert found["hidden/lstm-held/trials-to-solve"].seeds == list(range(10))
    assert found["hidden/last-one/solved-by-25"].ours == 0
    assert found["hidden/last-one/cost/difference"].ours == pytest.approx(0.85, abs=1e-3)
    assert found["hidden/last-one/promise"].ours == pytest.approx(0.45, abs=0.01)


def test_pairs_share_their_seeds(folder):
    held, one = (analysis.load(name, folder) for name in ("lstm-held", "last-one"))
    assert np.allclose(stats.apart(lambda run: run.score, held, one), np.log(2), atol=1e-4)


def runs_of(folder):
    return chapter.Runs.of(lambda name: analysis.load(name, folder), lambda name: of_section.load(name, folder))


def test_what_is_missing_is_one_line_and_what_is_there_is_drawn(folder):
    found = runs_of(folder)
    missing = ("lstm-no-dropout", "control-last-four", "language-none")
    assert found.missing.markdown == f"*Not run yet: {', '.join(f'`hidden/{name}`' for name in missing)}.*"
    for draw, of in ((figures.readings, found.languages), (figures.scores, found.models), (figures.trial, found.models),
                     (figures.over_time, found.models), (figures.learning, found.learners)):  # fmt: skip
        assert isinstance(draw(of), plt.Figure)
        assert draw(type(of)()) is None
    plt.close("all")
    assert "than the **last observation** it predicts better: 0.69 [0.69, 0.69] nats" in chapter.answers(found).markdown
    assert chapter.over_fitting(found).markdown.count("nats a character") == 2
    assert [row[1] for row in chapter.models_table(found)[1]] == [20] * 4
    assert [row[:2] for row in chapter.learners_table(found)[1]] == [
        ["last observation", 10], ["LSTM, held masks", 10], [SEEN, 10],
    ]  # fmt: skip
    assert len(found.records) == 9
    assert chapter.answers(chapter.Runs([], [], {})).markdown == ""


def test_pictures_of_texts_and_learners_show_the_numbers(folder):
    found = runs_of(folder)
    train, test = figures.readings(found.languages).axes
    assert [ax.get_title() for ax in (train, test)] == ["text that it was trained on", "other text"]
    for ax, part in ((train, "train"), (test, "test")):
        assert set(labelled(ax)) == {LANGUAGES["language-fresh"], LANGUAGES["language-held"]}
        for name in ("language-fresh", "language-held"):
            (record,) = records.find("data_efficiency", name=f"hidden/{name}", folder=folder)
            np.testing.assert_allclose(
                labelled(ax)[LANGUAGES[name]].get_ydata(), record.arrays[part].mean(0), rtol=1e-5
            )
    costs, ever = figures.learning(found.learners).axes
    assert [ax.get_ylabel() for ax in (costs, ever)] == ["mean cost per step", "share of repetitions solved by then"]
    expected = {
        MODELS["last-one"]: 0.9045,
        MODELS["lstm-held"]: 0.1045,
        SEEN: 0.0545,
    }  # of the ten seeds that all share
    assert {label: line.get_ydata().mean() for label, line in labelled(costs).items()} == pytest.approx(
        expected, abs=1e-5
    )
    assert {line.get_color(): line.get_ydata().tolist() for line in ever.lines} == {
        figures.STYLES[name][0]: [share] * 25 for name, share in (("last-one", 0), ("lstm-held", 1), ("seen", 1))
    }
    plt.close("all")


def test_pictures_of_predictions_show_the_numbers(folder):
    noise, found = np.random.default_rng(100), []
    for run in runs_of(folder).models:
        shape = run.arrays["observed"].shape
        drawn = {name: noise.standard_normal(shape) for name in ("observed", "predicted_mean")}
        found.append(replace(run, arrays={**drawn, "predicted_std": noise.uniform(0.5, 2, shape)}))
    (density, covered), over, trials = (draw(found).axes for draw in (figures.scores, figures.over_time, figures.trial))
    assert [ax.get_ylabel() for ax in (density, covered)] == [
        "log density of a number [nats]",
        "within two predicted std",
    ]
    assert [ax.get_title() for ax in over] == ["x", "θ"]
    assert [ax.get_title() for ax in trials] == [MODELS[run.name] for run in found[:3]]
    for place, run in enumerate(found):
        true, mean, std = (run.arrays[name] for name in ("observed", "predicted_mean", "predicted_std"))
        log_density = norm.logpdf(true, mean, std)
        inside = np.abs(true - mean) <= 2 * std
        for ax, values in ((density, log_density), (covered, inside)):
            bars = ax.containers[place]
            assert bars.get_label() == MODELS[run.name]
            np.testing.assert_allclose(bars.lines[0].get_ydata(), values.mean((0, 2, 3, 4)))
        for ax, number in zip(over, (0, 1), strict=True):
            drawn = labelled(ax)[MODELS[run.name]].get_ydata()
            np.testing.assert_allclose(drawn, log_density[..., number].mean((0, 1, 2)))
        if place < 3:
            drawn = labelled(trials[place])
            np.testing.assert_array_equal(drawn["predicted, two std"].get_ydata(), mean[0, -1, 0, :, 1])
            np.testing.assert_array_equal(drawn["observed"].get_ydata(), true[0, -1, 0, :, 1])
            edges = trials[place].collections[0].get_paths()[0].vertices[:, 1]
            assert edges.max() == pytest.approx((mean + 2 * std)[0, -1, 0, :, 1].max())
    plt.close("all")


def test_what_the_page_says_of_the_stored_runs():
    """Where this changes, write "What it means" again."""
    said = {
        "DE13": "supported",
        "DE13b": "inconclusive",
        "DE13c": "inconclusive",
        "DE13d": "inconclusive",
        "DE13e": "supported",
        "DE13f": "inconclusive",
        "DE16a": "no difference",
        "DE16b": "supported",
    }
    assert {name: verdict(None, name) for name in said} == said
    whole = stats.apart(lambda run: run.score, *(analysis.load(name) for name in ("lstm-held", "last-one")))
    one, without = stats.t_interval(whole), stats.t_interval(np.delete(whole, whole.argmax()))
    assert without.high - without.low < (one.high - one.low) / 3
    assert without.low > MARGIN_LOG
    learners = analysis.learners(of_section.load)
    solved = {name: int(np.isfinite(learner.first_solved).sum()) for name, learner in learners.items()}
    assert solved == {"last-one": 0, "last-four": 4, "lstm-held": 6, "seen": 10}
    assert (learners["last-one"].predicted_costs[:, 1:].mean(0) > 0.9).all()
    numbers = {result.id: result for result in analysis.results()}
    assert all(numbers[f"hidden/{name}/cost/difference"].low > 0 for name in list(solved)[:3])
    (record,) = records.find("data_efficiency", name="hidden/control-last-one", published=True)
    assert (record.arrays["policy_redrawn"][:, 1:] > 0).mean() > 0.5
