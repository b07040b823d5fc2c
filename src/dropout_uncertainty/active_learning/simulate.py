"""Active learning on a data set whose labels are all known: how many of them would have been enough?"""

import hashlib
import re
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from torch import Tensor
from tqdm import tqdm

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning.acquisition import checked
from dropout_uncertainty.active_learning.batch_acquisition import check_acquisition
from dropout_uncertainty.active_learning.inputs import indices, numbers, whole
from dropout_uncertainty.active_learning.learners import Holder
from dropout_uncertainty.active_learning.loop import Learner, acquire, predictions
from dropout_uncertainty.active_learning.pools import Pool
from dropout_uncertainty.runs import checkpoints


@dataclass(frozen=True)
class Curve:
    """What a simulation found."""

    acquisition: str  #: the acquisition function.
    labels: Int[np.ndarray, " T"]  #: [T] number of labelled points.
    #: [T] test error in % after training on them, of the deterministic pass (an ensemble: of its mean).
    error: Float[np.ndarray, " T"]
    points: Int[np.ndarray, " n"]  #: [labels[-1]] indices of the labelled points, in the order of labelling.

    def __str__(self) -> str:
        """Return the last point of the curve in words."""
        return f"{self.acquisition}: {self.labels[-1]} labels, test error {self.error[-1]:.1f} %"

    def plot(self, ax: Any, **line: Any) -> Any:
        """Draw the curve on a matplotlib axes and return the axes."""
        ax.plot(self.labels, self.error, **{"label": self.acquisition, **line})
        ax.set(xlabel="labels", ylabel="test error [%]")
        return ax


def simulate(
    learner: Learner,
    images: ArrayLike,
    labels: ArrayLike,
    *,
    acquisition: str = "bald",
    count: int = 10,
    rounds: int = 20,
    draws: int = 20,
    per_class: int = 2,
    test: float | ArrayLike = 0.25,
    subset: int | None = None,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    progress: bool = True,
) -> Curve:
    """Grow a training set round by round, as a person who labels on demand would, and return the test errors.

    Args:
        learner: ``SklearnLearner``, ``DropoutLearner``, ``EnsembleLearner``, or any ``loop.Learner`` (with one replica)
            over the same data set.
        images: N images or rows of features, [N, ...]: array, tensor or data frame.
        labels: N labels of any type that has an order, such as strings; for classification only.
        acquisition: "random" or a name in ``ACQUISITIONS`` or ``BATCH_ACQUISITIONS``.
        count: points labelled in each round; the last ones are fewer if the pool runs out, and then it ends.
        rounds: acquisition rounds.
        draws: weight draws that score a candidate; 0 is the deterministic pass.
        per_class: labelled points of each class at the start (all of them in the pool, if there are fewer).
        test: the share of points held out to measure the error, or their indices, or a mask.
        subset: random candidates scored in each round; None: all.
        seed: of the split, the learner and the acquisition.
        checkpoint: a file that is written after each round; a call with the same arguments continues from it, also with
            more rounds. A learner of your own is told from others by its ``repr`` if it has one, else by its type, and
            what a network does in ``forward`` is not looked at: name another file when you change that.
        progress: whether to show a progress bar.

    Raises:
        ValueError: if the data are not as above, or the checkpoint is damaged or of another simulation.
    """
    check_acquisition(acquisition, learner)
    count, rounds = whole(count, "the count of points to acquire"), whole(rounds, "the number of rounds", 0)
    draws, seed = whole(draws, "the number of weight draws", 0), whole(seed, "the seed", 0)
    subset = None if subset is None else whole(subset, "the size of the subset")
    features, targets, names = _data(images, labels)
    tested, pool = _split(targets, test, whole(per_class, "the number of initial points per class"), seed)
    if isinstance(learner, type) or not isinstance(learner, Learner):
        raise ValueError(
            f"expected a learner with fit and log_probs, such as SklearnLearner(classifier), got {learner!r}"
        )
    if isinstance(learner, Holder):
        learner.check_labels(names)
    if hasattr(learner, "hold"):
        learner.hold(features, targets, len(names), seed)
    settings = (acquisition, count, draws, subset, seed, targets.tolist(), tested.tolist(), pool.labelled.tolist())
    saved = _Checkpoint(checkpoint, _identity(learner, features, *settings) if checkpoint is not None else "")
    sizes, errors = saved.restore(pool)
    if len(errors) < rounds:  # the last round writes nothing
        saved.check()
    with tqdm(total=rounds + 1, initial=len(errors), desc=acquisition, unit="round", disable=not progress) as bar:
        while len(errors) <= rounds:
            learner.fit(pool.labelled[None])
            sizes.append(len(pool.labelled))
            errors.append(_error(learner, tested, targets, len(names)))
            bar.set_postfix_str(f"{sizes[-1]} labels, error {errors[-1]:.1f} %", refresh=False)
            bar.update()
            left = int(pool.available.sum())
            if left == 0 or len(errors) > rounds:
                break
            streams = [rng.generator(seed, "policy", acquisition, len(errors))]
            acquire(learner, [pool], acquisition, min(count, left), draws=draws, generators=streams, subset=subset)
            saved.write(pool, sizes, errors)
    sizes, errors = sizes[: rounds + 1], errors[: rounds + 1]  # the checkpoint may be of more rounds
    return Curve(acquisition, np.array(sizes), np.array(errors), pool.labelled[: sizes[-1]].numpy())


