import gzip
import shutil

import pytest

from dropout_uncertainty.active_learning import mnist


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
