"""The experiment: replicas side by side, resuming, pool edges and the configs."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning.experiment import CONFIGS, ROWS, ActiveLearning, CNNLearner, Config, units
from dropout_uncertainty.active_learning.loop import acquire
from dropout_uncertainty.active_learning.pools import Pool

TINY = replace(
    CONFIGS["ours/dropout/bald"], epochs=2, draws=5, subset=60, rounds=3, acquired=3, validation=100, pool=500
)


@pytest.fixture
def process(digits, monkeypatch):
    """Make small processes; the source of the initial points is cut to fit 2,000 images."""
    from dropout_uncertainty.active_learning import experiment, pools

    monkeypatch.setattr(experiment, "split", lambda *a, **k: pools.split(*a, **k, source=400))

    def make(config=TINY, seeds=(100,), precision="float32"):
        return ActiveLearning(config, seeds, device="cpu", precision=precision, data=digits)

    return make


def finish(process):
    while process.done < process.total:
        process.advance()
    return process.result()


@pytest.mark.parametrize("masks_per_image", [False, True])
def test_a_replica_alone_equals_itself_among_others(digits, masks_per_image):
    config, labelled = replace(TINY, masks_per_image=masks_per_image), torch.arange(60).view(2, 30)
    together = CNNLearner(config, (101, 102), precision="float64", data=digits)
    together.fit(labelled)
    alone = CNNLearner(config, (102,), precision="float64", data=digits)
    alone.fit(labelled[1:])
    candidates = torch.arange(100, 120)[None]
    both, one = together.log_probs(candidates.expand(2, -1), 3), alone.log_probs(candidates, 3)
    torch.testing.assert_close(both[1], one[0], rtol=1e-9, atol=1e-9)
    assert not torch.allclose(both[0], one[0], atol=1e-2)


def test_a_run_is_repeatable_and_replicas_stack(process):
    both, one = (
        finish(process(seeds=(100, 101), precision="float64")),
        finish(process(seeds=(101,), precision="float64")),
    )
    assert both["labels"].tolist() == [20, 23, 26, 29]
    assert both["points"].shape == (2, 29)
    np.testing.assert_array_equal(both["points"][1:], one["points"])
    np.testing.assert_allclose(both["error"][1:], one["error"])


@pytest.mark.parametrize("row", ["dropout/bald", "random", "softmax/bald"])
def test_resumed_equals_uninterrupted(process, row):
    approximation, acquisition = ROWS[row]
    config = replace(TINY, approximation=approximation, acquisition=acquisition, mc_test_every=2)
    whole = finish(process(config))
    first = process(config)
    first.advance()
    first.advance()
    second = process(config)
    second.restore(first.state())
    assert second.done == 2
    resumed = finish(second)
    for name, array in whole.items():
        np.testing.assert_array_equal(array, resumed[name], err_msg=name)
    assert len(set(whole["points"][0])) == 29
    assert whole["all_tied"].all() == (row != "dropout/bald")
    assert np.isfinite(whole["mc_error"][0]).tolist() == [True, False, True, False]


@pytest.mark.parametrize(
    ("change", "labels", "warning"),
    [
        ({"subset": 2}, [20, 22, 24, 26], "the subset has 2 candidates, asked for 3"),
        ({"subset": 2, "acquisition": "random"}, [20, 23, 26, 29], None),
        ({"random_from": 5, "acquisition": "random"}, [20, 23, 25], "only 2 points are left in the pool, asked for 3"),
        ({"random_from": 2, "replacement": True, "acquisition": "random"}, [20, 22, 24, 26], "only 2 points are left"),
    ],
)
@pytest.mark.filterwarnings("always")
def test_a_record_counts_what_was_labelled(process, change, labels, warning, recwarn):
    config = replace(TINY, **change)
    whole = finish(process(config))
    assert whole["labels"].tolist() == labels
    assert whole["points"].shape == (1, labels[-1])
    assert whole["error"].shape == (1, len(labels))
    assert (warning is None) == (not recwarn)
    assert all(str(given.message).startswith(warning) for given in recwarn)
    for done in {1, len(labels) - 1}:
        first, second = process(config), process(config)
        for _ in range(done):
            first.advance()
            assert len(first.pools[0].labelled) == labels[min(first.done, len(labels) - 1)]
        second.restore(first.state())
        for name, array in finish(second).items():
            np.testing.assert_array_equal(array, whole[name], err_msg=name)


def test_three_classes_are_counted_as_three(process, digits):
    few = digits.train_labels < 3
    data = replace(digits, train_images=digits.train_images[few], train_labels=digits.train_labels[few])
    first, second = (
        ActiveLearning(replace(TINY, pool=90), (100,), device="cpu", precision="float32", data=data) for _ in range(2)
    )
    first.advance()
    second.restore(first.state())
    resumed = finish(second)
    assert resumed["labels"].tolist() == [6, 9, 12, 15]
    np.testing.assert_array_equal(resumed["points"], finish(first)["points"])


def test_a_learner_is_given_the_pool_of_its_config_and_points_of_each_replica(digits):
    with pytest.raises(ValueError, match="pool of this config is ambiguous, not MNIST as it is: give the data"):
        CNNLearner(CONFIGS["pools/ambiguous/dropout/bald"], (100,))
    with pytest.raises(ValueError, match="of 2 replicas, got 1"):
        CNNLearner(TINY, (100, 101), data=digits).fit(torch.arange(20)[None])


def test_a_tiny_network_learns_twenty_images(digits):
    learner = CNNLearner(replace(TINY, epochs=60, decay=0.1), (100,), data=digits)
    labelled = torch.arange(20)[None]
    learner.fit(labelled)
    predicted = learner.log_probs(labelled, 0)[0, 0].argmax(-1)
    assert (predicted == digits.train_labels[:20]).float().mean() >= 0.95
    assert learner.test_error()[0] < 75
    learner.config = replace(learner.config, tested=100)
    wrong = learner.test_error()[0]
    cut = replace(digits, test_images=digits.test_images[:100], test_labels=digits.test_labels[:100])
    learner.config, learner.data = replace(learner.config, tested=None), [cut]
    assert learner.test_error()[0] == wrong


def test_an_emptying_pool_is_taken_whole_and_then_refused(digits):
    learner = CNNLearner(TINY, (100,), data=digits)
    learner.fit(torch.arange(20)[None])
    pools = Pool(torch.arange(20), torch.arange(20, 24))
    options = {"draws": 0, "generators": [rng.generator(100)]}
    with pytest.warns(UserWarning, match="only 4 points are left"):
        acquire(learner, [pools], "max-entropy", 10, **options)
    assert len(pools.labelled) == 24
    with pytest.raises(ValueError, match="the pool is empty"):
        acquire(learner, [pools], "max-entropy", 10, **options)


def test_a_diverged_network_never_chooses(digits):
    class Diverged:
        def fit(self, labelled): ...

        def log_probs(self, candidates, draws):
            return torch.full((1, 1, candidates.shape[1], 10), torch.nan)

    with pytest.raises(ValueError, match="has the training diverged"):
        acquire(
            Diverged(), [Pool(torch.arange(2), torch.arange(2, 9))], "bald", 2, draws=0, generators=[rng.generator(1)]
        )


def test_the_configs_say_what_they_follow():
    assert CONFIGS["as-recorded/random"].kernel == 3
    assert CONFIGS["as-recorded/random"].replacement
    assert CONFIGS["as-recorded/softmax/max-entropy"].subset is None
    assert CONFIGS["as-recorded/dropout/bald"].kernel == 4
    written, ours = CONFIGS["as-written/dropout/bald"], CONFIGS["ours/dropout/bald"]
    changed = {f.name for f in dataclasses.fields(Config) if getattr(written, f.name) != getattr(ours, f.name)}
    assert changed == {"pool", "subset", "rounds"}
    assert [unit.label for unit in units("ours/random", [0, 1])] == [
        "active_learning/ours/random/000", "active_learning/ours/random/001",
    ]  # fmt: skip
    assert len(units("ours/random", [0, 1], device="cuda")) == 1


def test_early_runs_are_the_beginning_of_those_of_ours(process):
    for name in ("random", "dropout/variation-ratios"):
        ours, early = CONFIGS[f"ours/{name}"], CONFIGS[f"early/{name}"]
        assert replace(early, rounds=ours.rounds, mc_test_every=ours.mc_test_every) == ours
        assert early.rounds * early.acquired == 400
        small = replace(TINY, acquisition=ours.acquisition, mc_test_every=ours.mc_test_every and 1)
        whole = finish(process(small))
        begun = finish(process(replace(small, rounds=2, mc_test_every=0)))
        np.testing.assert_array_equal(begun["error"], whole["error"][:, :3])
        np.testing.assert_array_equal(begun["points"], whole["points"][:, : begun["points"].shape[1]])


@pytest.mark.parametrize("change", [{"acquisition": "entropy"}, {"approximation": "mc"}, {"epochs": 0}, {"subset": 0}])
def test_impossible_settings_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change)).replace("approximation", "approximation|acquisition")):
        replace(TINY, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"members": 3}, "members does nothing here: no ensemble scores the pool; leave it at 5, got 3"),
        ({"ambiguous": 0.1}, "ambiguous does nothing here: the pool is clean; leave it at 0.5, got 0.1"),
        ({"random_from": 30}, "random_from does nothing here: acquisition is not random; leave it at None, got 30"),
        ({"replacement": True}, "replacement does nothing here: acquisition is not random; leave it at False"),
        ({"drop": (0.0, 0.0)}, "no weight draws without dropout: choose the approximation softmax"),
    ],
)
def test_settings_that_do_nothing_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(TINY, acquisition="bald", **change)
    elsewhere = {"members": "approximation", "ambiguous": "pool_kind"}.get(next(iter(change)), "acquisition")
    use = {"approximation": "ensemble", "pool_kind": "ambiguous", "acquisition": "random"}[elsewhere]
    replace(TINY, **{"acquisition": "bald", elsewhere: use}, **change)


@pytest.mark.parametrize("row", ["ambiguous/ensemble/bald", "repeated/dropout/batch-bald", "irrelevant/dropout/bald"])
def test_runs_on_noisy_pools_resume(process, row):
    changes = {"epochs": 2, "draws": 5, "subset": 60, "rounds": 2, "acquired": 4, "pool": 500, "validation": 100}
    config = replace(CONFIGS[f"pools/{row}"], **changes, **({"members": 2} if "ensemble" in row else {}))
    whole = finish(process(config))
    first = process(config)
    first.advance()
    second = process(config)
    second.restore(first.state())
    resumed = finish(second)
    for name, array in whole.items():
        np.testing.assert_array_equal(array, resumed[name], err_msg=name)
    assert whole["labels"].tolist() == [20, 24, 28]
    assert whole["wasted"].shape == (1, 2)


def test_an_ensemble_is_tested_by_the_network_that_a_single_run_trains(process):
    rows = [
        finish(process(replace(TINY, approximation=a, acquisition="bald", rounds=1))) for a in ("ensemble", "dropout")
    ]
    assert rows[0]["error"][0, 0] == rows[1]["error"][0, 0]
    assert rows[0]["points"].tolist() != rows[1]["points"].tolist()
    assert not rows[0]["all_tied"].any()  # its members differ


def test_irrelevant_points_teach_nothing(process):
    config = replace(CONFIGS["pools/irrelevant/random"], epochs=2, pool=500, validation=100)
    learner = process(config).learner
    labels = learner.labels[0]
    relevant, irrelevant = (labels >= 0).nonzero().flatten()[:30], (labels < 0).nonzero().flatten()[:10]
    learner.fit(relevant[None])
    alone = learner.log_probs(relevant[None], 0)
    learner.round = -1
    learner.fit(torch.cat([relevant, irrelevant])[None])
    assert torch.equal(learner.log_probs(relevant[None], 0), alone)


@pytest.mark.parametrize("size", range(20, 321, 10))
def test_even_minibatches_leave_no_remainder(digits, size):
    learner = CNNLearner(replace(CONFIGS["pools/clean/random"], epochs=1), (100,), data=digits)
    parts = list(learner._minibatches(size))
    sizes = [part.shape[1] for part in parts]
    assert max(sizes) - min(sizes) <= 1
    assert max(sizes) <= 128
    assert torch.cat(parts, 1).sort().values.tolist() == [list(range(size))]


def test_networks_of_one_seed_differ_by_their_path_in_all_their_draws(digits):
    drawn = {}
    for path in ((), ("member", 1)):
        learner = CNNLearner(TINY, (101,), *path, precision="float64", data=digits)
        learner.fit(torch.arange(30)[None])
        asked, draw = drawn.setdefault(path, []), learner.network.draw
        learner.network.draw = lambda *args, asked=asked, draw=draw: asked.append(draw(*args)) or asked[-1]
        learner.log_probs(torch.arange(100, 110)[None], 1)
    (one,), (other,) = drawn.values()
    assert not torch.equal(one[1], other[1])


def test_batch_bald_with_masks_for_each_image_is_refused():
    with pytest.raises(ValueError, match="set masks_per_image=False"):
        replace(TINY, acquisition="batch-bald", masks_per_image=True)


def test_a_network_with_masks_for_each_image_says_so(digits):
    learner = CNNLearner(replace(TINY, masks_per_image=True), (100,), data=digits)
    with pytest.raises(ValueError, match="draws anew for each"):
        acquire(learner, [Pool([0], range(1, 90))], "batch-bald", 5, draws=3, generators=[rng.generator(100)])
