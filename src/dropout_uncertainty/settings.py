"""Settings made plain, so that equal configs have equal hashes; what is not of the type its field names is refused."""

import math
import operator
from dataclasses import fields
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

__all__ = ["tidy"]


def tidy(config: Any) -> None:
    """Make the fields of a frozen dataclass what their types say: ``int``, ``float``, ``bool``, tuples of these.

    NumPy's numbers become Python's, lists and arrays tuples, and a whole number in a field for a ``float`` one of that
    type; a field of any other type stays as it is.

    Raises:
        ValueError: if a whole number is not whole, a number is not finite, or a field is of another type.
    """
    hints = get_type_hints(type(config))
    for field in fields(config):
        object.__setattr__(config, field.name, _tidied(getattr(config, field.name), hints[field.name], field.name))


def _tidied(value: Any, kind: Any, name: str) -> Any:
    value = value.tolist() if isinstance(value, np.generic | np.ndarray) else value
    arguments = get_args(kind)
    if NoneType in arguments:
        return None if value is None else _tidied(value, arguments[0], name)
    if get_origin(kind) is tuple:
        if not isinstance(value, list | tuple):
            raise ValueError(f"{name} must be a tuple, got {value!r}")
        return tuple(_tidied(item, arguments[0], name) for item in value)
    if kind is int:
        return _whole(value, name)
    if kind is float:
        return _finite(value, name)
    if isinstance(kind, type) and not isinstance(value, kind):
        raise ValueError(f"{name} must be of type {kind.__name__}, got {value!r}")
    return value


def _whole(value: Any, name: str) -> int:
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise ValueError(f"{name} must be a whole number, got {value!r}")
    return operator.index(value)


def _finite(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return float(value)
