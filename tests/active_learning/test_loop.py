"""What a learner returns is held to the candidates, comes in bounded parts, and does not depend on them."""

import pytest
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning import loop
from dropout_uncertainty.active_learning.loop import acquire
from dropout_uncertainty.active_learning.pools import Pool


class Table:
    """A learner whose predictions stand in a table [S, N, C]."""

    def __init__(self, draws=7, points=90, classes=4, change=lambda x: x):
        logits = torch.randn(draws, points, classes, generator=rng.generator(100), dtype=torch.float64)
        self.table, self.change, self.asked = logits.log_softmax(-1), change, []

    def fit(self, labelled): ...

    def log_probs(self, candidates, draws):
        self.asked.append(candidates.shape[1] * draws * self.table.shape[2])
        return self.change(self.table[:draws, candidates].transpose(0, 1))


def chosen(learner, acquisition="bald", **options):
    pool = Pool([0], range(1, 90))
    options = {"draws": 7, "generators": [rng.generator(100)]} | options
    acquire(learner, [pool], acquisition, 5, **options)
    return pool.labelled.tolist()


@pytest.mark.parametrize("acquisition", ["bald", "max-entropy", "batch-bald"])
@pytest.mark.parametrize("known", [None, 4])
def test_parts_are_bounded_and_make_no_difference(acquisition, known, monkeypatch):
    whole, parts = Table(), Table()
    whole.classes = 4
    expected = chosen(whole, acquisition)
    assert whole.asked == [89 * 7 * 4]
    parts.classes = known
    monkeypatch.setattr(loop, "VALUES", 300)
    assert chosen(parts, acquisition) == expected
    assert max(parts.asked) == 10 * 7 * 4
    assert sum(parts.asked) == sum(whole.asked)


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_a_thousand_classes_keep_the_bound():
    learner = Table(20, 1, 1000)
    learner.table = learner.table.expand(-1, 4_001, -1)
    acquire(learner, [Pool([0], range(1, 4_001))], "bald", 5, draws=20, generators=[rng.generator(100)])
    assert max(learner.asked) == loop.VALUES
    assert sum(learner.asked) == 4_000 * 20 * 1000


@pytest.mark.parametrize(
    "change", [lambda x: x.numpy(), lambda x: x.tolist(), lambda x: x.float(), lambda x: x.clone().requires_grad_()]
)
def test_a_learner_may_return_any_kind_of_numbers(change):
    assert chosen(Table(change=change)) == chosen(Table())


@pytest.mark.parametrize("acquisition", ["bald", "power-bald"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda x: x.transpose(1, 2), r"\[R, S, M, C\] = \[1, 7, 2, classes\] for 2 candidates, got \[1, 2, 7, 4\]"),
        (lambda x: x[0], r"got \[7, 2, 4\]"),
        (lambda x: x[:, :, :1], r"for 2 candidates, got \[1, 7, 1, 4\]"),
        (lambda x: x.exp(), "sum to 1 over the classes, got sums from"),
        (lambda x: x - 1, "a regression has no classes"),
        (lambda x: x * torch.nan, "has the training diverged"),
        (lambda x: "nothing", "expected log-probabilities"),
    ],
)
def test_what_is_no_prediction_of_the_candidates_is_refused(change, message, acquisition):
    with pytest.raises(ValueError, match=message):
        chosen(Table(change=change), acquisition)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"draws": -1}, "weight draws is a whole number of at least 0, got -1"),
        ({"subset": 0}, "subset is a whole number of at least 1, got 0"),
        ({"generators": []}, "one pool and one generator for each replica"),
        ({"acquisition": "entropy"}, "function 'entropy', choose one of random, max-entropy, .*batch-bald, power-bald"),
    ],
)
def test_impossible_requests_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        chosen(Table(), **options)


def test_pools_of_unequal_size_are_refused():
    pools, generators = [Pool([0], [1, 2]), Pool([0], [1])], [rng.generator(100), rng.generator(101)]
    with pytest.raises(ValueError, match=r"same size, got \[2, 1\] candidates"):
        acquire(Table(), pools, "bald", 1, draws=1, generators=generators)


def test_replicas_do_not_share_a_pool():
    pool, generators = Pool([0], range(1, 90)), [rng.generator(seed) for seed in (100, 101)]
    with pytest.raises(ValueError, match="a pool of its own for each replica"):
        acquire(Table(), [pool] * 2, "bald", 5, draws=7, generators=generators)
    assert len(pool.labelled) == 1


def test_batch_bald_wants_draws_that_points_share():
    learner = Table()
    learner.draws_per_point = True
    with pytest.raises(ValueError, match="the same for all points, and a Table draws anew for each: take power-bald"):
        chosen(learner, "batch-bald")
    assert len(chosen(learner, "power-bald")) == 6


@pytest.mark.filterwarnings("ignore:all scores are equal")
@pytest.mark.parametrize("acquisition", ["bald", "batch-bald", "power-bald"])
def test_where_all_draws_agree_the_choice_says_that_it_is_random(acquisition):
    alike = Table(change=lambda x: x[:, :1].expand(-1, 7, -1, -1))
    (selection,) = acquire(alike, [Pool([0], range(1, 90))], acquisition, 5, draws=7, generators=[rng.generator(100)])
    assert (selection.tied, selection.all_tied) == (89, True)
