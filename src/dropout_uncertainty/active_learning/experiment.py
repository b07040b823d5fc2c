"""The experiment of thesis section 5.2: grow a training set of MNIST digits from 20 to 1000 labels.

One unit of work is one row of Tables 5.1 and 5.2 (an acquisition function and an approximation) for one or more seeds.
Each acquisition round is one step. A round trains a new network from streams named by seed and round, so a run that was
killed continues from the list of acquired points alone and ends with the same arrays.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning import mnist
from dropout_uncertainty.active_learning.batch_acquisition import check_acquisition
from dropout_uncertainty.active_learning.loop import acquire
from dropout_uncertainty.active_learning.network import CLASSES, INITIALISATIONS, BayesianCNN
from dropout_uncertainty.active_learning.noisy_pools import KINDS, NO_LABEL, Task, make_task
from dropout_uncertainty.active_learning.pools import Pool, split
from dropout_uncertainty.bayes import check_probability
from dropout_uncertainty.runs import sweep
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.runs.unit import precision_dtype
from dropout_uncertainty.settings import idle, of_type, tidy

__all__ = ["CONFIGS", "EXPERIMENT", "ROWS", "ActiveLearning", "CNNLearner", "Config", "start", "units"]

EXPERIMENT = "active_learning"
#: Images that go through the network at a time when nothing is learned; bounds the memory.
EVALUATION_BATCH = 1_000


@dataclass(frozen=True)
class Config:
    """Everything that decides the science of one row; `script` means the original program of that row."""

    #: Acquisition function: "random" or a name in ``ACQUISITIONS`` (thesis 5.2) or ``BATCH_ACQUISITIONS``.
    acquisition: str = "random"
    #: What scores the pool: "dropout" (MC dropout), "softmax" (one deterministic pass) (thesis 5.2) or "ensemble".
    approximation: str = "dropout"
    #: Side of the convolution kernels in pixels (thesis 5.2: 4; scripts of Random and Softmax Max Entropy: 3).
    kernel: int = 4
    #: Drop probabilities after the pooling and after the dense layer (thesis 5.2).
    drop: tuple[float, float] = (0.25, 0.5)
    #: c of the penalty (c / N) Σ w² on the weights of the dense layer (not in the thesis; scripts: 2.5 or 3.5).
    decay: float = 2.5
    #: Rule of the initial weights (not in the thesis; scripts: the Glorot rule as Keras 0.3.1 computes it).
    initialisation: str = "keras-0.3"
    #: Whether the network on the 20 initial labels has a second block of two convolutions (scripts: yes).
    four_convolutions_at_start: bool = False
    epochs: int = 50  #: Passes over the labelled points in each round (not in the thesis; scripts: 50).
    batch: int = 128  #: Labelled points per step of Adam (not in the thesis; scripts: 128).
    learning_rate: float = 1e-3  #: Of Adam, with its usual constants (not in the thesis; scripts: 0.001).
    draws: int = 100  #: Weight draws S that score a pool point (not in the thesis; scripts: 100).
    #: Whether each image has masks of its own (scripts), or all share a draw, which is then a draw of the weights.
    masks_per_image: bool = False
    per_class: int = 2  #: Initial labelled points per class; 2 gives 20 labels (thesis 5.2).
    validation: int = 5_000  #: Points held out for validation; unused by the scripts too (thesis 5.2).
    pool: int | None = 40_000  #: Points in the pool; None: all that is left, 54,980 (thesis 5.2). Scripts: 40,000.
    #: Random candidates scored in each round; None: the whole pool (thesis 5.2). Scripts: 2,000.
    subset: int | None = 2_000
    #: Random acquisition reaches only the first so many pool points (script of Random: 38,000); None: all.
    random_from: int | None = None
    replacement: bool = False  #: Whether acquired points stay in the pool (script of Random: yes).
    acquired: int = 10  #: Points labelled in each round (thesis 5.2).
    rounds: int = 98  #: Acquisition rounds (thesis 5.2: 100; scripts: 98, which ends at 1000 labels).
    #: Rounds between test errors averaged over ``draws`` weight draws; 0: never. The thesis uses weight scaling.
    mc_test_every: int = 0
    #: Whether the minibatches of an epoch are of equal size to one point, or the last is what is left (scripts).
    even_minibatches: bool = field(default=False, metadata={"before": False})
    #: What the pool shows: one of ``noisy_pools.KINDS`` (not in the thesis).
    pool_kind: str = field(default="clean", metadata={"before": "clean"})
    #: Share of blended images in the pool of that kind (not in the thesis).
    ambiguous: float = field(default=0.5, metadata={"before": 0.5})
    #: Networks of the ensemble where that scores the pool (not in the thesis).
    members: int = field(default=5, metadata={"before": 5})
    #: Images of the test set, from its beginning, that the error is taken of; None: all (thesis 5.2).
    tested: int | None = field(default=None, metadata={"before": None})

    def __post_init__(self) -> None:
        """Raise ValueError where a setting cannot be run."""
        tidy(self)
        check_acquisition(self.acquisition)
        if self.approximation not in ("dropout", "softmax", "ensemble"):
            raise ValueError(f"unknown approximation {self.approximation!r}, choose dropout, softmax or ensemble")
        if self.pool_kind not in KINDS:
            raise ValueError(f"unknown pool_kind {self.pool_kind!r}, choose one of {', '.join(KINDS)}")
        if not 0 <= self.ambiguous <= 1:
            raise ValueError(f"ambiguous is a share between 0 and 1, got {self.ambiguous}")
        for name in ("epochs", "batch", "draws", "per_class", "acquired", "members", "pool", "random_from", "tested"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.initialisation not in INITIALISATIONS:
            choices = ", ".join(INITIALISATIONS)
            raise ValueError(f"unknown initialisation {self.initialisation!r}, choose one of {choices}")
        if len(self.drop) != 2:
            raise ValueError(f"expected two drop probabilities, got {self.drop}")
        for p in self.drop:
            check_probability(p)
        if self.learning_rate <= 0 or self.decay < 0 or self.mc_test_every < 0:
            raise ValueError("learning_rate must be above 0, decay and mc_test_every at least 0")
        if self.rounds < 0 or self.validation < 0 or (self.subset is not None and self.subset < 1):
            raise ValueError("rounds and validation must be at least 0, and subset at least 1 or None")
        if self.acquisition != "random":
            idle(self, ("random_from", "replacement"), "acquisition is not random")
            if self.approximation == "dropout" and not any(self.drop):
                raise ValueError("there are no weight draws without dropout: choose the approximation softmax")
        if self.acquisition == "batch-bald" and self.approximation == "dropout" and self.masks_per_image:
            raise ValueError("batch-bald needs weight draws that all images share: set masks_per_image=False")
        if self.pool_kind != "ambiguous":
            idle(self, ("ambiguous",), f"the pool is {self.pool_kind}")
        if self.approximation != "ensemble":
            idle(self, ("members",), "no ensemble scores the pool")


#: The rows of Tables 5.1 and 5.2 that we run, in this order: name -> (approximation, acquisition).
ROWS: dict[str, tuple[str, str]] = {
    "random": ("dropout", "random"),
    "dropout/max-entropy": ("dropout", "max-entropy"),
    "dropout/variation-ratios": ("dropout", "variation-ratios"),
    "dropout/bald": ("dropout", "bald"),
    "dropout/mean-std": ("dropout", "mean-std"),
    "softmax/max-entropy": ("softmax", "max-entropy"),
    "softmax/variation-ratios": ("softmax", "variation-ratios"),
    "softmax/bald": ("softmax", "bald"),
    "softmax/least-confidence": ("softmax", "least-confidence"),
}

#: One common setting for every row; verdicts rest on it.
OURS = Config()
#: What the thesis text says, where it says something.
AS_WRITTEN = replace(OURS, pool=None, subset=None, rounds=100)
#: The scripts behind the five rows with 4x4 kernels, and the one behind Random and Softmax Max Entropy.
AS_RECORDED = replace(OURS, four_convolutions_at_start=True, masks_per_image=True)
AS_RECORDED_3X3 = replace(AS_RECORDED, kernel=3, decay=3.5)

#: Small enough to compute every row while a reader waits: 20 to 180 labels, fewer candidates, draws and test images.
QUICK = replace(OURS, rounds=8, acquired=20, draws=20, subset=1_000, tested=2_000)


def _family(name: str, base: Config) -> dict[str, Config]:
    return {
        f"{name}/{row}": replace(base, approximation=approximation, acquisition=acquisition)
        for row, (approximation, acquisition) in ROWS.items()
    }


#: When do weight draws save labels? 20 to 320 labels, from pools of four kinds.
POOLS = replace(OURS, rounds=30, even_minibatches=True)
POOLS_QUICK = replace(POOLS, rounds=2, acquired=40, draws=20, subset=500, tested=2_000)
#: The rows that are run on each kind of pool, beside Random.
POOL_ROWS: dict[str, tuple[str, ...]] = {
    "ambiguous": (
        "softmax/max-entropy",
        "dropout/max-entropy",
        "dropout/bald",
        "dropout/variation-ratios",
        "ensemble/bald",
        "ensemble/max-entropy",
        "softmax/least-confidence",
        "softmax/margin",
        "dropout/mean-std",
    ),
    "clean": ("softmax/max-entropy", "dropout/max-entropy", "dropout/bald", "ensemble/bald", "softmax/margin"),
    "repeated": ("softmax/max-entropy", "dropout/bald", "dropout/batch-bald", "dropout/power-bald"),
    "irrelevant": ("softmax/max-entropy", "dropout/bald"),
}
#: Four labels for each of the digits 0-4 are 20 labels too.
_KIND: dict[str, dict[str, Any]] = {"irrelevant": {"per_class": 4}}
#: Changes of the ambiguous pool's setting, and the rows that they concern.
_CONTRAST, _BALD = ("random", "softmax/max-entropy", "dropout/bald"), ("dropout/bald",)
SENSITIVITY: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "drop-halved": ({"drop": (0.125, 0.25)}, _CONTRAST),
    # Twice 0.5 would drop everything; half of what was kept is kept.
    "drop-doubled": ({"drop": (0.5, 0.75)}, _CONTRAST),
    "draws-10": ({"draws": 10}, _BALD),
    "draws-1000": ({"draws": 1_000}, _BALD),
    "masks-per-image": ({"masks_per_image": True}, _BALD),
    "ambiguous-10": ({"ambiguous": 0.1}, _CONTRAST),
    "ambiguous-90": ({"ambiguous": 0.9}, _CONTRAST),
}


def _pool_config(base: Config, kind: str, row: str, **changes: Any) -> Config:
    approximation, _, acquisition = row.rpartition("/")
    base = replace(base, approximation=approximation or "dropout", acquisition=acquisition)
    return replace(base, pool_kind=kind, **_KIND.get(kind, {}), **changes)


#: Named configs, "family/row".
CONFIGS: dict[str, Config] = {
    **_family("ours", OURS),
    "ours/random": replace(OURS, acquisition="random", mc_test_every=7),
    "ours/random-without-dropout": replace(OURS, acquisition="random", drop=(0.0, 0.0)),
    # The runs of "ours", ended after 400 acquired points: all that a primary statement (AL5b) asks for.
    "early/random": replace(OURS, acquisition="random", rounds=40),
    "early/dropout/variation-ratios": replace(OURS, acquisition="variation-ratios", rounds=40),
    **_family("as-recorded", AS_RECORDED),
    "as-recorded/random": replace(AS_RECORDED_3X3, random_from=38_000, replacement=True),
    "as-recorded/softmax/max-entropy": replace(
        AS_RECORDED_3X3, approximation="softmax", acquisition="max-entropy", subset=None
    ),
    **_family("as-written", AS_WRITTEN),
    **_family("quick", QUICK),
    **{
        f"pools/{kind}/{row}": _pool_config(POOLS, kind, row)
        for kind, rows in POOL_ROWS.items()
        for row in ("random", *rows)
    },
    **{
        f"pools-sensitivity/{change}/{row}": _pool_config(POOLS, "ambiguous", row, **values)
        for change, (values, rows) in SENSITIVITY.items()
        for row in rows
    },
    **{f"pools-quick/ambiguous/{row}": _pool_config(POOLS_QUICK, "ambiguous", row) for row in _CONTRAST},
}


class CNNLearner:
    """R Bayesian CNNs on MNIST, retrained from scratch in every round (a ``loop.Learner``).

    Args:
        config: see ``Config``.
        seeds: one per replica.
        path: further names of the streams, so that networks of the same seed differ.
        device: where it computes.
        precision: of convolutions and matrix products.
        data: one for all replicas, or one per replica.

    Attributes:
        network: the networks of the last ``fit``.

    Raises:
        ValueError: without ``data`` for a config whose pool is not MNIST as it is.
    """

    network: BayesianCNN
    classes = CLASSES

    def __init__(
        self,
        config: Config,
        seeds: Sequence[int],
        *path: str | int,
        device: str = "cpu",
        precision: str = "float32",
        data: mnist.Mnist | Sequence[mnist.Mnist] | None = None,
    ) -> None:
        self.config, self.seeds, self.path = of_type(Config, config, "config"), rng.check_seeds(seeds), path
        self.device = torch.device(device)
        self.compute = precision_dtype(precision)
        if data is None and config.pool_kind != "clean":
            raise ValueError(
                f"the pool of this config is {config.pool_kind}, not MNIST as it is: give the data of each seed, "
                "task_of(config, seed, mnist.load()).data"
            )
        data = data or mnist.load()
        self.data = [data] * len(self.seeds) if isinstance(data, mnist.Mnist) else list(data)
        on_device = {id(d): (d.train_images.to(device), d.train_labels.to(device)) for d in self.data}
        self.images, self.labels = zip(*(on_device[id(d)] for d in self.data), strict=True)
        self.round = -1
        self.scored = 0
        #: Whether each point has weight draws of its own.
        self.draws_per_point = config.masks_per_image

    def fit(self, labelled: Int[Tensor, "R n"]) -> None:
        """Train new networks on the given training points: Adam, fresh weight draws in every step.

        Raises:
            ValueError: if there are not as many rows as replicas.
        """
        if len(labelled) != len(self.seeds):
            raise ValueError(f"expected labelled points [R, n] of {len(self.seeds)} replicas, got {len(labelled)}")
        self.round, self.scored = self.round + 1, 0
        config = self.config
        images, labels = gather(self.images, labelled), gather(self.labels, labelled)
        if config.pool_kind == "irrelevant":  # what teaches nothing takes no part; units are of one replica
            images, labels = images[:, labels[0] != NO_LABEL], labels[:, labels[0] != NO_LABEL]
        size = labels.shape[1]
        self.network = BayesianCNN(
            self.seeds,
            *self.path,
            self.round,
            kernel=config.kernel,
            blocks=2 if config.four_convolutions_at_start and self.round == 0 else 1,
            drop=config.drop,
            initialisation=config.initialisation,
            compute=self.compute,
        ).to(self.device)
        adam = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate, fused=True)
        replicas = torch.arange(len(self.seeds), device=self.device)[:, None]
        for step, order in enumerate(self._minibatches(size)):
            masks = self.network.draw(order.shape[1], "fit", *self.path, self.round, step)
            log_probs = self.network(images[replicas, order], masks)
            # The mean over a minibatch of each replica; replicas add up, so that their gradients stay apart.
            errors = F.nll_loss(log_probs.flatten(0, 1), labels[replicas, order].flatten(), reduction="sum")
            penalty = config.decay / size * self.network.weights[0].square().sum()
            adam.zero_grad(set_to_none=True)
            (errors / order.shape[1] + penalty).backward()
            adam.step()

    def _minibatches(self, size: int) -> Iterator[Int[Tensor, "R B"]]:
        path = ("data", *self.path, self.round)
        for epoch in range(self.config.epochs):
            order = rng.stacked(lambda g: torch.randperm(size, generator=g), self.seeds, *path, epoch).to(self.device)
            if self.config.even_minibatches:
                yield from order.tensor_split(-(-size // self.config.batch), 1)
            else:
                yield from order.split(self.config.batch, 1)

    @torch.inference_mode()
    def log_probs(self, candidates: Int[Tensor, "R M"], draws: int) -> Float[Tensor, "R S M 10"]:
        """Return log-probabilities of training points under ``draws`` weight draws; 0: the deterministic pass."""
        return self._predict(
            [gather(self.images, part) for part in candidates.to(self.device).split(EVALUATION_BATCH, 1)], draws
        )

    def _predict(self, batches: Sequence[Float[Tensor, "R B 28 28"]], draws: int) -> Float[Tensor, "R S M 10"]:
        network = self.network
        features = torch.cat([network.features(batch) for batch in batches], 1)
        if draws == 0:
            return network.head(features)[:, None]
        count = features.shape[1] if self.config.masks_per_image else 1
        block = self.scored if self.config.masks_per_image else 0
        self.scored += 1
        path = ("predict", *self.path, self.round, block)
        return torch.stack([network.head(features, network.draw(count, *path, draw)) for draw in range(draws)], 1)

    @torch.inference_mode()
    def test_error(self, draws: int = 0) -> Float[np.ndarray, " R"]:
        """Return the test error in %, with weight scaling (``draws=0``) or averaged over weight draws."""
        wrong = torch.zeros(len(self.seeds))
        data, tested = self.data[0], self.config.tested  # the test set is the same for all
        labels = data.test_labels[:tested].to(self.device)
        for images, truth in zip(
            data.test_images[:tested].split(EVALUATION_BATCH), labels.split(EVALUATION_BATCH), strict=True
        ):
            batch = images.to(self.device).expand(len(self.seeds), -1, -1, -1)
            mean = self._predict([batch], draws).double().logsumexp(1)
            wrong += (mean.argmax(-1) != truth).sum(1).cpu()
        return (100 * wrong / len(labels)).numpy()


class Ensemble:
    """Networks trained on the same points from different streams; one deterministic pass of each is a draw.

    They are the yardstick of the field for weight draws that cost one training. Only the scores are the ensemble's. The
    test error is that of the first member, since an ensemble predicts better than one network whatever points it was
    trained on.
    """

    classes = CLASSES

    def __init__(self, members: Sequence[CNNLearner]) -> None:
        self.members, self.round = members, -1

    def fit(self, labelled: Int[Tensor, "R n"]) -> None:
        """Train every member from scratch."""
        for member in self.members:
            member.round = self.round
            member.fit(labelled)
        self.round += 1

    def log_probs(self, candidates: Int[Tensor, "R M"], draws: int) -> Float[Tensor, "R S M 10"]:
        """Return log-probabilities under each of the S members; ``draws`` has no say."""
        return torch.cat([member.log_probs(candidates, 0) for member in self.members], 1)

    def test_error(self, draws: int = 0) -> Float[np.ndarray, " R"]:
        """Return the test error of the first member in %, see ``CNNLearner.test_error``."""
        return self.members[0].test_error(draws)


def gather(arrays: Sequence[Tensor], indices: Int[Tensor, "R n"]) -> Tensor:
    """Return the entries [R, n, ...] at each replica's indices in its own array."""
    return torch.stack([array[chosen] for array, chosen in zip(arrays, indices.to(arrays[0].device), strict=True)])


