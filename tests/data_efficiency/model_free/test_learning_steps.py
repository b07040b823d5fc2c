"""A learning step of DDPG and of NAF is that of PyTorch's own modules, replica by replica."""

import copy
from dataclasses import replace

import pytest
import torch
from torch import nn

from dropout_uncertainty.data_efficiency.model_free.config import DDPG_AS_PRINTED, NAF_AS_PRINTED
from dropout_uncertainty.data_efficiency.model_free.ddpg import DDPG
from dropout_uncertainty.data_efficiency.model_free.naf import NAF
from dropout_uncertainty.data_efficiency.model_free.networks import Network, Trained
from dropout_uncertainty.data_efficiency.model_free.replay import Memory, Transitions
from dropout_uncertainty.rng import generator

SEEDS, INPUTS, BATCH = (100, 101, 102), 5, 16
SMALL = {"hidden": (7, 6), "batch": BATCH, "follow": 0.25}


def transitions():
    """Return transitions of which the last ends."""
    g, shape = generator(100, "transitions"), (len(SEEDS), BATCH)
    inputs, following = (torch.randn(*shape, INPUTS, generator=g, dtype=torch.float64) for _ in range(2))
    action = 2 * torch.rand(*shape, 1, generator=g, dtype=torch.float64) - 1
    reward = torch.rand(*shape, 1, generator=g, dtype=torch.float64)
    discount = torch.full_like(reward, 0.99)
    discount[:, -1] = 0.0
    return Transitions(inputs, following, action, reward, discount)


def module(network, replica):
    with torch.random.fork_rng():  # PyTorch's layers draw first weights, which are replaced at once
        return Module(network, replica)


class Module(nn.Module):
    """One replica of a `Network` in PyTorch's own layers."""

    def __init__(self, network, replica):
        super().__init__()
        self.joined = network.joined
        self.linear, self.norm = nn.ModuleList(), nn.ModuleList()
        for layer in range(network.layers):
            weights, biases = (x.detach()[replica] for x in network.parameters[2 * layer : 2 * layer + 2])
            linear = nn.Linear(*weights.shape, dtype=weights.dtype)
            linear.weight.data, linear.bias.data = weights.T.clone(), biases[0].clone()
            self.linear.append(linear)
        for layer in range(network.normalised):
            size = network.moments[2 * layer].shape[-1]
            self.norm.append(nn.BatchNorm1d(size, dtype=weights.dtype))

    def forward(self, x, further=None):
        h = self.norm[0](x) if len(self.norm) else x
        for layer, linear in enumerate(self.linear):
            if further is not None and layer == self.joined:
                h = torch.cat((h, further), -1)
            h = linear(h)
            if layer + 1 < len(self.linear):
                h = self.norm[layer + 1](h) if layer + 1 < len(self.norm) else h
                h = h.relu()
        return h


def follow(target, module, share):
    for old, new in zip(target.parameters(), module.parameters(), strict=True):
        old.data.lerp_(new.data, share)
    for old, new in zip(target.buffers(), module.buffers(), strict=True):
        if old.is_floating_point():
            old.lerp_(new, share)


def assert_equal(network, module, replica):
    for layer, linear in enumerate(module.linear):
        weights, biases = network.parameters[2 * layer : 2 * layer + 2]
        torch.testing.assert_close(weights[replica], linear.weight.T)
        torch.testing.assert_close(biases[replica, 0], linear.bias)
    for layer, norm in enumerate(module.norm):
        scale, shift = network.parameters[2 * (network.layers + layer) :][:2]
        torch.testing.assert_close(scale[replica, 0], norm.weight)
        torch.testing.assert_close(shift[replica, 0], norm.bias)
        mean, variance = network.moments[2 * layer : 2 * layer + 2]
        torch.testing.assert_close(mean[replica, 0], norm.running_mean)
        torch.testing.assert_close(variance[replica, 0], norm.running_var)


@pytest.mark.parametrize("normalise", [True, False])
def test_ddpg_learns_as_it_does_with_the_modules_of_pytorch(normalise):
    config = replace(DDPG_AS_PRINTED, normalise=normalise, policy_rate=1e-2, **SMALL)
    agent, batches = DDPG(config, SEEDS, INPUTS, torch.float64), transitions()
    modules = [(module(agent.policy.network, r), module(agent.value.network, r)) for r in range(len(SEEDS))]
    for _ in range(3):
        agent.learn(batches)
    for r, (policy, value) in enumerate(modules):
        targets = copy.deepcopy(policy).eval(), copy.deepcopy(value).eval()
        adams = (
            torch.optim.Adam(policy.parameters(), lr=config.policy_rate),
            torch.optim.Adam(value.parameters(), lr=config.value_rate, weight_decay=config.value_decay),
        )
        inputs, following, action, reward, discount = (x[r] for x in batches)
        for _ in range(3):
            with torch.no_grad():
                wanted = reward + discount * targets[1](following, targets[0](following).tanh())
            value.train()
            adams[1].zero_grad()
            (value(inputs, action) - wanted).square().mean().backward()
            adams[1].step()
            follow(targets[1], value, config.follow)
            value.eval()
            adams[0].zero_grad()
            (-value(inputs, policy(inputs).tanh()).mean()).backward()
            adams[0].step()
            follow(targets[0], policy, config.follow)
        assert_equal(agent.policy.network, policy, r)
        assert_equal(agent.value.network, value, r)
        assert_equal(agent.policy.target, targets[0], r)
        assert_equal(agent.value.target, targets[1], r)


