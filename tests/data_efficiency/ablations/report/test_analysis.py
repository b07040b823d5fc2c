"""What matters, from synthetic records: differences, verdicts that follow their rules, exponents, pictures."""

import matplotlib
import numpy as np
import pytest

matplotlib.use("agg")
import matplotlib.pyplot as plt
from drawn import dots, labelled
from matplotlib.text import Annotation

from dropout_uncertainty.data_efficiency.ablations import variants
from dropout_uncertainty.data_efficiency.ablations.probes import CLOUDS, OPTIMISERS, PARTED
from dropout_uncertainty.data_efficiency.ablations.report import analysis as matters
from dropout_uncertainty.data_efficiency.ablations.report import figures
from dropout_uncertainty.data_efficiency.ablations.variants import MECHANISM, SCALING, VARIANTS
from dropout_uncertainty.data_efficiency.deep_pilco.learner import OURS
from dropout_uncertainty.data_efficiency.deep_pilco.particles import MATCHING
from dropout_uncertainty.data_efficiency.pilco.learner import PILCO_PAPER
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.judging.collect import STATEMENTS
from dropout_uncertainty.judging.statements import judge
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_dict, config_hash

RUNS, STEPS = 10, PAPER.steps
rng = np.random.default_rng(100)


def costs(first, trials):
    """Return costs of repetitions that are solved from the trials ``first`` on."""
    good = np.arange(trials + 1) >= np.array(first)[:, None]
    return np.where(good[..., None] & (np.arange(STEPS) >= 10), 0.05, 1.0)


def write(folder, name, config, arrays, provenance=None, runs=RUNS):
    plain = config_dict(config)
    header = {
        "experiment": "data_efficiency", "name": name, "seeds": list(range(runs)), "config": plain,
        "config_hash": config_hash(plain), "device": "cpu", "precision": "float32",
        "provenance": provenance or {},
    }  # fmt: skip
    records.write(folder / "data_efficiency" / name / f"000-{runs - 1:03d}.npz", arrays, header)


def learned(folder, name, config, first):
    arrays = {"costs": costs(first, config.trials).astype(np.float16)}
    write(folder, name, config, arrays | {"predicted_cost": arrays["costs"]}, runs=len(first))


def looked(folder, *, holds=True, old=False):
    """Write a record of the mechanism in which the claims hold, or none of them does."""
    sign, shape = (1 if holds else -1), (RUNS, len(MECHANISM.measured))
    noise = 0.01 * rng.standard_normal((RUNS, *(1,) * 4))
    # log of the predicted std by cloud: masks held give more than masks redrawn
    wide = np.array([sign * 0.3 if "held" in name else 0.0 for name in CLOUDS])
    std = np.exp(np.broadcast_to(wide[:, None, None], (*shape, len(CLOUDS), STEPS, 4)) + noise)
    errors = rng.uniform(-2.4, 2.4, (*shape, STEPS + 1, 4)) if holds else np.zeros((*shape, STEPS + 1, 4))
    valley = rng.uniform(size=(*shape, len(CLOUDS), STEPS))
    variance = np.array([1.0, 2.0, 4.0]) if holds else np.array([4.0, 2.0, 1.0])
    scatter = np.broadcast_to(variance[:, None], (*shape, len(MATCHING), len(MECHANISM.horizons)))
    bias = sign * 0.1 / np.array(MECHANISM.counts)
    reached = {"fresh-adam": 0.5, "fixed-adam": 0.48, "fixed-bfgs": 0.45}
    fresh = {"fresh-adam": 0.5, "fixed-adam": 0.55, "fixed-bfgs": 0.5 + sign * 0.1}
    arrays = {
        "costs": costs([5] * RUNS, MECHANISM.trials), "predicted_cost": costs([5] * RUNS, MECHANISM.trials),
        "true_states": errors, "cloud_mean": np.zeros_like(std), "cloud_std": std, "cloud_valley": valley,
        "penalty": sign * valley[:, :, 1] + 0.1 * rng.standard_normal((*shape, STEPS)),
        "diagonal_std": std[:, :, [list(CLOUDS).index(name) for name in ("held-free", "redrawn-free")]],
        "gradient_variance": scatter * np.exp(noise[..., 0]), "gradient_norm": np.ones_like(scatter),
        "objective": np.broadcast_to(0.5 + bias, (*shape, len(MATCHING), len(bias))) + noise[..., 0],
        "reached": np.array([reached[name] for name in OPTIMISERS]) + noise[..., 0, 0],
        "fresh": np.array([fresh[name] for name in OPTIMISERS]) + 2 * noise[..., 0, 0],
    }  # fmt: skip
    arrays["penalty_diagonal"] = arrays["penalty"]
    small = {name: value.astype(np.float32) for name, value in arrays.items() if not (old and "diagonal" in name)}
    write(folder, "what-matters/mechanism", MECHANISM, small)


