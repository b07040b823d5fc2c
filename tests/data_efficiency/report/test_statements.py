"""Statements of section 5.4 whose runs are still to come: their rules, on learners made up for the purpose."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dropout_uncertainty.data_efficiency.ablations.report import statements as of_parts
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.data_efficiency.report import analysis, statements
from dropout_uncertainty.judging.collect import STATEMENTS
from dropout_uncertainty.judging.statements import NotRun, judge
from dropout_uncertainty.runs.records import Record

RUNS, TRIALS, STEPS = 10, 10, PAPER.steps
NEVER = 99


def learner(name, first, wrong=0.0):
    """Return repetitions that are solved from a trial on; predicted angles are wrong by ``wrong`` [T] rad."""
    good = np.arange(TRIALS + 1) >= first
    costs = np.broadcast_to(np.where(good[:, None], 0.05, 1.0), (RUNS, TRIALS + 1, STEPS))
    costs = costs + 0.01 * np.random.default_rng(100).standard_normal((RUNS, 1, 1))
    states = np.zeros((RUNS, TRIALS + 1, STEPS + 1, 4))
    mean = states.copy()
    mean[:, :, 1:, 3] += wrong
    arrays = {"costs": costs, "predicted_cost": costs, "states": states, "predicted_mean": mean}
    return analysis.from_arrays(name, PAPER, arrays, range(RUNS))


@pytest.fixture
def verdict(monkeypatch):
    def of(identifier, **learners):
        known = {name.replace("__", "/").replace("_", "-"): found for name, found in learners.items()}
        monkeypatch.setattr(statements, "load", lambda name, folder: known.get(name))
        (judged,) = judge([STATEMENTS[identifier]])
        return judged.verdict

    return of


def test_a_learner_that_never_solves_the_task_needs_more_trials_than_it_had(verdict):
    quick, never = learner("quick", 1), learner("never", NEVER)
    assert verdict("DE9a", ddpg=never, deep_pilco_ours=quick) == "supported"  # at least 11 trials against 1
    assert verdict("DE9c", ddpg=never, deep_pilco_ours=quick) == "inconclusive"  # 11 is not a hundred
    assert verdict("DE9b", naf=learner("naf", 5), deep_pilco_ours=quick) == "contradicted"
    assert verdict("DE14b", deep_pilco_ours=never, pilco_paper=never) == "inconclusive"
    assert verdict("DE2f", deep_pilco_as_written=never) == "imprecise"  # after 10 trials 42 are still possible
    assert verdict("DE1c", pilco_paper=never) == "differs"  # 5 are not
    assert verdict("DE9d") == "untested"


def test_a_model_that_is_right_at_first_and_wrong_later(verdict):
    off = np.where(np.arange(STEPS) < 10, 0.0, 3.0)
    assert verdict("DE7d", doubt__pilco_mean=learner("sure", 3, off)) == "supported"
    assert verdict("DE7d", doubt__pilco_mean=learner("right", 3)) == "no difference"


def test_a_model_is_judged_by_repetitions_and_not_by_trials(monkeypatch):
    found = learner("sure", 3)
    monkeypatch.setattr(statements, "load", lambda name, folder: found)
    assert statements.fades("doubt/pilco-mean", None).difference.n == RUNS


def test_what_many_dimensions_are_judged_by(verdict):
    near, far = learner("near", 3, 0.1), learner("far", 3, 0.2)
    deep, pilco = "many_dimensions__deep_pilco", "many_dimensions__pilco"
    assert verdict("DE15", **{deep: near, pilco: learner("never", NEVER)}) == "supported"
    assert verdict("DE15", **{deep: near, pilco: far}) == "inconclusive"  # ten repetitions each


def test_particles_through_a_gaussian_process(verdict):
    fixed, fresh = "mchutchon__fixed_bfgs_off", "mchutchon__fresh_adam_off"
    assert verdict("DE5c", **{fixed: learner("late", 9), fresh: learner("soon", 3)}) == "supported"


def test_hours_are_those_of_repetitions_by_themselves_on_one_processor(monkeypatch):
    def alone(hours, seeds=(0,), processor="a"):
        provenance = {f"{part}_cpu_s": [hours] * 50 for part in analysis.TIMED} | {"processor": processor}
        header = {"seeds": list(seeds), "device": "cpu", "provenance": provenance, "name": "x"}
        return Record(header, {}, Path("x"))

    def found(pilco, deep):
        learners = {"pilco-paper-40": pilco, "deep-pilco-ours": deep}
        monkeypatch.setattr(
            of_parts.analysis, "load", lambda name, folder: replace(learner(name, 3), records=tuple(learners[name]))
        )
        return of_parts.longer(of_parts.HOURS, None)

    five = [alone(1.0)] * 5
    assert found([alone(of_parts.HOURS)] * 5, five).difference[:3] == pytest.approx((0, 0, 0), abs=1e-9)
    with pytest.raises(NotRun):
        found(five, [alone(1.0, seeds=(0, 1))])  # side by side
    with pytest.raises(NotRun):
        found(five, [alone(1.0, processor="b")] * 5)
    assert found([alone(1.0)], five).difference.n == 1
