"""Acquisition functions that choose a whole batch rather than the points with the highest scores.

The highest BALD scores of a round can belong to images that are alike, and then most of the batch repeats what its
first image says. BatchBALD (Kirsch et al., 2019) scores a batch by the mutual information between all of its labels
and the weights; power-BALD (Kirsch et al., 2023) perturbs the scores of BALD, which costs nothing.

Each function takes log-probabilities [S, N, C], the size of the batch and a generator, and returns a ``Selection``.
Where the draws are the same for every point, the choice is random, with the warning of ``select``.
"""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dropout_uncertainty.active_learning.acquisition import (
    ACQUISITIONS,
    Selection,
    agreed,
    bald,
    checked,
    p_log_q,
    select,
)
from dropout_uncertainty.active_learning.inputs import whole

__all__ = ["BATCH_ACQUISITIONS", "batch_bald", "check_acquisition", "power_bald"]

#: Joint outcomes of the points chosen so far that are enumerated; beyond that as many are sampled.
OUTCOMES = 1_000
#: Numbers held at a time: outcomes x candidates x classes.
CHUNK = 4_000_000
#: Stands for scores of 0, whose logarithm could not be ranked.
LEAST = 1e-30


def power_bald(log_probs: Float[Tensor, "S N C"], count: int, generator: Generator) -> Selection:
    """Return a batch drawn without replacement with probabilities proportional to the scores of BALD.

    The highest ``count`` of log BALD plus standard Gumbel noise are such a draw.
    """
    scores = bald(checked(log_probs)).cpu()
    if (scores == 0).all():
        return select(scores, count, generator)
    uniform = torch.rand(len(scores), generator=generator, dtype=torch.float64)
    gumbel = -(-uniform.clamp_min(LEAST).log()).log()
    return select(scores.clamp_min(LEAST).log() + gumbel, count, generator)


def batch_bald(
    log_probs: Float[Tensor, "S N C"], count: int, generator: Generator, *, outcomes: int = OUTCOMES
) -> Selection:
    """Return the batch that greedy maximisation of the mutual information I(y₁ … y_k; ω) builds, best first.

    The joint entropy of the labels sums over all joint outcomes of the points chosen so far while these are at most
    ``outcomes``; beyond that it is estimated from as many sampled outcomes. Equal scores fall in random order.
    """
    log_p, count = checked(log_probs), whole(count, "the count of points to choose")
    if agreed(log_p).all():
        return select(log_p.new_zeros(log_p.shape[1]), count, generator)
    conditional = -p_log_q(log_p, log_p).sum(-1).mean(0)
    probs, classes = log_p.exp(), log_p.shape[-1]
    joint, weights = probs.new_ones(len(probs), 1), probs.new_ones(1)
    chosen: list[int] = []
    picks: list[Selection] = []
    for _ in range(min(count, log_p.shape[1])):
        gains = _joint_entropies(joint, weights, probs) - conditional
        left = torch.ones(len(gains), dtype=torch.bool)
        left[chosen] = False
        candidates = left.nonzero().flatten()
        picks.append(select(gains.cpu()[candidates], 1, generator))
        best = int(candidates[picks[-1].positions])
        chosen.append(best)
        if joint.shape[1] * classes <= outcomes:
            joint = (joint[:, :, None] * probs[:, best, None, :]).flatten(1)
            weights = probs.new_ones(joint.shape[1])
        else:
            joint, weights = _sampled(probs[:, chosen], outcomes, generator)
    return Selection(torch.tensor(chosen), picks[-1].tied, all(pick.all_tied for pick in picks))


def _joint_entropies(
    joint: Float[Tensor, "S M"], weights: Float[Tensor, " M"], probs: Float[Tensor, "S N C"]
) -> Float[Tensor, " N"]:
    """Return H[y₁ … y_k, y] in nats for each candidate y, up to a constant where outcomes are sampled.

    ``joint`` holds the probabilities of outcomes of y₁ … y_k under each draw, each outcome up to a factor, ``weights``
    what each outcome counts.
    """
    draws, _, classes = probs.shape
    parts = []
    for part in probs.split(max(1, CHUNK // (joint.shape[1] * classes)), 1):
        both = joint.T @ part.flatten(1) / draws
        parts.append((weights @ torch.special.entr(both)).view(-1, classes).sum(1))
    return torch.cat(parts)


def _sampled(
    probs: Float[Tensor, "S k C"], outcomes: int, generator: Generator
) -> tuple[Float[Tensor, "S M"], Float[Tensor, " M"]]:
    """Return joint probabilities [S, M] of outcomes sampled from the predictive distribution, and their weights.

    Those of an outcome are relative to the largest: products of hundreds of probabilities would underflow.
    """
    draws = len(probs)
    per_draw = -(-outcomes // draws)
    # Every draw gives as many outcomes; labels are independent given a draw.
    labels = torch.multinomial(
        probs.flatten(0, 1).cpu(), per_draw, replacement=True, generator=generator
    ).view(draws, -1, per_draw).permute(1, 0, 2).flatten(1)  # fmt: skip
    log_joint = probs.new_zeros(draws, draws * per_draw)
    for point, outcome in enumerate(labels.to(probs.device)):
        log_joint += probs[:, point, outcome].log()
    joint = (log_joint - log_joint.amax(0)).exp()
    return joint, 1 / (joint.shape[1] * joint.mean(0))


#: Batch acquisition functions by name.
BATCH_ACQUISITIONS: dict[str, Callable[[Tensor, int, Generator], Selection]] = {
    "batch-bald": batch_bald,
    "power-bald": power_bald,
}


def check_acquisition(acquisition: str, learner: Any = None) -> None:
    """Raise ValueError unless points can be acquired by that name: "random", a score, or what chooses a batch.

    Also for BatchBALD and a learner with draws of its own for each point: then the joint information of points is the
    sum of that of each, and copies of an image look as good as different ones.
    """
    names = ["random", *ACQUISITIONS, *BATCH_ACQUISITIONS]
    if acquisition not in names:
        raise ValueError(f"unknown acquisition function {acquisition!r}, choose one of {', '.join(names)}")
    if acquisition == "batch-bald" and getattr(learner, "draws_per_point", False):
        raise ValueError(
            f"batch-bald needs draws of the weights that are the same for all points, and a {type(learner).__name__} "
            "draws anew for each: take power-bald, or an EnsembleLearner, whose members are the draws"
        )
