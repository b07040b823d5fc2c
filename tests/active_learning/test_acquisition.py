"""Acquisition functions by hand, by their identities, and the choice among ties."""

import math
import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning.acquisition import ACQUISITIONS, score, select


def log_probs(*draws):
    """Log-probabilities [S, N, C] from probabilities."""
    return torch.tensor(draws, dtype=torch.float64).log()


@pytest.fixture
def random_draws():
    logits = 3 * torch.randn(20, 50, 10, generator=rng.generator(100), dtype=torch.float64)
    return logits.log_softmax(-1)


def test_two_confident_opposite_draws():
    draws = log_probs([[1.0, 0.0]], [[0.0, 1.0]])
    assert score("bald", draws).item() == pytest.approx(math.log(2))
    assert score("max-entropy", draws).item() == pytest.approx(math.log(2))
    assert score("variation-ratios", draws).item() == 0.5
    assert score("mean-std", draws).item() == 0.5
    assert score("least-confidence", draws).item() == pytest.approx(0.5)


def test_draws_that_agree_on_being_unsure_do_not_disagree():
    draws = log_probs([[0.5, 0.5]], [[0.5, 0.5]])
    assert score("bald", draws).item() == 0
    assert score("max-entropy", draws).item() == pytest.approx(math.log(2))


def test_variation_ratios_counts_votes():
    draws = log_probs([[0.6, 0.3, 0.1]], [[0.1, 0.8, 0.1]], [[0.2, 0.7, 0.1]], [[0.3, 0.3, 0.4]])
    assert score("variation-ratios", draws).item() == 0.5


def test_a_single_draw_has_constant_bald_and_variation_ratios(random_draws):
    one = random_draws[:1].float()
    assert score("bald", one).unique().tolist() == [0.0]
    assert score("variation-ratios", one).unique().tolist() == [0.0]
    assert len(score("least-confidence", one).unique()) == 50


def test_identities(random_draws):
    bald, entropy = score("bald", random_draws), score("max-entropy", random_draws)
    expected = entropy + (random_draws.exp() * random_draws).sum(-1).mean(0)
    torch.testing.assert_close(bald, expected)
    assert (bald >= 0).all()
    assert (bald <= entropy).all()
    assert (entropy <= math.log(10) + 1e-12).all()
    assert (score("variation-ratios", random_draws) <= 0.9).all()


@pytest.mark.parametrize("name", ACQUISITIONS)
def test_the_order_of_draws_does_not_matter(name, random_draws):
    torch.testing.assert_close(score(name, random_draws), score(name, random_draws.flip(0)), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", ACQUISITIONS)
def test_probabilities_of_exactly_zero_are_fine(name):
    scores = score(name, log_probs([[1.0, 0.0], [0.4, 0.6]], [[1.0, 0.0], [1.0, 0.0]]))
    assert torch.isfinite(scores).all()
    assert scores[0] == 0
    assert scores[1] > 0


def test_bad_predictions_are_refused():
    broken = torch.full((2, 3, 4), 0.25).log()
    broken[1, 2, 0] = torch.nan
    with pytest.raises(ValueError, match="predictions of 1 of 3 points are NaN: has the training diverged"):
        score("bald", broken)
    logits = torch.tensor([[[-0.3, -2.0], [-1.0, -5.0]]])
    for wrong in (broken.exp().nan_to_num(0.25), logits, -torch.ones(2, 3, 1), torch.full((2, 3, 4), -torch.inf)):
        with pytest.raises(ValueError, match="whose exponentials sum to 1 over the classes, got sums from") as refused:
            score("bald", wrong)
        assert "diverged" not in str(refused.value)
    with pytest.raises(ValueError, match="as real numbers in one array, got a list"):
        score("bald", [[["a"]]])
    with pytest.raises(ValueError, match=r"\[S, N, C\]"):
        score("bald", torch.zeros(3, 0, 4))
    with pytest.raises(ValueError, match="unknown acquisition function 'entropy', choose one of max-entropy"):
        score("entropy", torch.zeros(1, 1, 1))


@pytest.mark.parametrize(
    "given",
    [
        lambda x: x.numpy(), lambda x: x.tolist(), lambda x: x.float(), lambda x: x.numpy()[:, ::-1].copy()[:, ::-1],
        lambda x: x.clone().requires_grad_(), lambda x: x.transpose(0, 2).contiguous().transpose(0, 2),
    ],
)  # fmt: skip
def test_what_holds_the_numbers_does_not_matter(given, random_draws):
    for name in ACQUISITIONS:
        torch.testing.assert_close(score(name, given(random_draws)), score(name, random_draws), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    "given", [list, np.array, np.float16, torch.tensor, lambda x: torch.tensor(x).requires_grad_()]
)
def test_scores_may_be_anything_that_holds_numbers(given):
    assert select(given([0.25, 0.75, 0.5]), 2, rng.generator(100)).positions.tolist() == [1, 2]


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("classes", [2, 10, 1000, 30_000])
def test_rounded_log_probabilities_are_accepted(dtype, classes):
    logits = torch.randn(2, 5, classes, generator=rng.generator(100)) * torch.tensor([0, 1, 3, 10, 30])[:, None]
    exact = logits.log_softmax(-1)
    torch.testing.assert_close(score("max-entropy", exact.to(dtype)), score("max-entropy", exact), rtol=0.05, atol=0.01)


def test_select_takes_the_best_and_counts_ties():
    selection = select(torch.tensor([0.1, 0.9, 0.5, 0.5, 0.5, 0.2]), 2, rng.generator(100))
    assert selection.positions[0] == 1
    assert selection.positions[1] in (2, 3, 4)
    assert (selection.tied, selection.all_tied) == (3, False)


def test_ties_are_broken_at_random_and_evenly():
    counts = torch.zeros(10)
    for seed in range(100, 1100):
        with pytest.warns(UserWarning, match="all scores are equal"):
            selection = select(torch.zeros(10), 3, rng.generator(seed))
        assert selection.all_tied
        counts[selection.positions] += 1
    # 300 expected, standard deviation sqrt(1000 * 0.3 * 0.7) = 14.5
    assert (counts - 300).abs().max() < 5 * 14.5


def test_select_refuses_what_cannot_be_ranked():
    with pytest.raises(ValueError, match="1 of 2 scores are NaN or infinite"):
        select(torch.tensor([0.0, torch.nan]), 1, rng.generator(100))
    with pytest.raises(ValueError, match="at least one score"):
        select(torch.zeros(0), 1, rng.generator(100))
    assert len(select(torch.tensor([0.3, 0.1]), 5, rng.generator(100)).positions) == 2


def test_our_scores_are_those_of_scipy_on_the_points_that_other_libraries_are_asked_about():
    module = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "same_names.py"))
    formulas = {
        "max-entropy": "entropy of the mean prediction, H[p̄]",
        "variation-ratios": "share of draws that are outvoted",
        "bald": "mutual information, H[p̄] − mean H[p]",
        "mean-std": "mean standard deviation over draws",
        "least-confidence": "least confidence, 1 − max p̄",
        "margin": "1 minus that gap",
    }
    assert formulas.keys() == ACQUISITIONS.keys()
    probs = torch.tensor(module["PROBS"])
    for name, words in formulas.items():
        expected = torch.tensor(module["FORMULAS"][words](module["PROBS"]))
        torch.testing.assert_close(score(name, probs.log()), expected, rtol=1e-12, atol=1e-12)
