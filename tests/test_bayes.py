import pytest
import torch

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import MLP, dropout_mask, weight_decay


@pytest.mark.parametrize("p", [0.25, 0.5, 0.1])
def test_masks_hold_two_values_and_have_mean_one(p):
    mask = dropout_mask((200, 1000), p, rng.generator(100))
    assert mask.unique().tolist() == pytest.approx([0.0, 1 / (1 - p)])
    standard_error = (p / (1 - p) / mask.numel()) ** 0.5
    assert abs(mask.mean().item() - 1) < 4 * standard_error
    rows = mask.mean(1)
    assert abs(rows.var().item() / (p / (1 - p) / 1000) - 1) < 0.5, "entries of a row are not independent"


def test_masks_are_the_bernoulli_variates_of_torch_on_a_cpu():
    """Where the drop probability is no multiple of 1/256; by its kernel for all CPUs, which is that without MKL."""
    uniform = rng.generator(100)
    drawn = torch.rand(50_000, generator=uniform, dtype=torch.float64)
    assert torch.equal(dropout_mask((50_000,), 0.05, rng.generator(100)) > 0, drawn < 0.95)


@pytest.mark.parametrize("p", [-0.1, 1.0, 1.5, float("nan")])
def test_probabilities_outside_0_1_are_refused(p):
    with pytest.raises(ValueError, match="drop probability"):
        dropout_mask((2,), p, rng.generator(100))


def test_weight_decay_by_hand():
    # (1 - 0.2) * 2^2 / (2 * 10 * 4) = 0.04
    assert weight_decay(10, 0.2, 2.0, 4.0) == pytest.approx(0.04)
    for n, length_scale in ((0, 2.0), (10, float("nan"))):
        with pytest.raises(ValueError, match="positive"):
            weight_decay(n, 0.2, length_scale, 4.0)


def test_weight_decay_belongs_to_half_the_mean_squared_error():
    """A linear model with a Gaussian prior: its most probable weights are known, and the minimum of ½ MSE + decay."""
    g = rng.generator(100, "linear")
    x, noise = (torch.randn(*shape, generator=g, dtype=torch.float64) for shape in ((12, 3), (12,)))
    length_scale, precision = 1.5, 4.0
    y = x @ torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64) + noise / precision**0.5
    prior = length_scale**2 / precision * torch.eye(3, dtype=torch.float64)
    likeliest = torch.linalg.solve(x.T @ x + prior, x.T @ y)
    decay = weight_decay(len(x), 0.0, length_scale, precision)

    def slope(factor):
        weights = likeliest.clone().requires_grad_()
        (factor * (y - x @ weights).square().mean() + decay * weights.square().sum()).backward()
        return weights.grad.abs().max().item()

    assert slope(0.5) < 1e-12
    assert slope(1.0) > 0.01


@pytest.fixture
def net():
    return MLP((3, 20, 2), (0.0, 0.5), seeds=(100, 101), dtype=torch.float64)


def test_the_mlp_is_the_formula(net):
    x = torch.randn(2, 5, 3, generator=rng.generator(100, "x"), dtype=torch.float64)
    masks = net.draw(5, "step", 0)
    assert masks[0] is None
    assert masks[1].shape == (2, 5, 20)
    for r in range(2):
        hidden = torch.relu(x[r] @ net.weights[0][r] + net.biases[0][r]) * masks[1][r]
        torch.testing.assert_close(net(x, masks)[r], hidden @ net.weights[1][r] + net.biases[1][r])


def test_a_held_draw_repeats_and_a_fresh_draw_differs(net):
    x = torch.ones(2, 5, 3, dtype=torch.float64)
    held = net.draw(5, "trajectory")
    assert torch.equal(net(x, held), net(x, held))
    assert not torch.equal(net(x, held), net(x, net.draw(5, "another")))


def test_weight_scaling_is_the_mean_over_draws_of_a_linear_layer():
    net = MLP((30, 1), (0.5,), seeds=(100,), dtype=torch.float64)
    x = torch.ones(1, 1, 30, dtype=torch.float64)
    draws = net(x.expand(1, 20_000, 30), net.draw(20_000))
    standard_error = draws.std() / 20_000**0.5
    assert abs(draws.mean() - net(x).squeeze()) < 4 * standard_error


def test_a_replica_alone_equals_itself_among_others(net):
    alone = MLP((3, 20, 2), (0.0, 0.5), seeds=(101,), dtype=torch.float64)
    x = torch.ones(2, 4, 3, dtype=torch.float64)
    torch.testing.assert_close(net(x, net.draw(4, 9))[1:], alone(x[1:], alone.draw(4, 9)), rtol=1e-12, atol=0)


def test_impossible_networks_are_refused():
    with pytest.raises(ValueError, match="one drop probability per weight layer"):
        MLP((3, 4, 2), (0.1,), seeds=(100,))
    with pytest.raises(ValueError, match="each 0 or more and once only"):
        MLP((3, 4, 2), (0.1, 0.1), seeds=(100, 100))
    with pytest.raises(ValueError, match="unknown activation"):
        MLP((3, 4, 2), (0.1, 0.1), seeds=(100,), activation="swish")
