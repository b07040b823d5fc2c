"""The training objective of a dropout network and its gradients, worked out by hand.

Beside autograd it saves the passes over memory that fuse into others: the weight decay and the scale of the masks go
into the matrix products, a dropped unit and one below zero are the same zero, and narrow layers are multiplied in the
order that is fast for a few columns.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty.bayes import MLP, Masks


def pull_back(name: str, gradient: Tensor, h: Tensor) -> Tensor:
    """Return the gradient before an activation, "relu" or "sigmoid", from that behind it and its value."""
    if name == "relu":
        return torch.ops.aten.threshold_backward(gradient, h, 0)
    return torch.ops.aten.sigmoid_backward(gradient, h)


@torch.no_grad()
def set_gradients(
    net: MLP,
    activation: str,
    log_noise: Float[Tensor, "R 1 E"],
    limits: tuple[float, float],
    x: Float[Tensor, "R B D"],
    y: Float[Tensor, "R B E"],
    masks: Masks,
    decays: Sequence[float],
) -> Float[Tensor, " R"]:
    """Return the mean negative log-likelihood per row, and set ``grad`` of the parameters to that of the objective.

    The objective is the likelihood and, for each weight matrix, its decay times the sum of squares.

    Args:
        net: the networks.
        activation: of the networks, by name.
        log_noise: log standard deviation of the noise, a parameter.
        limits: between which it has an effect.
        x: inputs.
        y: targets.
        masks: a weight draw per row.
        decays: one per weight matrix.
    """
    *inner, last = zip(net.weights, net.biases, strict=True)
    seen, h = [], x if masks[0] is None else x * masks[0]
    for (weight, bias), mask in zip(inner, masks[1:], strict=True):
        seen.append(h)
        h = torch.baddbmm(bias, h, weight)
        h = h.relu_() if activation == "relu" else h.sigmoid_()
        if mask is not None:
            h.mul_(mask)
    noise = log_noise.clamp(*limits).mT  # [R, E, 1], as the residuals: rows last
    precision = torch.exp(-noise)
    residual = (torch.baddbmm(last[1].mT, last[0].mT, h.mT) - y.mT) * precision
    count = x.shape[1]
    loss = (residual.square().mean(-1) / 2 + noise[..., 0]).sum(-1)

    inside = (log_noise >= limits[0]) & (log_noise <= limits[1])
    log_noise.grad = (1 - residual.square().mean(-1))[:, None] * inside
    out = residual * (precision / count)
    last[0].grad = torch.baddbmm(last[0].mT, out, h, beta=2 * decays[-1]).mT.contiguous()
    last[1].grad = out.sum(-1)[:, None]
    gradient, after = out.mT, last[0]
    for layer in reversed(range(len(inner))):
        weight, bias = inner[layer]
        keep = 1 - net.drop[layer + 1]
        gradient = torch.baddbmm(h, gradient, after.mT, beta=0, alpha=1 / keep)
        gradient = pull_back(activation, gradient, h if activation == "relu" else h * keep)
        h, after = seen[layer], weight
        weight.grad = torch.baddbmm(weight, h.mT, gradient, beta=2 * decays[layer])
        bias.grad = gradient.sum(1, keepdim=True)
    return loss
