"""Named random streams: every number that a learner or a world draws in a run comes from a generator made here.

NumPy draws the rest, from generators of its own with a fixed seed: the first inducing inputs of PILCO
(`gaussian_process.initial_inducing`), the resamples of intervals (`stats`) and which records are recomputed
(`recompute.choose`). Gymnasium environments draw from their own ``np_random``.

A stream is a pure function of a seed and a path of names and counters, such as ``generator(3, "masks", 17)``. Nothing
has to be saved to continue a killed run, since a counter in the path says how far it had come, and no function touches
the global random state.
"""

import hashlib
import operator
from collections.abc import Callable, Iterable
from typing import SupportsIndex

import torch
from torch import Generator, Tensor


def generator(seed: SupportsIndex, *path: str | SupportsIndex, device: str | torch.device = "cpu") -> Generator:
    """Return the generator of one stream, another one for every (seed, path).

    PyTorch's generator on the CPU takes 32 bits of a seed, so two streams are the same with a chance of 2^-32.

    ``path`` names the purpose ("init", "data", "masks", "policy", "environment") and, where a run draws in blocks, the
    number of the block. The same arguments give the same stream on the same device type.

    Raises:
        ValueError: if ``seed`` is not an integer of at least 0.
    """
    return Generator(device=device).manual_seed(derived(seed, *path))


def derived(seed: SupportsIndex, *path: str | SupportsIndex) -> int:
    """Return the seed of a part, such as a network of an ensemble, that has streams of its own.

    Raises:
        ValueError: if ``seed`` is not an integer of at least 0.
    """
    if isinstance(seed, bool) or not isinstance(seed, SupportsIndex) or operator.index(seed) < 0:
        raise ValueError(f"a seed is an integer of at least 0, got {seed!r}")
    # Integers of NumPy have another name than Python's: the same numbers must give the same stream.
    parts = tuple(part if isinstance(part, str) else operator.index(part) for part in (seed, *path))
    # Hashing, rather than seed + counter, keeps streams apart whose seeds and counters are close.
    digest = hashlib.sha256(repr(parts).encode()).digest()
    return int.from_bytes(digest[:8], "little")


def check_seeds(seeds: Iterable[SupportsIndex]) -> tuple[int, ...]:
    """Return the seeds of some replicas as plain integers.

    Raises:
        ValueError: if there are none, one is no integer of at least 0, or one comes twice.
    """
    try:
        seeds = list(seeds)
        plain = tuple(map(operator.index, seeds))
    except TypeError:
        raise ValueError(f"expected seeds as a list of integers, got {seeds!r}") from None
    if not plain or min(plain) < 0 or len(set(plain)) < len(plain) or any(isinstance(seed, bool) for seed in seeds):
        raise ValueError(f"expected at least one seed, each 0 or more and once only, got {seeds}")
    return plain


def stacked(
    draw: Callable[[Generator], Tensor], seeds: Iterable[int], *path: str | int, device: str | torch.device = "cpu"
) -> Tensor:
    """Return ``draw`` applied to the stream of each replica, stacked to shape [R, ...].

    A replica gets the same numbers alone as among others, because each seed has streams of its own.
    """
    return torch.stack([draw(generator(seed, *path, device=device)) for seed in seeds])


def normal(seeds: Iterable[int], shape: tuple[int, ...], *path: str | int) -> Tensor:
    """Return standard normal numbers of the streams of each replica, ``[R, *shape]`` in float64."""
    return stacked(lambda g: torch.randn(shape, dtype=torch.float64, generator=g), seeds, *path)


def uniform(seeds: Iterable[int], shape: tuple[int, ...], *path: str | int) -> Tensor:
    """Return uniform numbers in [0, 1) of the streams of each replica, ``[R, *shape]`` in float64."""
    return stacked(lambda g: torch.rand(shape, dtype=torch.float64, generator=g), seeds, *path)
