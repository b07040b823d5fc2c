"""The experiment of thesis section 5.2: grow a training set of MNIST digits from 20 to 1000 labels.

One unit of work is one row of Tables 5.1 and 5.2 (an acquisition function and an approximation) for one or more seeds.
Each acquisition round is one step. A round trains a new network from streams named by seed and round, so a run that was
killed continues from the list of acquired points alone and ends with the same arrays.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning import mnist
from dropout_uncertainty.active_learning.acquisition import ACQUISITIONS
from dropout_uncertainty.active_learning.loop import acquire
from dropout_uncertainty.active_learning.network import CLASSES, BayesianCNN
from dropout_uncertainty.active_learning.pool import Pool, split
from dropout_uncertainty.runs import Unit, precision_dtype

__all__ = ["CONFIGS", "EXPERIMENT", "ROWS", "ActiveLearning", "CNNLearner", "Config", "start", "units"]

EXPERIMENT = "active_learning"
#: Images that go through the network at a time when nothing is learned; bounds the memory.
EVALUATION_BATCH = 1_000


@dataclass(frozen=True)
class Config:
    """Everything that decides the science of one row; `script` means the original program of that row."""

    acquisition: str = "random"
    """Acquisition function: "random" or a name in ``acquisition.ACQUISITIONS`` (thesis 5.2)."""
    approximation: str = "dropout"
    """What scores the pool: "dropout" (MC dropout) or "softmax" (one deterministic pass) (thesis 5.2)."""
    kernel: int = 4
    """Side of the convolution kernels in pixels (thesis 5.2: 4; scripts of Random and Softmax Max Entropy: 3)."""
    drop: tuple[float, float] = (0.25, 0.5)
    """Drop probabilities after the pooling and after the dense layer (thesis 5.2)."""
    decay: float = 2.5
    """c of the penalty (c / N) Σ w² on the weights of the dense layer (not in the thesis; scripts: 2.5 or 3.5)."""
    initialisation: str = "keras-0.3"
    """Rule of the initial weights (not in the thesis; scripts: the Glorot rule as Keras 0.3.1 computes it)."""
    four_convolutions_at_start: bool = False
    """Whether the network on the 20 initial labels has a second block of two convolutions (scripts: yes)."""
    epochs: int = 50
    """Passes over the labelled points in each round (not in the thesis; scripts: 50)."""
    batch: int = 128
    """Labelled points per step of Adam (not in the thesis; scripts: 128)."""
    learning_rate: float = 1e-3
    """Of Adam, with its usual constants (not in the thesis; scripts: 0.001)."""
    draws: int = 100
    """Weight draws S that score a pool point (not in the thesis; scripts: 100)."""
    masks_per_image: bool = False
    """Whether each image has masks of its own (scripts), or all share a draw, which is then a draw of the weights."""
    per_class: int = 2
    """Initial labelled points per class; 2 gives 20 labels (thesis 5.2)."""
    validation: int = 5_000
    """Points held out for validation; unused by the scripts too (thesis 5.2)."""
    pool: int | None = 40_000
    """Points in the pool; None: all that is left, 54,980 (thesis 5.2). Scripts: 40,000."""
    subset: int | None = 2_000
    """Random candidates scored in each round; None: the whole pool (thesis 5.2). Scripts: 2,000."""
    random_from: int | None = None
    """Random acquisition reaches only the first so many pool points (script of Random: 38,000); None: all."""
    replacement: bool = False
    """Whether acquired points stay in the pool (script of Random: yes)."""
    acquired: int = 10
    """Points labelled in each round (thesis 5.2)."""
    rounds: int = 98
    """Acquisition rounds (thesis 5.2: 100; scripts: 98, which ends at 1000 labels)."""
    mc_test_every: int = 0
    """Rounds between test errors averaged over ``draws`` weight draws; 0: never. The thesis uses weight scaling."""

    def __post_init__(self) -> None:
        """Raise ValueError where a setting cannot be run."""
        if self.acquisition != "random" and self.acquisition not in ACQUISITIONS:
            names = ", ".join(["random", *ACQUISITIONS])
            raise ValueError(f"unknown acquisition function {self.acquisition!r}, choose one of {names}")
        if self.approximation not in ("dropout", "softmax"):
            raise ValueError(f"unknown approximation {self.approximation!r}, choose dropout or softmax")
        for name in ("epochs", "batch", "draws", "per_class", "acquired"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.rounds < 0 or self.validation < 0 or (self.subset is not None and self.subset < 1):
            raise ValueError("rounds and validation must be at least 0, and subset at least 1 or None")


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

#: Small enough to compute every row while a reader waits: 20 to 180 labels, fewer candidates and draws.
QUICK = replace(OURS, rounds=8, acquired=20, draws=20, subset=1_000)


def _family(name: str, base: Config) -> dict[str, Config]:
    return {
        f"{name}/{row}": replace(base, approximation=approximation, acquisition=acquisition)
        for row, (approximation, acquisition) in ROWS.items()
    }


#: Named configs, "family/row".
CONFIGS: dict[str, Config] = {
    **_family("ours", OURS),
    "ours/random": replace(OURS, acquisition="random", mc_test_every=7),
    "ours/random-without-dropout": replace(OURS, acquisition="random", drop=(0.0, 0.0)),
    **_family("as-recorded", AS_RECORDED),
    "as-recorded/random": replace(AS_RECORDED_3X3, random_from=38_000, replacement=True),
    "as-recorded/softmax/max-entropy": replace(
        AS_RECORDED_3X3, approximation="softmax", acquisition="max-entropy", subset=None
    ),
    **_family("as-written", AS_WRITTEN),
    **_family("quick", QUICK),
}


class CNNLearner:
    """R Bayesian CNNs on MNIST, retrained from scratch in every round (a ``loop.Learner``).

    Attributes:
        network: the networks of the last ``fit``.
    """

    network: BayesianCNN
    classes = CLASSES

    def __init__(
        self,
        config: Config,
        seeds: Sequence[int],
        *,
        device: str = "cpu",
        precision: str = "float32",
        data: mnist.Mnist | None = None,
    ) -> None:
        self.config, self.seeds, self.device = config, tuple(seeds), torch.device(device)
        self.compute = precision_dtype(precision)
        self.data = data or mnist.load()
        self.images = self.data.train_images.to(self.device)
        self.labels = self.data.train_labels.to(self.device)
        self.round = -1
        self.scored = 0

    def fit(self, labelled: Int[Tensor, "R n"]) -> None:
        """Train new networks on the given training points: Adam, fresh weight draws in every step."""
        self.round, self.scored = self.round + 1, 0
        config, size = self.config, labelled.shape[1]
        self.network = BayesianCNN(
            self.seeds,
            self.round,
            kernel=config.kernel,
            blocks=2 if config.four_convolutions_at_start and self.round == 0 else 1,
            drop=config.drop,
            initialisation=config.initialisation,
            compute=self.compute,
        ).to(self.device)
        adam = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate, fused=True)
        images, labels = self.images[labelled], self.labels[labelled]
        replicas = torch.arange(len(self.seeds), device=self.device)[:, None]
        for step, order in enumerate(self._minibatches(size)):
            masks = self.network.draw(order.shape[1], "fit", self.round, step)
            log_probs = self.network(images[replicas, order], masks)
            # The mean over a minibatch of each replica; replicas add up, so that their gradients stay apart.
            errors = F.nll_loss(log_probs.flatten(0, 1), labels[replicas, order].flatten(), reduction="sum")
            penalty = config.decay / size * self.network.weights[0].square().sum()
            adam.zero_grad(set_to_none=True)
            (errors / order.shape[1] + penalty).backward()
            adam.step()

    def _minibatches(self, size: int) -> Iterator[Int[Tensor, "R B"]]:
        for epoch in range(self.config.epochs):
            order = rng.stacked(lambda g: torch.randperm(size, generator=g), self.seeds, "data", self.round, epoch)
            yield from order.to(self.device).split(self.config.batch, 1)

    @torch.inference_mode()
    def log_probs(self, candidates: Int[Tensor, "R M"], draws: int) -> Float[Tensor, "R S M 10"]:
        """Return log-probabilities of training points under ``draws`` weight draws; 0: the deterministic pass."""
        return self._predict(
            [self.images[part] for part in candidates.to(self.device).split(EVALUATION_BATCH, 1)], draws
        )

    def _predict(self, batches: Sequence[Float[Tensor, "R B 28 28"]], draws: int) -> Float[Tensor, "R S M 10"]:
        network = self.network
        features = torch.cat([network.features(batch) for batch in batches], 1)
        if draws == 0:
            return network.head(features)[:, None]
        count = features.shape[1] if self.config.masks_per_image else 1
        block = self.scored if self.config.masks_per_image else 0
        self.scored += 1
        return torch.stack(
            [network.head(features, network.draw(count, "predict", self.round, block, draw)) for draw in range(draws)],
            1,
        )

    @torch.inference_mode()
    def test_error(self, draws: int = 0) -> Float[np.ndarray, " R"]:
        """Return the test error in %, with weight scaling (``draws=0``) or averaged over weight draws."""
        wrong = torch.zeros(len(self.seeds))
        labels = self.data.test_labels.to(self.device)
        for images, truth in zip(
            self.data.test_images.split(EVALUATION_BATCH), labels.split(EVALUATION_BATCH), strict=True
        ):
            batch = images.to(self.device).expand(len(self.seeds), -1, -1, -1)
            mean = self._predict([batch], draws).double().logsumexp(1)
            wrong += (mean.argmax(-1) != truth).sum(1).cpu()
        return (100 * wrong / len(labels)).numpy()


class ActiveLearning:
    """One row of the tables for R seeds, as a resumable process: step r trains on 20 + 10 r labels and acquires."""

    def __init__(
        self, config: Config, seeds: Sequence[int], *, device: str, precision: str, data: mnist.Mnist | None = None
    ) -> None:
        self.config, self.seeds = config, tuple(seeds)
        self.learner = CNNLearner(config, seeds, device=device, precision=precision, data=data)
        splits = [
            split(
                self.learner.data.train_labels,
                rng.generator(seed, "data"),
                per_class=config.per_class,
                validation=config.validation,
                pool=config.pool,
            )
            for seed in seeds
        ]
        self.pools = [Pool(s.initial, s.pool[: config.random_from]) for s in splits]
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
        share the score of the last one chosen; ``all_tied`` [R, T - 1]. T is 1 + rounds, or less if the pool runs out.
        """
        points = torch.stack([pool.labelled for pool in self.pools]).numpy().astype(np.int32)
        return {"labels": self.labels, "points": points, **dict(self._measured())}

    def _measured(self) -> list[tuple[str, np.ndarray]]:
        return [("error", self.error), ("mc_error", self.mc_error), ("tied", self.tied), ("all_tied", self.all_tied)]


def start(config: Config, seeds: Sequence[int], *, device: str = "cpu", precision: str = "bfloat16") -> ActiveLearning:
    """Return the process of one unit, at its first step."""
    return ActiveLearning(config, seeds, device=device, precision=precision)


def units(name: str, seeds: Sequence[int], *, device: str = "cpu", precision: str = "bfloat16") -> list[Unit]:
    """Return the units of a named config: one per seed on a CPU, one of all seeds stacked on a GPU."""
    groups = [tuple(seeds)] if device == "cuda" else [(seed,) for seed in seeds]
    return [Unit(EXPERIMENT, name, start, CONFIGS[name], group, device, precision) for group in groups]
