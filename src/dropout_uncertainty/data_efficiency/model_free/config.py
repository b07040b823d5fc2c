"""Settings of the learners without a model, and where they stand in the papers."""

from dataclasses import dataclass, field, replace
from typing import Any

from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER, CartPole
from dropout_uncertainty.settings import at_least, positive, tidy

__all__ = ["DDPG_AS_PRINTED", "DDPG_TUNED", "ENDS", "NAF_AS_PRINTED", "NAF_TUNED", "SEARCH", "ModelFreeConfig"]


@dataclass(frozen=True)
class ModelFreeConfig:
    """One learner on the cart-pole; defaults are those of DDPG as printed.

    "DDPG" is Lillicrap et al. (2015), experiment details; "NAF" is Gu et al. (2016). Both papers have other cart-poles,
    so plant, length and end of a run are ours.
    """

    method: str = "ddpg"  #: Learner: "ddpg" or "naf".
    #: The cart-pole of Deep PILCO: the same start states, steps, force limit and cost.
    plant: CartPole = field(default_factory=lambda: PAPER)
    trials: int = 2_500  #: Trials at most.
    test_every: int = 10  #: Every so many trials one is without noise; it counts for "solved" and for the curves.
    solved_tests: int = 3  #: A repetition ends after so many solved tests in a row.
    hidden: tuple[int, ...] = (400, 300)  #: Widths of the hidden layers (DDPG: 400 and 300, NAF: 200 and 200).
    #: Batch normalisation of inputs and hidden layers, of Q only before the action comes in (DDPG).
    normalise: bool = True
    #: What x, v, w, sin θ and cos θ are divided by: the spreads of Deep PILCO's first policies; ours.
    scale: tuple[float, ...] = (1.0, 2.0, 4.0, 0.7, 0.7)
    time_input: bool = False  #: Whether the share of the trial that is over is a further input; not in the papers.
    #: Whether nothing is expected behind a trial's last step, which ends by time alone; the papers have no such end.
    end_is_terminal: bool = False
    policy_rate: float = 1e-4  #: Adam's step size for the policy (DDPG).
    #: Adam's step size for Q (DDPG), or for the one network (NAF: searched in 1e-4, 1e-3, 1e-2).
    value_rate: float = 1e-3
    #: L2 decay of all parameters of Q, in the gradient that Adam is given (DDPG, as we read it).
    value_decay: float = 1e-2
    discount: float = 0.99  #: γ (DDPG, NAF).
    follow: float = 1e-3  #: τ, with which target networks follow (DDPG, NAF).
    batch: int = 64  #: Transitions of a learning step (DDPG).
    memory: int = 1_000_000  #: Transitions that are remembered (DDPG).
    updates: int = 1  #: Learning steps per step of the plant (DDPG: 1, NAF: 5).
    noise_return: float = 0.15  #: θ of the Ornstein–Uhlenbeck noise, by which it returns to 0 in a step (DDPG).
    #: σ, what comes in in a step, as a share of the force limit (DDPG; NAF: searched in 0.1, 0.3, 1).
    noise_std: float = 0.2

    def __post_init__(self) -> None:
        tidy(self)
        if self.method not in ("ddpg", "naf"):
            raise ValueError(f"expected the method ddpg or naf, got {self.method!r}")
        counts = {name: getattr(self, name) for name in ("trials", "test_every", "solved_tests", "updates")}
        if min(counts.values()) < 1 or self.trials % self.test_every:
            raise ValueError(f"expected positive numbers, and trials in whole blocks of test_every, got {counts}")
        at_least(2, batch=self.batch)
        at_least(self.batch, memory=self.memory)
        if not self.hidden or min(self.hidden) < 1 or (self.method == "ddpg" and len(self.hidden) < 2):
            raise ValueError(
                f"expected two or more hidden layers, the action joins behind the first, got {self.hidden}"
            )
        if len(self.scale) != 5 or min(self.scale) <= 0:
            raise ValueError(f"expected five positive scales, one per feature, got {self.scale}")
        positive(policy_rate=self.policy_rate, value_rate=self.value_rate)
        at_least(0, value_decay=self.value_decay, noise_std=self.noise_std)
        shares = {name: getattr(self, name) for name in ("discount", "follow", "noise_return")}
        if not all(0 <= share <= 1 for share in shares.values()):
            raise ValueError(f"expected shares between 0 and 1, got {shares}")


DDPG_AS_PRINTED = ModelFreeConfig()
#: Of the searched values the middle ones.
NAF_AS_PRINTED = ModelFreeConfig(
    method="naf", hidden=(200, 200), normalise=False, value_decay=0.0, updates=5, noise_std=0.3
)

#: What the search on development seeds tries: for NAF the paper's own grid and one more, for DDPG changes of what is
#: printed, in three rounds: one at a time, then with noise that meets a reward, then without the decay of Q. The best
#: is the one of least mean cost over the tests of the last hundred trials. More than one update a step is not among
#: DDPG's: twenty repetitions of 2,500 trials would take seven core-hours with five.
CHANGES: dict[str, dict[str, Any]] = {
    "ddpg-search/printed": {},
    "ddpg-search/policy-rate-1e-3": {"policy_rate": 1e-3},
    "ddpg-search/not-normalised": {"normalise": False},
    "ddpg-search/noise-0.5": {"noise_std": 0.5},
    "ddpg-search/noise-1": {"noise_std": 1.0},
    "ddpg-search/noise-1-policy-rate-1e-3": {"noise_std": 1.0, "policy_rate": 1e-3},
    "ddpg-search/noise-1-not-normalised": {"noise_std": 1.0, "normalise": False},
    "ddpg-search/noise-1-no-decay": {"noise_std": 1.0, "value_decay": 0.0},
    "ddpg-search/noise-1-no-decay-not-normalised": {"noise_std": 1.0, "value_decay": 0.0, "normalise": False},
    "ddpg-search/noise-1-no-decay-policy-rate-1e-3": {"noise_std": 1.0, "value_decay": 0.0, "policy_rate": 1e-3},
    **{
        f"naf-search/rate-{rate:g}-noise-{noise:g}": {"value_rate": rate, "noise_std": noise}
        for rate in (1e-4, 1e-3, 1e-2)
        for noise in (0.1, 0.3, 1.0)
    },
    "naf-search/noise-1-follow-1e-2": {"noise_std": 1.0, "follow": 1e-2},
}
SEARCH: dict[str, ModelFreeConfig] = {
    name: replace(DDPG_AS_PRINTED if name.startswith("ddpg") else NAF_AS_PRINTED, trials=400, **change)
    for name, change in CHANGES.items()
}

#: The best of the search by that rule, which the published runs have.
DDPG_TUNED = replace(DDPG_AS_PRINTED, **CHANGES["ddpg-search/noise-1-no-decay-not-normalised"])
NAF_TUNED = replace(NAF_AS_PRINTED, **CHANGES["naf-search/rate-0.001-noise-1"])

#: Other ends of a trial, over the first 400 trials: the end counts as one, without or with time among the inputs; or it
#: does not, as usual, with time among them.
ENDS: dict[str, ModelFreeConfig] = {
    f"ends/{config.method}/{name}": replace(config, trials=400, end_is_terminal=terminal, time_input=time)
    for config in (DDPG_TUNED, NAF_TUNED)
    for name, terminal, time in (
        ("terminal", True, False),
        ("terminal-with-time", True, True),
        ("with-time", False, True),
    )
}
