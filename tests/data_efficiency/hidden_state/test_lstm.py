"""The recurrent cell beside PyTorch's, and masks that are held over a sequence or fresh at every step."""

import pytest
import torch

from dropout_uncertainty.data_efficiency.hidden_state.lstm import LSTM

SIZES, SEEDS = (4, 6, 2), (100, 101)


def network(drop=(0.0, 0.0, 0.0), seeds=SEEDS):
    return LSTM(SIZES, drop, seeds, dtype=torch.float64)


def sequence(batch=3, steps=7):
    return torch.randn(
        len(SEEDS), batch, steps, SIZES[0], generator=torch.Generator().manual_seed(1), dtype=torch.float64
    )


def library(net, row):
    """Return PyTorch's layer with the weights of one replica."""
    with torch.random.fork_rng():  # it draws first weights that are not used
        twin = torch.nn.LSTM(SIZES[0], SIZES[1], batch_first=True, dtype=torch.float64)
    with torch.no_grad():
        twin.weight_ih_l0.copy_(net.from_inputs[row].mT)
        twin.weight_hh_l0.copy_(net.from_state[row].mT)
        twin.bias_ih_l0.copy_(net.bias[row, 0])
        twin.bias_hh_l0.zero_()
    return twin


@pytest.mark.parametrize("row", range(len(SEEDS)))
def test_without_dropout_output_memory_and_gradient_are_those_of_pytorch(row):
    net, x = network(), sequence()
    twin = library(net, row)
    out, memory = net(x)
    states, last = twin(x[row])
    expected = states @ net.to_output[row] + net.output_bias[row]
    assert torch.allclose(out[row], expected, atol=1e-12)
    for mine, theirs in zip(memory, last, strict=True):
        assert torch.allclose(mine[row], theirs[0], atol=1e-12)
    out[row].square().sum().backward()
    expected.square().sum().backward(inputs=list(twin.parameters()))
    assert torch.allclose(net.from_inputs.grad[row].mT, twin.weight_ih_l0.grad, atol=1e-10)
    assert torch.allclose(net.from_state.grad[row].mT, twin.weight_hh_l0.grad, atol=1e-10)
    assert torch.allclose(net.bias.grad[row, 0], twin.bias_ih_l0.grad, atol=1e-10)


def test_in_single_precision_it_is_pytorchs_to_a_millionth():
    net, x = network().float(), sequence().float()
    states, _ = library(net.double(), 0)(x[0].double())
    expected = states @ net.to_output[0] + net.output_bias[0]
    assert torch.allclose(net.float()(x)[0][0].double(), expected, atol=1e-6)


@pytest.mark.parametrize("steps", [None, 7])
def test_step_by_step_is_the_whole_sequence(steps):
    net, x = network((0.2, 0.4, 0.3)), sequence()
    masks = net.draw(x.shape[1], "test", steps=steps)
    whole, end = net(x, masks)
    memory = net.blank(x.shape[1])
    for t in range(x.shape[2]):
        out, memory = net.step(x[:, :, t], memory, masks, t)
        assert torch.allclose(out, whole[:, :, t], atol=1e-12)
    assert torch.allclose(memory[1], end[1], atol=1e-12)


def test_a_sequence_in_two_parts_under_one_draw_is_the_whole():
    net, x = network((0.2, 0.4, 0.3)), sequence()
    masks = net.draw(x.shape[1], "test")
    first, memory = net(x[:, :, :3], masks)
    second, _ = net(x[:, :, 3:], masks, memory)
    assert torch.allclose(torch.cat((first, second), 2), net(x, masks)[0], atol=1e-12)


def test_held_masks_are_fresh_ones_that_happen_to_be_the_same():
    net, x = network((0.2, 0.4, 0.3)), sequence()
    held = net.draw(x.shape[1], "test")
    repeated = tuple(mask[:, :, None].expand(-1, -1, x.shape[2], -1) for mask in held)
    assert torch.allclose(net(x, held)[0], net(x, repeated)[0], atol=1e-12)
    fresh = net.draw(x.shape[1], "test", steps=x.shape[2])
    assert not torch.allclose(net(x, held)[0], net(x, fresh)[0], atol=1e-3)


def test_a_held_draw_is_a_network_without_the_dropped_units():
    """By hand: a unit that the state's mask drops and the output's mask drops has no effect on anything."""
    net, x = network((0.0, 0.5, 0.5)), sequence()
    mask = torch.ones(len(SEEDS), x.shape[1], SIZES[1], dtype=torch.float64)
    mask[..., 2] = 0.0
    before, _ = net(x, (None, mask, mask))
    with torch.no_grad():
        net.from_state[:, 2], net.to_output[:, 2] = 9.0, 9.0  # what the unit sends
        net.from_inputs[:, :, 2::6] = 5.0  # and what it receives, of all four gates
    after, _ = net(x, (None, mask, mask))
    assert torch.allclose(before, after, atol=1e-12)


def test_draws_keep_the_mean_and_differ_only_where_they_should():
    net = network((0.0, 0.25, 0.5))
    seen, kept, out = net.draw(4000, "test")
    assert seen is None
    assert kept.shape == out.shape == (2, 4000, 6)
    assert kept.unique().tolist() == pytest.approx([0, 4 / 3])
    assert torch.allclose(out.mean((1, 2)), torch.ones(2, dtype=torch.float64), atol=0.03)
    fresh = net.draw(5, "test", steps=3)[1]
    assert fresh.shape == (2, 5, 3, 6)
    assert not torch.equal(fresh[:, :, 0], fresh[:, :, 1])


def test_a_replica_alone_is_as_among_others():
    x, both, alone = sequence(), network((0.2, 0.4, 0.3)), network((0.2, 0.4, 0.3), SEEDS[1:])
    for steps in (None, x.shape[2]):
        among = both(x, both.draw(3, "test", steps=steps))[0][1]
        assert torch.allclose(among, alone(x[1:], alone.draw(3, "test", steps=steps))[0][0], atol=1e-12)


def test_the_forget_gate_begins_open():
    bias = network().bias[0, 0].unflatten(0, (4, 6))
    assert bias[1].eq(1).all()
    assert bias[[0, 2, 3]].eq(0).all()


def test_sizes_that_are_not_three_are_refused():
    with pytest.raises(ValueError, match="inputs, state and output"):
        LSTM((4, 6), (0.1, 0.1, 0.1), SEEDS)
    with pytest.raises(ValueError, match="each 0 or more and once only"):
        LSTM(SIZES, (0.1, 0.1, 0.1), (100, 100))
