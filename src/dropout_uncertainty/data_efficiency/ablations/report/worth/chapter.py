"""What the notebook *What doubt is worth* asks for in one call: the runs of a profile, and their sentences."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.ablations import doubt, gradients, literal, mchutchon, shrinking
from dropout_uncertainty.data_efficiency.ablations.gradients import ESTIMATES
from dropout_uncertainty.data_efficiency.ablations.mchutchon import ParticlePilcoConfig
from dropout_uncertainty.data_efficiency.ablations.report.analysis import Comparison, factor, pair
from dropout_uncertainty.data_efficiency.ablations.report.chapter import TINY
from dropout_uncertainty.data_efficiency.ablations.report.worth import analysis as worth
from dropout_uncertainty.data_efficiency.ablations.report.worth.analysis import PAIRS, Cloud, Estimates, coverage
from dropout_uncertainty.data_efficiency.pilco.learner import PilcoConfig
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.page.profiles import complete
from dropout_uncertainty.page.tables import Words
from dropout_uncertainty.runs.process import finished
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import in_words, t_interval, told

__all__ = ["Runs", "answers", "choices", "clouds", "grown", "pairs_table", "runs", "trusted"]

SEEDS = (100, 101, 102)
#: What an interval of a difference of costs says.
COSTS = ("costs more", "costs less", "may cost more or less")
#: Live runs: what is smaller than in the stored ones; of PILCO, of its particles, and of the two measurements.
TINY_PILCO: dict[str, Any] = {"trials": 2, "policy_iterations": 4, "model_iterations": 10}
TINY_PLAN: dict[str, Any] = {"particles": 10, "policy_steps": 8}
TINY_GRADIENTS: dict[str, Any] = {"particles": 10, "draws": 4, "horizons": (5, 15, 25)}
#: The settings of Deep PILCO, from the text's to ours.
SETTINGS = ("deep-pilco-as-text", "deep-pilco-as-written", "deep-pilco-ours")
#: Choices of the text that are run live.
LIVE = ("matching", "angle-features")


@dataclass(frozen=True)
class Runs:
    """What the chapter shows, as far as it has been run."""

    settings: Sequence[Learning]  #: of Deep PILCO.
    pairs: Sequence[Comparison]
    literal: dict[str, list[Comparison]]
    particles: Sequence[Comparison]
    clouds: Sequence[Cloud]
    estimates: Estimates | None

    @classmethod
    def of(cls, find: worth.Find, clouds: Sequence[Cloud], estimates: Estimates | None) -> "Runs":
        """Return what can be compared of the learners that are found."""
        settings = [learning for name in SETTINGS if (learning := find(name))]
        return cls(
            settings, worth.pairs(find), worth.literal_pairs(find), worth.particle_pairs(find), clouds, estimates
        )

    @property
    def pilco(self) -> Comparison | None:
        """PILCO planning on its mean beside PILCO."""
        return next((found for found in self.pairs if found.name == "pilco-mean"), None)

    @property
    def records(self) -> list[Record]:
        """The records of all this, each once."""
        compared = [*self.pairs, *self.particles, *(found for those in self.literal.values() for found in those)]
        made = [record for learning in self.settings for record in learning.records]
        made += [record for x in compared for record in (*x.first.records, *x.second.records)]
        made += [record for cloud in self.clouds for record in cloud.records]
        made += self.estimates.records if self.estimates else []
        return list({record.label: record for record in made}.values())

    def missing(self, part: str) -> Words:
        """Return in a line what of a part of the page has not been run; nothing where all has."""
        have: dict[str, Iterable[str]] = {
            "doubt": {found.first.config for found in self.pairs},
            "literal": {f"literal/{way}/{found.name}" for way, those in self.literal.items() for found in those},
            "mchutchon": {x.config for found in self.particles for x in (found.first, found.second)},
            "shrinking": {f"shrinking/{cloud.name}" for cloud in self.clouds},
            "gradients": {"gradients/pilco"} if self.estimates else set(),
        }
        names = [f"`{name}`" for name in configs.CONFIGS if name.startswith(f"{part}/") and name not in have[part]]
        listed = ", ".join(names) if len(names) <= 6 else f"{len(names)} of the learners `{part}/…`"
        return Words(f"*Not run yet: {listed}.*" if names else "")


def runs(profile: str) -> Runs:
    """Return the stored runs; in ``quick`` live ones that are much too short to tell anything."""
    families = (doubt, literal, mchutchon, shrinking, gradients)
    names = ["deep-pilco-as-text", *(name for family in families for name in family.CONFIGS)]
    complete(profile, [unit for name in names for unit in configs.units(name)])
    if profile == "quick":
        return Runs.of(_live().get, _live_clouds(), _live_estimates())
    return Runs.of(worth.stored(), worth.clouds(), worth.estimates())


def _live() -> dict[str, Learning]:
    """Return short runs of the learners, by the names of their configs; of the slow ones a few."""
    names = ["deep-pilco-ours", "deep-pilco-as-text", "pilco-paper-15"]
    names += [name for name in doubt.CONFIGS if name != "doubt/as-text-mean"]
    names += [f"literal/{way}/{change}" for way in worth.LITERAL for change in LIVE]
    names += [name for name in mchutchon.CONFIGS if name.endswith("-off")]
    return {name: _learned(name, _tiny(configs.CONFIGS[name])) for name in names}


def _tiny(config: Any) -> Any:
    if not isinstance(config, PilcoConfig):
        return replace(config, **TINY)
    if isinstance(config, ParticlePilcoConfig):
        config = replace(config, planning=replace(config.planning, **TINY_PLAN))
    return replace(config, **TINY_PILCO)


def _finished(name: str, config: Any) -> Any:
    return finished(configs.units(name, SEEDS)[0].start(config, SEEDS))


def _learned(name: str, config: Any) -> Learning:
    return analysis.from_arrays(name, config.plant, _finished(name, config).result(), SEEDS)


def _live_clouds() -> list[Cloud]:
    config = replace(shrinking.CONFIGS["shrinking/as-text"], **TINY, many=100)
    return [worth.cloud("as-text", config.particles, _finished("shrinking/as-text", config).result())]


def _live_estimates() -> Estimates:
    config = replace(gradients.CONFIGS["gradients/pilco"], **TINY_PILCO, **TINY_GRADIENTS)
    return Estimates.of(config.horizons, config.draws, _finished("gradients/pilco", config).result())


def pairs_table(found: Runs) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: each pair's differences, and what each of the two keeps, breaks and covers."""
    heads = ["", "pairs", "cost", "trials to solve", "kept", "promise broken by", "coverage"]

    def kept(learning: Learning) -> str:
        return in_words(learning.kept, ".0%")

    def promise(learning: Learning) -> str:
        return in_words(t_interval(learning.broken_promise))

    def share(learning: Learning) -> str | None:
        values = coverage(learning)
        return None if values is None else f"{values.mean():.0%}"

    return heads, [
        [
            PAIRS[x.name], len(x.first.seeds), in_words(x.cost_difference), in_words(x.trials_difference, ".1f"),
            *(f"{say(x.first)} (other: {say(x.second)})" for say in (kept, promise, share)),
        ]
        for x in found.pairs
    ]  # fmt: skip


