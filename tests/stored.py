"""What the tests of records write."""

import json

import numpy as np

from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_hash

ARRAYS = {"error": np.arange(6, dtype=np.float32).reshape(2, 3), "points": np.array([[1, 2]], np.int32)}
CONFIG = {"rounds": 3, "drop": [0.25, 0.5]}


def header(**changes):
    return {
        "experiment": "toy", "name": "ours/a", "seeds": [100, 101], "config": CONFIG,
        "config_hash": config_hash(CONFIG), "device": "cpu", "precision": "float32",
        "provenance": {}, **changes,
    }  # fmt: skip


def rewrite(path, **changes):
    """Write the file again with another header, as somebody who edits it by hand would."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    changed = json.loads(arrays.pop(records.HEADER).tobytes()) | changes
    np.savez(path, **{records.HEADER: np.frombuffer(json.dumps(changed).encode(), np.uint8)}, **arrays)
