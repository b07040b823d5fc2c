"""Models of what is seen: windows, what fitting does, and particles that read their own predictions."""

import pytest
import torch

from dropout_uncertainty.data_efficiency.hidden_state.models import (
    Fit,
    Recurrent,
    Windowed,
    free_run,
    inputs_of,
    windows,
)

SEEDS = (100, 101)
HOW = Fit(steps=4, rate=0.01, final_rate=0.1, batch=3, length_scale=0.3)


def made(kind, seeds=SEEDS, drop=0.2):
    if kind == "windowed":
        return Windowed(seeds, 3, hidden=(8, 8), drop=drop, dtype=torch.float64)
    return Recurrent(seeds, 8, (0.0, drop, drop), kind == "held", torch.float64)


def data(runs=2, count=4, steps=6):
    g = torch.Generator().manual_seed(1)
    seen = torch.randn(runs, count, steps, 4, generator=g, dtype=torch.float64)
    return seen, torch.randn(runs, count, steps, 2, generator=g, dtype=torch.float64)


def fitted(kind, seeds=SEEDS, rows=slice(None), how=HOW):
    model, (seen, changes) = made(kind, seeds), data()
    loss, repairs = model.fit(seen[rows], changes[rows], "fit", how=how)
    return model, loss.detach(), repairs


every_kind = pytest.mark.parametrize("kind", ["windowed", "held", "fresh"])


def test_what_a_network_is_given():
    seen = inputs_of(torch.tensor([[1.0, torch.pi / 2]]), torch.tensor([3.0]))
    assert torch.allclose(seen, torch.tensor([[1.0, 1.0, 0.0, 3.0]]), atol=1e-6)


def test_windows_by_hand():
    """The first observation, without force, stands for those before it."""
    seen = torch.arange(12.0).view(1, 1, 3, 4) + 1
    found = windows(seen, 2)[0, 0]
    assert found[0].tolist() == [1, 2, 3, 0, 1, 2, 3, 4]
    assert found[2].tolist() == [5, 6, 7, 8, 9, 10, 11, 12]
    assert torch.equal(windows(seen, 1), seen)


def test_a_window_that_is_followed_is_a_window_of_the_sequence():
    model, _, _ = fitted("windowed")
    seen, _ = data()
    draw, memory = model.draw(4, 6, "test"), None
    whole = windows(seen, 3)
    for t in range(6):
        change, memory = model.step(seen[:, :, t], memory, draw, t)
        assert torch.allclose(change, draw(whole[:, :, t]), atol=1e-12)


@every_kind
def test_a_replica_alone_is_as_among_others(kind):
    both, loss, _ = fitted(kind)
    alone, own, _ = fitted(kind, SEEDS[1:], slice(1, 2))
    assert torch.allclose(loss[1:], own, atol=1e-10)
    first, forces = torch.zeros(2, 3, 2, dtype=torch.float64), torch.ones(2, 3, 6, dtype=torch.float64)
    noise = torch.randn(2, 3, 5, 6, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    among, by_itself = free_run(both, first, forces, noise, 0), free_run(alone, first[1:], forces[1:], noise[1:], 0)
    for one, two in zip(among, by_itself, strict=True):
        assert torch.allclose(one[1:], two, atol=1e-9)


@every_kind
def test_fitting_lowers_the_objective(kind):
    longer = Fit(steps=150, rate=0.02, final_rate=0.1, batch=8, length_scale=0.3)
    assert (fitted(kind, how=longer)[1] < fitted(kind)[1]).all()


def test_the_objective_of_sequences_by_hand():
    """One step of length 0 leaves the first weights: mean squared error in units of the noise, its log, and decay."""
    model, (seen, changes) = made("held", drop=0.0), data(count=1)
    loss, _ = model.fit(seen, changes, "fit", how=Fit(1, 1e-30, 1.0, 1, 0.3))
    x = (seen - model.input_mean[:, None]) / model.input_std[:, None]
    y = (changes - model.target_mean[:, None]) / model.target_std[:, None]
    likelihood = ((model.net(x)[0] - y).square() * torch.exp(torch.tensor(4.0)) / 2 - 2).mean((1, 2)).sum(-1)
    decay = 0.3**2 / (2 * 6) * sum(w.square().sum((1, 2)) for w in model.net.weights)
    assert torch.allclose(loss, (likelihood + decay).detach(), rtol=1e-6)


@every_kind
def test_a_broken_network_begins_anew_and_data_that_are_not_finite_are_refused(kind):
    model, (seen, changes) = made(kind), data()
    first = {name: value.clone() for name, value in model.state().items()}
    broken = {name: value.clone() for name, value in first.items()}
    broken["log_noise"][1] = torch.nan
    model.restore(broken)
    _, repairs = model.fit(seen, changes, "fit", how=HOW)
    assert repairs.tolist() == [0, 1]
    again = made(kind)
    again.fit(seen, changes, "fit", how=HOW)
    for name, value in model.state().items():
        assert torch.allclose(value, again.state()[name], atol=1e-12), name
    with pytest.raises(ValueError, match="finite transitions"):
        model.fit(torch.full_like(seen, torch.nan), changes, "fit", how=HOW)


class Still:
    """A model of a world that moves by 1 and 0 a step, with noise of known size."""

    def fit(self, seen, changes, *path, how):
        raise NotImplementedError

    def select(self, replicas):
        raise NotImplementedError

    state = restore = select

    def draw(self, count, steps, *path):
        return None

    def noise_std(self):
        return torch.tensor([[0.5, 0.1]])

    def step(self, seen, memory, draw, t):
        assert memory == (t or None)
        return torch.tensor([1.0, 0.0]).expand(*seen.shape[:2], 2), t + 1


def test_a_free_run_by_hand():
    """The particles walk: their variance before noise grows by that of the noise a step, and noise is added."""
    noise = torch.randn(1, 2, 4000, 3, 2, generator=torch.Generator().manual_seed(3))
    mean, std = free_run(Still(), torch.zeros(1, 2, 2), torch.zeros(1, 2, 3), noise)
    assert torch.allclose(mean[..., 0], torch.tensor([1.0, 2.0, 3.0]).expand(1, 2, 3), atol=0.05)
    expected = torch.arange(1, 4).sqrt()[:, None] * torch.tensor([0.5, 0.1])
    assert torch.allclose(std[0, 0], expected, rtol=0.05)


def test_held_masks_are_drawn_once_and_fresh_ones_at_every_step():
    assert made("held").draw(3, 6, 0)[1].shape == (2, 3, 8)
    assert made("fresh").draw(3, 6, 0)[1].shape == (2, 3, 6, 8)