def answers(found: Runs) -> Words:
    """Return, for each pair that has been run, what its interval says."""
    lines = [
        f"- **{PAIRS[x.name]}** {told(x.cost_difference, *COSTS)}: {in_words(x.cost_difference)} per step over "
        f"{x.first.trials} trials, {len(x.first.seeds)} pairs with {x.second.label}."
        for x in found.pairs
    ]
    by = {x.name: x.first for x in found.pairs}
    if {"mean-network", "no-dropout"} <= by.keys():
        name = PAIRS["mean-network"]
        if both := pair(name, by["mean-network"], by["no-dropout"], worth.LONGEST):
            lines.append(f"- Beside no dropout at all, **{name}** costs {in_words(both.cost_difference)} more.")
    return Words("\n".join(lines))


def trusted(found: Comparison | None, trials: int = 5) -> Words:
    """Return what a sure PILCO expected of its first trials, and what they cost."""
    if found is None:
        return Words("*Not run yet: `doubt/pilco-mean`.*")

    def tell(learning: Learning) -> str:
        here = slice(1, trials + 1)
        said, cost = (t_interval(x[:, here].mean(1)) for x in (learning.predicted_costs, learning.trial_costs))
        return f"{in_words(said)} a step, and they cost {in_words(cost)}"

    count = min(trials, found.first.trials)
    return Words(
        f"Planning on its mean, PILCO expected of its first {count} trials {tell(found.first)}. With its doubt it "
        f"expected {tell(found.second)}."
    )


