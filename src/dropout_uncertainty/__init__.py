"""A checkable reproduction of the applications of dropout uncertainty (chapter 5 of *Uncertainty in Deep Learning*)."""

from importlib.metadata import version

from dropout_uncertainty.folders import resolve

__all__ = ["__version__"]

__version__ = version("dropout-uncertainty")
resolve()
