import pytest
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning.pools import Pool, balanced_subset, split

LABELS = torch.arange(2000) % 10


def test_a_split_is_balanced_and_disjoint():
    parts = split(LABELS, rng.generator(100), source=300, validation=200, pool=1000)
    assert LABELS[parts.initial].bincount().tolist() == [2] * 10
    assert [len(parts.initial), len(parts.validation), len(parts.pool)] == [20, 200, 1000]
    every = torch.cat([parts.initial, parts.validation, parts.pool])
    assert len(every.unique()) == len(every)


def test_as_the_text_says_all_the_rest_is_pool():
    parts = split(LABELS, rng.generator(100), source=300, validation=200, pool=None)
    assert len(parts.pool) == 2000 - 200 - 20
    same_start = split(LABELS, rng.generator(100), source=300, validation=200, pool=1000)
    assert torch.equal(parts.initial, same_start.initial)


def test_impossible_splits_are_refused():
    with pytest.raises(ValueError, match="do not fit"):
        split(LABELS, rng.generator(100), source=300, validation=800, pool=1000)
    with pytest.raises(ValueError, match="2 points of class 3, found 0"):
        balanced_subset(torch.tensor([0, 0, 1, 1, 2, 2, 4, 4]), 2)


@pytest.fixture
def pool():
    return Pool(torch.tensor([0, 1]), torch.arange(10, 30))


def test_no_point_is_handed_out_twice(pool):
    for step in range(4):
        chosen = pool.candidates(rng.generator(100, step), 5)
        pool.acquire(chosen)
    assert len(pool.labelled.unique()) == 22
    assert len(pool.candidates(rng.generator(100))) == 0
    with pytest.raises(ValueError, match="twice, or one that is not in the pool"):
        pool.acquire(torch.tensor([10]))


def test_acquired_points_stay_with_replacement(pool):
    pool.acquire(torch.tensor([10, 11]), keep=True)
    pool.acquire(torch.tensor([10]), keep=True)
    assert pool.labelled.tolist() == [0, 1, 10, 11, 10]
    assert len(pool.candidates(rng.generator(100))) == 20


def test_a_subset_larger_than_the_pool_is_the_pool(pool):
    assert len(pool.candidates(rng.generator(100), 500)) == 20


def test_points_outside_the_pool_are_refused(pool):
    with pytest.raises(ValueError, match="not in the pool"):
        pool.acquire(torch.tensor([5]))
    with pytest.raises(ValueError, match="disjoint"):
        Pool(torch.tensor([1]), torch.tensor([1, 2]))
