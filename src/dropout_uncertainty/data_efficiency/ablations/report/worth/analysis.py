"""What doubt is worth, from records: learners beside the same without doubt, choices of the text, clouds, gradients.

Nothing is run and nothing is drawn here. A difference is that named first less the other, paired by seed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dropout_uncertainty.data_efficiency.ablations import doubt, literal, mchutchon, shrinking, variants
from dropout_uncertainty.data_efficiency.ablations.gradients import ESTIMATES
from dropout_uncertainty.data_efficiency.ablations.report.analysis import Comparison, compared, numbers, pair
from dropout_uncertainty.data_efficiency.ablations.shrinking import NOISE
from dropout_uncertainty.data_efficiency.report.analysis import Learning, load
from dropout_uncertainty.judging.results import Result, listed, measured
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import paired_difference, t_interval

#: Finds a learner by the name of its config, among records or live runs; None if it has not been run.
Find = Callable[[str], Learning | None]
#: Trials over which two learners are compared, at most: those within which the thesis's succeeds.
LONGEST = doubt.TRIALS
#: One network without dropout beside five of its kind: a pair that was added when both had been run.
ALONE = "alone"
#: Learners in words, by their configs; what each is held against is in ``doubt.WITH_DOUBT``.
PAIRS = {
    "mean-network": "Deep PILCO, planned on the mean network",
    "no-dropout": "Deep PILCO, no dropout at all",
    "as-text-mean": "Deep PILCO of the text, on the mean network",
    ALONE: "one network of the ensemble, by itself",
    "ensemble-mean": "ensemble, planned on its mean",
    "pilco-mean": "PILCO, planned on its mean",
    "ensemble": "ensemble in the place of dropout",
}
#: The learners that the choices are added to and taken from.
LITERAL = {"add": "deep-pilco-as-text", "drop": "deep-pilco-ours"}
#: Particles through PILCO's Gaussian process: each against the first with moments matched in the same way.
PARTICLES = {"fresh-adam": "fresh particles, Adam", "fixed-bfgs": "fixed particles, BFGS"}


def coverage(learning: Learning) -> Float[np.ndarray, "R T"] | None:
    """Return the share of true states within two predicted standard deviations, by step; None without predictions."""
    if "states" not in learning.arrays or "predicted_mean" not in learning.arrays:
        return None
    return learning.covered[:, 1:].mean((1, 3))


def stored(folder: Path | None = None) -> Find:
    """Return what finds a learner in the records of a folder."""
    return partial(load, folder=folder)


def _paired(name: str, first: Learning | None, second: Learning | None) -> Iterator[Comparison]:
    """Yield a pair, if both are there and share a seed."""
    if first and second and (found := pair(name, first, second, LONGEST)):
        yield found


def pairs(find: Find) -> list[Comparison]:
    """Return the learners of ``PAIRS`` that are found; a shorter run of ten stands in for one still to come."""

    def two(name: str) -> tuple[Learning | None, Learning | None]:
        if name == ALONE:
            return find("doubt/no-dropout"), find("doubt/ensemble")
        return find(f"{doubt.FAMILY}/{name}") or find(f"{variants.FAMILY}/{name}"), find(doubt.WITH_DOUBT[name])

    return [found for name in PAIRS for found in _paired(name, *two(name))]


def literal_pairs(find: Find) -> dict[str, list[Comparison]]:
    """Return the choices of ``literal`` that are found, beside the learner they are added to or taken from."""
    return {
        way: [
            found
            for change in literal.CHANGES
            for found in _paired(change, find(f"literal/{way}/{change}"), find(base))
        ]
        for way, base in LITERAL.items()
    }


def particle_pairs(find: Find) -> list[Comparison]:
    """Return fixed particles with BFGS beside fresh ones with Adam, for each way to match of which both are found."""
    return [
        found
        for matching in ("full", "diagonal", "off")
        for found in _paired(
            matching, find(f"mchutchon/fixed-bfgs-{matching}"), find(f"mchutchon/fresh-adam-{matching}")
        )
    ]


@dataclass(frozen=True)
class Cloud:
    """What refitting leaves of the spread that a learner plans with."""

    name: str  #: of the learner.
    particles: int  #: those that it plans with.
    #: by kind of noise [R, trial, T]: mean variance of the angle over draws, as a share of that of many particles.
    left: Mapping[str, Float[np.ndarray, "R trials T"]]
    typical: Mapping[str, Float[np.ndarray, "R trials T"]]  #: the same of the median over draws.
    records: tuple[Record, ...] = ()  #: where it comes from; none for a live run.


def cloud(name: str, particles: int, arrays: Mapping[str, np.ndarray], found: Sequence[Record] = ()) -> Cloud:
    """Return the cloud of a learner, from the arrays of its records or of a live run."""
    many = arrays["many_variance"][:, 1:, :, 3]
    left, typical = (
        {noise: arrays[f"{kind}_variance"][:, 1:, row, :, 3] / many for row, noise in enumerate(NOISE)}
        for kind in ("mean", "median")
    )
    return Cloud(name, particles, left, typical, tuple(found))


def clouds(folder: Path | None = None) -> list[Cloud]:
    """Return the learners whose clouds were measured."""
    found = []
    for name in shrinking.LEARNERS:
        if learning := load(f"shrinking/{name}", folder):
            count = learning.records[0].header["config"]["particles"]
            found.append(cloud(name, count, learning.arrays, learning.records))
    return found


@dataclass(frozen=True)
class Estimates:
    """Of each estimate of the gradient, over draws: variance and norm of the mean, by length of the trial [steps]."""

    horizons: tuple[int, ...]
    draws: int
    variance: Float[np.ndarray, "R trials estimates horizons"]
    norm: Float[np.ndarray, "R trials estimates horizons"]
    records: tuple[Record, ...] = ()

    @classmethod
    def of(
        cls, horizons: Sequence[int], draws: int, arrays: Mapping[str, np.ndarray], found: Sequence[Record] = ()
    ) -> "Estimates":
        """Return the estimates of a run, from its arrays."""
        variance, norm = (arrays[f"gradient_{name}"][:, 1:].astype(float) for name in ("variance", "norm"))
        return cls(tuple(horizons), draws, variance, norm, tuple(found))

    def log(self, estimate: str) -> Float[np.ndarray, "R horizons"]:
        """Return the decimal logarithm of an estimate's variance, mean over trials."""
        return np.log10(self.variance[:, :, list(ESTIMATES).index(estimate)]).mean(1)

    def whole(self, estimate: str) -> tuple[Float[np.ndarray, " R"], Float[np.ndarray, " R"]]:
        """Return, of the longest trial and the last policy, the norm of the mean, and its standard error as a share."""
        place = (slice(None), -1, list(ESTIMATES).index(estimate), -1)
        return self.norm[place], np.sqrt(self.variance[place] / self.draws) / self.norm[place]


