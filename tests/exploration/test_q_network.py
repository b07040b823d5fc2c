"""One learning step against the original program, against autograd and against the core's network."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import MLP
from dropout_uncertainty.exploration.q_network import MaskStream, QNetwork, keep_units, td_error

GOLDEN = Path(__file__).parents[1] / "golden"
with gzip.open(GOLDEN / "rl2d_learner_trace.json.gz") as file:
    TRACE = json.load(file)["agents"]
LEARNING = {"discount": 0.7, "rate": 0.001, "decay": 0.01}
SIZES = (59, 50, 50, 5)


def load(network, weights):
    """Give every replica the recorded weights; the original stores [out, in]."""
    for layer in range(3):
        network.weights[layer].copy_(torch.tensor(weights[f"W{layer + 1}"], dtype=torch.float64).T)
        network.biases[layer].copy_(torch.tensor(weights[f"b{layer + 1}"], dtype=torch.float64))


def recorded(agent):
    """Return rows, one-hot actions, rewards and masks of a recorded minibatch, for one replica."""
    batch = agent["batch"]
    states = torch.tensor([t["s0"] for t in batch] + [t["s1"] for t in batch], dtype=torch.float64)[None]
    taken = torch.eye(5, dtype=torch.float64)[[t["a"] for t in batch]][None]
    reward = torch.tensor([t["r"] for t in batch], dtype=torch.float64)[None]
    if batch[0]["keep_mask_s0"] is None:
        return states, taken, reward, None
    keep = [[float(bit) for bit in t[key]] for key in ("keep_mask_s0", "keep_mask_s1") for t in batch]
    mask = torch.tensor(keep, dtype=torch.float64)[None] / (1 - agent["drop_prob"])
    return states, taken, reward, (None, mask, None)


@pytest.mark.parametrize("name", ["thompson", "greedy"])
def test_one_learning_step_of_the_original_is_reproduced(name):
    agent = TRACE[name]
    assert {"discount": agent["gamma"], "rate": agent["lr"], "decay": agent["l2_decay"]} == LEARNING
    network = QNetwork(SIZES, (100,), dtype=torch.float64)
    load(network, agent["weights_before"])
    states, taken, reward, masks = recorded(agent)
    assert (masks is not None) == (name == "thompson")
    penalty = 0.5 * LEARNING["decay"] * (network.parameters.square() * network.decayed).sum()
    _, error = network.learn(states, taken, reward, masks, **LEARNING)
    assert float(0.5 * error.square().sum() + penalty) / 64 == pytest.approx(
        agent["mean_loss_incl_l2_over_64"], abs=1e-12
    )
    expected = QNetwork(SIZES, (100,), dtype=torch.float64)
    load(expected, agent["weights_after"])
    torch.testing.assert_close(network.parameters, expected.parameters, rtol=0, atol=1e-12)


def random_step(seeds, drop, dtype=torch.float64, sizes=(59, 50, 50, 5), batch=8):
    """Return rows, actions, rewards and masks made of each replica's own random stream."""

    def normal(*shape):
        return rng.stacked(lambda g: torch.randn(shape, generator=g, dtype=torch.float64), seeds, "test", *shape).to(
            dtype
        )

    states, reward = normal(2 * batch + 2, sizes[0]), normal(batch)
    taken = torch.nn.functional.one_hot(normal(batch, sizes[-1]).argmax(-1), sizes[-1]).to(dtype)
    masks = MaskStream(seeds, sizes[:-1], drop, 2, 2 * batch + 1, dtype=dtype).at(1)
    return states, taken, reward, masks


@pytest.mark.parametrize("drop", [(0.0, 0.2, 0.0), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0)])
def test_gradient_by_hand_is_that_of_autograd(drop):
    seeds = (100, 101, 102)
    states, taken, reward, masks = random_step(seeds, drop)
    network = QNetwork(SIZES, seeds, dtype=torch.float64)
    parameters = network.parameters.clone().requires_grad_()
    weights, biases = network._views(parameters)
    x = states
    for layer in range(3):
        x = x if masks[layer] is None else x * masks[layer]
        x = torch.bmm(x, weights[layer]) + biases[layer]
        x = torch.relu(x) if layer < 2 else x
    with torch.no_grad():
        target = reward + 0.7 * x[:, 8:16].amax(-1)
    (0.5 * ((x[:, :8] * taken).sum(-1) - target).square()).sum().backward()
    expected = parameters - 0.001 / 8 * (parameters.grad + 0.01 * network.decayed * parameters)
    further, _ = network.learn(states, taken, reward, masks, **LEARNING)
    torch.testing.assert_close(further, x[:, 16:], rtol=0, atol=1e-12)
    torch.testing.assert_close(
        network.gradients - 0.01 * network.decayed * parameters, parameters.grad, rtol=0, atol=1e-12
    )
    torch.testing.assert_close(network.parameters, expected, rtol=0, atol=1e-14)