def pilco(folder, *, narrow=True):
    config, shape = PILCO_PAPER, (RUNS, PILCO_PAPER.trials + 1, STEPS + 1, 4)
    true = rng.standard_normal(shape) if narrow else np.zeros(shape)
    arrays = {
        "costs": costs([5] * RUNS, config.trials), "predicted_cost": costs([5] * RUNS, config.trials), "states": true,
        "predicted_mean": np.zeros(shape), "predicted_variance": np.full(shape, 0.25),
    }  # fmt: skip
    write(folder, "pilco-paper", config, arrays)


def timed(folder, exponents=(2.0, 2.0, 2.0), flat=(0.0, 0.5, 1.0), runs=RUNS):
    seconds = np.array([
        np.prod(np.array(sizes, float) ** (exponents if method == "pilco" else flat))
        for method, _, sizes in SCALING.points()
    ])  # fmt: skip
    noisy = seconds * np.exp(0.01 * rng.standard_normal((runs, len(seconds))))
    values = {name: np.zeros((runs, len(seconds)), np.float32) for name in ("fit_value", "trial_value")}
    times = {"scaling_fit_s": (0.25 * noisy).tolist(), "scaling_policy_s": (0.75 * noisy).tolist()}
    write(folder, "what-matters/scaling", SCALING, values, times, runs)


def world(folder, *, holds=True, changed=()):
    """Write all records, such that every claim holds, or that none does."""
    learned(folder, "deep-pilco-ours", OURS, [5] * RUNS if holds else [99] * RUNS)
    for name, variant in VARIANTS.items():
        robust = variant.claim == "DE10" or name == "matching-diagonal"
        first = [6] * RUNS if robust == holds else [99] * RUNS if holds else [4] * RUNS
        learned(folder, f"what-matters/{name}", variant.config, dict(changed).get(name, first))
    looked(folder, holds=holds)
    pilco(folder, narrow=holds)
    timed(folder, *(((2, 2, 2), (0, 0.5, 1)) if holds else ((1, 1, 1), (1, 2, 2))))
    return folder


def test_pairs_share_seeds_and_trials(tmp_path):
    learned(tmp_path, "deep-pilco-ours", OURS, [5, 30, 30, 30, 30, 30])
    learned(tmp_path, "what-matters/no-guard", VARIANTS["no-guard"].config, [99, 99, 3, 3])
    found = matters.compare("no-guard", tmp_path)
    assert found.first.seeds == found.second.seeds == (0, 1, 2, 3)
    assert found.first.trials == found.second.trials == variants.TRIALS
    assert found.solved.value == 0.5
    assert found.solved_difference.value == pytest.approx(0.25)  # ours solved one by then: later trials do not count
    missed = variants.TRIALS + 1
    assert found.trials_difference.value == pytest.approx(np.mean([missed - 5, 0, 3 - missed, 3 - missed]))
    assert matters.compare("no-dropout", tmp_path) is None
    assert [comparison.name for comparison in matters.comparisons(tmp_path)] == ["no-guard"]
    ids = {result.id: result for result in matters.results(tmp_path)}
    assert ids["what-matters/no-guard/solved-by-20"].ours == 0.5
    assert ids["what-matters/no-guard/solved-by-20/difference"].seeds == [0, 1, 2, 3]


