"""From records to what matters in Deep PILCO: variants beside `OURS`, the mechanism, times against sizes.

Nothing is run and nothing is drawn here. Differences are variant less `OURS`, paired by seed.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy import stats as scipy_stats

from dropout_uncertainty.data_efficiency.ablations.probes import CLOUDS, DIAGONAL, OPTIMISERS, PARTED, Mechanism
from dropout_uncertainty.data_efficiency.ablations.scaling import AXES, METHODS, Scaling, ScalingConfig
from dropout_uncertainty.data_efficiency.ablations.variants import FAMILY, TRIALS, VARIANTS
from dropout_uncertainty.data_efficiency.deep_pilco.particles import MATCHING
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT
from dropout_uncertainty.data_efficiency.plant.cartpole import STATE_NAMES, CartPole
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.judging.results import Result, listed, measured
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Interval, common, paired_difference, share_interval, t_interval

#: The published record of `OURS`; its first trials are those of the variants' baseline.
BASELINE = "deep-pilco-ours"
#: The share of a normal distribution within two standard deviations.
NOMINAL = math.erf(2**0.5)


@dataclass(frozen=True)
class Comparison:
    """A variant and what it is held against, with the same seeds in the same order and equally many trials."""

    name: str
    first: Learning
    second: Learning

    @property
    def solved(self) -> Interval:
        """Share of the variant's repetitions that are solved by the last trial."""
        return self.first.solved_by(self.first.trials)

    @property
    def solved_difference(self) -> Interval:
        """By how much that share differs."""
        flags = [learning.first_solved <= learning.trials for learning in (self.first, self.second)]
        return share_difference(*flags)

    @property
    def cost_difference(self) -> Interval:
        """By how much the cost per step differs, mean over all controlled trials."""
        return paired_difference(*(x.trial_costs[:, 1:].mean(1) for x in (self.first, self.second)))

    @property
    def trials_difference(self) -> Interval:
        """By how many the trials to solve differ; what is not solved counts one more than there are."""
        return paired_difference(*(np.minimum(x.first_solved, x.trials + 1) for x in (self.first, self.second)))


def share_difference(first: Sequence[bool] | np.ndarray, second: Sequence[bool] | np.ndarray) -> Interval:
    """Return the difference of two shares over the same repetitions, with an interval that is never empty.

    Wilson's limits of both shares, joined with regard to their correlation (Newcombe, Improved confidence intervals
    for the difference between binomial proportions based on paired data, 1998, method 8).
    """
    first, second = np.asarray(first, bool), np.asarray(second, bool)
    if first.shape != second.shape:
        raise ValueError(f"paired shares need one flag per seed in both, got {first.shape} and {second.shape}")
    one, two = share_interval(first), share_interval(second)
    difference = one.value - two.value
    if len(first) < 2:
        return Interval(difference, np.nan, np.nan, len(first))
    varies = 0 < one.value < 1 and 0 < two.value < 1
    phi = float(np.corrcoef(first, second)[0, 1]) if varies else 0.0
    below = _joined(one.value - one.low, two.high - two.value, phi)
    above = _joined(one.high - one.value, two.value - two.low, phi)
    return Interval(difference, max(difference - below, -1.0), min(difference + above, 1.0), len(first))


def _joined(a: float, b: float, phi: float) -> float:
    return max(a * a - 2 * phi * a * b + b * b, 0.0) ** 0.5


