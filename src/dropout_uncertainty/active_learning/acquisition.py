"""Acquisition functions of thesis section 5.2, from log-probabilities, and the choice of the points to label.

Each function takes normalised log-probabilities of shape [S, N, C] (S weight draws, N points, C classes) and returns
one score per point; the highest scores are acquired. The deterministic approximation (*Softmax*) is the case S = 1. No
epsilon is added anywhere and entropies are in nats. ``score`` checks what it is given and computes in float64; the
functions by themselves trust it.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from torch import Generator, Tensor

from dropout_uncertainty.active_learning.inputs import numbers, whole

__all__ = [
    "ACQUISITIONS", "Selection", "bald", "least_confidence", "margin", "max_entropy", "mean_std", "score", "select",
    "variation_ratios",
]  # fmt: skip

#: How far the probabilities of the classes may be from a sum of 1: log-probabilities of thousands of classes that were
#: rounded to bfloat16 are off by 3 %; logits, probabilities and regressions by far more.
SLACK = 0.05


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
    are never negative, so nothing cancels. Where all draws are the same, as for S = 1, the score is exactly 0 and not
    a rounding error.
    """
    mean = mean_log_probs(log_probs)
    value = (p_log_q(log_probs, log_probs) - p_log_q(log_probs, mean)).sum(-1).mean(0).clamp_min(0.0)
    return value.masked_fill(agreed(log_probs), 0.0)


def agreed(log_probs: Float[Tensor, "S N C"]) -> Bool[Tensor, " N"]:
    """Return for which points all draws are the same."""
    return (log_probs == log_probs[:1]).all(-1).all(0)


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


def checked(log_probs: ArrayLike) -> Float[Tensor, "S N C"]:
    """Return log-probabilities in float64.

    Raises:
        ValueError: if the shape is not [S, N, C], a value is NaN, or the probabilities of a point do not sum to 1.
    """
    values = numbers(log_probs, "log-probabilities [S, N, C]").double()
    if values.ndim != 3 or 0 in values.shape:
        raise ValueError(f"expected log-probabilities of shape [S, N, C], got {list(values.shape)}")
    if broken := int(values.isnan().any(-1).any(0).sum()):
        raise ValueError(f"the predictions of {broken} of {values.shape[1]} points are NaN: has the training diverged?")
    total = values.exp().sum(-1)
    if ((total - 1).abs() > SLACK).any():
        raise ValueError(
            "expected log-probabilities, whose exponentials sum to 1 over the classes, got sums from "
            f"{total.min():.3g} to {total.max():.3g}: take log_softmax of logits, the log of probabilities; "
            "a regression has no classes"
        )
    return values


def score(acquisition: str, log_probs: ArrayLike) -> Float[Tensor, " N"]:
    """Return the scores of the named acquisition function in float64, from log-probabilities [S, N, C].

    Raises:
        ValueError: if no function of that name scores points, or ``checked`` refuses the log-probabilities.
    """
    if acquisition not in ACQUISITIONS:
        raise ValueError(f"unknown acquisition function {acquisition!r}, choose one of {', '.join(ACQUISITIONS)}")
    return ACQUISITIONS[acquisition](checked(log_probs))


@dataclass(frozen=True)
class Selection:
    """The points chosen from scored candidates."""

    positions: Int[Tensor, " k"]  #: [k] positions among the candidates, best first.
    tied: int  #: how many candidates share the score of the last point chosen (1: no tie at the cut-off).
    all_tied: bool  #: whether every candidate has the same score, so that the choice is random.


def select(scores: ArrayLike, count: int, generator: Generator) -> Selection:
    """Return the ``count`` highest of N scores, equal scores in random order; all of them if there are fewer.

    A warning is given when every score is equal: the acquisition is then random (statement AL7).

    Raises:
        ValueError: if a score is NaN or infinite, if there is none, or if ``count`` < 1.
    """
    count, scores = whole(count, "the count of points to choose"), numbers(scores, "scores").cpu()
    if scores.ndim != 1 or len(scores) == 0:
        raise ValueError(f"expected at least one score, in one row, got shape {list(scores.shape)}")
    if not torch.isfinite(scores).all():
        raise ValueError(f"{int((~torch.isfinite(scores)).sum())} of {len(scores)} scores are NaN or infinite")
    # A stable sort by score of a random order: ties fall in random order.
    order = torch.randperm(len(scores), generator=generator)
    positions = order[scores[order].argsort(descending=True, stable=True)][:count]
    tied = int((scores == scores[positions[-1]]).sum())
    all_tied = tied == len(scores) and len(scores) > 1
    if all_tied:
        why = "with one draw of the weights, or one set of them, BALD is 0 everywhere"
        warnings.warn(f"all scores are equal: this acquisition is random ({why})", stacklevel=2)
    return Selection(positions, tied, all_tied)