def test_paired_shares():
    yes, no = np.ones(10, bool), np.zeros(10, bool)
    value, low, high, n = matters.share_difference(yes, no)
    assert (value, n) == (1, 10)
    assert 0.5 < low < 1
    assert high == 1
    value, low, high, _ = matters.share_difference(yes, yes)  # a t interval would have no width
    assert low < value == 0 < high
    half = np.arange(10) < 5
    wide, narrow = matters.share_difference(half, ~half), matters.share_difference(half, half)
    assert narrow.high - narrow.low < wide.high - wide.low  # what goes together differs less
    np.testing.assert_allclose(narrow[1:3], (0, 0), atol=1e-9)
    with pytest.raises(ValueError, match="one flag per seed"):
        matters.share_difference(yes, yes[:5])


def test_the_interval_of_paired_shares_covers_the_truth():
    g = np.random.default_rng(101)
    common = g.uniform(size=(500, 20))
    first, second = common < 0.8, 0.7 * common + 0.3 * g.uniform(size=common.shape) < 0.5
    truth = first.mean() - second.mean()
    found = [matters.share_difference(a, b) for a, b in zip(first, second, strict=True)]
    assert 0.92 < np.mean([low <= truth <= high for _, low, high, _ in found]) < 0.99


def test_exponents_are_recovered(tmp_path):
    timed(tmp_path, (1.9, 1.5, 2.2), (0.02, 0.4, 0.8))
    taken = matters.times(tmp_path)
    for axis, pilco_exponent, deep_exponent in zip(
        ("transitions", "inputs", "outputs"), (1.9, 1.5, 2.2), (0.02, 0.4, 0.8), strict=True
    ):
        assert taken.exponents("pilco", axis).mean() == pytest.approx(pilco_exponent, abs=0.02)
        assert taken.exponents("deep-pilco", axis).mean() == pytest.approx(deep_exponent, abs=0.02)
        np.testing.assert_allclose(taken.local_exponents("pilco", axis).mean(0), pilco_exponent, atol=0.05)
    ids = {result.id: result for result in matters.results(tmp_path)}
    found = ids["what-matters/scaling/pilco/transitions"]
    assert found.low < found.ours < found.high
    assert found.ours == pytest.approx(1.9, abs=0.02)


def test_an_overhead_does_not_count_where_it_has_been_outgrown():
    sizes = np.array(SCALING.pilco_sizes[0], float)
    seconds = np.zeros((5, len(SCALING.points())))
    seconds[:, : len(sizes)] = 1 + 1e-3 * sizes**2
    taken = matters.Times(SCALING, seconds + 1e-9, np.zeros_like(seconds))
    assert taken.local_exponents("pilco", "transitions")[0, 0] < 1.7
    assert taken.exponents("pilco", "transitions").mean() == pytest.approx(2, abs=0.05)


def test_numbers_of_the_mechanism(tmp_path):
    looked(tmp_path)
    seen = matters.inside(tmp_path)
    np.testing.assert_allclose(seen.log_std_ratio("held-free", "redrawn-free"), 0.3, atol=1e-5)
    assert (seen.coverage("held-free") > seen.coverage("redrawn-free")).all()
    np.testing.assert_allclose(seen.log_gradient_ratio("off", "full"), np.log(4), rtol=1e-5)
    np.testing.assert_allclose(seen.log_gradient_ratio("off", "full", noise=True), np.log(2), rtol=1e-5)
    np.testing.assert_allclose(seen.bias("full")[:, 0], 0.1 / 5 - 0.1 / 100, atol=1e-5)
    assert seen.behind("fixed-bfgs").mean() == pytest.approx(0.1, abs=1e-3)
    assert seen.optimism("fixed-bfgs").mean() == pytest.approx(0.15, abs=0.02)
    ids = {result.id for result in matters.results(tmp_path)}
    assert {"what-matters/mechanism/held-free/coverage", "what-matters/mechanism/bias/off/5"} <= ids


def test_development_seeds_are_left_out(tmp_path):
    timed(tmp_path, runs=3)
    path = tmp_path / "data_efficiency" / "what-matters" / "scaling" / "000-002.npz"
    record = records.read(path)
    path.unlink()
    records.write(path.with_name("100-102.npz"), record.arrays, record.header | {"seeds": [100, 101, 102]})
    assert matters.times(tmp_path) is None
    assert matters.inside(tmp_path) is None
    assert matters.results(tmp_path) == []