def test_naf_learns_as_it_does_with_the_modules_of_pytorch():
    config = replace(NAF_AS_PRINTED, **SMALL)
    agent, batches = NAF(config, SEEDS, INPUTS, torch.float64), transitions()
    modules = [module(agent.value.network, r) for r in range(len(SEEDS))]
    for _ in range(3):
        agent.learn(batches)
    for r, own in enumerate(modules):
        target = copy.deepcopy(own)
        adam = torch.optim.Adam(own.parameters(), lr=config.value_rate)
        inputs, following, action, reward, discount = (x[r] for x in batches)
        for _ in range(3):
            with torch.no_grad():
                wanted = reward + discount * target(following)[:, :1]
            value, mean, root = own(inputs).split(1, -1)
            lower = root.exp()[..., None]  # L, one by one
            apart = (action - mean.tanh())[..., None]
            advantage = -(apart.mT @ lower @ lower.mT @ apart)[..., 0] / 2
            adam.zero_grad()
            (value + advantage - wanted).square().mean().backward()
            adam.step()
            follow(target, own, config.follow)
        assert_equal(agent.value.network, own, r)
        assert_equal(agent.value.target, target, r)


def test_the_first_weights_lie_within_their_bounds_and_fill_them():
    network = Network((5, 400, 300, 1), SEEDS, "value", joined=(1, 1))
    shapes = [tuple(x.shape[1:]) for x in network.parameters]
    assert shapes == [(5, 400), (1, 400), (401, 300), (1, 300), (300, 1), (1, 1)]
    for layer, bound in enumerate((5**-0.5, 401**-0.5, 3e-3)):
        weights = network.parameters[2 * layer]
        assert 0.98 * bound < weights.abs().max() <= bound
        assert abs(weights.mean()) < 0.05 * bound


@pytest.mark.parametrize("agent", [DDPG(DDPG_AS_PRINTED, SEEDS, INPUTS), NAF(NAF_AS_PRINTED, SEEDS, INPUTS)])
def test_first_actions_are_near_zero_and_within_the_limits(agent):
    action = agent.act(torch.randn(3, INPUTS, generator=generator(100)))
    assert action.shape == (3,)
    assert action.abs().max() < 0.1


def test_a_replica_alone_goes_the_way_it_goes_among_others():
    for method, config in ((DDPG, DDPG_AS_PRINTED), (NAF, NAF_AS_PRINTED)):
        config = replace(config, **SMALL)
        batches = transitions()
        together, alone = (
            method(config, SEEDS, INPUTS, torch.float64),
            method(config, SEEDS[1:2], INPUTS, torch.float64),
        )
        for _ in range(3):
            errors, error = together.learn(batches), alone.learn(Transitions(*(x[1:2] for x in batches)))
        torch.testing.assert_close(errors[1:2], error)
        torch.testing.assert_close(together.act(batches[0][:, 0])[1:2], alone.act(batches[0][1:2, 0]))


def test_a_trained_network_goes_on_with_some_of_its_replicas_and_from_its_state():
    def loss(trained, rows):
        return trained.network(rows, training=True).square().sum()

    make = lambda: Trained(Network((3, 4, 1), SEEDS, normalised=1, dtype=torch.float64), 0.01, 0.1, 0.5)  # noqa: E731
    rows = torch.randn(3, 8, 3, generator=generator(100), dtype=torch.float64)
    whole, kept, resumed = make(), make(), make()
    for trained in (whole, kept):
        for _ in range(2):
            trained.step(loss(trained, rows))
    resumed.restore(copy.deepcopy(whole.state()))
    kept.keep(torch.tensor([0, 2]))
    for _ in range(2):
        whole.step(loss(whole, rows))
        kept.step(loss(kept, rows[[0, 2]]))
        resumed.step(loss(resumed, rows))
    for a, b, c in zip(whole.state()["tensors"], kept.state()["tensors"], resumed.state()["tensors"], strict=True):
        torch.testing.assert_close(a[[0, 2]], b)
        torch.testing.assert_close(a, c, rtol=0, atol=0)


def test_a_memory_holds_the_last_transitions():
    def one(number):
        return Transitions(*(torch.tensor([[[number]], [[10 + number]]]) + part for part in (0, 0.1, 0.2, 0.3, 0.4)))

    memory = Memory(2, 3, 1)
    for number in range(5):
        memory.store(one(float(number)))
    assert len(memory) == 3
    drawn = memory.sample(torch.tensor([[0.0, 0.34, 0.99]] * 2, dtype=torch.float64))
    assert sorted(drawn.inputs[0, :, 0].tolist()) == [2, 3, 4]
    assert sorted(drawn.inputs[1, :, 0].tolist()) == [12, 13, 14]
    for part, values in zip((0.1, 0.2, 0.3, 0.4), drawn[1:], strict=True):
        torch.testing.assert_close(values, drawn.inputs + part)
    memory.keep(torch.tensor([1]))
    again = Memory(2, 3, 1)
    again.restore(memory.state())
    torch.testing.assert_close(again.rows, memory.rows)
    assert again.seen == 5
