"""The active learning loop, for any classifier and any data set.

A learner is whatever can be fitted to labelled points and predict others::

    class Learner:
        def fit(self, labelled): ...               # indices [R, n] -> trains from scratch
        def log_probs(self, candidates, draws): ...  # indices [R, M] -> [R, S, M, C]; draws=0: one deterministic pass

R is the number of replicas that run side by side; a single classifier has R = 1.
"""

import warnings
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor

from dropout_uncertainty.active_learning.acquisition import Selection, score, select
from dropout_uncertainty.active_learning.batch_acquisition import BATCH_ACQUISITIONS
from dropout_uncertainty.active_learning.pools import Pool

__all__ = ["Learner", "acquire"]

#: Points whose draws are held in memory at a time: 100 draws of 10 classes take 32 MB.
CHUNK = 4_000


@runtime_checkable
class Learner(Protocol):
    """A classifier that can be trained again and again on growing sets."""

    def fit(self, labelled: Int[Tensor, "R n"]) -> None:
        """Train from scratch on the given points of the data set."""

    def log_probs(self, candidates: Int[Tensor, "R M"], draws: int) -> Float[Tensor, "R S M C"]:
        """Return log-probabilities under ``draws`` weight draws, or (0) of the deterministic pass, S = 1."""


def acquire(
    learner: Learner,
    pools: Sequence[Pool],
    acquisition: str,
    count: int,
    *,
    draws: int,
    generators: Sequence[Generator],
    subset: int | None = None,
    replace: bool = False,
) -> list[Selection]:
    """Choose ``count`` points of each replica's pool with the named acquisition function and label them.

    ``draws`` is the number of weight draws S (0: deterministic softmax), ``subset`` how many random candidates are
    scored (None: all), ``replace`` leaves acquired points in the pool. If fewer than ``count`` points are left they are
    all taken, with a warning.

    Raises:
        ValueError: if a pool is empty, the acquisition is unknown or a prediction is NaN.
    """
    offered = [pool.candidates(g, subset) for pool, g in zip(pools, generators, strict=True)]
    left = min(len(o) for o in offered)
    if left == 0:
        raise ValueError("the pool is empty: nothing is left to acquire")
    if left < count:
        warnings.warn(f"only {left} points are left in the pool, asked for {count}: taking them all", stacklevel=2)
    if acquisition in BATCH_ACQUISITIONS:
        choose = BATCH_ACQUISITIONS[acquisition]
        predictions = learner.log_probs(torch.stack(offered), draws)
        selections = [
            Selection(choose(replica, count, generator), 1, False)
            for replica, generator in zip(predictions, generators, strict=True)
        ]
    else:
        selections = highest(learner, offered, acquisition, count, draws, generators)
    for pool, candidates, selection in zip(pools, offered, selections, strict=True):
        pool.acquire(candidates[selection.positions], keep=replace)
    return selections


def highest(
    learner: Learner,
    offered: Sequence[Int[Tensor, " M"]],
    acquisition: str,
    count: int,
    draws: int,
    generators: Sequence[Generator],
) -> list[Selection]:
    """Return the candidates with the highest scores, for each replica."""
    if acquisition == "random":
        scores = [torch.zeros(len(o)) for o in offered]
    else:
        scores = predicted_scores(learner, torch.stack(list(offered)), acquisition, draws)
    with warnings.catch_warnings():
        if acquisition == "random":  # all scores are equal on purpose
            warnings.simplefilter("ignore")
        return [select(values, count, generator) for values, generator in zip(scores, generators, strict=True)]


def predicted_scores(
    learner: Learner, candidates: Int[Tensor, "R M"], acquisition: str, draws: int
) -> list[Float[Tensor, " M"]]:
    """Return the score of every candidate, one vector per replica."""
    parts = []
    for chunk in candidates.split(CHUNK, 1):
        parts.append([score(acquisition, replica) for replica in learner.log_probs(chunk, draws)])
    return [torch.cat(scores).cpu() for scores in zip(*parts, strict=True)]
