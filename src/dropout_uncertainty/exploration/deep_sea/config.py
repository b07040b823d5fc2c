"""What is set of an agent in Deep Sea, and what is refused."""

from dataclasses import dataclass
from typing import Any, Literal, get_args

from dropout_uncertainty.bayes import check_probability
from dropout_uncertainty.exploration.config import NO_DROPOUT, check_learning
from dropout_uncertainty.exploration.policies import POLICIES, Policy, policy
from dropout_uncertainty.settings import at_least, idle, tidy

__all__ = ["EPISODES", "HELD", "Config", "Held", "make_policy"]

#: Episodes for which random numbers are drawn ahead.
EPISODES = 10
#: How long a draw is held.
Held = Literal["move", "episode"]
HELD: tuple[Held, ...] = get_args(Held)
#: No random moves at the start: `policies.in_burn_in` counts from the third tick.
NO_BURN_IN = -2
#: Policies with a temperature that falls.
COOLED = ("boltzmann", "annealed-thompson")


#: Records count episodes in 16 bits.
MOST_EPISODES = 32_760


@dataclass(frozen=True)
class Config:
    """One agent in seas of one size; network and learning step are those of the 2D world unless said otherwise."""

    policy: str  #: Behaviour policy, a key of ``POLICIES``.
    size: int  #: N: rows and columns of the sea, moves of an episode.
    drop: tuple[float, ...] = NO_DROPOUT  #: Drop probability before each weight layer; a one-hot input takes none.
    held: Held = "move"  #: How long a draw is held where the policy acts on one.
    members: int = 1  #: Networks, one of which is followed through an episode; ten as in Osband et al. (2016).
    share: float = 1.0  #: Probability with which a member learns from a transition: the bootstrap (Osband et al. 2016).
    prior_scale: float = 0.0  #: Weight β of randomised prior functions (Osband et al. 2018).
    episodes: int = 10_000  #: Length of a run that does not solve the sea (bsuite).
    #: Episodes until ε would be 0, or the temperature is at its end; chosen, see ``AGENTS``.
    anneal_episodes: int = 1000
    epsilon_floor: float = 0.05  #: Smallest ε.
    temperature_start: float = 0.1  #: First temperature, in units of Q.
    temperature_end: float = 0.003  #: Last temperature.
    hidden: tuple[int, ...] = (50, 50)  #: Widths of the hidden layers.
    memory: int = 30_000  #: Transitions in a replay memory.
    batch: int = 64  #: Transitions per learning step; one step per move, once the memory holds as many.
    discount: float = 0.99  #: γ; with the 0.7 of the 2D world the treasure would be worth nothing at the start.
    learning_rate: float = 0.05  #: Step size; chosen, see ``AGENTS``.
    l2_decay: float = 0.01  #: Weight decay, divided by the batch size.

    def __post_init__(self) -> None:
        check(self)


def check(config: Config) -> None:
    """Raise ValueError where a config makes no sense."""
    if config.policy not in POLICIES:
        raise ValueError(f"unknown policy {config.policy!r}, choose one of {', '.join(POLICIES)}")
    tidy(config)
    check_learning(config)
    at_least(1, members=config.members, anneal_episodes=config.anneal_episodes)
    if config.size < 2:
        raise ValueError(f"a sea has at least 2 rows, got a size of {config.size}")
    if not EPISODES <= config.episodes <= MOST_EPISODES or config.episodes % EPISODES:
        wanted = f"a positive multiple of {EPISODES} up to {MOST_EPISODES:,}"
        raise ValueError(f"episodes must be {wanted}, got {config.episodes}")
    if len(config.drop) != len(config.hidden) + 1 or config.drop[0]:
        raise ValueError(
            f"expected {len(config.hidden) + 1} drop probabilities, the first 0 for one-hot inputs, got {config.drop}"
        )
    for p in config.drop:
        check_probability(p)
    if config.held not in HELD:
        raise ValueError(f"a draw is held for a move or an episode, got {config.held!r}")
    if not 0 < config.share <= 1:
        raise ValueError(f"a share lies in (0, 1], got {config.share}")
    if config.policy != "epsilon-greedy":
        idle(config, ("epsilon_floor",), "the policy has no ε")
    if config.policy not in COOLED:
        idle(config, ("temperature_start", "temperature_end"), "the policy has no temperature")
    if config.policy not in ("epsilon-greedy", *COOLED):
        idle(config, ("anneal_episodes",), "nothing is annealed")
    if POLICIES[config.policy].draws_weights:
        if not any(config.drop):
            raise ValueError(f"{config.policy} acts on draws of the weights: a drop probability must be above 0")
    else:
        idle(config, ("held",), "the policy acts on the mean weights")


def make_policy(config: Config) -> Policy:
    """Return the policy with the settings of the config."""
    moves = config.anneal_episodes * config.size
    temperatures = {"start": config.temperature_start, "end": config.temperature_end, "cooling_end": moves}
    settings: dict[str, dict[str, Any]] = {
        "epsilon-greedy": {"anneal_end": moves, "floor": config.epsilon_floor},
        "boltzmann": temperatures,
        "annealed-thompson": temperatures,
    }
    return policy(config.policy, burn_in=NO_BURN_IN, **settings.get(config.policy, {}))