def _data(images: ArrayLike, labels: ArrayLike) -> tuple[Tensor, Int[Tensor, " N"], np.ndarray]:
    """Return features, labels as numbers from 0, and the labels that these stand for."""
    features = numbers(images, "images or features [N, ...]").cpu()
    given = np.asarray(labels.cpu() if isinstance(labels, Tensor) else labels)
    if given.dtype.kind == "U" and not hasattr(labels, "dtype"):  # NumPy has made a word of a NaN in the list
        given = np.array(labels, dtype=object)
    if given.ndim != 1 or features.ndim < 2 or len(given) != len(features):
        shapes = f"{list(features.shape)} and {list(given.shape)}"
        raise ValueError(f"expected images or features [N, ...] and one label for each, [N], got shapes {shapes}")
    if features.is_floating_point() and not features.isfinite().all():
        raise ValueError("the images or features have values that are NaN or infinite: fill them or leave them out")
    if given.dtype.kind == "f" and not (np.isfinite(given) & (given == np.floor(given))).all():
        raise ValueError("expected labels of classes, got fractions, NaN or infinity: a regression is out of scope")
    if np.ma.is_masked(labels):
        raise ValueError("some of the labels are masked: leave those points out")
    try:
        names, targets = np.unique(given, return_inverse=True)
    except TypeError:
        raise ValueError("expected labels of one type that has an order: is one missing?") from None
    if any(name != name for name in names):  # NaN among objects, or no time
        raise ValueError("some of the labels are NaN: leave those points out")
    if len(names) < 2:
        raise ValueError(f"expected labels of at least two classes, got {len(names)}")
    return features, torch.from_numpy(targets).long(), names


def _split(targets: Int[Tensor, " N"], test: float | ArrayLike, per_class: int, seed: int) -> tuple[Tensor, Pool]:
    """Return the test points, and the pool with the first points of each class labelled."""
    total = len(targets)
    order = torch.randperm(total, generator=rng.generator(seed, "data"))
    try:
        tested = order[: max(round(np.asarray(test).item() * total), 0)] if np.ndim(test) == 0 else _named(test, total)
    except TypeError:
        tested = order[:0]
    held_out = torch.zeros(total, dtype=torch.bool)
    if not 0 < len(tested) < total or tested.max() >= total:
        raise ValueError(f"expected a share between 0 and 1, or indices below {total}, as test points, got {test!r}")
    held_out[tested] = True
    rest = order[~held_out[order]]
    first = [rest[targets[rest] == label][:per_class] for label in targets.unique()]
    initial = torch.cat(first)
    return tested, Pool(initial, rest[~torch.isin(rest, initial)])


