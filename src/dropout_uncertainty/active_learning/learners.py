"""Learners for ``simulate`` around classifiers from elsewhere: scikit-learn's, torch modules with dropout, ensembles.

Each is given the data once (``hold``) and is then a ``loop.Learner`` with one replica. Its random numbers are a
function of the seed and of the number of labelled points, so that a simulation can go on from a checkpoint; the global
random state is not moved.
"""

import copy
import math
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from torch import Tensor, nn

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning.inputs import numbers, whole
from dropout_uncertainty.active_learning.loop import Learner
from dropout_uncertainty.runs.records import checksum

__all__ = ["DropoutLearner", "EnsembleLearner", "Holder", "SklearnLearner"]

#: Images that go through a network at a time when nothing is learned; bounds the memory.
EVALUATION_BATCH = 1_000


def _number(seed: int, *path: str | int) -> int:
    """Return a seed for the random numbers of another library."""
    return int(torch.randint(2**31, (), generator=rng.generator(seed, *path)))


@contextmanager
def _numpy_random(seed: int) -> Iterator[None]:
    """Give NumPy's global random state over to a stream of ours for a while: classifiers draw from it."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


class Holder(Learner):
    """What the learners share: the data, the number of classes and a seed."""

    images: Tensor
    labels: Int[Tensor, " N"]
    classes: int
    seed: int
    whole: bool  #: Whether all features are whole numbers, of whatever type.

    def hold(self, images: ArrayLike, labels: ArrayLike, classes: int, seed: int) -> None:
        """Take the data set: N images or rows of features, labels from 0 to ``classes`` - 1, others where unknown.

        Raises:
            ValueError: if these are no numbers, or not one whole label for each image.
        """
        self.images, self.classes, self.seed = numbers(images, "images or features [N, ...]").cpu(), classes, seed
        given = numbers(labels, "labels").cpu()
        if given.shape != self.images.shape[:1] or (given.is_floating_point() and (given != given.floor()).any()):
            raise ValueError(
                f"expected a whole number as label for each of {len(self.images)} images, got {given.dtype} of shape "
                f"{list(given.shape)}"
            )
        self.labels = given.long()
        self.whole = not self.images.is_floating_point() or bool((self.images == self.images.floor()).all())

    def _labels(self, points: Int[Tensor, " n"]) -> Int[Tensor, " n"]:
        """Return the labels of points to learn from; raises ValueError if one is none of the classes."""
        labels = self.labels[points]
        if (wrong := (labels < 0) | (labels >= self.classes)).any():
            raise ValueError(
                f"expected labels from 0 to {self.classes - 1}, got {int(labels[wrong][0])} for point "
                f"{int(points[wrong][0])}: has it been labelled?"
            )
        return labels

    def check_labels(self, names: np.ndarray) -> None:
        """Raise ValueError if a setting speaks of labels [C] otherwise than by their numbers from 0."""

    def fingerprint(self) -> str:
        """Return what tells this learner from others."""
        return repr(self)


def _alike(one: Tensor, two: Tensor) -> bool:
    """Return whether logits are the same but for rounding."""
    slack = torch.finfo(one.dtype).eps ** 0.5
    return torch.allclose(one, two, rtol=slack, atol=slack * float(two.abs().max()))


def _drops(layer: nn.Module) -> bool:
    """Return whether a layer of PyTorch drops units by itself when it is in training mode."""
    if isinstance(layer, nn.MultiheadAttention | nn.RNNBase):
        return layer.dropout > 0
    return isinstance(layer, nn.modules.dropout._DropoutNd) and layer.p > 0


class SklearnLearner(Holder):
    """Any classifier with ``fit(x, y)`` and ``predict_proba(x)``, such as scikit-learn's; images become rows.

    It has one set of weights, S = 1, so BALD and the like need an ``EnsembleLearner`` around it. Each fit is of a copy;
    where a ``random_state`` is None it is set.

    Raises:
        ValueError: if it is no classifier.
    """

    def __init__(self, classifier: Any) -> None:
        if isinstance(classifier, type) or not (hasattr(classifier, "fit") and hasattr(classifier, "predict_proba")):
            raise ValueError(
                f"expected a classifier with fit and predict_proba, got {classifier!r}: a class has to be called, some "
                "classifiers want probability=True, and regression is out of scope"
            )
        self.classifier = classifier

    def __repr__(self) -> str:
        return f"SklearnLearner({type(self.classifier).__qualname__}, {self._settings()})"

    def fingerprint(self) -> str:
        """Return the settings and, where training goes on from it, what has been fitted already; arrays in full."""
        goes_on = self._settings().get("warm_start", not hasattr(self.classifier, "get_params"))
        held = getattr(self.classifier, "__dict__", {}) if goes_on else {}
        fitted = {name: value for name, value in held.items() if name.endswith("_")}
        with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
            return f"{self!r}, {fitted}"

    def _settings(self) -> dict[str, Any]:
        return getattr(self.classifier, "get_params", lambda: vars(self.classifier))()

    def check_labels(self, names: np.ndarray) -> None:
        """Raise ValueError if classes are weighted by label: the classifier knows them by their numbers only."""
        weighted = any(n.endswith("class_weight") and isinstance(v, dict) for n, v in self._settings().items())
        if weighted and names.tolist() != list(range(len(names))):
            raise ValueError(
                "expected the labels 0, 1, ... where class_weight is a dictionary, got others: number them, or use "
                'class_weight="balanced"'
            )

    def fit(self, labelled: Int[Tensor, "1 n"]) -> None:
        """Train a fresh copy on the given points."""
        points, labels = labelled[0], self._labels(labelled[0]).numpy()
        self.fitted = copy.deepcopy(self.classifier)
        states = {n: v for n, v in getattr(self.fitted, "get_params", dict)().items() if n.endswith("random_state")}
        if free := [name for name, value in states.items() if value is None]:
            self.fitted.set_params(**dict.fromkeys(free, _number(self.seed, "fit", len(points))))
        with _numpy_random(_number(self.seed, "numpy", len(points))):
            self.fitted.fit(self._rows(points), labels)

    def log_probs(self, candidates: Int[Tensor, "1 M"], draws: int) -> Float[Tensor, "1 1 M C"]:
        """Return log-probabilities, those of classes without a labelled point -inf."""
        given = np.asarray(self.fitted.predict_proba(self._rows(candidates[0])), np.float64)
        seen = torch.as_tensor(getattr(self.fitted, "classes_", range(self.classes)))
        if given.shape != (candidates.shape[1], len(seen)):
            wanted = f"[{candidates.shape[1]}, {len(seen)}]"
            raise ValueError(f"expected probabilities {wanted}, points × classes, got shape {list(given.shape)}")
        probs = torch.zeros(candidates.shape[1], self.classes, dtype=torch.float64)
        probs[:, seen] = torch.from_numpy(given)
        return probs.log()[None, None]

    def _rows(self, points: Int[Tensor, " n"]) -> np.ndarray:
        rows = self.images[points].flatten(1)
        return (rows.float() if rows.dtype == torch.bfloat16 else rows).numpy()


class DropoutLearner(Holder):
    """A torch module with dropout, trained by Adam on the cross-entropy; a weight draw keeps the dropout active.

    ``make()`` returns the module, of which each fit trains a copy. It takes [B, ...] images as they are in the data
    set, whole numbers as such where it begins with an embedding and else in its own precision, and returns logits
    [B, C]. When it draws, only what drops units is as in training: ``nn.Dropout`` and the dropout within PyTorch's
    attention and recurrent layers; batch normalisation never is. Each image has masks of its own, so "batch-bald" is
    refused.

    Raises:
        ValueError: if a setting is below 1, or (in ``fit``) if the module has no dropout layer or the wrong output.
    """

    draws_per_point = True

    def __init__(
        self,
        make: Callable[[], nn.Module],
        *,
        epochs: int = 50,
        batch: int = 32,
        learning_rate: float = 1e-3,
        decay: float = 0.0,
        device: str = "cpu",
    ) -> None:
        if torch.device(device).type == "cuda" and not torch.cuda.is_available():
            raise ValueError(f"the device {device} was asked for, but PyTorch finds no CUDA GPU here")
        self.make, self.device, self.learning_rate, self.decay = make, device, learning_rate, decay
        self.epochs, self.batch = whole(epochs, "the number of epochs"), whole(batch, "the batch")
        if isinstance(make, nn.Module) or not callable(make):
            raise ValueError("expected a function that makes a new module, such as `lambda: nn.Sequential(...)`")

    def __repr__(self) -> str:
        settings = f"{self.epochs}, {self.batch}, {self.learning_rate}, {self.decay}"
        with self._random(0):
            return f"DropoutLearner({self.make()!r}, {settings})"

    def fingerprint(self) -> str:
        """Return the settings, those of all layers, and a checksum of the weights that training starts from."""
        with self._random(0):
            module = self.make()
        layers = [{k: v for k, v in vars(layer).items() if not k.startswith("_")} for layer in module.modules()]
        weights = {name: value.double().cpu().numpy() for name, value in module.state_dict().items()}
        return f"{self!r}, {layers}, {checksum(weights)}"

    @contextmanager
    def _random(self, *path: str | int) -> Iterator[None]:
        """Give torch's global random state over to a stream of ours for a while: modules draw from it."""
        with torch.random.fork_rng(devices=[] if self.device == "cpu" else None):
            torch.manual_seed(_number(getattr(self, "seed", 0), "torch", *path))
            yield

    def fit(self, labelled: Int[Tensor, "1 n"]) -> None:
        """Train a new module on the given points."""
        points, self.size, self.calls = labelled[0], labelled.shape[1], 0
        self._labels(points)
        with self._random("fit", len(points)):
            self.network = copy.deepcopy(self.make()).to(self.device)
            adam = torch.optim.Adam(self.network.parameters(), lr=self.learning_rate, weight_decay=self.decay)
            for _ in range(self.epochs):
                # Batches of nearly equal size: batch normalisation cannot do with a single image left over.
                order = points[torch.randperm(len(points))]
                for part in order.tensor_split(math.ceil(len(points) / self.batch)):
                    self.network.train()
                    loss = F.cross_entropy(self._logits(part), self.labels[part].to(self.device))
                    adam.zero_grad()
                    loss.backward()
                    adam.step()
        self.network.eval()
        layers = list(self.network.modules())
        if not any(map(_drops, layers)):
            raise ValueError(
                "weight draws need an nn.Dropout layer that drops something, and the module has none (F.dropout does "
                "not show)"
            )
        # in evaluation mode a transformer's layer passes its own dropout layers by
        self.drawing = [layer for layer in layers if _drops(layer) or isinstance(layer, nn.TransformerEncoderLayer)]
        self._check_company()
        self._check_draws()

    @torch.inference_mode()
    def _check_company(self) -> None:
        """Warn if the prediction for an image depends on the others that are predicted with it."""
        with self._random("company", self.size):
            two, three = (self._logits(torch.arange(count)) for count in (2, min(3, len(self.images))))
        if not three.isfinite().all():
            raise ValueError("the predictions are NaN or infinite: has the training diverged, or are images so?")
        if not _alike(two, three[:2]):
            warnings.warn(
                "the network predicts an image differently in other company: layers for sequences want "
                "batch_first=True, batch normalisation track_running_stats=True",
                stacklevel=2,
            )

    @torch.inference_mode()
    def _check_draws(self) -> None:
        """Warn if something random is no weight draw, or if weight draws do not differ."""
        points, trained = torch.arange(min(8, len(self.images))), self.network
        with self._random("draws", self.size):
            steady = _alike(self._logits(points), self._logits(points))
        try:
            alone = _alike(*(self._in_training(points, trained, number) for number in range(2)))
        finally:
            self.network = trained
        if not steady:
            warnings.warn(
                "the module is random in evaluation mode too: F.dropout needs training=self.training", stacklevel=3
            )
        elif not alone:
            warnings.warn(
                "something besides its dropout layers is random in training (F.dropout, noise, stochastic depth) and "
                "takes no part in weight draws: should it? Then make it an nn.Dropout",
                stacklevel=3,
            )
        one, two = self.log_probs(points[None], 2)[0]
        self.calls = 0
        if torch.equal(one, two):
            warnings.warn("two weight draws are the same: does the module use its dropout layers?", stacklevel=3)

    def _in_training(self, points: Int[Tensor, " B"], trained: nn.Module, number: int) -> Float[Tensor, "B C"]:
        """Return logits of a copy in training mode, with its dropout off: modules may note what they have seen."""
        with self._random("copy", self.size):
            self.network = copy.deepcopy(self.make()).to(self.device).train()
        self.network.load_state_dict(trained.state_dict())
        for layer in self.network.modules():
            if _drops(layer) or isinstance(layer, nn.modules.batchnorm._NormBase):
                layer.training = False
        with self._random("draws", self.size, number):
            return self._logits(points)

    @torch.inference_mode()
    def log_probs(self, candidates: Int[Tensor, "1 M"], draws: int) -> Float[Tensor, "1 S M C"]:
        """Return log-probabilities under ``draws`` weight draws, or (0) with all dropout off."""
        self.calls += 1
        for layer in self.drawing:
            layer.training = draws > 0  # unlike train() it leaves the layers within alone
        with self._random("predict", self.size, self.calls):
            parts = candidates[0].split(EVALUATION_BATCH)
            outputs = [torch.cat([self._logits(part).log_softmax(-1) for part in parts]) for _ in range(max(draws, 1))]
        return torch.stack(outputs)[None].cpu()

    def _logits(self, points: Int[Tensor, " B"]) -> Float[Tensor, "B C"]:
        leaves = (layer for layer in self.network.modules() if not any(layer.children()))
        first = next((layer for layer in leaves if any(True for _ in layer.parameters())), self.network)
        weight = next(first.parameters())
        looked_up = self.whole and isinstance(first, nn.Embedding)
        logits = self.network(self.images[points].to(weight.device, torch.long if looked_up else weight.dtype))
        if logits.shape != (len(points), self.classes):
            raise ValueError(
                f"expected logits [{len(points)}, {self.classes}], images × classes, got {list(logits.shape)}"
            )
        likely = (logits.detach() >= 0).all() and (logits.detach().sum(-1) - 1).abs().max() < 1e-3
        if likely and len(points) >= 10:  # a few points could look so by chance
            raise ValueError("the module ends in a softmax: leave it out, so that logits come out")
        return logits


