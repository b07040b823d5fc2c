"""Behaviour policies: how an agent turns the values of its Q-network into an action.

A policy is a function of the Q-values and of random numbers drawn ahead of time. To add one, write a class with a
``__call__`` like those below and enter it in ``POLICIES``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

__all__ = [
    "POLICIES", "AnnealedThompson", "Boltzmann", "Chance", "EpsilonGreedy", "Greedy", "Policy", "Thompson", "gumbel",
    "policy",
]  # fmt: skip


class Chance(NamedTuple):
    """Random numbers for one decision of each replica: two uniform ones [R] and Gumbel noise [R, C]."""

    whether: NDArray
    which: NDArray
    gumbel: NDArray


def gumbel(uniform: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return standard Gumbel noise from uniform numbers in [0, 1)."""
    with np.errstate(divide="ignore"):
        return -np.log(-np.log(uniform))


@runtime_checkable
class Policy(Protocol):
    """Chooses one action per replica."""

    #: True to act on the values under one weight draw, False to act on those of the network without dropout.
    draws_weights: ClassVar[bool]

    def __call__(self, q: Float[np.ndarray, "R C"], chance: Chance, tick: int) -> Int[np.ndarray, " R"]:
        """Return the actions at ``tick`` (1, 2, ...) for Q-values ``q``."""


def random_action(q: NDArray, chance: Chance) -> Int[np.ndarray, " R"]:
    """Return uniformly random actions."""
    return (chance.which * q.shape[-1]).astype(np.int64)


def sample_softmax(q: NDArray, temperature: float, chance: Chance) -> Int[np.ndarray, " R"]:
    """Return actions from Categorical(softmax(q / temperature)), by the Gumbel-max trick."""
    return (q / temperature + chance.gumbel).argmax(-1)


@dataclass(frozen=True)
class EpsilonGreedy:
    """Takes a random action with probability ε, else the best one.

    ε is 1 during the burn-in, then falls linearly as if to reach 0 at ``anneal_end``, but stays at ``floor``: the demo
    never stops exploring. A random action may be the best one; among equals the first wins.
    """

    burn_in: int = 3000
    anneal_end: int = 200_000
    floor: float = 0.05
    draws_weights: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check the schedule; raises ValueError."""
        if self.anneal_end <= self.burn_in:
            raise ValueError(f"anneal_end must exceed burn_in ({self.burn_in}), got {self.anneal_end}")
        if not 0 <= self.floor <= 1:
            raise ValueError(f"the floor of epsilon must be a probability, got {self.floor}")

    def epsilon(self, tick: int) -> float:
        """Return the probability of a random action at ``tick``."""
        learned = (tick - 1 - self.burn_in) / (self.anneal_end - self.burn_in)
        return min(1.0, max(self.floor, 1.0 - learned))

    def __call__(self, q: NDArray, chance: Chance, tick: int) -> Int[np.ndarray, " R"]:
        """Return the actions."""
        return np.where(chance.whether < self.epsilon(tick), random_action(q, chance), q.argmax(-1))


@dataclass(frozen=True)
class Greedy:
    """Takes the best action, and a random one during the burn-in only: the control that does not explore. Ours."""

    burn_in: int = 3000
    draws_weights: ClassVar[bool] = False

    def __call__(self, q: NDArray, chance: Chance, tick: int) -> Int[np.ndarray, " R"]:
        """Return the actions."""
        return random_action(q, chance) if in_burn_in(tick, self.burn_in) else q.argmax(-1)


@dataclass(frozen=True)
class Thompson(Greedy):
    """Draws the weights and takes the action that is best under the draw; random actions during the burn-in only."""

    draws_weights: ClassVar[bool] = True


@dataclass(frozen=True)
class Boltzmann:
    """Samples an action from softmax(Q / τ), with τ falling geometrically from ``start`` to ``end`` (thesis, Remark).

    The thesis gives no schedule. Ours falls while ε does, from 0.1, about the difference in Q between
    the best and the worst action of a trained network, to 0.003, a tenth of that between the best two.
    """

    burn_in: int = 3000
    cooling_end: int = 200_000
    start: float = 0.1
    end: float = 0.003
    draws_weights: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check the schedule; raises ValueError."""
        if self.cooling_end <= self.burn_in:
            raise ValueError(f"cooling_end must exceed burn_in ({self.burn_in}), got {self.cooling_end}")
        if not 0 < self.end <= self.start < np.inf:
            raise ValueError(f"temperatures must be positive and fall, got {self.start} to {self.end}")

    def temperature(self, tick: int) -> float:
        """Return τ at ``tick``, in units of Q."""
        cooled = (tick - 1 - self.burn_in) / (self.cooling_end - self.burn_in)
        return self.start * (self.end / self.start) ** min(1.0, max(0.0, cooled))

    def __call__(self, q: NDArray, chance: Chance, tick: int) -> Int[np.ndarray, " R"]:
        """Return the actions."""
        if in_burn_in(tick, self.burn_in):
            return random_action(q, chance)
        return sample_softmax(q, self.temperature(tick), chance)


@dataclass(frozen=True)
class AnnealedThompson(Boltzmann):
    """Boltzmann exploration on the values under a draw of the weights: the combination the thesis proposes to try."""

    draws_weights: ClassVar[bool] = True


def in_burn_in(tick: int, burn_in: int) -> bool:
    """Return whether fewer than ``burn_in`` transitions were stored before ``tick``; the first comes in tick 3."""
    return tick - 3 < burn_in


POLICIES: dict[str, type[Policy]] = {
    "epsilon-greedy": EpsilonGreedy,
    "thompson": Thompson,
    "greedy": Greedy,
    "boltzmann": Boltzmann,
    "annealed-thompson": AnnealedThompson,
}


def policy(name: str, **settings: Any) -> Policy:
    """Return a policy by name.

    Raises:
        ValueError: if there is none of that name.
    """
    if name not in POLICIES:
        raise ValueError(f"unknown policy {name!r}, choose one of {', '.join(POLICIES)}")
    kind: Callable[..., Policy] = POLICIES[name]
    return kind(**settings)
