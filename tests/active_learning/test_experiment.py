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


def test_a_tiny_network_learns_twenty_images(digits):
    learner = CNNLearner(replace(TINY, epochs=60, decay=0.1), (100,), data=digits)
    labelled = torch.arange(20)[None]
    learner.fit(labelled)
    predicted = learner.log_probs(labelled, 0)[0, 0].argmax(-1)
    assert (predicted == digits.train_labels[:20]).float().mean() >= 0.95
    assert learner.test_error()[0] < 75


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


@pytest.mark.parametrize("change", [{"acquisition": "entropy"}, {"approximation": "mc"}, {"epochs": 0}, {"subset": 0}])
def test_impossible_settings_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change)).replace("approximation", "approximation|acquisition")):
        replace(TINY, **change)
