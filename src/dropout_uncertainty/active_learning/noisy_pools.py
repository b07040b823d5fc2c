"""Pools in which some images are not worth their label: *ambiguous*, *repeated* and *irrelevant* ones.

Each kind changes what a pool of MNIST shows and what its labels say, as a function of one seed; the test set stays
clean. All indices stay those of the training set, whatever image and label now stand there.

- ``ambiguous``: a share of the pool's images are even blends of two training digits of different classes; which of the
  two classes the label names is decided by a fair coin. No number of labels makes such an image predictable.
- ``repeated``: 10,000 images stand in the pool four times each, with Gaussian noise of their own (the setting of
  BatchBALD, Kirsch et al., 2019). The second label of an image is wasted.
- ``irrelevant``: the task is to tell the digits 0-4 apart. About half of the pool shows 5-9; their label is "none of
  these", which is paid for like any other and teaches nothing.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning.mnist import Mnist
from dropout_uncertainty.active_learning.pools import Split

__all__ = ["KINDS", "NO_LABEL", "Task", "make_task"]

KINDS = ("clean", "ambiguous", "repeated", "irrelevant")
#: What stands for "none of these".
NO_LABEL = -1
#: How often an image stands in a repeated pool, and the standard deviation of its noise (pixels lie in [0, 1]).
COPIES, NOISE = 4, 0.1
#: Digits that the task with irrelevant images tells apart.
RELEVANT = 5


@dataclass(frozen=True)
class Task:
    """What one seed's pool shows."""

    data: Mnist  #: images and labels; a label ``NO_LABEL`` says "none of these".
    split: Split  #: initial points and pool.
    noise: Bool[Tensor, " N"]  #: whether an image is ambiguous or irrelevant.
    origin: Int[Tensor, " N"]  #: index of the image that this one was made from.
    partner: Int[Tensor, " N"]  #: index of the image that it is blended with; its own index where there is none.

    def wasted(self, points: Int[Tensor, " n"]) -> Bool[Tensor, " n"]:
        """Return which of the points, in the order of labelling, are noise or repeat an image labelled before."""
        origins = self.origin[points]
        earlier = torch.ones(len(points), len(points), dtype=torch.bool).tril(-1)
        return self.noise[points] | ((origins[:, None] == origins) & earlier).any(1)


def make_task(kind: str, data: Mnist, split: Split, seed: int, *, ambiguous: float = 0.5) -> Task:
    """Return the task that one seed makes of clean data and its split.

    ``ambiguous`` is the share of blends in a pool of that kind.

    Raises:
        ValueError: if the kind is unknown.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown kind of pool {kind!r}, choose one of {', '.join(KINDS)}")
    everything = torch.arange(len(data.train_labels))
    clean = Task(data, split, torch.zeros(len(everything), dtype=torch.bool), everything, everything)
    if kind == "ambiguous":
        return _ambiguous(clean, seed, ambiguous)
    if kind == "repeated":
        return _repeated(clean, seed)
    return _irrelevant(clean) if kind == "irrelevant" else clean


def _ambiguous(task: Task, seed: int, share: float) -> Task:
    """Return the task with the first points of the pool, which is in random order, blended with others of the pool."""
    generator, data, pool = rng.generator(seed, "noise", "ambiguous"), task.data, task.split.pool
    blended = pool[: round(share * len(pool))]
    partner = task.partner.clone()
    left = blended
    while len(left):  # those that drew a partner of their own class draw again
        partner[left] = pool[torch.randint(len(pool), (len(left),), generator=generator)]
        left = left[data.train_labels[left] == data.train_labels[partner[left]]]
    heads = torch.rand(len(blended), generator=generator) < 0.5
    images, labels, noise = data.train_images.clone(), data.train_labels.clone(), task.noise.clone()
    images[blended] = (data.train_images[blended] + data.train_images[partner[blended]]) / 2
    labels[blended] = torch.where(heads, labels[blended], data.train_labels[partner[blended]])
    noise[blended] = True
    return replace(task, data=_with_training(data, images, labels), noise=noise, partner=partner)


def _repeated(task: Task, seed: int) -> Task:
    """Return the task whose pool holds its first quarter four times."""
    generator, data, pool = rng.generator(seed, "noise", "repeated"), task.data, task.split.pool
    originals = pool[: len(pool) // COPIES]
    copies = pool[: COPIES * len(originals)]
    origin = task.origin.clone()
    origin[copies] = originals.repeat(COPIES)
    images, labels = data.train_images.clone(), data.train_labels[origin]
    exact = data.train_images[origin[copies]]
    images[copies] = exact + NOISE * torch.randn(exact.shape, generator=generator)
    split = replace(task.split, pool=copies)
    return replace(task, data=_with_training(data, images, labels), split=split, origin=origin)


def _irrelevant(task: Task) -> Task:
    """Return the task of telling 0-4 apart; the test set shows nothing else."""
    data, initial = task.data, task.split.initial
    noise, tested = data.train_labels >= RELEVANT, data.test_labels < RELEVANT
    relevant = Mnist(
        data.train_images,
        torch.where(noise, NO_LABEL, data.train_labels),
        data.test_images[tested],
        data.test_labels[tested],
    )
    return replace(task, data=relevant, split=replace(task.split, initial=initial[~noise[initial]]), noise=noise)


def _with_training(data: Mnist, images: Float[Tensor, "N 28 28"], labels: Int[Tensor, " N"]) -> Mnist:
    return replace(data, train_images=images, train_labels=labels)
