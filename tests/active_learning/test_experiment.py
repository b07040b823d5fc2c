"""The experiment: replicas side by side, resuming, and the configs."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dropout_uncertainty.active_learning import experiment
from dropout_uncertainty.active_learning.experiment import CONFIGS, CNNLearner, Config

TINY = replace(CONFIGS["ours/dropout/bald"], epochs=2, draws=5, subset=60, rounds=2, acquired=3)


def finish(process):
    while process.done < process.total:
        process.advance()
    return process.result()


@pytest.fixture(scope="module")
def small_test_set(mnist_small):
    return mnist_small


@pytest.mark.parametrize("masks_per_image", [False, True])
def test_a_replica_alone_equals_itself_among_others(masks_per_image):
    config = replace(TINY, masks_per_image=masks_per_image, drop=(0.25, 0.5))
    labelled = torch.arange(60).view(2, 30)
    together = CNNLearner(config, (101, 102), precision="float64")
    together.fit(labelled)
    alone = CNNLearner(config, (102,), precision="float64")
    alone.fit(labelled[1:])
    candidates = torch.arange(100, 120)[None]
    both = together.log_probs(candidates.expand(2, -1), 3)
    one = alone.log_probs(candidates, 3)
    torch.testing.assert_close(both[1], one[0], rtol=1e-4, atol=1e-5)
    assert not torch.allclose(both[0], one[0], atol=1e-2)


def test_resumed_equals_uninterrupted():
    whole = experiment.start(TINY, (103,), precision="float32")
    arrays = finish(whole)
    first = experiment.start(TINY, (103,), precision="float32")
    first.advance()
    second = experiment.start(TINY, (103,), precision="float32")
    second.restore(first.state())
    resumed = finish(second)
    assert arrays.keys() == resumed.keys()
    for name in arrays:
        np.testing.assert_array_equal(arrays[name], resumed[name], err_msg=name)
    assert arrays["points"].shape == (1, 26)
    assert len(set(arrays["points"][0])) == 26
