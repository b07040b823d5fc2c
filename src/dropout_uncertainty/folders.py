"""Where things are: the checkout, the records and the data.

``DROPOUT_UNCERTAINTY_RECORDS`` and ``DROPOUT_UNCERTAINTY_DATA`` name other folders. Relative names are made absolute in
the environment when the package is imported: notebooks and workers, which run elsewhere, find the same folders there.
"""

import contextlib
import os
from pathlib import Path

from dropout_uncertainty.errors import UserError

RECORDS, DATA = "DROPOUT_UNCERTAINTY_RECORDS", "DROPOUT_UNCERTAINTY_DATA"


def resolve() -> None:
    """Make the folders that the environment names absolute, seen from the current one."""
    for variable in (RECORDS, DATA):
        if value := os.environ.get(variable):
            with contextlib.suppress(OSError, RuntimeError):  # the current folder is gone, or there is no such user
                os.environ[variable] = str(Path(value).expanduser().absolute())


def named(variable: str) -> Path | None:
    """Return the folder that a variable of the environment names, None if it names none."""
    value = os.environ.get(variable)
    return Path(value) if value else None


def checkout() -> Path | None:
    """Return the clone of the repository that this package runs from, None if it is installed elsewhere."""
    folder = Path(__file__).resolve().parents[2]
    return folder if (folder / "_config.yml").exists() else None


def existing(folder: Path, variable: str, what: str) -> Path:
    """Return ``folder``; raises UserError, saying how another one is named, if it is not there."""
    if not folder.is_dir():
        source = "as named by" if named(variable) == folder else "a clone of the repository has them; name theirs with"
        raise UserError(f"there is no folder {folder} of {what} ({source} {variable})")
    return folder


def create(folder: Path) -> None:
    """Make sure that there is a folder; raises UserError if it cannot be made."""
    if not folder.is_absolute():  # `resolve` could not make sense of it
        raise UserError(f"cannot tell where the folder {folder} is: name it from / on")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {folder}: {error.strerror or error}") from None
