"""DDPG (Lillicrap et al., 2015, algorithm 1): a policy that climbs the slope of a learned Q in the action."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from dropout_uncertainty.data_efficiency.model_free.config import ModelFreeConfig
from dropout_uncertainty.data_efficiency.model_free.networks import Network, Trained
from dropout_uncertainty.data_efficiency.model_free.replay import Transitions


class DDPG:
    """R replicas of policy and Q for ``inputs`` numbers and one action in [-1, 1]."""

    def __init__(
        self, config: ModelFreeConfig, seeds: Sequence[int], inputs: int, dtype: torch.dtype = torch.float32
    ) -> None:
        sizes, layers, follow = (inputs, *config.hidden, 1), len(config.hidden) + 1, config.follow
        policy = Network(sizes, seeds, "policy", normalised=layers if config.normalise else 0, dtype=dtype)
        value = Network(sizes, seeds, "value", normalised=2 if config.normalise else 0, joined=(1, 1), dtype=dtype)
        self.policy = Trained(policy, config.policy_rate, 0.0, follow)
        self.value = Trained(value, config.value_rate, config.value_decay, follow)
        self.networks = {"policy": self.policy, "value": self.value}

    @torch.no_grad()
    def act(self, inputs: Float[Tensor, "R inputs"]) -> Float[Tensor, " R"]:
        """Return the actions of the policies, without noise."""
        return self.policy.network(inputs[:, None]).tanh()[:, 0, 0]

    def learn(self, batch: Transitions) -> Float[Tensor, " R"]:
        """Take a learning step on transitions and return the mean squared TD error before it."""
        with torch.no_grad():
            best = self.policy.target(batch.following).tanh()
            target = batch.reward + batch.discount * self.value.target(batch.following, best)
        error = (self.value.network(batch.inputs, batch.action, training=True) - target).square().mean((1, 2))
        self.value.step(error.sum())
        chosen = self.policy.network(batch.inputs, training=True).tanh()
        self.policy.step(-self.value.network(batch.inputs, chosen).mean((1, 2)).sum())
        return error.detach()
