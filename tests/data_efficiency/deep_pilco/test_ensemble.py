"""Ensembles: every particle follows its member, members are networks of their own, replicas do not meddle."""

import pytest
import torch

from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import DropoutDynamics
from dropout_uncertainty.data_efficiency.deep_pilco.ensemble import Ensemble
from dropout_uncertainty.rng import derived, generator

FIT = {"steps": 20, "rate": 1e-2, "final_rate": 0.1, "batch": 16, "length_scale": 0.3}
OPTIONS = {"hidden": (12, 10), "dtype": torch.float64}


def data(runs=2, count=30):
    g = generator(100, "test transitions")
    inputs, mix = (torch.randn(*shape, generator=g, dtype=torch.float64) for shape in ((runs, count, 6), (6, 4)))
    return inputs, inputs @ mix


@pytest.fixture(scope="module")
def fitted():
    ensemble = Ensemble.of((100, 101), 3, **OPTIONS)
    inputs, targets = data()
    return ensemble, *ensemble.fit(inputs, targets, "fit", **FIT)


def alone(replica, member):
    """The same member, trained by itself."""
    network = DropoutDynamics((derived(100 + replica, "member", member),), drop=0.0, **OPTIONS)
    inputs, targets = (tensor[replica : replica + 1] for tensor in data())
    return network, *network.fit(inputs, targets, "fit", **FIT)


def test_particles_follow_the_members_in_equal_parts(fitted):
    ensemble, loss, repairs = fitted
    x = data()[0][:, :6]
    moved = ensemble.function(ensemble.draw(6, "draw"))(x)
    members = [[alone(replica, member) for member in range(3)] for replica in range(2)]
    for replica in range(2):
        for particle in range(6):
            network = members[replica][particle // 2][0]
            expected = network.function(None)(x[replica : replica + 1, particle : particle + 1])[0, 0]
            torch.testing.assert_close(moved[replica, particle], expected, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(loss, torch.stack([torch.cat([one[1] for one in row]).mean() for row in members]))
    noise = torch.stack([torch.cat([one[0].noise_std() for one in row]).mean(0) for row in members])
    torch.testing.assert_close(ensemble.noise_std(), noise)
    assert repairs.tolist() == [0, 0]


def test_members_see_the_same_data_and_differ(fitted):
    ensemble, *_ = fitted
    same = data()[0][:, :1].expand(-1, 6, -1)
    moved = ensemble.function(())(same)
    assert torch.equal(moved[:, 0], moved[:, 1])  # of one member
    assert (moved[:, 0] - moved[:, 2]).abs().min() > 0


def test_the_mean_of_an_ensemble_is_the_mean_of_its_members(fitted):
    ensemble, *_ = fitted
    x = data()[0][:, :1]
    each = ensemble.function(())(x.expand(-1, 3, -1))
    mean = ensemble.mean().function(())(x.expand(-1, 3, -1))
    torch.testing.assert_close(mean, each.mean(1, keepdim=True).expand(-1, 3, -1))
    assert not ensemble.averaged
    assert ensemble.mean().select([1]).averaged


def test_selected_replicas_keep_their_members(fitted):
    ensemble, *_ = fitted
    x = data()[0][:, :6]
    part = ensemble.select([1])
    assert part.seeds == (101,)
    torch.testing.assert_close(part.function(())(x[1:]), ensemble.function(())(x)[1:])
    before = ensemble.state()
    inputs, targets = (tensor[1:] for tensor in data())
    part.fit(inputs, targets, "again", **FIT)
    assert all(torch.equal(value, before[name]) for name, value in ensemble.state().items())


def test_state_restores_an_ensemble(fitted):
    ensemble, *_ = fitted
    other = Ensemble.of((100, 101), 3, **OPTIONS)
    other.restore(ensemble.state())
    x = data()[0][:, :6]
    assert torch.equal(other.function(())(x), ensemble.function(())(x))
