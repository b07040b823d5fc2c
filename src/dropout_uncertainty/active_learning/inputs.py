"""What users pass without thinking, made into tensors: arrays, lists, data frames, any precision, any device."""

import operator

import numpy as np
import torch
from jaxtyping import Int
from numpy.typing import ArrayLike
from torch import Tensor


def numbers(given: ArrayLike, what: str) -> Tensor:
    """Return real numbers as a tensor without gradient; a tensor keeps its device and precision.

    Raises:
        ValueError: if they are no real numbers, or rows of unequal lengths; ``what`` says what was expected.
    """
    if np.ma.is_masked(given):
        raise ValueError(f"expected {what} without masked values: fill them or leave those points out")
    try:
        tensor = given.detach() if isinstance(given, Tensor) else torch.from_numpy(_array(given))
    except (TypeError, ValueError, RuntimeError):
        tensor = None
    if tensor is None or tensor.is_complex():
        raise ValueError(f"expected {what} as real numbers in one array, got {_kind(given)}") from None
    return tensor


def _array(given: ArrayLike) -> np.ndarray:
    """Return a copy, since torch takes neither negative strides nor read-only memory, nor the bytes of other machines.

    Columns of a data frame that have several types become floats.
    """
    array = np.array(given)
    if array.dtype == object and (to_numpy := getattr(given, "to_numpy", None)):
        array = to_numpy(float)
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def indices(given: ArrayLike, what: str) -> Int[Tensor, " n"]:
    """Return indices into a data set, given as such or as a mask over it.

    Raises:
        ValueError: if they are not integers of at least 0 in one row; ``what`` says what was expected.
    """
    tensor = numbers(given, what).cpu()
    if tensor.ndim != 1 or (tensor.is_floating_point() and len(tensor)):
        raise ValueError(f"expected {what} as a row of indices or a mask, got {_kind(given)}")
    tensor = tensor.nonzero().flatten() if tensor.dtype == torch.bool else tensor.long()
    if (tensor < 0).any():
        raise ValueError(f"expected {what} as indices that count from 0, got {int(tensor.min())}")
    return tensor


def whole(given: int, what: str, least: int = 1) -> int:
    """Return a whole number; raises ValueError if it is none or below ``least``."""
    try:
        number = least - 1 if isinstance(given, bool) else operator.index(given)
    except TypeError:
        number = least - 1
    if number < least:
        raise ValueError(f"{what} is a whole number of at least {least}, got {given!r}")
    return number


def _kind(given: ArrayLike) -> str:
    shape = getattr(given, "shape", None)
    kind = type(given).__name__  # a sparse matrix has a dtype too
    if isinstance(given, np.ndarray | np.generic | Tensor):
        kind = str(given.dtype)
    return f"{kind} of shape {list(shape)}" if shape is not None else f"a {kind}"
