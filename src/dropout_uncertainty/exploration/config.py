"""What is set in an experiment of section 5.3, and what is refused: a setting that cannot work or would do nothing."""

from dataclasses import dataclass, field
from typing import Any

from dropout_uncertainty.bayes import check_probability
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.foraging.world import CHUNK, Rules
from dropout_uncertainty.exploration.policies import POLICIES, Policy, policy
from dropout_uncertainty.settings import at_least, idle, tidy

__all__ = ["BLOCK", "NO_DROPOUT", "AgentConfig", "Config", "check_learning", "make_policy"]

#: Ticks per block, the unit in which results are kept: one point of the demo's plot.
BLOCK = 500
NO_DROPOUT = (0.0, 0.0, 0.0)
COOLING = {"temperature_start": "start", "temperature_end": "end", "cooling_end": "cooling_end"}
#: Fields of ``Config`` that set a policy, and what they are called there.
SCHEDULES: dict[str, dict[str, str]] = {
    "epsilon-greedy": {"anneal_end": "anneal_end", "epsilon_floor": "floor"},
    "boltzmann": COOLING,
    "annealed-thompson": COOLING,
}


@dataclass(frozen=True)
class AgentConfig:
    """What distinguishes the agents of one world."""

    policy: str  #: Behaviour policy, a key of ``POLICIES``.
    drop: tuple[float, ...] = NO_DROPOUT  #: Drop probability before each weight layer: inputs, hidden 1, hidden 2.
    #: Drop probabilities of the draws that are acted on; None: those of learning. Ours.
    drop_acting: tuple[float, ...] | None = field(default=None, metadata={"before": None})
    #: Ticks for which a draw is held in acting; the thesis takes a new one at every tick. Ours.
    hold: int = field(default=1, metadata={"before": 1})
    #: Last tick at which a draw is acted on, later the mean weights; None: no end. Ours, after footnote 4.
    draws_until: int | None = field(default=None, metadata={"before": None})

    def __post_init__(self) -> None:
        tidy(self)

    @property
    def drop_when_acting(self) -> tuple[float, ...]:
        """Drop probabilities of the draws that are acted on."""
        return self.drop if self.drop_acting is None else self.drop_acting


@dataclass(frozen=True)
class Config:
    """One experiment. Sources: rl_demo.html and deepqlearn.js of the demo, unless said otherwise."""

    agents: tuple[AgentConfig, ...]  #: The agents; more than one share a world and its items.
    ticks: int  #: Length of a run; the demo runs until it is stopped.
    hidden: tuple[int, ...] = (50, 50)  #: Widths of the hidden layers.
    burn_in: int = 3000  #: Transitions in memory before agents stop acting at random; the thesis says 25 batches.
    anneal_end: int = 200_000  #: Tick at which ε would reach 0 if it did not stop at its floor.
    epsilon_floor: float = 0.05  #: Smallest ε.
    temperature_start: float = 0.1  #: Temperature at the end of the burn-in, in units of Q; ours, see ``Boltzmann``.
    temperature_end: float = 0.003  #: Last temperature, in units of Q; ours.
    cooling_end: int = 200_000  #: Tick at which the temperature reaches its end, having fallen geometrically; ours.
    memory: int = 30_000  #: Transitions in the replay memory.
    learning_start: int = 1000  #: Learning begins when the memory holds more transitions than this.
    batch: int = 64  #: Transitions per learning step, drawn with replacement; one step per tick, the thesis's "batch".
    discount: float = 0.7  #: γ.
    learning_rate: float = 0.001  #: Step size of gradient descent on the mean over the minibatch.
    l2_decay: float = 0.01  #: Weight decay; convnetjs divides it by the batch size.
    #: Each n-th block of transitions is kept from learning, to measure TD errors on it; 0: none. Ours.
    held_out_every: int = 0
    rules: Rules = field(default_factory=Rules)  #: Rules of the world.

    @property
    def held_out_size(self) -> int:
        """Transitions kept from learning in memory, as many as there are of those age among the others."""
        return self.memory // (self.held_out_every - 1) if self.held_out_every else 0

    def __post_init__(self) -> None:
        tidy(self)
        _check_sizes(self)
        for agent in self.agents:
            _check_agent(agent, self)
        _check_schedules(self)