def test_forward_is_that_of_the_core_network():
    seeds, drop = (100, 101), (0.1, 0.2, 0.0)
    states, _, _, masks = random_step(seeds, drop)
    core, network = MLP(SIZES, drop, seeds, dtype=torch.float64), QNetwork(SIZES, seeds, dtype=torch.float64)
    for layer in range(3):
        network.weights[layer].copy_(core.weights[layer].detach())
        network.biases[layer].copy_(core.biases[layer].detach())
    for draw in (masks, None):
        torch.testing.assert_close(network.forward(states, draw)[-1], core(states, draw).detach(), rtol=0, atol=1e-12)


def test_a_replica_is_the_same_alone_and_among_others():
    seeds, drop = (100, 101, 102), (0.1, 0.1, 0.1)
    among, alone = QNetwork(SIZES, seeds, dtype=torch.float64), QNetwork(SIZES, seeds[1:2], dtype=torch.float64)
    among.learn(*random_step(seeds, drop), **LEARNING)
    alone.learn(*random_step(seeds[1:2], drop), **LEARNING)
    torch.testing.assert_close(among.parameters[1:2], alone.parameters, rtol=0, atol=1e-14)


def test_initial_weights_have_the_spread_of_the_original():
    network = QNetwork(SIZES, tuple(range(100, 140)))
    for layer, fan_in in enumerate(SIZES[:-1]):
        assert float(network.weights[layer].std()) * fan_in**0.5 == pytest.approx(1.0, abs=0.03)
        assert float(network.weights[layer].mean()) * fan_in**0.5 == pytest.approx(0.0, abs=0.05)
    assert [float(bias.unique()) for bias in network.biases] == pytest.approx([0.1, 0.1, 0.0])


def test_td_error_on_a_chain_by_hand():
    q = torch.tensor([[[1.0, 2.0], [5.0, 3.0]]])  # one state, one successor
    taken, reward = torch.tensor([[[0.0, 1.0]]]), torch.tensor([[0.25]])
    assert td_error(q, taken, reward, 0.5).item() == 2.0 - (0.25 + 0.5 * 5.0)


@pytest.mark.parametrize("p", [0.1, 0.2, 0.5, 0.999])
def test_units_are_dropped_with_exactly_the_probability(p):
    # without the second number the probability would be off by up to 1/256, seven standard errors here
    count = 4_000_000
    kept = np.empty(count, dtype=bool)
    keep_units(p, rng.generator(100, "test"), out=kept)
    dropped = 1 - kept.mean()
    assert abs(dropped - p) < 4 * (p * (1 - p) / count) ** 0.5


def test_masks_are_fresh_for_each_row_and_step_and_the_last_row_is_the_network_without_dropout():
    stream = MaskStream((100, 101), (59, 50, 50), (0.0, 0.2, 0.5), steps=3, rows=4)
    first, second = ([None if m is None else m.clone() for m in stream.at(step)] for step in (0, 1))
    assert first[0] is None
    for layer, p in ((1, 0.2), (2, 0.5)):
        values = first[layer][:, :-1].unique()
        torch.testing.assert_close(values, torch.tensor([0.0, 1 / (1 - p)]))
        assert (first[layer][:, -1] == 1).all()
        rows = torch.cat((first[layer][:, :-1], second[layer][:, :-1])).flatten(0, 1)
        assert len(rows.unique(dim=0)) == len(rows)


def test_bad_drop_probability_is_refused():
    for p in (-0.1, 1.0, np.nan):
        with pytest.raises(ValueError, match="drop probability"):
            MaskStream((100,), (3,), (p,), 1, 1)
