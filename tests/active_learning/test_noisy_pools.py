"""What each kind of pool shows, that it is a function of the seed, and that the test set stays clean."""

import dataclasses

import pytest
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning import pools
from dropout_uncertainty.active_learning.noisy_pools import KINDS, NO_LABEL, make_task


@pytest.fixture
def make(digits):
    split = pools.split(digits.train_labels, rng.generator(100, "data"), validation=100, pool=1000, source=400)

    def make(kind, seed=100, **options):
        return make_task(kind, digits, split, seed, **options)

    return make


def test_a_clean_task_is_the_data_itself(make, digits):
    task = make("clean")
    assert task.data is digits
    assert not task.wasted(task.split.pool).any()


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_ambiguous_images_are_even_blends_with_a_fair_label(make, digits, share):
    task = make("ambiguous", ambiguous=share)
    pool, blended = task.split.pool, task.noise.nonzero().flatten()
    assert len(blended) == round(share * 1000)
    assert torch.isin(blended, pool).all()
    one, two = digits.train_labels[blended], digits.train_labels[task.partner[blended]]
    assert (one != two).all()
    half = (digits.train_images[blended] + digits.train_images[task.partner[blended]]) / 2
    torch.testing.assert_close(task.data.train_images[blended], half)
    labels = task.data.train_labels[blended]
    assert ((labels == one) | (labels == two)).all()
    heads = int((labels == one).sum())
    assert abs(heads - len(blended) / 2) < 4.5 * (len(blended) / 4) ** 0.5
    others = ~task.noise
    assert torch.equal(task.data.train_images[others], digits.train_images[others])
    assert torch.equal(task.data.train_labels[others], digits.train_labels[others])
    assert task.wasted(pool).float().mean() == pytest.approx(share)


def test_repeated_images_stand_four_times_in_the_pool_each_with_noise_of_its_own(make, digits):
    task = make("repeated")
    pool = task.split.pool
    assert task.origin[pool].unique(return_counts=True)[1].tolist() == [4] * 250
    noise = task.data.train_images[pool] - digits.train_images[task.origin[pool]]
    assert noise.std() == pytest.approx(0.1, rel=0.01)
    assert torch.unique(noise[:, 0, 0]).numel() > 990
    assert torch.equal(task.data.train_labels[pool], digits.train_labels[task.origin[pool]])
    assert torch.equal(task.data.train_images[task.split.initial], digits.train_images[task.split.initial])
    # In the order of the pool each image comes once, and then again three times.
    assert task.wasted(pool).tolist() == [False] * 250 + [True] * 750


def test_irrelevant_images_have_no_label_and_are_not_tested(make, digits):
    task = make("irrelevant")
    assert torch.equal(task.data.train_labels == NO_LABEL, digits.train_labels >= 5)
    assert task.data.test_labels.max() == 4
    assert len(task.data.test_labels) == int((digits.test_labels < 5).sum())
    assert task.data.train_labels[task.split.initial].tolist() != []
    assert (task.data.train_labels[task.split.initial] != NO_LABEL).all()
    assert torch.equal(task.wasted(task.split.pool), digits.train_labels[task.split.pool] >= 5)


@pytest.mark.parametrize("kind", KINDS)
def test_a_task_is_a_function_of_the_seed_and_leaves_the_data_alone(make, digits, kind):
    before = digits.train_images.clone()
    first, again, other = make(kind), make(kind), make(kind, seed=101)
    for field in dataclasses.fields(first.data):
        assert torch.equal(getattr(first.data, field.name), getattr(again.data, field.name))
    changed = not torch.equal(first.data.train_images, other.data.train_images)
    assert changed == (kind in ("ambiguous", "repeated"))
    assert torch.equal(before, digits.train_images)
    if kind != "irrelevant":
        assert first.data.test_images is digits.test_images


def test_an_unknown_kind_is_refused(make):
    with pytest.raises(ValueError, match="unknown kind of pool 'dirty', choose one of clean, ambiguous"):
        make("dirty")
