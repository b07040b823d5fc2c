"""States by number: the same as the one-hot vectors that they stand for."""

import pytest
import torch

from dropout_uncertainty.bayes import draw_masks
from dropout_uncertainty.exploration.deep_sea.network import CellNetwork
from dropout_uncertainty.exploration.q_network import QNetwork

SIZES, SEEDS, SCALE = (6, 5, 4, 2), (100, 101), 2.5


@pytest.fixture
def networks():
    by_number = CellNetwork(SIZES, SEEDS, scale=SCALE, dtype=torch.float64)
    by_vector = QNetwork(SIZES, SEEDS, dtype=torch.float64)
    return by_number, by_vector


def parameters(networks):
    by_number, by_vector = networks
    used = by_vector.parameters.shape[1]
    assert (by_number.parameters[:, used:] == 0).all()
    return by_number.parameters[:, :used], by_vector.parameters


def test_a_learning_step_is_that_of_one_hot_vectors(networks):
    numbers = torch.Generator().manual_seed(100)
    cells = torch.randint(6, (2, 7), generator=numbers)
    cells[:, 1] = cells[:, 0]  # gradients of one cell add up
    taken = torch.eye(2, dtype=torch.float64)[torch.randint(2, (2, 3), generator=numbers)]
    reward, discount = torch.rand(2, 2, 3, generator=numbers, dtype=torch.float64)
    prior = torch.rand(2, 7, 2, generator=numbers, dtype=torch.float64)
    masks = draw_masks(SEEDS, SIZES[:-1], (0.0, 0.3, 0.2), 7, "test", weight=prior)
    vectors = SCALE * torch.eye(6, dtype=torch.float64)[cells]
    torch.testing.assert_close(*parameters(networks), rtol=0, atol=0)
    for _ in range(3):
        options = {"discount": discount, "rate": 0.1, "decay": 0.01, "prior": prior}
        found = networks[0].learn(cells, taken, reward, masks, **options)
        expected = networks[1].learn(vectors, taken, reward, masks, **options)
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-13)
        torch.testing.assert_close(*parameters(networks), rtol=0, atol=1e-13)


def test_the_last_move_of_an_episode_has_no_future_and_the_prior_counts_in_both_places(networks):
    cells = torch.tensor([[0, 1], [2, 3]])
    prior = torch.tensor([[[1.0, 2.0], [3.0, 5.0]], [[0.0, 4.0], [2.0, 1.0]]], dtype=torch.float64)
    taken = torch.tensor([[[0.0, 1.0]], [[1.0, 0.0]]], dtype=torch.float64)
    q = networks[0].forward(cells)[-1].clone() + prior
    discount = torch.tensor([[0.9], [0.0]], dtype=torch.float64)
    _, error = networks[0].learn(
        cells, taken, torch.ones(2, 1, dtype=torch.float64), None, discount=discount, rate=0.1, decay=0.0, prior=prior
    )
    expected = torch.stack((q[0, 0, 1] - 1 - 0.9 * q[0, 1].max(), q[1, 0, 0] - 1))
    torch.testing.assert_close(error[:, 0], expected)
