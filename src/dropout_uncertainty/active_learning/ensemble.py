"""An ensemble as what scores the pool: the yardstick of the field for weight draws that cost one training."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from dropout_uncertainty.active_learning.loop import Learner


class Member(Learner, Protocol):
    """A learner whose networks are a function of the round, and whose test error can be asked for."""

    round: int

    def test_error(self, draws: int = 0) -> Float[np.ndarray, " R"]:
        """Return the test error in %."""


class Ensemble:
    """Networks trained on the same points from different streams; one deterministic pass of each is a draw.

    Only the scores are the ensemble's. The test error is that of the first member, since an ensemble predicts better
    than one network whatever points it was trained on.
    """

    def __init__(self, members: Sequence[Member]) -> None:
        self.members = members
        self.classes = getattr(members[0], "classes", None)
        self.round = -1

    def fit(self, labelled: Int[Tensor, "R n"]) -> None:
        """Train every member from scratch."""
        for member in self.members:
            member.round = self.round
            member.fit(labelled)
        self.round += 1

    def log_probs(self, candidates: Int[Tensor, "R M"], draws: int) -> Float[Tensor, "R S M 10"]:
        """Return log-probabilities under each of the S members; ``draws`` has no say."""
        return torch.cat([member.log_probs(candidates, 0) for member in self.members], 1)

    def test_error(self, draws: int = 0) -> Float[np.ndarray, " R"]:
        """Return the test error of the first member in %, see ``CNNLearner.test_error``."""
        return self.members[0].test_error(draws)