class ActiveLearning:
    """One row of the tables for R seeds, as a resumable process: step r trains on 20 + 10 r labels and acquires."""

    def __init__(
        self,
        config: Config,
        seeds: Sequence[int],
        *,
        device: str = "cpu",
        precision: str = "bfloat16",
        data: mnist.Mnist | None = None,
    ) -> None:
        self.config, self.seeds = of_type(Config, config, "config"), rng.check_seeds(seeds)
        self.tasks = [task_of(config, seed, data or mnist.load()) for seed in self.seeds]
        options: dict[str, Any] = {"device": device, "precision": precision, "data": [task.data for task in self.tasks]}
        self.learner: CNNLearner | Ensemble = CNNLearner(config, self.seeds, **options)
        if config.approximation == "ensemble":
            others = [CNNLearner(config, self.seeds, "member", m, **options) for m in range(1, config.members)]
            self.learner = Ensemble([self.learner, *others])
        self.pools = [Pool(t.split.initial, t.split.pool[: config.random_from]) for t in self.tasks]
        self.labels = self._growth()
        self.total, self.done = len(self.labels), 0
        replicas, shape = len(self.seeds), (len(self.seeds), self.total - 1)
        self.error = np.full((replicas, self.total), np.nan, np.float32)
        self.mc_error = np.full((replicas, self.total), np.nan, np.float32)
        self.tied, self.all_tied = np.zeros(shape, np.int32), np.zeros(shape, bool)

    def _growth(self) -> Int[np.ndarray, " T"]:
        """Return the number of labels at each step: rounds are as large as the candidates, and end with the pool."""
        config, pool = self.config, self.pools[0]
        size, subset = len(pool.all), None if config.acquisition == "random" else config.subset
        each = min(config.acquired, size, subset or size)
        most = config.rounds * each if config.replacement else size
        grown = np.unique(np.minimum(each * np.arange(config.rounds + 1), most))
        return (len(pool.labelled) + grown).astype(np.int32)

    def advance(self) -> str:
        """Train on what is labelled, measure the test error, and acquire the next points."""
        config, r = self.config, self.done
        self.learner.round = r - 1
        self.learner.fit(torch.stack([pool.labelled for pool in self.pools]))
        self.error[:, r] = self.learner.test_error()
        if config.mc_test_every and r % config.mc_test_every == 0:
            self.mc_error[:, r] = self.learner.test_error(config.draws)
        if r + 1 < self.total:
            self._acquire(r)
        self.done += 1
        return f"{self.pools[0].labelled.shape[0]} labels, error {self.error[:, r].mean():.2f} %"

    def _acquire(self, r: int) -> None:
        config = self.config
        draws = config.draws if config.approximation == "dropout" else 0
        # The row's name is part of the stream: rows whose scores all tie are independent random acquisitions.
        names = ("policy", config.approximation, config.acquisition, r)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="all scores are equal")  # kept in the record instead
            selections = acquire(
                self.learner,
                self.pools,
                config.acquisition,
                config.acquired,
                draws=draws,
                generators=[rng.generator(seed, *names) for seed in self.seeds],
                subset=None if config.acquisition == "random" else config.subset,
                replace=config.replacement,
            )
        self.tied[:, r] = [selection.tied for selection in selections]
        self.all_tied[:, r] = [selection.all_tied for selection in selections]

    def state(self) -> dict[str, Any]:
        """Return what a killed run continues from: the acquired points and the measurements so far."""
        acquired = [pool.labelled[self.labels[0] :] for pool in self.pools]
        return {
            "done": self.done,
            "acquired": torch.stack(acquired),
            **{k: torch.from_numpy(v) for k, v in self._measured()},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from ``state()`` of a process with the same config and seeds, itself at step 0."""
        self.done = state["done"]
        for pool, acquired in zip(self.pools, state["acquired"], strict=True):
            for indices in acquired.split(np.diff(self.labels)[: self.done].tolist()):
                pool.acquire(indices, keep=self.config.replacement)
        for name, array in self._measured():
            array[:] = state[name].numpy()

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the record.

        ``labels`` [T] number of labels; ``error`` and ``mc_error`` [R, T] test error in % (NaN: not measured);
        ``points`` [R, labels[-1]] training-set indices in the order of labelling; ``tied`` [R, T - 1] candidates that
        share the score of the last one chosen; ``all_tied`` [R, T - 1]. Where the pool is not clean, ``wasted``
        [R, T - 1] is the share of noise or repetition among the points of each round. T is 1 + rounds, or less if the
        pool runs out.
        """
        points = torch.stack([pool.labelled for pool in self.pools]).numpy().astype(np.int32)
        arrays = {"labels": self.labels, "points": points, **dict(self._measured())}
        if self.config.pool_kind != "clean":
            arrays["wasted"] = np.stack([self._wasted(*pair) for pair in zip(self.tasks, self.pools, strict=True)])
        return arrays

    def _wasted(self, task: Task, pool: Pool) -> Float[np.ndarray, " rounds"]:
        acquired = task.wasted(pool.labelled)[self.labels[0] :].float()
        rounds = acquired.split(np.diff(self.labels)[: self.done].tolist())
        return np.array([points.mean() for points in rounds], np.float32)

    def _measured(self) -> list[tuple[str, np.ndarray]]:
        return [("error", self.error), ("mc_error", self.mc_error), ("tied", self.tied), ("all_tied", self.all_tied)]


def task_of(config: Config, seed: int, data: mnist.Mnist) -> Task:
    """Return what the pool of one seed shows."""
    parts = split(
        data.train_labels,
        rng.generator(seed, "data"),
        per_class=config.per_class,
        validation=config.validation,
        pool=config.pool,
    )
    return make_task(config.pool_kind, data, parts, seed, ambiguous=config.ambiguous)


#: Makes the process of one unit.
start = ActiveLearning


def memory(config: Config) -> float:
    """Return an estimate of the bytes that a repetition takes: features and predictions of the candidates it scores."""
    side = (30 - 2 * config.kernel) // 2  # behind two convolutions and the pooling
    features, activations = 32 * side**2, 32 * 2 * 28**2
    pool = 54_980 if config.pool is None else config.pool
    candidates = 0 if config.acquisition == "random" else min(config.subset or pool, pool)
    scored = candidates * (2 * features + 3 * 10 * config.draws)
    return 4.0 * (scored + EVALUATION_BATCH * (activations + features) + 5 * 128 * features)


def _sweep(choose: Callable[[str], bool], precisions: Sequence[str], stacked: int) -> Sweep:
    """Return the sweep of some configs: one seed per unit on a CPU, which one replica keeps busy."""
    configs = {name: config for name, config in CONFIGS.items() if choose(name)}
    return Sweep(EXPERIMENT, configs, start, precisions, {"cpu": 1, "cuda": stacked}, repetitions=5, memory=memory)


def _family_of(name: str) -> str:
    return "irrelevant" if CONFIGS[name].pool_kind == "irrelevant" else name.split("/")[0]


#: What came later, and what readers wait for, runs in float32: without AVX-512 or AMX a CPU takes ten times as long for
#: bfloat16, in which the tables were made.
FLOAT32, BFLOAT16 = ("float32", "bfloat16", "float64"), ("bfloat16", "float32", "float64")
TABLES = ("ours", "early", "as-recorded", "as-written")
SWEEPS = (
    _sweep(lambda name: _family_of(name) in TABLES, BFLOAT16, 10),
    _sweep(lambda name: _family_of(name) not in (*TABLES, "irrelevant"), FLOAT32, 10),
    # What teaches nothing differs between replicas, and with it the size of their training sets: no stacking.
    _sweep(lambda name: _family_of(name) == "irrelevant", FLOAT32, 1),
)


#: The units of a named config.
units = partial(sweep.units, SWEEPS)
