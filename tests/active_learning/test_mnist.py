import gzip
import shutil
from types import SimpleNamespace

import pytest
import torch

from dropout_uncertainty.active_learning import mnist

FIELDS = "train_images", "train_labels", "test_images", "test_labels"


@pytest.fixture
def folder(tmp_path):
    return shutil.copytree(mnist.data_folder(), tmp_path / "mnist")


def test_the_files_are_mnist():
    data = mnist.load()
    assert data.train_images.shape == (60_000, 28, 28)
    assert (data.train_images.min(), data.train_images.max()) == (0, 1)
    assert data.test_labels[:5].tolist() == [7, 2, 1, 0, 4]


def test_a_missing_file_is_named(folder):
    (folder / "t10k-labels-idx1-ubyte.gz").unlink()
    with pytest.raises(mnist.DataError, match=r"t10k-labels-idx1-ubyte\.gz is missing: restore it"):
        mnist.load(folder)


def test_a_truncated_file_is_named(folder):
    path = folder / "t10k-labels-idx1-ubyte.gz"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(mnist.DataError, match=r"t10k-labels-idx1-ubyte\.gz cannot be read"):
        mnist.load(folder)


def test_an_altered_file_is_named(folder):
    path = folder / "train-labels-idx1-ubyte.gz"
    content = bytearray(gzip.decompress(path.read_bytes()))
    content[100] ^= 1
    path.write_bytes(gzip.compress(bytes(content)))
    with pytest.raises(mnist.DataError, match="not the original"):
        mnist.load(folder)


def test_the_environment_names_another_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("DROPOUT_UNCERTAINTY_DATA", str(tmp_path))
    with pytest.raises(mnist.DataError, match="is missing"):
        mnist.load()


@pytest.mark.parametrize(
    ("images", "labels", "message"),
    [
        (torch.zeros(3, 32, 32), torch.arange(3), r"grey images .*got torch.float32 of shape \[3, 32, 32\]"),
        (torch.zeros(3, 3, 28, 28), torch.arange(3), r"grey images .*shape \[3, 3, 28, 28\]"),
        (torch.zeros(3, 28, 28, dtype=torch.uint8), torch.arange(3), "floating-point numbers, got torch.uint8"),
        (torch.zeros(3, 28, 28).numpy(), torch.arange(3), "as a tensor .*got float32"),
        (torch.zeros(3, 28, 28), ["a", "b", "c"], "one int64 label for each of 3 images, got <class 'list'>"),
        (torch.zeros(3, 28, 28), torch.arange(2), r"one int64 label for each of 3 .*, got torch.int64 of shape \[2\]"),
        (torch.zeros(3, 28, 28), torch.arange(3) + 8, "expected labels 0-9, got 8 to 10"),
    ],
    ids=range(7),
)  # fmt: skip
def test_other_data_are_sent_to_simulate(images, labels, message):
    blank = torch.zeros(0, 28, 28), torch.zeros(0, dtype=torch.int64)
    with pytest.raises(mnist.DataError, match=f"{message}.*`active_learning.simulate` takes"):
        # By itself, since the types of the fields are checked before it under test.
        mnist.Mnist.__post_init__(SimpleNamespace(**dict(zip(FIELDS, (images, labels, *blank), strict=True))))
