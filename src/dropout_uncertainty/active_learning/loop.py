"""The active learning loop, for any classifier and any data set.

A learner is whatever can be fitted to labelled points and predict others::

    class Learner:
        def fit(self, labelled): ...               # indices [R, n] -> trains from scratch
        def log_probs(self, candidates, draws): ...  # indices [R, M] -> [R, S, M, C]; draws=0: one deterministic pass

R is the number of replicas that run side by side; a single classifier has R = 1. S is the number of draws asked for, or
that of its members for a learner that has a fixed number of them. Candidates come in parts, which bounds the memory: a
learner may say in an integer attribute ``classes`` how many there are; of others the first two points are predicted
alone to find out. BatchBALD asks what one draw says of several points together: a learner that draws anew for each
point says so in an attribute ``draws_per_point``, and is refused.
"""

import warnings
from collections.abc import Iterator, Sequence
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor, nn

from dropout_uncertainty.active_learning.acquisition import Selection, score, select
from dropout_uncertainty.active_learning.batch_acquisition import BATCH_ACQUISITIONS, check_acquisition
from dropout_uncertainty.active_learning.inputs import numbers, whole
from dropout_uncertainty.active_learning.pools import Pool

__all__ = ["Learner", "acquire", "predictions"]

#: Candidates that a learner predicts at a time, at most.
CHUNK = 4_000
#: Log-probabilities (draws × points × classes) of one replica that are scored at a time: 160 MB in float64.
VALUES = 20_000_000


@runtime_checkable
class Learner(Protocol):
    """A classifier that can be trained again and again on growing sets."""

    def fit(self, labelled: Int[Tensor, "R n"]) -> None:
        """Train from scratch on the given points of the data set."""

    def log_probs(self, candidates: Int[Tensor, "R M"], draws: int) -> Float[Tensor, "R S M C"]:
        """Return log-probabilities under ``draws`` weight draws, or (0) of the deterministic pass, S = 1.

        Classes come in the order of ``np.unique(labels)``, all C of them; -inf where one has no labelled point.
        """


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
        ValueError: if a pool is empty, the acquisition is unknown or cannot do with this learner's draws, or the
            learner returns anything but the log-probabilities of these candidates.
    """
    check_acquisition(acquisition, learner)
    if isinstance(pools, Pool) or isinstance(generators, Generator) or len(pools) != len(generators):
        raise ValueError("expected one pool and one generator for each replica, in two lists of the same length")
    if len({id(pool) for pool in pools}) < len(pools):
        raise ValueError("expected a pool of its own for each replica, got one of them twice")
    whole(count, "the count of points to acquire")
    whole(draws, "the number of weight draws", 0)
    offered = [pool.candidates(g, subset) for pool, g in zip(pools, generators, strict=True)]
    left = min(len(o) for o in offered)
    if any(len(o) != left for o in offered):
        raise ValueError(f"expected pools of the same size, got {[len(o) for o in offered]} candidates")
    if left == 0:
        raise ValueError("the pool is empty: nothing is left to acquire")
    if left < count:
        few = f"the subset has {left} candidates" if left == subset else f"only {left} points are left in the pool"
        warnings.warn(f"{few}, asked for {count}: taking them all", stacklevel=2)
    if acquisition in BATCH_ACQUISITIONS:
        choose = BATCH_ACQUISITIONS[acquisition]
        log_probs = torch.cat(list(predictions(learner, torch.stack(offered), draws)), 2)
        selections = [
            choose(replica, count, generator) for replica, generator in zip(log_probs, generators, strict=True)
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
    parts = [[score(acquisition, r) for r in log_probs] for log_probs in predictions(learner, candidates, draws)]
    return [torch.cat(scores).cpu() for scores in zip(*parts, strict=True)]


def predictions(learner: Learner, candidates: Int[Tensor, "R M"], draws: int) -> Iterator[Float[Tensor, "R S m C"]]:
    """Yield the log-probabilities of the candidates part by part, at most ``VALUES`` of a replica at a time.

    Raises:
        ValueError: if the learner returns another shape than [R, S, m, C].
    """
    classes, samples, begin = getattr(learner, "classes", None), max(draws, 1), 0
    while begin < candidates.shape[1]:
        points = max(1, min(CHUNK, VALUES // (samples * classes))) if isinstance(classes, int) else 2
        part = candidates[:, begin : begin + points]
        log_probs = numbers(learner.log_probs(part, draws), "log-probabilities [R, S, M, C]")
        replicas, count = part.shape
        if log_probs.ndim != 4 or (log_probs.shape[0], log_probs.shape[2]) != (replicas, count):
            raise ValueError(
                f"expected log-probabilities of shape [R, S, M, C] = [{replicas}, {samples}, {count}, classes] for "
                f"{count} candidates, got {list(log_probs.shape)}"
            )
        samples, classes, begin = log_probs.shape[1], log_probs.shape[3], begin + count
        yield log_probs
    if any(layer.training or getattr(layer, "running_mean", 0) is None for layer in _batch_normalisations(learner)):
        warnings.warn(
            "the learner predicts with batch normalisation in training mode, so a prediction depends on its company: "
            "call eval() on the network, train() on its dropout layers only, and leave track_running_stats on",
            stacklevel=2,
        )


def _batch_normalisations(learner: Any) -> list[nn.Module]:
    held = [learner, *getattr(learner, "__dict__", {}).values()]
    networks = [network for network in held if isinstance(network, nn.Module)]
    return [layer for network in networks for layer in network.modules() if "BatchNorm" in type(layer).__name__]