def _named(test: ArrayLike, total: int) -> Int[Tensor, " M"]:
    """Return the test points given as indices or as a mask, in order."""
    given = numbers(test, "the test points")
    if given.dtype == torch.bool and len(given) != total:
        raise ValueError(f"expected a mask over all {total} points as test points, got one over {len(given)}")
    named = indices(given, "the test points")
    if len(named.unique()) < len(named):
        raise ValueError("the test points repeat an index: is it a mask? Then make it one of booleans")
    return named.unique()


def _error(learner: Learner, tested: Int[Tensor, " M"], targets: Int[Tensor, " N"], classes: int) -> float:
    """Return the test error in %."""
    parts = [checked(log_probs[0]).cpu() for log_probs in predictions(learner, tested[None], 0)]
    if parts[0].shape[-1] != classes:
        raise ValueError(
            f"expected log-probabilities of all {classes} classes, in the order of np.unique(labels), got "
            f"{parts[0].shape[-1]}: -inf stands for a class without a labelled point"
        )
    predicted = torch.cat([log_probs.logsumexp(0).argmax(-1) for log_probs in parts])
    return 100 * float((predicted != targets[tested]).double().mean())


class _Checkpoint:
    """The measurements and the acquired points so far, in a file that is replaced as a whole; None: nowhere."""

    def __init__(self, path: str | Path | None, identity: str) -> None:
        self.path, self.identity = None if path is None else Path(path), identity
        if self.path and (self.path.is_dir() or not self.path.parent.is_dir()):
            raise ValueError(f"the checkpoint {self.path} should be a file in a folder that is there: name another one")

    def check(self) -> None:
        """Raise ValueError if nothing can be written, before hours of work."""
        if not self.path:
            return
        try:
            with tempfile.TemporaryFile(dir=self.path.parent):
                pass
        except OSError as error:
            raise ValueError(f"the checkpoint {self.path} cannot be written: {error.strerror or error}") from None

    def write(self, pool: Pool, sizes: list[int], errors: list[float]) -> None:
        if not self.path:
            return
        state = {"identity": self.identity, "labelled": pool.labelled, "sizes": sizes, "errors": errors}
        checkpoints.save(self.path, state)

    def restore(self, pool: Pool) -> tuple[list[int], list[float]]:
        """Label in the pool what had been, and return the number of labels and the errors so far."""
        if not self.path or not self.path.exists():
            return [], []
        try:
            state = checkpoints.load(self.path)
            identity = state["identity"]
        except (ValueError, KeyError):
            raise ValueError(f"{self.path} is damaged or no checkpoint of a simulation: move it away") from None
        if identity != self.identity:
            raise ValueError(f"{self.path} is of another simulation (data, learner or settings): name another file")
        pool.acquire(state["labelled"][len(pool.labelled) :])
        return state["sizes"], state["errors"]


def _identity(learner: Learner, features: Tensor, *settings: Any) -> str:
    """Return a checksum of everything that a simulation depends on but its number of rounds."""
    told = learner.fingerprint() if isinstance(learner, Holder) else repr(learner)
    kind = f"{type(learner).__module__}.{type(learner).__qualname__}"
    if vague := re.search(
        r"<(?!built-in)[^<>]* object at 0x|<lambda> at 0x|(RandomState|Generator)\(\w+\) at 0x", told
    ):
        warnings.warn(
            f"the learner is described by {vague[0]}..., as another one would be: the checkpoint goes on with either; "
            "give it a repr, or a function a name",
            stacklevel=3,
        )
    told = re.sub("0x[0-9a-fA-F]+", "", told)  # addresses in memory
    digest = hashlib.sha256(repr((kind, told, list(features.shape), features.dtype, *settings)).encode())
    digest.update(features.contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()