def test_quick_run_is_held_to_its_bands(tmp_path):
    world(tmp_path)
    ours, seen, taken = analysis.load(matters.BASELINE, tmp_path), matters.inside(tmp_path), matters.times(tmp_path)
    matters.check_quick(ours, seen, taken)
    timed(tmp_path / "other", (0, 0, 0))
    with pytest.raises(ValueError, match=r"time grows with exponents -?0\.0\d"):
        matters.check_quick(ours, seen, matters.times(tmp_path / "other"))


def test_pictures_of_variants_show_the_numbers(tmp_path):
    world(tmp_path)
    found = matters.comparisons(tmp_path)
    _, axes = plt.subplots(1, 2, sharey=True)
    figures.forest(list(axes), found)
    ours = costs([5] * RUNS, variants.TRIALS).mean(-1)[:, 1:].mean(0)
    solved = [comparison.first.first_solved.max() for comparison in found]
    theirs = [costs([first], variants.TRIALS).mean(-1)[0, 1:] for first in solved]
    rows = np.arange(len(found))
    np.testing.assert_allclose(dots(axes[0]), np.transpose((-np.isinf(solved).astype(float), rows)))
    dearer = [curve.mean() - ours.mean() for curve in theirs]
    np.testing.assert_allclose(dots(axes[1]), np.transpose((dearer, rows)), atol=1e-3)
    labels = [text.get_text() for text in axes[0].get_yticklabels()]
    assert labels[1] == "no moment matching  (0/10)"
    _, axes = plt.subplots(1, 3)
    figures.curves(list(axes), {"a": found[:2], "b": found[2:4], "c": []})
    assert [ax.get_title() for ax in axes] == ["a", "b", "c"]
    for ax, place in ((axes[0], 0), (axes[1], 2)):
        np.testing.assert_allclose(labelled(ax)["ours"].get_ydata(), ours, atol=1e-3)
        assert [*labelled(ax)][-1] == "ours"
        for line, curve in zip(ax.lines[:2], theirs[place : place + 2], strict=True):
            np.testing.assert_allclose(line.get_ydata(), curve, atol=1e-3)
    plt.close("all")


def test_pictures_of_the_mechanism_show_the_numbers(tmp_path):
    world(tmp_path)
    seen, words = matters.inside(tmp_path), {name: style[0] for name, style in figures.CLOUD_STYLES.items()}
    _, (left, right) = plt.subplots(1, 2)
    figures.clouds([left, right], seen, analysis.load("pilco-paper", tmp_path))
    for name, label in words.items():
        held = 0.3 * ("held" in name)
        np.testing.assert_allclose(labelled(left)[label].get_ydata(), held / np.log(10), atol=0.01)
        share = (np.abs(seen.arrays["true_states"][:, :, 1:]) <= 2 * seen.std(name)).mean((0, 1, 3))
        np.testing.assert_allclose(labelled(right)[label].get_ydata(), share)
    np.testing.assert_allclose(labelled(left)["PILCO"].get_ydata(), np.log10(0.5))
    assert labelled(right)["PILCO"].get_ydata().mean() == pytest.approx(0.683, abs=0.03)
    _, (left, right) = plt.subplots(1, 2)
    figures.parting([left, right], seen)
    depth = {name: seen.arrays["cloud_valley"][:, :, place] for place, name in enumerate(CLOUDS)}
    assert set(labelled(left)) == {words["held-free"], words["held-matched"]}
    for name in ("held-free", "held-matched"):
        parted = (depth[name] >= PARTED).mean((0, 1))
        np.testing.assert_allclose(labelled(left)[words[name]].get_ydata(), parted)
    np.testing.assert_array_equal(right.lines[0].get_xdata(), depth["held-free"].ravel())
    np.testing.assert_array_equal(right.lines[0].get_ydata(), seen.arrays["penalty"].ravel())
    steps = [line.get_ydata()[0] for line in right.lines[1:6]]
    np.testing.assert_allclose(steps, [0.1, 0.3, 0.5, 0.7, 0.9], atol=0.05)
    _, (left, right) = plt.subplots(1, 2)
    figures.gradients([left, right], seen)
    for matching, variance in zip(MATCHING, (1, 2, 4), strict=True):
        label = figures.MATCHING_STYLES[matching][0]
        np.testing.assert_allclose(labelled(left)[label].get_ydata(), np.log10(variance), atol=0.02)
        np.testing.assert_allclose(labelled(right)[label].get_ydata(), np.log10(variance) / 2, atol=0.02)
    _, (left, right) = plt.subplots(1, 2)
    figures.objective(left, seen)
    few, most = np.array(MECHANISM.counts[:-1]), MECHANISM.counts[-1]
    for (label, _), whiskers in zip(figures.MATCHING_STYLES.values(), left.collections, strict=True):
        np.testing.assert_allclose(labelled(left)[label].get_ydata(), 0.1 / few - 0.1 / most, atol=1e-5)
        middle = np.mean([ends[:, 1] for ends in whiskers.get_segments()], axis=1)
        np.testing.assert_allclose(middle, 0.1 / few - 0.1 / most, atol=1e-5)
    figures.optimisers(right, seen)
    assert {label: line.get_marker() for label, line in labelled(right).items()} == {
        "by its own account": "s", "on fresh particles": "o",
    }  # fmt: skip
    np.testing.assert_allclose(dots(right, marker="s"), [(0.5, 0), (0.48, 1), (0.45, 2)], atol=0.02)
    np.testing.assert_allclose(dots(right), [(0.5, 0), (0.55, 1), (0.6, 2)], atol=0.02)
    arrows = [(arrow.xyann[0], arrow.xy[0]) for arrow in right.texts if isinstance(arrow, Annotation)]
    np.testing.assert_allclose(arrows, [(0.5, 0.5), (0.48, 0.55), (0.45, 0.6)], atol=0.02)
    _, axes = plt.subplots(1, 3)
    figures.scaling(list(axes), matters.times(tmp_path))
    for ax, flat in zip(axes, (0, 0.5, 1), strict=True):
        for label, exponent in (("PILCO", 2), ("Deep PILCO", flat)):
            slope = np.polyfit(*np.log(labelled(ax)[label].get_data()), 1)[0]
            assert slope == pytest.approx(exponent, abs=0.02)
        assert {text.get_text() for text in ax.texts} == {"2.0", f"{flat:.1f}"}
    plt.close("all")


