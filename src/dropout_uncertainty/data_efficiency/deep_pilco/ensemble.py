"""An ensemble in the place of dropout: several networks per replica, which share the particles.

A draw of the weights is the choice of a member (Lakshminarayanan, Pritzel and Blundell, Simple and scalable predictive
uncertainty estimation using deep ensembles, 2017). Every particle keeps its member over the whole trajectory, and every
member has equally many particles. Replicas R first, then members M.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dropout_uncertainty.bayes import Masks
from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import DrawnFunction, DropoutDynamics
from dropout_uncertainty.rng import derived


@dataclass(frozen=True)
class MembersFunction:
    """The functions of R ensembles; each particle follows one member, or all follow the mean of the members."""

    function: DrawnFunction  # of R M networks
    members: int
    averaged: bool = False

    @property
    def angle_features(self) -> bool:
        """Whether it is given features of the state."""
        return self.function.angle_features

    def __call__(self, inputs: Float[Tensor, "R K D"]) -> Float[Tensor, "R K E"]:
        """Return the change of state for features (without ``angle_features``: the state) and force."""
        if self.averaged:
            every = self.function(inputs.repeat_interleave(self.members, 0))
            return every.unflatten(0, (-1, self.members)).mean(1)
        shared = self.function(inputs.unflatten(1, (self.members, -1)).flatten(0, 1))
        return shared.unflatten(0, (-1, self.members)).flatten(1, 2)


@dataclass(frozen=True)
class Ensemble:
    """R ensembles of networks without dropout, which differ in their first weights and their minibatches."""

    seeds: tuple[int, ...]  # one per replica
    members: int  # networks M of each
    networks: DropoutDynamics  # R M of them
    averaged: bool = False  # all particles follow the mean of the members

    @classmethod
    def of(cls, seeds: Sequence[int], members: int, **options: Any) -> "Ensemble":
        """Return new ensembles; the options are those of the networks (`DropoutDynamics`)."""
        own = [derived(seed, "member", member) for seed in seeds for member in range(members)]
        return cls(tuple(seeds), members, DropoutDynamics(own, drop=0.0, **options))

    @property
    def log_noise(self) -> Tensor:
        """Logarithms of the noise standard deviations of all networks."""
        return self.networks.log_noise

    def inputs(self, states: Float[Tensor, "*batch 4"], forces: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch D"]:
        """Return what the networks are given for states and forces [N]."""
        return self.networks.inputs(states, forces)

    def noise_std(self) -> Float[Tensor, "R E"]:
        """Return the learned standard deviation of the noise in SI units, mean over the members."""
        return self.networks.noise_std().unflatten(0, (-1, self.members)).mean(1)

    def fit(
        self, inputs: Float[Tensor, "R N D"], targets: Float[Tensor, "R N E"], *path: str | int, **options: Any
    ) -> tuple[Float[Tensor, " R"], Int[Tensor, " R"]]:
        """Train every member on all transitions (`DropoutDynamics.fit`); return the mean objective and all repairs."""
        inputs, targets = (tensor.repeat_interleave(self.members, 0) for tensor in (inputs, targets))
        loss, repairs = self.networks.fit(inputs, targets, *path, **options)
        return loss.unflatten(0, (-1, self.members)).mean(1), repairs.unflatten(0, (-1, self.members)).sum(1)

    def draw(self, count: int, *path: str | int) -> Masks:
        """Return nothing: which member a particle follows is known from its place."""
        return ()

    def function(self, masks: Masks | None) -> MembersFunction:
        """Return the functions of the particles."""
        return MembersFunction(self.networks.function(None), self.members, self.averaged)

    def mean(self) -> "Ensemble":
        """Return the ensemble whose particles all follow the mean of its members; parameters are shared."""
        return replace(self, averaged=True)

    def select(self, replicas: Sequence[int]) -> "Ensemble":
        """Return a copy with some of the replicas."""
        networks = torch.arange(len(self.seeds) * self.members).unflatten(0, (-1, self.members))[list(replicas)]
        seeds = tuple(self.seeds[row] for row in replicas)
        return replace(self, seeds=seeds, networks=self.networks.select(networks.flatten().tolist()))

    def state(self) -> dict[str, Tensor]:
        """Return a copy of all that a fit changes."""
        return self.networks.state()

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from `state()` of an ensemble made with the same arguments."""
        self.networks.restore(state)
