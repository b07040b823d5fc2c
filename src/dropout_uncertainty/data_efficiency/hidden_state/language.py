"""Masks held over a sequence, or fresh at every step: a small language model of characters, which over-fits.

Text is cut into short sequences that follow each other, and the state is carried on, as in language models of the time.
A held draw lasts for one such sequence; dropping an input drops a character wherever it stands in it. All models are
assessed by the deterministic pass on text that was not trained on.
"""

import gzip
import hashlib
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from dropout_uncertainty import folders, rng
from dropout_uncertainty.bayes import Masks
from dropout_uncertainty.data_efficiency.hidden_state.lstm import LSTM, Memory
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, on_cpu
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.settings import at_least, tidy

__all__ = ["CONFIGS", "MASKS", "Language", "LanguageConfig", "encoded", "start", "text"]

FILE = Path("python-topics", "topics.txt.gz")
#: SHA-256 of the uncompressed text.
CHECKSUM = "2a95af4ac93f5b719944030ce3769070ddf827d847cba42192afa8da989e5dc4"
MASKS = ("none", "fresh", "held")


def text(path: Path | None = None) -> str:
    """Return the topics of Python's documentation, from the repository, or from beside a named folder of MNIST.

    Raises:
        UserError: if it is missing, unreadable or altered.
    """
    mnist = folders.named(folders.DATA)
    data = (folders.checkout() or Path.cwd()) / "data"
    if mnist and not (data / FILE).exists():
        data = mnist.parent
    path = path or data / FILE
    try:
        content = gzip.decompress(path.read_bytes())
    except (OSError, EOFError, zlib.error) as error:
        raise UserError(f"the text {path} cannot be read ({error}): a clone of the repository has it") from error
    if hashlib.sha256(content).hexdigest() != CHECKSUM:
        raise UserError(
            f"the text {path} is not the original (its SHA-256 differs): restore it with `git checkout data`"
        )
    return content.decode()


@lru_cache(maxsize=1)
def encoded() -> tuple[Int[Tensor, " N"], str]:
    """Return the text as numbers of characters, and the characters in order."""
    whole = text()
    alphabet = "".join(sorted(set(whole)))
    places = {character: place for place, character in enumerate(alphabet)}
    return torch.tensor([places[character] for character in whole]), alphabet


@dataclass(frozen=True)
class LanguageConfig:
    """A language model and its training."""

    masks: str  #: "none", "fresh" at every step, or "held" over a sequence.
    drop: float = 0.3  #: Drop probability of the recurrent state and before the output.
    input_drop: float = 0.1  #: Drop probability of the characters that are read.
    width: int = 64  #: Units of the layer.
    train: int = 10_000  #: Characters that are trained on: few, so that there is something to over-fit.
    test: int = 5_000  #: Characters that follow and are not trained on.
    batch: int = 20  #: Parts that the text is cut into and that are read side by side.
    length: int = 25  #: Characters of a sequence, over which gradients go back and masks are held.
    passes: int = 50  #: Times that the text is read.
    rate: float = 0.005  #: Adam's step.

    def __post_init__(self) -> None:
        tidy(self)
        if self.masks not in MASKS:
            raise ValueError(f"expected masks out of {', '.join(MASKS)}, got {self.masks!r}")
        at_least(1, width=self.width, batch=self.batch, length=self.length, passes=self.passes)
        if (least := self.batch * (self.length + 1)) > min(self.train, self.test):
            raise ValueError(
                f"train and test must be at least {least}, a sequence in each of {self.batch} parts, "
                f"got {self.train} and {self.test}"
            )


def sequences(
    characters: Int[Tensor, " N"], batch: int, length: int
) -> list[tuple[Int[Tensor, "B T"], Int[Tensor, "B T"]]]:
    """Return what is read and what comes next, sequence by sequence; row b goes on where it ended before."""
    per_row = (len(characters) - 1) // batch
    read, following = (characters[i : i + batch * per_row].view(batch, per_row) for i in (0, 1))
    return [(read[:, t : t + length], following[:, t : t + length]) for t in range(0, per_row - length + 1, length)]