def compare(name: str, folder: Path | None = None) -> Comparison | None:
    """Return a variant beside `OURS`; None if one has no record or no seed is shared.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    first, second = analysis.load(f"{FAMILY}/{name}", folder), analysis.load(BASELINE, folder)
    return pair(name, first, second) if first and second else None


def pair(name: str, first: Learning, second: Learning, most: int = TRIALS) -> Comparison | None:
    """Return two runs cut to the seeds and trials that they share; None if they share no seed."""
    one, two = common(first.seeds, second.seeds)
    if not one:
        return None
    trials = min(first.trials, second.trials, most)
    return Comparison(name, first.part(one, trials), second.part(two, trials))


def comparisons(folder: Path | None = None) -> list[Comparison]:
    """Return all variants that have records, in the order of the table."""
    return [found for name in VARIANTS if (found := compare(name, folder))]


@dataclass(frozen=True)
class Inside:
    """What `mechanism` saw: R repetitions, M measured trials, T steps."""

    plant: CartPole  #: the cart-pole.
    measured: tuple[int, ...]  #: the measured trials.
    horizons: tuple[int, ...]  #: lengths of the predicted trial at which the gradient was taken.
    counts: tuple[int, ...]  #: numbers of particles for which the objective was averaged.
    arrays: Mapping[str, np.ndarray]  #: of the records, [R, M, ...].
    records: tuple[Record, ...] = ()  #: where they come from; none for a live run.

    @classmethod
    def of(cls, process: Mechanism) -> "Inside":
        """Return what a live process saw."""
        config = process.config
        return cls(config.plant, process.measured, config.horizons, config.counts, process.result())

    def std(self, cloud: str) -> Float[np.ndarray, "R M T 4"]:
        """Return the predicted standard deviation of each state at times 1 ... T, before matching."""
        name, clouds = ("diagonal_std", DIAGONAL) if cloud in DIAGONAL else ("cloud_std", CLOUDS)
        return self.arrays[name][:, :, _place(cloud, clouds)].astype(float)

    def covered(self, cloud: str) -> Bool[np.ndarray, "R M T 4"]:
        """Return whether the true state was within two standard deviations of the predicted mean."""
        mean = self.arrays["cloud_mean"][:, :, _place(cloud, CLOUDS)].astype(float)
        return np.abs(self.arrays["true_states"][:, :, 1:] - mean) <= 2 * self.std(cloud)

    def coverage(self, cloud: str) -> Float[np.ndarray, " R"]:
        """Return the share of the true states that were, over trials, steps and dimensions."""
        return self.covered(cloud).mean((1, 2, 3))

    def parted(self, cloud: str) -> Bool[np.ndarray, "R M T"]:
        """Return where the particles' angles had parted into two groups."""
        return self.arrays["cloud_valley"][:, :, _place(cloud, CLOUDS)] >= PARTED

    def log_std_ratio(self, first: str, second: str) -> Float[np.ndarray, " R"]:
        """Return the log ratio of predicted standard deviations, mean over states and the later half of the steps."""
        ratio = np.log(self.std(first) / self.std(second))
        return ratio[:, :, ratio.shape[2] // 2 :].mean((1, 2, 3))

    def penalty_correlation(self, name: str = "penalty") -> Float[np.ndarray, " R"]:
        """Return the rank correlation, over trials and steps, of how far free particles part and what a Gaussian adds.

        It adds "penalty" to the cost or, one for each dimension by itself, "penalty_diagonal".
        """
        depth, penalty = self.arrays["cloud_valley"][:, :, _place("held-free", CLOUDS)], self.arrays[name]
        return np.array([_rank_correlation(d.ravel(), p.ravel()) for d, p in zip(depth, penalty, strict=True)])

    def gradient_variance(self, matching: str) -> Float[np.ndarray, "R M H"]:
        """Return the variance of the policy gradient over draws, by length of the predicted trial."""
        return self.arrays["gradient_variance"][:, :, _place(matching, MATCHING)].astype(float)

    def gradient_noise(self, matching: str) -> Float[np.ndarray, "R M H"]:
        """Return the gradient's standard deviation over draws as a multiple of the norm of its mean."""
        norm = self.arrays["gradient_norm"][:, :, _place(matching, MATCHING)].astype(float)
        return np.sqrt(self.gradient_variance(matching)) / norm

    def log_gradient_ratio(self, first: str, second: str, *, noise: bool = False) -> Float[np.ndarray, " R"]:
        """Return the log ratio of gradient variance, or noise, for the whole trial, mean over measured trials."""
        of = self.gradient_noise if noise else self.gradient_variance
        return np.log(of(first)[..., -1] / of(second)[..., -1]).mean(1)

    def bias(self, matching: str) -> Float[np.ndarray, "R counts"]:
        """Return the mean objective at each number of particles less that at the largest, mean over trials."""
        values = self.arrays["objective"][:, :, _place(matching, MATCHING)].astype(float)
        return (values - values[..., -1:]).mean(1)

    def objective(self, optimiser: str, *, fresh: bool = True) -> Float[np.ndarray, "R M"]:
        """Return what a search reached: the objective on fresh particles, or by its own account."""
        return self.arrays["fresh" if fresh else "reached"][:, :, _place(optimiser, OPTIMISERS)].astype(float)

    def optimism(self, optimiser: str) -> Float[np.ndarray, " R"]:
        """Return by how much fresh particles cost more than a search said, mean over trials."""
        return (self.objective(optimiser) - self.objective(optimiser, fresh=False)).mean(1)

    def behind(self, optimiser: str) -> Float[np.ndarray, " R"]:
        """Return by how much a search ends above that with fresh particles and Adam, mean over trials."""
        return (self.objective(optimiser) - self.objective("fresh-adam")).mean(1)


def _place(name: str, names: Iterable[str]) -> int:
    return list(names).index(name)


def _rank_correlation(x: np.ndarray, y: np.ndarray) -> float:
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    return float(scipy_stats.spearmanr(x, y).statistic)


def inside(folder: Path | None = None) -> Inside | None:
    """Return what the published records of `mechanism` hold; None if there are none yet."""
    learning = analysis.load(f"{FAMILY}/mechanism", folder)
    if learning is None:
        return None
    config = learning.records[0].header["config"]
    seen = tuple(trial for trial in config["measured"] if trial <= config["trials"])
    return Inside(
        learning.plant, seen, tuple(config["horizons"]), tuple(config["counts"]), learning.arrays, learning.records
    )


def coverage_of_pilco(learning: Learning, trials: Sequence[int]) -> Float[np.ndarray, " R"]:
    """Return the share of true states of some trials within two standard deviations of what PILCO predicted."""
    chosen = [trial for trial in trials if trial <= learning.trials]
    return learning.covered[:, chosen].mean((1, 2, 3))


@dataclass(frozen=True)
class Times:
    """Times per trial of R repetitions at the points of a `ScalingConfig`."""

    config: ScalingConfig
    fit: Float[np.ndarray, "R points"]  # CPU seconds
    policy: Float[np.ndarray, "R points"]
    records: tuple[Record, ...] = ()

    @classmethod
    def of(cls, process: Scaling) -> "Times":
        """Return the times of a live process."""
        return cls(process.config, process.log["fit_s"].numpy(), process.log["policy_s"].numpy())

    def sizes(self, method: str, axis: str) -> Float[np.ndarray, " S"]:
        """Return the sizes along an axis."""
        return np.array(self.config.sizes(method)[AXES.index(axis)], float)

    def seconds(self, method: str, axis: str) -> Float[np.ndarray, "R S"]:
        """Return CPU seconds per trial at these sizes."""
        here = [i for i, (m, a, _) in enumerate(self.config.points()) if (m, a) == (method, AXES.index(axis))]
        return (self.fit + self.policy)[:, here]

    def exponents(self, method: str, axis: str) -> Float[np.ndarray, " R"]:
        """Return the slope of log time against log size, by least squares over the larger half of the sizes."""
        sizes = np.log(self.sizes(method, axis))
        half = len(sizes) // 2
        return np.polyfit(sizes[half:], np.log(self.seconds(method, axis)[:, half:]).T, 1)[0]

    def local_exponents(self, method: str, axis: str) -> Float[np.ndarray, "R steps"]:
        """Return the slope between each size and the next."""
        return np.diff(np.log(self.seconds(method, axis))) / np.diff(np.log(self.sizes(method, axis)))


def times(folder: Path | None = None) -> Times | None:
    """Return the published times; None if there are none yet."""
    found = records.find(EXPERIMENT, name=f"{FAMILY}/scaling", folder=folder, published=True)
    if not found:
        return None
    plain = found[0].header["config"]
    pilco, deep = (tuple(map(tuple, plain[name])) for name in ("pilco_sizes", "deep_sizes"))
    config = ScalingConfig(base=tuple(plain["base"]), pilco_sizes=pilco, deep_sizes=deep, timed=plain["timed"])
    fit, policy = (
        np.concatenate([np.array(r.header["provenance"][f"scaling_{name}"]) for r in found])
        for name in ("fit_s", "policy_s")
    )
    return Times(config, fit, policy, tuple(found))


def factor(logs: Float[np.ndarray, " R"]) -> Interval:
    """Return the geometric mean of ratios, given as logs, with its interval."""
    value, low, high, n = t_interval(logs)
    return Interval(math.exp(value), math.exp(low), math.exp(high), n)


def check_quick(ours: Learning, seen: Inside, taken: Times) -> None:
    """Check tiny live runs against wide bands that were set before they were first run.

    Raises:
        ValueError: naming the band that is left.
    """
    random = ours.trial_costs[:, 0]
    if not (random > 0.9).all():
        raise ValueError(f"random trials cost {random.round(2)} per step, expected more than 0.9")
    for name in CLOUDS:
        if not 0.05 <= (share := seen.coverage(name).mean()) <= 1:
            raise ValueError(f"the cloud {name} covers {share:.2f} of the true states, outside 0.05 to 1")
    growth, flat = (taken.exponents(m, "transitions").mean() for m in ("pilco", "deep-pilco-diagonal"))
    if not (growth > 0.3 and abs(flat) < 0.5):
        raise ValueError(f"time grows with exponents {growth:.2f} (PILCO) and {flat:.2f} (Deep PILCO) of N")


def results(folder: Path | None = None) -> list[Result]:
    """Return the numbers of this chapter, with ids as in ``python -m dropout_uncertainty results``."""
    return _of_variants(folder) + _of_mechanism(folder) + _of_scaling(folder)


def _of_variants(folder: Path | None) -> list[Result]:
    return [r for found in comparisons(folder) for r in compared(found, f"{FAMILY}/{found.name}", "ours")]


def compared(comparison: Comparison, name: str, other: str) -> list[Result]:
    """Return the numbers of a comparison; the name is that of the config, ``other`` says what it is held against."""
    solved = f"solved-by-{comparison.first.trials}"
    rows = (
        (solved, comparison.solved, "share", "repetitions solved by then"),
        (f"{solved}/difference", comparison.solved_difference, "share", f"that, less the same of {other}, paired"),
        ("cost/difference", comparison.cost_difference, "cost per step", f"mean over trials, less {other}, paired"),
        ("trials-to-solve/difference", comparison.trials_difference, "trials", f"mean, less {other}, paired"),
    )
    return numbers(comparison, name, rows)


def numbers(comparison: Comparison, name: str, rows: Iterable[tuple[str, Interval, str, str]]) -> list[Result]:
    """Return numbers (kind, interval, unit, words) of the seeds that a comparison shares."""
    made = [record for x in (comparison.first, comparison.second) for record in x.records]
    return [replace(result, seeds=sorted(comparison.first.seeds)) for result in listed(name, rows, made, name)]


def _of_mechanism(folder: Path | None) -> list[Result]:
    seen = inside(folder)
    if seen is None:
        return []
    rows: list[tuple[str, np.ndarray, str, str]] = []
    for cloud in CLOUDS:
        rows += [
            (f"{cloud}/coverage", seen.coverage(cloud), "share", "true states within two predicted std"),
            (f"{cloud}/parted", seen.parted(cloud).mean((1, 2)), "share", "steps whose particles have parted"),
        ]
        for dim, state in enumerate(STATE_NAMES):
            std = seen.std(cloud)[:, :, -1, dim].mean(1)
            rows.append((f"{cloud}/std/{state}", std, "SI", "predicted at the end of the trial, mean over trials"))
    for matching in MATCHING:
        variance = seen.gradient_variance(matching)[..., -1].mean(1)
        noise = np.log(seen.gradient_noise(matching)[..., -1]).mean(1)
        rows += [
            (f"gradient/{matching}/variance", variance, "", "policy gradient over draws, whole trial"),
            (f"gradient/{matching}/log-noise", noise, "", "log of its std over draws by the norm of its mean"),
        ]
        for count, values in zip(seen.counts, seen.bias(matching).T, strict=True):
            words = f"objective with {count} particles less that with {seen.counts[-1]}"
            rows.append((f"bias/{matching}/{count}", values, "cost per step", words))
    for optimiser in OPTIMISERS:
        rows += [
            (f"{optimiser}/objective", seen.objective(optimiser).mean(1), "cost per step", "on fresh particles"),
            (f"{optimiser}/optimism", seen.optimism(optimiser), "cost per step", "that, less what the search said"),
        ]
    rows.append(("penalty-correlation", seen.penalty_correlation(), "", "rank correlation of parting and penalty"))
    name = f"{FAMILY}/mechanism"
    return listed(
        name, ((kind, t_interval(values), unit, words) for kind, values, unit, words in rows), seen.records, name
    )


def _of_scaling(folder: Path | None) -> list[Result]:
    taken = times(folder)
    if taken is None:
        return []
    name = f"{FAMILY}/scaling"
    return [
        measured(
            f"{name}/{method}/{axis}", t_interval(taken.exponents(method, axis)), taken.records,
            unit="exponent", statistic=f"of the time per trial, from {int(sizes[len(sizes) // 2])} on", config=name,
        )
        for method in METHODS
        for axis in AXES
        for sizes in [taken.sizes(method, axis)]
    ]  # fmt: skip
