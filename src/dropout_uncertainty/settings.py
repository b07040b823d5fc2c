"""Settings made plain, so that equal configs have equal hashes; what is of another type or does nothing is refused.

The hash of a config is part of what its records are known by, so what it is taken of must not change.
"""

import hashlib
import json
import math
import operator
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

#: Equal to no value of a config.
_NEVER = object()


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


def of_type(kind: type, value: Any, name: str) -> Any:
    """Return the value; raises ValueError if it is of another type than ``kind``."""
    if not isinstance(value, kind):
        make = f", make one by {kind.__name__}(...) or dataclasses.replace" if is_dataclass(kind) else ""
        raise ValueError(f"{name} must be of type {kind.__name__}, got {value!r}{make}")
    return value


def at_least(low: int, **settings: int | float) -> None:
    """Raise ValueError, which names the setting, if one is below a number."""
    for name, value in settings.items():
        if value < low:
            raise ValueError(f"{name} must be at least {low}, got {value}")


def positive(**settings: int | float) -> None:
    """Raise ValueError, which names the setting, if one is not above 0."""
    for name, value in settings.items():
        if value <= 0:
            raise ValueError(f"{name} must be positive, got {value}")


def idle(config: Any, names: Iterable[str], why: str) -> None:
    """Raise ValueError if one of these settings of a dataclass, which do nothing because of ``why``, was set."""
    for field in fields(config):
        value = getattr(config, field.name)
        default = field.default if field.default_factory is MISSING else field.default_factory()
        if field.name in names and value != default:
            raise ValueError(f"{field.name} does nothing here: {why}; leave it at {default!r}, got {value!r}")


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
    return of_type(kind, value, name) if isinstance(kind, type) else value


def _whole(value: Any, name: str) -> int:
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise ValueError(f"{name} must be a whole number, got {value!r}")
    return operator.index(value)


def _finite(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return float(value)


def widened(kind: type, config: Any, **changes: Any) -> Any:
    """Return a config of a kind that extends that of another, with the values of the other where nothing is changed."""
    return kind(**{f.name: getattr(config, f.name) for f in fields(config)} | changes)


def config_dict(config: Any) -> dict[str, Any]:
    """Return a config dataclass (or mapping) as plain JSON data.

    A field that was added after records had been published carries ``metadata={"before": value}`` and is left out
    while it has that value, the one that the code knew before: those records keep their config and its hash.
    """
    return json.loads(json.dumps(_plain(config)))


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        kept = [f for f in fields(value) if getattr(value, f.name) != f.metadata.get("before", _NEVER)]
        return {f.name: _plain(getattr(value, f.name)) for f in kept}
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def config_hash(config: Any) -> str:
    """Return 16 hexadecimal digits that identify the content of a config."""
    return hashlib.sha256(json.dumps(config_dict(config), sort_keys=True).encode()).hexdigest()[:16]


def config_diff(first: Any, second: Any) -> list[tuple[str, Any, Any]]:
    """Return (field, value in first, value in second) for every field in which two configs differ."""
    one, two = ({**_before(first), **_before(second), **config_dict(config)} for config in (first, second))
    return [(key, one.get(key), two.get(key)) for key in dict.fromkeys([*one, *two]) if one.get(key) != two.get(key)]


def _before(config: Any) -> dict[str, Any]:
    """Return the values at which later fields of a config are left out."""
    if not is_dataclass(config) or isinstance(config, type):
        return {}
    return {f.name: _plain(f.metadata["before"]) for f in fields(config) if "before" in f.metadata}