def make_policy(name: str, config: Config) -> Policy:
    """Return the policy of that name with the settings of the config."""
    schedule = {theirs: getattr(config, ours) for ours, theirs in SCHEDULES.get(name, {}).items()}
    return policy(name, burn_in=config.burn_in, **schedule)


# ------------------------------------------------------------------ what is refused


def check_precision(precision: str) -> None:
    """Raise UserError for a precision in which the agents' matrix products are not to be had."""
    if precision not in ("float32", "float64"):
        raise UserError(f"the agents of section 5.3 compute in float32 or float64, not in {precision!r}")


def check_learning(config: Any) -> None:
    """Refuse settings of network, memory and learning step with which nothing would be learned."""
    at_least(1, memory=config.memory, batch=config.batch)
    for width in config.hidden:
        if width < 1:
            raise ValueError(f"a hidden layer's width must be at least 1, got {width}")
    if not 0 <= config.discount <= 1:
        raise ValueError(f"discount must be a number from 0 to 1, got {config.discount}")
    at_least(0, l2_decay=config.l2_decay)
    if config.learning_rate <= 0:
        raise ValueError(f"learning_rate must be above 0, or nothing is learned, got {config.learning_rate}")


def _check_sizes(config: Config) -> None:
    """Refuse numbers out of their range, and sizes with which nothing would be learned or acted on."""
    if not config.agents:
        raise ValueError("a config needs at least one agent, as a tuple of AgentConfig, got ()")
    check_learning(config)
    at_least(1, ticks=config.ticks, burn_in=config.burn_in)
    at_least(0, learning_start=config.learning_start, held_out_every=config.held_out_every)
    if config.ticks % BLOCK:
        raise ValueError(f"ticks must be a positive multiple of {BLOCK}, got {config.ticks}")
    if config.memory <= config.learning_start:
        raise ValueError(
            f"memory must exceed learning_start ({config.learning_start}), or learning never starts, "
            f"got {config.memory}"
        )
    if config.burn_in <= config.learning_start:
        raise ValueError(f"burn_in must exceed learning_start ({config.learning_start}), got {config.burn_in}")
    if config.ticks < config.burn_in + 3:
        raise ValueError(f"ticks must exceed burn_in + 2 ({config.burn_in + 2}), or all moves are random")
    _check_held_out(config)


def _check_held_out(config: Config) -> None:
    every, blocks = config.held_out_every, config.ticks // BLOCK
    if every and not 2 <= every <= min(blocks, config.memory + 1):
        raise ValueError(f"held_out_every must be 0, or at least 2 and at most the {blocks} blocks, got {every}")


def _check_agent(agent: AgentConfig, config: Config) -> None:
    """Refuse an agent that cannot be, or draws that would be none."""
    name = agent.policy
    if name not in POLICIES:
        raise ValueError(f"unknown policy {name!r}, choose one of {', '.join(POLICIES)}")
    for drop in (agent.drop, agent.drop_when_acting):
        if len(drop) != len(config.hidden) + 1:
            raise ValueError(f"expected {len(config.hidden) + 1} drop probabilities per agent, got {drop}")
        for p in drop:
            check_probability(p)
    at_least(1, hold=agent.hold)
    if CHUNK % agent.hold and agent.hold % CHUNK:
        raise ValueError(f"hold must be a divisor or a multiple of {CHUNK} ticks, got {agent.hold}")
    draws = POLICIES[name].draws_weights
    if draws and not any(agent.drop_when_acting):
        raise ValueError(f"{name} acts on draws of the weights: at least one drop probability must be above 0")
    if not draws and (agent.drop_acting, agent.hold, agent.draws_until) != (None, 1, None):
        raise ValueError(f"{name} acts on the mean weights: drop_acting, hold and draws_until would do nothing")
    if agent.draws_until is not None:
        at_least(config.burn_in + 3, draws_until=agent.draws_until)
        if agent.draws_until >= config.ticks:
            raise ValueError(f"draws_until must lie before the last tick ({config.ticks}), got {agent.draws_until}")


def _check_schedules(config: Config) -> None:
    """Refuse a schedule that makes no sense, or that no agent follows."""
    policies = [agent.policy for agent in config.agents]
    for name in policies:
        make_policy(name, config)
    followed = {setting for name in policies for setting in SCHEDULES.get(name, {})}
    idle(config, {s for known in SCHEDULES.values() for s in known} - followed, "no agent has a policy that follows it")
