"""Which points are labelled, and which can still be acquired."""

from dataclasses import dataclass

import torch
from jaxtyping import Int
from numpy.typing import ArrayLike
from torch import Generator, Tensor

from dropout_uncertainty.active_learning.inputs import indices, numbers, whole


@dataclass(frozen=True)
class Split:
    """Indices into the training set: the initial labelled points, the validation points and the pool; disjoint."""

    initial: Int[Tensor, " I"]
    validation: Int[Tensor, " V"]
    pool: Int[Tensor, " N"]


def balanced_subset(labels: ArrayLike, per_class: int) -> Int[Tensor, " I"]:
    """Return the positions of the first ``per_class`` points of each class, in the order of the points.

    Raises:
        ValueError: if the labels are not integers from 0, or a class up to the largest has fewer points than asked for.
    """
    labels, positions = _classes(labels), []
    whole(per_class, "the number of initial points per class")
    for label in range(int(labels.max()) + 1):
        found = (labels == label).nonzero().flatten()[:per_class]
        if len(found) < per_class:
            raise ValueError(f"a balanced start needs {per_class} points of class {label}, found {len(found)}")
        positions.append(found)
    return torch.cat(positions).sort().values


def _classes(labels: ArrayLike) -> Int[Tensor, " N"]:
    """Return labels as integers from 0; raises ValueError for any others."""
    what = "labels 0, 1, ... (`simulate` takes labels of any type)"
    labels = numbers(labels, what).cpu()
    return indices(labels.long() if labels.dtype == torch.bool else labels, what)


def split(
    labels: ArrayLike,
    generator: Generator,
    *,
    per_class: int = 2,
    validation: int = 5_000,
    pool: int | None = 40_000,
    source: int = 10_000,
) -> Split:
    """Return a random split of the training set.

    The set is shuffled; the first ``source`` points give the balanced initial set, the next ``validation`` points the
    validation set, and the last ``pool`` points the pool (what is between is unused). This is what the original scripts
    do with 10,000, 5,000 and 40,000; ``pool=None`` is the thesis text, where all that is left belongs to the pool.

    Raises:
        ValueError: if the parts do not fit into the set, or a class is missing in the source of the initial set.
    """
    labels = _classes(labels)
    total = len(labels)
    if min(source, validation, pool or 0) < 0 or source + validation + (pool or 0) > total:
        raise ValueError(f"source {source}, validation {validation} and pool {pool} do not fit into {total} points")
    order = torch.randperm(total, generator=generator)
    initial = order[:source][balanced_subset(labels[order[:source]], per_class)]
    held_out = order[source : source + validation]
    if pool is not None:
        return Split(initial, held_out, order[total - pool :])
    rest = torch.ones(total, dtype=torch.bool)
    rest[initial] = rest[held_out] = False
    return Split(initial, held_out, order[rest[order]])


class Pool:
    """The labelled points, in the order of acquisition, and the points that are left.

    All indices are those of the data set, never positions in a shrinking pool.
    """

    def __init__(self, initial: ArrayLike, pool: ArrayLike) -> None:
        """Start with ``initial`` labelled, both given as indices or as masks over the data set.

        Raises:
            ValueError: if they are neither, or masks of unequal lengths, or if the two overlap or repeat a point.
        """
        given = [numbers(points, "indices or masks") for points in (initial, pool)]
        if all(points.dtype == torch.bool for points in given) and len(given[0]) != len(given[1]):
            raise ValueError(f"expected two masks over one data set, got {len(given[0])} and {len(given[1])} points")
        initial, pool = indices(initial, "the initial points"), indices(pool, "the points of the pool")
        both = torch.cat([initial, pool])
        if len(both.unique()) != len(both):
            raise ValueError("the initial points and the pool repeat a point: they must be disjoint sets of indices")
        self.labelled = initial.clone()
        self.all = pool.clone()
        self.available = torch.ones(len(pool), dtype=torch.bool)

    def candidates(self, generator: Generator, size: int | None = None) -> Int[Tensor, " M"]:
        """Return the points left, or ``size`` of them drawn at random without replacement (all, if fewer are left)."""
        left = self.all[self.available]
        if size is not None:
            whole(size, "the size of the subset")
        if size is None or size >= len(left):
            return left
        return left[torch.randperm(len(left), generator=generator)[:size]]

    def acquire(self, points: ArrayLike, *, keep: bool = False) -> None:
        """Label the given points of the pool; ``keep`` leaves them in the pool (acquisition with replacement).

        Raises:
            ValueError: if a point is not in what is left of the pool.
        """
        points = indices(points, "the points to acquire")
        positions = torch.isin(self.all, points) & self.available
        if int(positions.sum()) != len(points.unique()) or (not keep and len(points.unique()) != len(points)):
            raise ValueError("tried to acquire a point twice, or one that is not in the pool")
        self.labelled = torch.cat([self.labelled, points])
        if not keep:
            self.available &= ~positions
