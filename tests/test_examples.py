"""The examples run as they stand, at small sizes: in a process and a folder of their own, or watched in this one."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from dropout_uncertainty import bayes
from dropout_uncertainty.data_efficiency import policies

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
    answers = "drak\n" + "dark one\nlight\n" * 5  # what is no class is asked again
    run("label_your_images", "images.npy", "dark one,light", "2", folder=tmp_path, answers=answers)
    labels = np.loadtxt(tmp_path / "labels.csv", str, delimiter=",")
    assert labels.shape == (10, 2)
    assert labels[:5, 0].tolist() == ["0", "1", "2", "3", "4"]
    assert len(set(labels[:, 0])) == 10
    assert labels[:, 1].tolist() == ["dark one", "light"] * 5
    # the names in another order, until nothing is left
    run("label_your_images", "images.npy", "light,dark one", "9", folder=tmp_path, answers="light\n" * 30)
    more = np.loadtxt(tmp_path / "labels.csv", str, delimiter=",")
    np.testing.assert_array_equal(more[:10], labels)
    assert more[10:, 1].tolist() == ["light"] * 30
    assert len(set(more[:, 0])) == 40


def test_answers_are_kept_one_by_one_and_held_to_the_classes(tmp_path):
    np.save(tmp_path / "images.npy", np.zeros((3, 4, 4), np.uint8))
    command = [sys.executable, str(EXAMPLES / "label_your_images.py"), "images.npy"]
    for classes, answers, said in (
        ("a,b", "b\na\n", "EOFError"),
        ("a,c", "", "expected points below 3 and the classes"),
    ):
        ended = subprocess.run(
            [*command, classes, "2"], capture_output=True, text=True, check=False, cwd=tmp_path, input=answers
        )
        assert said in ended.stderr
        assert (tmp_path / "labels.csv").read_text() == "0,b\n1,a\n"


def test_an_agent_holds_a_draw_for_an_episode(tmp_path):
    pytest.importorskip("gymnasium")
    for world in ("CartPole-v1", "dropout_uncertainty/DeepSea-v0"):
        lines = run("hold_a_draw", world, "3", folder=tmp_path)
        assert [line.split(":")[0] for line in lines] == ["episode 0", "episode 1", "episode 2"]


def play(name, *arguments, monkeypatch):
    """Run an example in this process; return its variables."""
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments])
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")


def test_after_the_burn_in_an_agent_acts_on_the_draw_of_its_episode(monkeypatch):
    gymnasium = pytest.importorskip("gymnasium")
    places, best, held = np.random.default_rng(100), [], []

    class Wandering(gymnasium.Env):
        observation_space, action_space = gymnasium.spaces.Box(-9, 9, (2,)), gymnasium.spaces.Discrete(2)

        def reset(self, *, seed=None, options=None):
            return places.uniform(-9, 9, 2).astype(np.float32), {}

        def step(self, action):
            seen, _ = self.reset()
            return seen, 1.0, False, len(best) % 520 == 0, {}

    forward = bayes.MLP.forward

    def watched(self, x, masks=None):
        out = forward(self, x, masks)
        if x.shape[:2] == (1, 1):  # not a batch to learn from
            best.append(int(out.argmax()))
            held.append(masks)
        return out

    gymnasium.register("Wandering-v0", Wandering)
    monkeypatch.setattr(bayes.MLP, "forward", watched)
    found = play("hold_a_draw", "Wandering-v0", "2", monkeypatch=monkeypatch)
    acted = [action for _, action, *_ in found["memory"]]
    assert len(acted) == 1040
    assert acted[1000:] == best[1000:]
    assert 300 < np.sum(np.not_equal(acted[:1000], best[:1000])) < 700
    for step, masks in enumerate(held):
        for mask, drawn in zip(masks, found["q"].draw(1, "episode", step // 520), strict=True):
            assert mask is drawn is None or torch.equal(mask, drawn)


def test_a_plant_of_ones_own_is_pushed_as_its_policy_says(monkeypatch, capsys):
    pytest.importorskip("gymnasium")
    from dropout_uncertainty.data_efficiency.plant.environment import CartPoleSwingUp

    pushed, step = [], CartPoleSwingUp.step

    def watched(self, action):
        after = step(self, action)
        pushed.append((action.item(), after[0]))
        return after

    monkeypatch.setattr(CartPoleSwingUp, "step", watched)
    found = play("your_own_plant", "1", "small", monkeypatch=monkeypatch)
    actions, after = zip(*pushed, strict=True)
    assert len(actions) == found["plant"].steps == 30
    seen = torch.tensor(np.array(after[:-1])).to(found["run"].policy).view(1, -1, 4)
    forces = policies.force(found["policy"], found["plant"], seen)[0].detach() / found["plant"].force_limit
    np.testing.assert_allclose(actions[1:], forces, atol=1e-5)
    assert np.ptp(actions) > 0.01
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert 0 < float(lines[-1].split()[-3]) <= 1


def test_each_is_short_and_linked():
    readme = (EXAMPLES.parent / "README.md").read_text(encoding="utf-8")
    scripts = sorted(EXAMPLES.glob("*.py"))
    assert len(scripts) == 3
    for script in scripts:
        assert len(script.read_text(encoding="utf-8").splitlines()) <= 36
        assert f"examples/{script.name}" in readme