class Language:
    """R language models of one text, which differ in their first weights, their masks and where the text begins."""

    def __init__(self, config: LanguageConfig, seeds: Sequence[int], dtype: torch.dtype) -> None:
        self.config, self.seeds = config, rng.check_seeds(seeds)
        self.total, self.done = config.passes, 0
        characters, alphabet = encoded()
        drop = (0.0,) * 3 if config.masks == "none" else (config.input_drop, config.drop, config.drop)
        self.net = LSTM((len(alphabet), config.width, len(alphabet)), drop, self.seeds, dtype=dtype)
        self.adam = torch.optim.Adam(self.net.parameters(), lr=config.rate, fused=True)
        rows = [self._begin(seed, len(characters)) + torch.arange(config.train + config.test) for seed in self.seeds]
        own = characters[torch.stack(rows)]
        self.train, self.test = (
            [sequences(part, config.batch, config.length) for part in parts]
            for parts in (own[:, : config.train], own[:, config.train :])
        )
        self.log = {name: torch.full((len(self.seeds), self.total), torch.nan) for name in ("train", "test")}

    def _begin(self, seed: int, count: int) -> int:
        """Return where the text of a replica begins."""
        last = count - self.config.train - self.config.test
        return int(torch.randint(last, (1,), generator=rng.generator(seed, "language", "begin")))

    def advance(self) -> str:
        """Read the training text once more, and assess on both texts."""
        memory: Memory | None = None
        for place in range(len(self.train[0])):
            loss, memory = self._loss(self.train, place, self._draw(place), memory)
            self.adam.zero_grad()
            loss.sum().backward()
            self.adam.step()
            memory = memory[0].detach(), memory[1].detach()
        for name, part in (("train", self.train), ("test", self.test)):
            self.log[name][:, self.done] = self._assess(part)
        self.done += 1
        train, test = (self.log[name][:, self.done - 1].mean().item() for name in ("train", "test"))
        return f"{train:.2f} nats a character in training, {test:.2f} in test"

    def _draw(self, place: int) -> Masks | None:
        masks, batch, length = self.config.masks, self.config.batch, self.config.length
        if masks == "none":
            return None
        return self.net.draw(batch, "train", self.done, place, steps=None if masks == "held" else length)

    def _loss(
        self, part: list, place: int, masks: Masks | None, memory: Memory | None
    ) -> tuple[Float[Tensor, " R"], Memory]:
        """Return the mean surprise of a character in one sequence [nats]."""
        read, following = (torch.stack([own[place][i] for own in part]) for i in (0, 1))
        out, memory = self.net(F.one_hot(read, self.net.sizes[0]).to(self.net.bias), masks, memory)
        surprise = F.cross_entropy(out.flatten(0, 2), following.flatten(), reduction="none")
        return surprise.view(len(part), -1).mean(1), memory

    @torch.no_grad()
    def _assess(self, part: list) -> Float[Tensor, " R"]:
        memory, losses = None, []
        for place in range(len(part[0])):
            loss, memory = self._loss(part, place, None, memory)
            losses.append(loss)
        return torch.stack(losses).mean(0)

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue."""
        return {"done": self.done, "log": self.log, "net": self.net.state_dict(), "adam": self.adam.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from `state()` of a process made with the same arguments."""
        self.done, self.log = state["done"], state["log"]
        self.net.load_state_dict(state["net"])
        self.adam.load_state_dict(state["adam"])

    def result(self) -> dict[str, np.ndarray]:
        """Return the mean surprise of a character [nats] after each pass, [R, pass], of both texts."""
        return {name: value.numpy().astype(np.float32) for name, value in self.log.items()}


CONFIGS = {f"hidden/language-{masks}": LanguageConfig(masks) for masks in MASKS}


def memory(config: LanguageConfig) -> float:
    """Return an estimate of the bytes that a repetition takes: activations of a sequence, and the inputs as vectors."""
    return 4.0 * config.batch * config.length * (config.width * 24 + 1000)


start = partial(on_cpu, Language, LanguageConfig, "language models")
SWEEPS = [Sweep(EXPERIMENT, CONFIGS, start, ("float32", "float64"), {"cpu": 5}, 5, memory)]
