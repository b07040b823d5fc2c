"""Checkpoints: files that are written as a whole and carry a checksum, so that what is read is what was written."""

import hashlib
import io
import os
import pickle
from pathlib import Path
from typing import Any

import torch

__all__ = ["OtherVersion", "load", "save"]

LENGTH = hashlib.sha256().digest_size


class OtherVersion(ValueError):
    """A checkpoint is intact, but not of this version."""


def save(path: Path, content: dict[str, Any]) -> None:
    """Write a checkpoint beside ``path`` and move it into place, so that a kill leaves the old one or the new one."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    temporary = path.with_name(f"{path.name}.tmp")
    with open(temporary, "wb") as file:
        file.write(hashlib.sha256(buffer.getvalue()).digest() + buffer.getvalue())
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def load(path: Path) -> dict[str, Any]:
    """Return the content of a checkpoint.

    Raises:
        ValueError: if it is damaged.
        OtherVersion: if it was written by a version that kept other types in it.
    """
    stored = path.read_bytes()
    if hashlib.sha256(stored[LENGTH:]).digest() != stored[:LENGTH]:
        raise ValueError(f"{path} is damaged, or no checkpoint")
    try:
        return torch.load(io.BytesIO(stored[LENGTH:]), weights_only=True)
    except pickle.UnpicklingError:
        raise OtherVersion(f"the checkpoint {path} is of a version that kept other things in it") from None
