"""Acquisition functions of thesis section 5.2, from log-probabilities, and the choice of the points to label.

Each function takes normalised log-probabilities of shape [S, N, C] (S weight draws, N points, C classes) and returns
one score per point; the highest scores are acquired. The deterministic approximation (*Softmax*) is the case S = 1. No
epsilon is added anywhere and entropies are in nats, computed in float64.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor

__all__ = [
    "ACQUISITIONS", "Selection", "bald", "least_confidence", "margin", "max_entropy", "mean_std", "score", "select",
    "variation_ratios",
]  # fmt: skip


def mean_log_probs(log_probs: Float[Tensor, "S N C"]) -> Float[Tensor, "N C"]:
    """Return log p̄, the log of the predictive probabilities averaged over the draws."""
    return torch.logsumexp(log_probs, 0) - torch.tensor(float(len(log_probs)), dtype=log_probs.dtype).log()


def p_log_q(log_p: Tensor, log_q: Tensor) -> Tensor:
    """Return p log q elementwise with 0 log 0 = 0."""
    return torch.where(log_p == -torch.inf, 0.0, log_p.exp() * log_q)


def max_entropy(log_probs: Float[Tensor, "S N C"]) -> Float[Tensor, " N"]:
    """Return the predictive entropy H[p̄] in nats (Shannon, 1948; thesis section 3.3.1)."""
    mean = mean_log_probs(log_probs)
    return -p_log_q(mean, mean).sum(-1)


def bald(log_probs: Float[Tensor, "S N C"]) -> Float[Tensor, " N"]:
    """Return the mutual information between prediction and weights in nats (Houlsby et al., 2011).

    Computed as the mean over draws of KL(p_s ‖ p̄), the same quantity as H[p̄] - mean H[p_s] but a mean of terms that
    are never negative, so nothing cancels. One draw carries no disagreement: for S = 1 the score is exactly 0.
    """
    if len(log_probs) == 1:
        return log_probs.new_zeros(log_probs.shape[1])
    mean = mean_log_probs(log_probs)
    return (p_log_q(log_probs, log_probs) - p_log_q(log_probs, mean)).sum(-1).mean(0).clamp_min(0.0)


def variation_ratios(log_probs: Float[Tensor, "S N C"]) -> Float[Tensor, " N"]:
    """Return the share of draws whose predicted class is not the most frequent one (Freeman, 1965).

    Counted in integers and divided once at the end, so equal scores are exactly equal. For S = 1 it is 0.
    """
    draws, _, classes = log_probs.shape
    votes = torch.nn.functional.one_hot(log_probs.argmax(-1), classes).sum(0)
    return (draws - votes.amax(-1)).to(log_probs.dtype) / draws


def mean_std(log_probs: Float[Tensor, "S N C"]) -> Float[Tensor, " N"]:
    """Return the standard deviation over draws of each class probability, averaged over classes (thesis 5.1.3)."""
    return log_probs.exp().std(0, correction=0).mean(-1)


def least_confidence(log_probs: Float[Tensor, "S N C"]) -> Float[Tensor, " N"]:
    """Return 1 - max p̄: what variation ratios would be of a deterministic network if it were not constant."""
    return -torch.expm1(mean_log_probs(log_probs).amax(-1))


def margin(log_probs: Float[Tensor, "S N C"]) -> Float[Tensor, " N"]:
    """Return 1 minus the gap between the two largest p̄ (Scheffer et al., 2001)."""
    first, second = mean_log_probs(log_probs).exp().topk(2, -1).values.unbind(-1)
    return 1 - (first - second)


#: Scored acquisition functions by name; "random" is the acquisition that needs no score.
ACQUISITIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "max-entropy": max_entropy,
    "variation-ratios": variation_ratios,
    "bald": bald,
    "mean-std": mean_std,
    "least-confidence": least_confidence,
    "margin": margin,
}


def score(acquisition: str, log_probs: Float[Tensor, "S N C"]) -> Float[Tensor, " N"]:
    """Return the scores of the named acquisition function in float64.

    Raises:
        ValueError: if the name is unknown, the shape is not [S, N, C], or a log-probability is NaN or above 0.
    """
    if acquisition not in ACQUISITIONS:
        names = ", ".join(["random", *ACQUISITIONS])
        raise ValueError(f"unknown acquisition function {acquisition!r}, choose one of {names}")
    if log_probs.ndim != 3 or 0 in log_probs.shape:
        raise ValueError(f"expected log-probabilities of shape [S, N, C], got {list(log_probs.shape)}")
    # The margin allows for the rounding of a log-softmax; a NaN fails the comparison too.
    if not (log_probs <= 1e-3).all():
        raise ValueError("expected log-probabilities, got values that are NaN or above 0: has the training diverged?")
    return ACQUISITIONS[acquisition](log_probs.double())


@dataclass(frozen=True)
class Selection:
    """The points chosen from scored candidates.

    Attributes:
        positions: [k] positions among the candidates, best first.
        tied: how many candidates share the score of the last point chosen (1: no tie at the cut-off).
        all_tied: whether every candidate has the same score, so that the choice is random.
    """

    positions: Int[Tensor, " k"]
    tied: int
    all_tied: bool


def select(scores: Float[Tensor, " N"], count: int, generator: Generator) -> Selection:
    """Return the ``count`` highest scores, equal scores in random order; all of them if there are fewer.

    A warning is given when every score is equal: the acquisition is then random (claim AL7).

    Raises:
        ValueError: if a score is NaN or infinite, if there is none, or if ``count`` < 1.
    """
    if count < 1 or scores.ndim != 1 or len(scores) == 0:
        raise ValueError(f"expected at least one score and a count of at least 1, got {list(scores.shape)}, {count}")
    if not torch.isfinite(scores).all():
        raise ValueError(f"{int((~torch.isfinite(scores)).sum())} of {len(scores)} scores are NaN or infinite")
    # A stable sort by score of a random order: ties fall in random order.
    order = torch.randperm(len(scores), generator=generator)
    positions = order[scores[order].argsort(descending=True, stable=True)][:count]
    tied = int((scores == scores[positions[-1]]).sum())
    all_tied = tied == len(scores) and len(scores) > 1
    if all_tied:
        warnings.warn("all scores are equal: this acquisition is random", stacklevel=2)
    return Selection(positions, tied, all_tied)