def verdicts(folder, *names):
    return [judge([STATEMENTS[name]], folder)[0].verdict for name in names]


INSIDE = ("DE4b", "DE4c", "DE5b", "DE5d", "DE6b", "DE6c")


def test_what_was_seen_inside_decides(tmp_path):
    assert verdicts(world(tmp_path / "1"), *INSIDE, "DE6a") == ["supported"] * 7
    assert verdicts(world(tmp_path / "2", holds=False), *INSIDE) == ["contradicted"] * 6


def test_exponents_are_held_against_what_is_printed(tmp_path):
    assert verdicts(world(tmp_path / "1"), *(f"DE8{x}" for x in "abcdefh")) == [
        "agrees", "agrees", "agrees", "agrees", "differs", "agrees", "agrees",
    ]  # fmt: skip
    assert verdicts(world(tmp_path / "2", holds=False), "DE8a", "DE8d", "DE8f", "DE8h") == ["differs"] * 4


def test_a_sensitive_hyper_parameter_has_a_statement_of_its_own(tmp_path):
    world(tmp_path, changed={"dropout-twice": [99] * RUNS})
    assert verdicts(tmp_path, "DE10a", "DE10b") == ["supported", "contradicted"]


def test_few_repetitions_of_a_primary_statement_are_untested(tmp_path):
    (found,) = judge([STATEMENTS["DE4a"]], world(tmp_path))
    assert (found.verdict, found.why) == ("untested", f"{RUNS} of 40 repetitions")


def test_matching_by_dimension_is_judged_where_records_hold_it(tmp_path):
    for holds, verdict in ((True, "supported"), (False, "contradicted")):
        looked(tmp_path / verdict, holds=holds)
        assert [judge([STATEMENTS[name]], tmp_path / verdict)[0].verdict for name in ("DE4e", "DE6d")] == [verdict] * 2
    looked(tmp_path / "old", old=True)
    assert [judge([STATEMENTS[name]], tmp_path / "old")[0].verdict for name in ("DE4e", "DE6d")] == ["untested"] * 2


def test_published_variants_are_what_the_page_was_written_for():
    (raw,) = (found for found in matters.comparisons() if found.name == "raw-inputs")
    solved = [(learning.first_solved <= 20).sum() for learning in (raw.first, raw.second)]
    assert solved == [1, 10]
