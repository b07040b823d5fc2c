"""The examples run as they stand, at small sizes, each in a process and a folder of its own."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name, *arguments, folder, answers=""):
    """Return the lines that an example prints."""
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *arguments]
    env = {**os.environ, "OMP_NUM_THREADS": "1"}
    outcome = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=folder, input=answers, env=env, timeout=600
    )
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout.splitlines()


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 1), (4, 4, 3)])
def test_images_are_asked_for_and_their_labels_kept(tmp_path, shape):
    classes = (np.arange(40) % 2).reshape(-1, *(1 for _ in shape))
    images = 155 * classes + 100 * np.random.default_rng(100).random((40, *shape))
    np.save(tmp_path / "images.npy", images.astype(np.uint8))
    answers = "drak\n" + "dark\nlight\n" * 5  # what is no class is asked again
    run("label_your_images", "images.npy", "dark,light", "2", folder=tmp_path, answers=answers)
    labels = np.loadtxt(tmp_path / "labels.csv", int, delimiter=",")
    assert labels.shape == (10, 2)
    assert labels[:5, 0].tolist() == [0, 1, 2, 3, 4]
    assert len(set(labels[:, 0])) == 10
    assert labels[:, 1].tolist() == [0, 1] * 5
    run("label_your_images", "images.npy", "dark,light", "1", folder=tmp_path, answers="light\n" * 5)
    more = np.loadtxt(tmp_path / "labels.csv", int, delimiter=",")
    np.testing.assert_array_equal(more[:10], labels)
    assert more[10:, 1].tolist() == [1] * 5
    assert len(set(more[:, 0])) == 15


def test_an_agent_holds_a_draw_for_an_episode(tmp_path):
    pytest.importorskip("gymnasium")
    lines = run("hold_a_draw", "CartPole-v1", "3", folder=tmp_path)
    assert [line.split(":")[0] for line in lines] == ["episode 0", "episode 1", "episode 2"]


def test_a_plant_of_ones_own(tmp_path):
    pytest.importorskip("gymnasium")
    lines = run("your_own_plant", "1", "small", folder=tmp_path)
    assert len(lines) == 3
    assert 0 < float(lines[-1].split()[-3]) <= 1


def test_each_is_short_and_linked():
    readme = (EXAMPLES.parent / "README.md").read_text(encoding="utf-8")
    scripts = sorted(EXAMPLES.glob("*.py"))
    assert len(scripts) == 3
    for script in scripts:
        assert len(script.read_text(encoding="utf-8").splitlines()) <= 32
        assert f"examples/{script.name}" in readme
