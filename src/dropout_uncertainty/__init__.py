"""A checkable reproduction of the applications of dropout uncertainty (chapter 5 of *Uncertainty in Deep Learning*)."""

from typing import Any

from dropout_uncertainty.environments import announce
from dropout_uncertainty.folders import resolve

__all__ = ["__version__"]

resolve()
announce()


def __getattr__(name: str) -> Any:
    if name == "__version__":  # looked up when asked for: reading the metadata of packages takes long
        from importlib.metadata import version

        return version("dropout-uncertainty")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
