"""BatchBALD against the mutual information summed over all joint labels, and the draws of power-BALD."""

import itertools
import math

import pytest
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning.acquisition import score, select
from dropout_uncertainty.active_learning.batch_acquisition import BATCH_ACQUISITIONS, batch_bald, power_bald


@pytest.fixture
def draws():
    logits = 3 * torch.randn(8, 6, 3, generator=rng.generator(100), dtype=torch.float64)
    return logits.log_softmax(-1)


def information(log_probs, batch):
    """I(y of the batch; ω), outcome by outcome in plain Python."""
    probs = log_probs.exp().tolist()
    joint = conditional = 0.0
    for outcome in itertools.product(range(len(probs[0][0])), repeat=len(batch)):
        each = [math.prod(draw[point][y] for point, y in zip(batch, outcome, strict=True)) for draw in probs]
        mean = sum(each) / len(each)
        joint -= mean * math.log(mean)
        conditional -= sum(p * math.log(p) for p in each) / len(each)
    return joint - conditional


def greedy(log_probs, count):
    batch = []
    for _ in range(count):
        left = [point for point in range(log_probs.shape[1]) if point not in batch]
        batch.append(max(left, key=lambda point: information(log_probs, [*batch, point])))
    return batch


def test_batch_bald_builds_the_batch_of_the_enumerated_information(draws):
    assert batch_bald(draws, 4, rng.generator(100)).positions.tolist() == greedy(draws, 4)


def test_sampled_outcomes_choose_as_the_exact_ones_do(draws):
    # The same distribution of draws; one outcome is sampled from each as soon as there are more than two.
    many = draws.repeat(500, 1, 1)
    assert batch_bald(many, 4, rng.generator(100), outcomes=2).positions.tolist() == greedy(draws, 4)


def test_a_copy_of_the_best_image_is_left_to_other_images():
    sure, unsure = [0.99, 0.01], [0.7, 0.3]
    log_probs = torch.tensor([[sure, sure, unsure], [sure[::-1], sure[::-1], unsure], [sure, sure, unsure[::-1]],
                              [sure[::-1], sure[::-1], unsure[::-1]]], dtype=torch.float64).log()  # fmt: skip
    highest = score("bald", log_probs).topk(2).indices
    assert sorted(highest.tolist()) == [0, 1]
    assert 2 in batch_bald(log_probs, 2, rng.generator(100)).positions.tolist()


def test_power_bald_draws_in_proportion_to_the_scores(draws):
    shares = score("bald", draws) / score("bald", draws).sum()
    first = torch.tensor([int(power_bald(draws, 2, rng.generator(seed)).positions[0]) for seed in range(100, 2100)])
    counts = first.bincount(minlength=6) / 2000
    assert ((counts - shares).abs() < 4.5 * (shares * (1 - shares) / 2000).sqrt()).all()


@pytest.mark.parametrize("name", BATCH_ACQUISITIONS)
def test_a_batch_is_of_different_points_and_a_function_of_the_generator(name, draws):
    choose = BATCH_ACQUISITIONS[name]
    batch = choose(draws, 5, rng.generator(100)).positions
    assert len(batch.unique()) == 5
    assert torch.equal(batch, choose(draws, 5, rng.generator(100)).positions)
    assert len(choose(draws, 9, rng.generator(100)).positions) == 6


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_batch_bald_counts_ties_as_scores_do(draws):
    copies = draws[:, :1].expand(-1, 6, -1)
    batch, single = batch_bald(copies, 2, rng.generator(100)), select(score("bald", copies), 2, rng.generator(100))
    assert (single.tied, single.all_tied, batch.all_tied) == (6, True, True)
    assert batch.tied == 5  # of those left by the second
    assert not batch_bald(draws, 3, rng.generator(100)).all_tied


def test_a_batch_of_hundreds_does_not_underflow():
    log_probs = (10 * torch.ones(10) + 0.1 * torch.randn(20, 400, 10, generator=rng.generator(100))).log_softmax(-1)
    assert len(batch_bald(log_probs, 400, rng.generator(100), outcomes=100).positions.unique()) == 400


@pytest.mark.parametrize("name", BATCH_ACQUISITIONS)
def test_batches_refuse_what_single_scores_refuse(name, draws):
    with pytest.raises(ValueError, match="sum to 1"):
        BATCH_ACQUISITIONS[name](draws + 1, 2, rng.generator(100))
    with pytest.raises(ValueError, match="the count of points to choose"):
        BATCH_ACQUISITIONS[name](draws, 0, rng.generator(100))


@pytest.mark.parametrize("name", BATCH_ACQUISITIONS)
@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_points_that_say_nothing_are_taken_in_random_order(name):
    nothing = torch.full((4, 20, 5), 0.2).log()
    first = {int(BATCH_ACQUISITIONS[name](nothing, 1, rng.generator(seed)).positions) for seed in range(100, 140)}
    assert len(first) > 10
