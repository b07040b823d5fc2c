"""The network: its shapes, weight draws, replicas, and that the conv features are a shortcut without a difference."""

import pytest
import torch
import torch.nn.functional as F

from dropout_uncertainty.active_learning import network
from dropout_uncertainty.active_learning.network import BayesianCNN


@pytest.fixture(scope="module")
def images():
    from dropout_uncertainty.active_learning import mnist

    return mnist.load().train_images[:6].double()


def plain(net, replica, images, masks):
    """The network of the thesis for one replica, layer by layer."""
    maps = images[:, None]
    for kernels, bias in zip(net.kernels, net.kernel_biases, strict=True):
        maps = F.conv2d(maps, kernels[replica], bias[replica]).relu()
    features = F.max_pool2d(maps, 2).permute(0, 2, 3, 1).flatten(1)
    hidden = (features * masks[0][replica]) @ net.weights[0][replica] + net.biases[0][replica]
    return (hidden.relu() * masks[1][replica] @ net.weights[1][replica] + net.biases[1][replica]).log_softmax(-1)


@pytest.mark.parametrize("rows", [1, 6])
def test_the_network_is_that_of_the_thesis(images, rows):
    net = BayesianCNN((100, 101), compute=torch.float64)
    masks = net.draw(rows, "try")
    batch = images.expand(2, -1, -1, -1)
    assert net.features(batch).shape == (2, 6, 3872)
    for replica in range(2):
        expected = plain(net, replica, images, masks)
        torch.testing.assert_close(net(batch, masks)[replica], expected, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(net(batch).exp().sum(-1), torch.ones(2, 6, dtype=torch.float64))


@pytest.mark.parametrize("replicas", [1, 2])
def test_features_are_the_same_in_parts_that_stay_in_cache(images, replicas, monkeypatch):
    monkeypatch.setattr(network, "CACHED", 4 * replicas)  # six images are two parts, the second shorter
    net = BayesianCNN(range(100, 100 + replicas), compute=torch.float64)
    batch = images.expand(replicas, -1, -1, -1)
    with torch.inference_mode():
        parts = net.features(batch)
    torch.testing.assert_close(parts, net.features(batch).detach(), rtol=1e-12, atol=1e-14)


def test_a_shared_draw_is_one_function_and_rows_of_masks_are_many(images):
    net = BayesianCNN((100,), compute=torch.float64)
    same = images[:1].expand(1, 6, -1, -1)
    shared, own = net(same, net.draw(1, 0))[0], net(same, net.draw(6, 0))[0]
    assert shared.std(0).max() < 1e-12
    assert own.std(0).min() > 1e-4


@pytest.mark.parametrize(
    ("kernel", "blocks", "widths"),
    [(4, 1, [3872, 128]), (3, 1, [4608, 128]), (4, 2, [3872, 256, 128]), (3, 2, [4608, 1024, 128])],
)
def test_shapes_of_the_recorded_networks(images, kernel, blocks, widths):
    net = BayesianCNN((100,), kernel=kernel, blocks=blocks)
    assert net.widths == widths
    assert net(images[None].float(), net.draw(6)).shape == (1, 6, 10)


def test_initial_weights_follow_the_old_keras_rule():
    first = BayesianCNN((100,)).kernels[0]
    assert first.abs().max().item() == pytest.approx((6 / (16 + 32)) ** 0.5, rel=0.02)
    glorot = BayesianCNN((100,), initialisation="glorot").kernels[0]
    assert glorot.abs().max().item() == pytest.approx((6 / (16 + 32 * 16)) ** 0.5, rel=0.02)


def test_bfloat16_stays_close_to_float32(images):
    batch = images[None].float()
    exact = BayesianCNN((100,))(batch)
    rounded = BayesianCNN((100,), compute=torch.bfloat16)(batch)
    assert rounded.dtype == torch.float32
    assert (exact - rounded).abs().max() < 0.05


def test_bad_settings_are_refused():
    with pytest.raises(ValueError, match="unknown initialisation"):
        BayesianCNN((100,), initialisation="he")
    with pytest.raises(ValueError, match="1 or 2 blocks"):
        BayesianCNN((100,), blocks=3)
    with pytest.raises(ValueError, match="drop probability"):
        BayesianCNN((100,), drop=(1.0, 0.5))
    with pytest.raises(ValueError, match="nothing is left of 28 pixels"):
        BayesianCNN((100,), kernel=20)
