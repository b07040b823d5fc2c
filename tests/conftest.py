"""Shared by all tests: one thread, and nobody touches the global random state."""

import numpy as np
import pytest
import torch

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def global_random_state_untouched():
    """Every number drawn in this project comes from a generator made for it."""
    before = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002 - it is guarded, not used
    yield
    assert torch.equal(before[0], torch.get_rng_state()), "the test moved torch's global random state"
    assert np.array_equal(before[1], np.random.get_state()[1]), "the test moved NumPy's global random state"  # noqa: NPY002


@pytest.fixture(scope="session")
def digits():
    """Return the first 2,000 training and 500 test images of MNIST."""
    from dropout_uncertainty.active_learning import mnist  # late, so that its shapes are checked

    whole = mnist.load()
    return mnist.Mnist(
        whole.train_images[:2000], whole.train_labels[:2000], whole.test_images[:500], whole.test_labels[:500]
    )
