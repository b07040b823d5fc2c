"""NAF (Gu et al., 2016): Q as a value less a parabola in the action, so that its best action needs no search."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty.data_efficiency.model_free.config import ModelFreeConfig
from dropout_uncertainty.data_efficiency.model_free.networks import Network, Trained
from dropout_uncertainty.data_efficiency.model_free.replay import Transitions


class NAF:
    """R replicas of one network with three outputs, of ``inputs`` numbers: V, and μ and L of the advantage.

    Q(x, u) = V(x) - P(x) (u - μ(x))² / 2 with P = L², for one action u in [-1, 1]; L is made positive by exp, μ kept
    within the limits by tanh.
    """

    def __init__(
        self, config: ModelFreeConfig, seeds: Sequence[int], inputs: int, dtype: torch.dtype = torch.float32
    ) -> None:
        normalised = len(config.hidden) + 1 if config.normalise else 0
        network = Network((inputs, *config.hidden, 3), seeds, "value", normalised=normalised, dtype=dtype)
        self.value = Trained(network, config.value_rate, config.value_decay, config.follow)
        self.networks = {"value": self.value}

    @torch.no_grad()
    def act(self, inputs: Float[Tensor, "R inputs"]) -> Float[Tensor, " R"]:
        """Return the actions of highest Q."""
        return self.value.network(inputs[:, None])[:, 0, 1].tanh()

    def learn(self, batch: Transitions) -> Float[Tensor, " R"]:
        """Take a learning step on transitions and return the mean squared TD error before it."""
        with torch.no_grad():
            target = batch.reward + batch.discount * self.value.target(batch.following)[..., :1]
        value, mean, log_root = self.value.network(batch.inputs, training=True).split(1, -1)
        q = value - (2 * log_root).exp() * (batch.action - mean.tanh()).square() / 2
        error = (q - target).square().mean((1, 2))
        self.value.step(error.sum())
        return error.detach()