def choices(found: Runs) -> Words:
    """Return which choices help where they are added, and which hurt where they are taken, beyond their interval."""
    added, taken = found.literal["add"], found.literal["drop"]
    helps = [x.name for x in added if x.cost_difference.high < 0]
    needed = [x.name for x in taken if x.cost_difference.low > 0]
    tell = lambda names: ", ".join(name.replace("-", " ") for name in names) or "none"  # noqa: E731
    said = []
    if added:
        said.append(f"Of {len(added)} added to the text's learner, these make learning cheaper: {tell(helps)}.")
    if taken:
        said.append(f"Of {len(taken)} taken from ours, these make it dearer: {tell(needed)}.")
    if added and taken:
        said.append(f"In both directions: {tell([name for name in helps if name in needed])}.")
    return Words(" ".join([*said, "Each beyond its interval."] if said else []))


def clouds(found: Runs) -> Words:
    """Return what is left of the angle's variance at the end of a predicted trial, learner by learner."""

    def tell(shares: np.ndarray) -> str:
        return in_words(factor(np.log(shares[..., -1]).mean(1)))

    lines = [
        f"- **{cloud.name}**, {cloud.particles} particles: {tell(cloud.left['plain'])} with plain noise, "
        f"{tell(cloud.left['standardised'])} with standardised; in the middle draw {tell(cloud.typical['plain'])} and "
        f"{tell(cloud.typical['standardised'])}."
        for cloud in found.clouds
    ]
    return Words("\n".join(lines))


def grown(found: Estimates | None) -> Words:
    """Return by how much the variance of each estimate grows with the trial, and what total propagation loses."""
    if found is None:
        return Words("")
    first, last = found.horizons[0], found.horizons[-1]
    logs = {name: found.log(name) for name in ESTIMATES}
    decades = {name: in_words(t_interval(log[:, -1] - log[:, 0]), ".1f") for name, log in logs.items()}
    share = {name: factor(np.log(10) * (logs["total-propagation"] - log)[:, -1]) for name, log in logs.items()}
    (exact, error), (mixed, _) = (found.whole(name) for name in ("pathwise", "total-propagation"))
    return Words(
        f"From {first} to {last} steps the variance grows by {decades['pathwise']} powers of ten (pathwise), "
        f"{decades['likelihood-ratio']} (likelihood ratio) and {decades['total-propagation']} (total propagation). At "
        f"{last} steps that of the third is {in_words(share['pathwise'], '.4f')} times that of the first, and "
        f"{in_words(share['likelihood-ratio'], '.4f')} times that of the second.\n\nBut is it the same gradient? "
        f"There, at the last policy, its mean has {in_words(factor(np.log(mixed / exact)))} times the norm of the "
        f"pathwise mean, which is known to within {np.median(error):.0%} of itself in the middle repetition; without "
        "bias it would be 1."
    )
