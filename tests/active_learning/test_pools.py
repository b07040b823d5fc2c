import numpy as np
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


@pytest.mark.parametrize(
    "kind", [list, np.array, np.int32, np.uint8, torch.tensor, range, lambda x: torch.tensor(x, dtype=torch.int16)]
)
def test_indices_come_as_anything(kind):
    given = (lambda x: range(x[0], x[-1] + 1)) if kind is range else kind
    pool = Pool(given([0, 1]), given([2, 3, 4, 5]))
    pool.acquire(given([3, 4]))
    assert pool.labelled.tolist() == [0, 1, 3, 4]
    assert pool.labelled.dtype == torch.int64
    assert pool.candidates(rng.generator(100)).tolist() == [2, 5]


def test_masks_over_the_data_set_are_indices():
    mask = np.array([True, False, True, False])
    pool = Pool(mask, ~mask)
    assert (pool.labelled.tolist(), pool.all.tolist()) == ([0, 2], [1, 3])
    assert len(Pool([], [1]).labelled) == len(Pool(torch.tensor([]), [1]).labelled) == 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([-1], "count from 0, got -1"),
        ([0.0], "a row of indices or a mask, got a list"),
        (np.array([[1]]), r"got int64 of shape \[1, 1\]"),
        (["a"], "real numbers in one array"),
        ([1, 1], "repeat a point"),
    ],
)
def test_what_is_no_index_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Pool([0], given)


def test_labels_that_are_no_class_numbers_are_refused():
    assert balanced_subset(np.array([1, 0, 1, 0], dtype=np.int8), 1).tolist() == [0, 1]
    assert balanced_subset([True, False, True], 1).tolist() == [0, 1]
    for labels in (["a", "b"], [0.0, 1.0], [-1, 0, 1], np.eye(2)):
        with pytest.raises(ValueError, match="simulate` takes labels of any type"):
            balanced_subset(labels, 1)
    with pytest.raises(ValueError, match="at least 1, got 0"):
        balanced_subset([0, 1], 0)
    with pytest.raises(ValueError, match="at least 1, got -1"):
        Pool([0], [1, 2]).candidates(rng.generator(100), -1)
    with pytest.raises(ValueError, match="do not fit"):
        split(LABELS, rng.generator(100), source=300, validation=-5, pool=1000)


def test_masks_over_data_sets_of_two_sizes_are_refused():
    first = np.arange(5) < 2
    assert Pool(first, ~first).all.tolist() == [2, 3, 4]
    with pytest.raises(ValueError, match="two masks over one data set, got 5 and 4 points"):
        Pool(first, ~first[:4])
