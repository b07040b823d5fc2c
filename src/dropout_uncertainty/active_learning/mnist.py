"""MNIST from the four IDX files in ``data/mnist``, verified by checksum at every load."""

import gzip
import hashlib
import zlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from dropout_uncertainty import folders
from dropout_uncertainty.errors import UserError

__all__ = ["DataError", "Mnist", "data_folder", "load"]

#: SHA-256 of the uncompressed files (LeCun, Cortes and Burges), and the shape each holds.
FILES = {
    "train-images-idx3-ubyte": ("ba891046e6505d7aadcbbe25680a0738ad16aec93bde7f9b65e87a2fc25776db", (60_000, 28, 28)),
    "train-labels-idx1-ubyte": ("65a50cbbf4e906d70832878ad85ccda5333a97f0f4c3dd2ef09a8a9eef7101c5", (60_000,)),
    "t10k-images-idx3-ubyte": ("0fa7898d509279e482958e8ce81c8e77db3f2f8254e26661ceb7762c4d494ce7", (10_000, 28, 28)),
    "t10k-labels-idx1-ubyte": ("ff7bcfd416de33731a308c3f266cc351222c34898ecbeaf847f06e48f7ec33f2", (10_000,)),
}
#: What to do with other data.
OWN = "`active_learning.simulate` takes images and labels of any kind, with a classifier of your own"


class DataError(UserError):
    """A data file is missing, unreadable or altered."""


@dataclass(frozen=True)
class Mnist:
    """Images in [0, 1] (pixel / 255, not centred) and labels 0-9, or -1 for what is no digit of the task.

    Raises:
        DataError: if the images are not grey ones of 28 × 28 pixels as floating-point numbers, with one label 0-9 each.
    """

    train_images: Float[Tensor, "N 28 28"]
    train_labels: Int[Tensor, " N"]
    test_images: Float[Tensor, "M 28 28"]
    test_labels: Int[Tensor, " M"]

    def __post_init__(self) -> None:
        """Raise DataError for data that the network of section 5.2 cannot take."""
        for images, labels in ((self.train_images, self.train_labels), (self.test_images, self.test_labels)):
            if not (torch.is_tensor(images) and images.is_floating_point() and images.shape[1:] == (28, 28)):
                got = f"{getattr(images, 'dtype', type(images))} of shape {list(getattr(images, 'shape', []))}"
                raise DataError(
                    f"expected grey images as a tensor [N, 28, 28] of floating-point numbers, got {got}; {OWN}"
                )
            if not torch.is_tensor(labels) or labels.dtype != torch.int64 or labels.shape != images.shape[:1]:
                got = f"{getattr(labels, 'dtype', type(labels))} of shape {list(getattr(labels, 'shape', []))}"
                raise DataError(f"expected one int64 label for each of {len(images)} images, got {got}; {OWN}")
            if len(labels) and not -1 <= int(labels.min()) <= int(labels.max()) <= 9:
                raise DataError(f"expected labels 0-9, got {int(labels.min())} to {int(labels.max())}; {OWN}")


def data_folder() -> Path:
    """Return the folder of the data: ``DROPOUT_UNCERTAINTY_DATA`` if set, else ``data/mnist`` of the repository."""
    return folders.named(folders.DATA) or (folders.checkout() or Path.cwd()) / "data" / "mnist"


def read_idx(path: Path) -> np.ndarray:
    """Return the unsigned bytes of one gzipped IDX file in their shape.

    Raises:
        DataError: if the file is missing, truncated or not the one that ``FILES`` names.
    """
    checksum, shape = FILES[path.name.removesuffix(".gz")]
    restore = "restore it with `git checkout data/mnist`, or " if folders.checkout() else ""
    remedy = f"{restore}name a folder that has it with {folders.DATA}"
    try:
        content = gzip.decompress(path.read_bytes())
    except FileNotFoundError:
        raise DataError(f"the MNIST file {path} is missing: {remedy}") from None
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(f"the MNIST file {path} cannot be read ({error}): {remedy}") from error
    if hashlib.sha256(content).hexdigest() != checksum:
        raise DataError(f"the MNIST file {path} is not the original (its SHA-256 differs): {remedy}")
    header = 4 + 4 * len(shape)
    return np.frombuffer(content, np.uint8, offset=header).reshape(shape)


@lru_cache(maxsize=1)
def _load(folder: Path) -> Mnist:
    arrays = [torch.from_numpy(read_idx(folder / f"{name}.gz").copy()) for name in FILES]
    train_images, train_labels, test_images, test_labels = arrays
    return Mnist(train_images / 255, train_labels.long(), test_images / 255, test_labels.long())


def load(folder: Path | str | None = None) -> Mnist:
    """Return MNIST from ``folder`` (by default ``data_folder()``).

    Raises:
        DataError: if a file is missing, truncated or altered; the message says which and what to do.
    """
    return _load(folders.existing(Path(folder) if folder is not None else data_folder(), folders.DATA, "data"))