def estimates(folder: Path | None = None) -> Estimates | None:
    """Return what was measured of the gradient through PILCO's Gaussian process; None if there is nothing yet."""
    learning = load("gradients/pilco", folder)
    if learning is None:
        return None
    config = learning.records[0].header["config"]
    return Estimates.of(config["horizons"], config["draws"], learning.arrays, learning.records)


def results(folder: Path | None = None) -> list[Result]:
    """Return the numbers of this page, with ids as in ``python -m dropout_uncertainty results``."""
    find = stored(folder)
    return [
        *_of_pairs(find), *_of_literal(find), *_of_particles(find), *_of_clouds(folder), *_of_estimates(folder),
    ]  # fmt: skip


def _of_pairs(find: Find) -> list[Result]:
    found = []
    for comparison in pairs(find):
        first, second = comparison.first, comparison.second
        name = f"doubt/ensemble/{ALONE}" if comparison.name == ALONE else first.config
        if not name.startswith(doubt.FAMILY):
            continue  # the shorter run goes by its own name
        broken = first.broken_promise, second.broken_promise
        rows = [
            ("kept", first.kept, "share", "solved repetitions that keep their solution"),
            ("promise", t_interval(broken[0]), "cost per step", "realised less predicted, mean over trials"),
            ("promise/difference", paired_difference(*broken), "cost per step", f"that, less {second.config}'s"),
        ]
        if (covered := coverage(first)) is not None:
            rows.append(("coverage", t_interval(covered.mean(1)), "share", "true states within two predicted std"))
        found += [*compared(comparison, name, second.config), *numbers(comparison, name, rows)]
    return found


def _of_literal(find: Find) -> list[Result]:
    return [
        result
        for way, those in literal_pairs(find).items()
        for comparison in those
        for result in compared(comparison, f"literal/{way}/{comparison.name}", LITERAL[way])
    ]


def _of_particles(find: Find) -> list[Result]:
    found = []
    for name in mchutchon.CONFIGS:
        if learning := find(name):
            rows = (
                (f"solved-by-{learning.trials}", learning.solved_by(learning.trials), "share", "repetitions solved"),
                ("cost", t_interval(learning.trial_costs[:, 1:].mean(1)), "cost per step", "mean over trials"),
            )
            found += listed(name, rows, learning.records, name)
    for comparison in particle_pairs(find):
        name = comparison.first.config
        found += [r for r in compared(comparison, name, comparison.second.config) if r.id.endswith("/difference")]
    return found


def _of_clouds(folder: Path | None) -> list[Result]:
    return [
        measured(
            f"shrinking/{found.name}/{noise}", t_interval(values[..., -1].mean(1)), found.records, unit="share",
            statistic=f"variance of the angle left to {found.particles} particles at the end of a predicted trial",
            config=f"shrinking/{found.name}",
        )
        for found in clouds(folder)
        for noise, values in found.left.items()
    ]  # fmt: skip


def _of_estimates(folder: Path | None) -> list[Result]:
    found = estimates(folder)
    if found is None:
        return []
    return [
        measured(
            f"gradients/pilco/{name}/{steps}", t_interval(column), found.records, unit="decades",
            statistic=f"log10 of the gradient's variance over draws, {steps} steps", config="gradients/pilco",
        )
        for name in ESTIMATES
        for steps, column in zip(found.horizons, found.log(name).T, strict=True)
    ]  # fmt: skip