class EnsembleLearner(Holder):
    """Several copies of a learner, which differ in their seeds; each is one draw, whatever number is asked for.

    Args:
        learner: an ``SklearnLearner`` or a ``DropoutLearner``, whose deterministic pass is taken.
        members: number of copies.
        bootstrap: whether each trains on a resample of the labelled points of each class; without it, copies of a
            classifier that has no randomness of its own are all the same.
    """

    def __init__(self, learner: Holder, members: int = 5, *, bootstrap: bool = False) -> None:
        if not isinstance(learner, Holder) or isinstance(learner, EnsembleLearner):
            raise ValueError(f"expected an SklearnLearner or a DropoutLearner, got {learner!r}")
        self.members = [copy.copy(learner) for _ in range(whole(members, "the number of members"))]
        self.bootstrap = bootstrap

    def __repr__(self) -> str:
        return f"EnsembleLearner({self.members[0]!r}, {len(self.members)}, bootstrap={self.bootstrap})"

    def check_labels(self, names: np.ndarray) -> None:
        """Raise ValueError where its members do."""
        self.members[0].check_labels(names)

    def fingerprint(self) -> str:
        """Return what tells this ensemble from others."""
        return f"{self!r}, {self.members[0].fingerprint()}"

    def hold(self, images: ArrayLike, labels: ArrayLike, classes: int, seed: int) -> None:
        """Take the data set, and give each member a seed of its own."""
        super().hold(images, labels, classes, seed)
        for index, member in enumerate(self.members):
            member.hold(self.images, self.labels, classes, _number(seed, "member", index))

    def fit(self, labelled: Int[Tensor, "1 n"]) -> None:
        """Train all members."""
        points = labelled[0]
        for index, member in enumerate(self.members):
            if self.bootstrap:
                generator = rng.generator(self.seed, "bootstrap", index, len(points))
                of_class = [points[self.labels[points] == label] for label in self.labels[points].unique()]
                drawn = [some[torch.randint(len(some), some.shape, generator=generator)] for some in of_class]
                labelled = torch.cat(drawn)[None]
            member.fit(labelled)

    def log_probs(self, candidates: Int[Tensor, "1 M"], draws: int) -> Float[Tensor, "1 S M C"]:
        """Return log-probabilities of each member."""
        return torch.cat([member.log_probs(candidates, 0) for member in self.members], 1)
