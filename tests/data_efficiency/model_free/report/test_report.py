"""The page on learners without a model, from small made-up records: search, numbers, words and pictures."""

import re
from dataclasses import replace

import matplotlib
import numpy as np
import pytest

matplotlib.use("agg")
import matplotlib.pyplot as plt

from dropout_uncertainty.data_efficiency.configs import CONFIGS
from dropout_uncertainty.data_efficiency.deep_pilco.learner import OURS
from dropout_uncertainty.data_efficiency.model_free.config import ENDS, SEARCH, ModelFreeConfig
from dropout_uncertainty.data_efficiency.model_free.report import analysis, chapter, figures
from dropout_uncertainty.data_efficiency.report.analysis import from_arrays, from_records, load, solved_table
from dropout_uncertainty.data_efficiency.report.statements import times_as_many
from dropout_uncertainty.judging.collect import STATEMENTS
from dropout_uncertainty.judging.statements import judge
from dropout_uncertainty.page.plotting import WIDTH
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_dict, config_hash


def write(folder, name, cost, solved=None, seeds=range(5)):
    """Write tests that cost so much, a little different by seed, and 0 from a trial on where they are solved."""
    config, runs = CONFIGS[name], len(seeds)
    costs = np.full((runs, config.trials + 1, config.plant.steps), np.nan)
    tests = np.arange(config.test_every, config.trials + 1, config.test_every)
    costs[:, tests] = cost + 0.001 * np.arange(runs)[:, None, None]
    for run, first in enumerate(solved or []):
        costs[run, tests[tests >= first]] = 0.0
    plain = config_dict(config)
    header = {
        "experiment": "data_efficiency", "name": name, "seeds": list(seeds), "config": plain,
        "config_hash": config_hash(plain), "device": "cpu", "precision": "float32", "provenance": {"cpu_s": 50.0},
    }  # fmt: skip
    path = folder / "data_efficiency" / name / f"{min(seeds):03d}-{max(seeds):03d}.npz"
    records.write(path, {"costs": costs.astype(np.float32)}, header)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder, development = tmp_path_factory.mktemp("free"), range(100, 105)
    write(folder, "ddpg-search/printed", 0.9, seeds=development)
    write(folder, "ddpg-search/noise-0.5", 0.8, seeds=development)
    write(folder, "naf-search/rate-0.001-noise-0.3", 0.7, solved=[400, 100, 500], seeds=development)
    write(folder, "ddpg", 0.9, solved=[1000, 500, 2000, 2500])
    write(folder, "ends/ddpg/terminal", 0.7)
    return folder


def chosen(method, folder=None):
    """Return the best setting of the search, with as many trials as a published run has."""
    runs = analysis.searched(folder)
    costs = {name: analysis.end_cost(run).mean() for name, run in runs.items() if SEARCH[name].method == method}
    return replace(SEARCH[min(costs, key=costs.get)], trials=ModelFreeConfig().trials)


def test_the_search_goes_by_the_cost_of_its_last_tests(folder):
    assert set(analysis.searched(folder)) == {
        "ddpg-search/printed", "ddpg-search/noise-0.5", "naf-search/rate-0.001-noise-0.3",
    }  # fmt: skip
    assert chosen("ddpg", folder) == replace(SEARCH["ddpg-search/noise-0.5"], trials=2_500)
    heads, cells = analysis.search_table(folder)
    printed, noise, naf = cells
    assert [len(row) for row in cells] == [len(heads)] * 3
    assert printed[1:3] == ["nothing", "100-104"]
    assert noise[1] == "`noise_std` 0.2 → 0.5"
    assert printed[3].startswith("0.90 [")
    assert naf[4] == "2 of 5"  # one is solved only after the last trial
    learning = analysis.searched(folder)["naf-search/rate-0.001-noise-0.3"]
    assert analysis.end_cost(learning)[[0, 1, 2]] == pytest.approx([0.7 * 0.9, 0, 0.702], abs=1e-3)  # the last ten


def test_what_was_searched_and_chosen_is_what_is_run():
    """Where this fails the search has grown: the published runs are then of a setting that is not the best."""
    for method in ("ddpg", "naf"):
        assert CONFIGS[method] == chosen(method)


def test_another_end_is_held_against_the_same_trials_of_the_same_seeds(folder):
    (end,) = analysis.ends(folder)
    assert end.name == "ends/ddpg/terminal"
    assert end.difference.value == pytest.approx(-0.2, abs=1e-6)
    assert {r.id: r.ours for r in analysis.results(folder)} == pytest.approx(
        {"ends/ddpg/terminal/cost": 0.702, "ends/ddpg/terminal/difference": -0.2}, abs=1e-6
    )
    assert all(config.trials == 400 for config in ENDS.values())


def test_a_repetition_that_has_ended_keeps_its_last_test_until_the_last_trial(tmp_path):
    write(tmp_path, "naf", 0.5, solved=[100] * 5)
    arrays = dict(load("naf", tmp_path).arrays)
    arrays["costs"][:, 131:] = np.nan  # three tests in a row were solved
    ended = from_arrays("naf", CONFIGS["naf"].plant, arrays, range(5))
    assert ended.tested[-1] == 2_500
    assert analysis.end_cost(ended).tolist() == [0] * 5
    assert ended.cost_at(1000).value == 0
    assert ended.kept.n == 0  # it ended because its solution was kept


def test_tables_and_figures_take_learners_of_any_length(folder):
    ddpg = load("ddpg", folder)
    short = from_records("naf", analysis.searched(folder)["naf-search/rate-0.001-noise-0.3"].records)
    heads, cells = solved_table([short, ddpg], (100, 400, 1000, 2500))
    assert len(heads) == len(cells[0]) == 8
    assert cells[0][:3] == ["NAF (5)", None, "> 400 [100, > 400]"]
    assert cells[0][-3:] == [None] * 3  # neither had it so many trials, nor went on after it was solved for a while
    assert cells[1][2].startswith("2000 [500")
    figure = figures.unsolved([short, ddpg])
    assert figure.get_figwidth() == WIDTH
    assert [line.get_ydata()[-1] for line in figure.axes[0].lines] == pytest.approx([0.6, 0.2])
    plt.close(figure)


def test_what_the_page_says_of_the_stored_runs():
    """Where this changes, write "What it means" again, and the line of "What to use when"."""
    said = {"DE9a": "supported", "DE9b": "supported", "DE9c": "inconclusive", "DE9d": "inconclusive"}
    assert {name: judge([STATEMENTS[name]])[0].verdict for name in said} == said
    times = [times_as_many(name, "deep-pilco-ours", 0.0, None).ours for name in ("naf", "ddpg")]
    assert [[round(end, -1) for end in (t.low, t.high)] for t in times] == [[50, 120], [100, 200]]
    assert OURS.model_steps + OURS.policy_steps == 900
    ddpg, naf = load("ddpg"), load("naf")
    assert {len(learning.seeds) for learning in (ddpg, naf)} == {20}
    assert sum(np.isinf(learning.first_solved).sum() for learning in (ddpg, naf)) == 3
    kept = re.findall(r"(\d+) of 20 repetitions had 3 solved tests in a row", chapter.more().markdown)
    assert sum(map(int, kept)) == 21
    assert all(end.difference.low < 0 < end.difference.high for end in analysis.ends())
    assert [len(end.records[0].seeds) for end in analysis.ends()] == [5] * 3
