"""What the notebook *What matters in Deep PILCO* asks for in one call: the runs of a profile, and their sentences."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.ablations import scaling, variants
from dropout_uncertainty.data_efficiency.ablations.probes import CLOUDS
from dropout_uncertainty.data_efficiency.ablations.report import analysis as matters
from dropout_uncertainty.data_efficiency.ablations.report.analysis import Comparison, Inside, Times, factor
from dropout_uncertainty.data_efficiency.ablations.report.figures import METHOD_STYLES
from dropout_uncertainty.data_efficiency.ablations.report.statements import SENSITIVITY
from dropout_uncertainty.data_efficiency.ablations.scaling import AXES
from dropout_uncertainty.data_efficiency.ablations.variants import BASE, VARIANTS
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.page.profiles import complete
from dropout_uncertainty.page.tables import Words
from dropout_uncertainty.runs.process import finished
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.settings import config_diff
from dropout_uncertainty.stats import in_words, t_interval

__all__ = [
    "TINY", "Runs", "added", "changes", "clouds", "exponents", "gradients", "matching",
    "runs", "searches", "sensitivity", "times", "worse_and_better",
]  # fmt: skip

#: Live runs: what is smaller than in the stored ones, so that they take a minute; of the learners and of the two
#: measurements beside them; and their seeds.
TINY: dict[str, Any] = {"trials": 2, "hidden": (50, 50), "particles": 10, "policy_steps": 30, "model_steps": 150}
TINY_MECHANISM: dict[str, Any] = {
    "measured": (1, 2), "cloud": 60, "gradient_draws": 4, "counts": (5, 10, 30), "objective_draws": 8,
}  # fmt: skip
TINY_SCALING: dict[str, Any] = {
    "base": (150, 6, 4),
    "pilco_sizes": ((50, 100, 200, 400), (6, 12, 24), (2, 4, 8)),
    "deep_sizes": ((50, 200, 800), (6, 24, 96), (4, 16, 64)),
}
SEEDS = (100, 101, 102)
#: Variants that are run live.
LIVE = (
    "matching-diagonal", "matching-off", "particles-fixed-bfgs", "masks-redrawn", "no-dropout", "mean-network",
    *SENSITIVITY["dropout probability"], "no-guard", "cost-at-mean",
)  # fmt: skip
#: Variants that serve no claim: what we added, and what public ports do.
ADDED = ("weights-fifth", "no-guard", "cost-at-mean", "euler-plant", "raw-inputs")


@dataclass(frozen=True)
class Runs:
    """What the chapter shows: variants beside ours, the mechanism, times, and PILCO where it is stored."""

    comparisons: Sequence[Comparison]
    seen: Inside
    taken: Times
    pilco: Learning | None = None

    @cached_property
    def by(self) -> dict[str, Comparison]:
        """The comparisons by the name of the variant."""
        return {comparison.name: comparison for comparison in self.comparisons}

    @property
    def ours(self) -> Learning:
        """The learner that variants are held against, with their trials."""
        return self.comparisons[0].second

    @property
    def trials(self) -> int:
        """Controlled trials of every variant."""
        return self.ours.trials

    @property
    def records(self) -> list[Record]:
        """The records of all this, each once."""
        made = [record for x in self.comparisons for record in (*x.first.records, *x.second.records)]
        made += [*self.seen.records, *self.taken.records]
        return list({record.label: record for record in made}.values())

    def __str__(self) -> str:
        live = {
            "variants": not self.ours.records, "mechanism": not self.seen.records, "times": not self.taken.records,
        }  # fmt: skip
        names = ", ".join(name for name, computed in live.items() if computed)
        return f"Live and tiny on this page: {names or 'only the toy'}."


def runs(profile: str, tiny: Mapping[str, Any] = TINY) -> Runs:
    """Return the stored runs; in ``quick``, and where there are none yet, live ones that are much too short."""
    complete(profile, [unit for name in variants.CONFIGS for unit in configs.units(name)])
    if profile == "quick":
        found = Runs(_compared(tiny), _seen(tiny), _taken())
        matters.check_quick(found.ours, found.seen, found.taken)
        return found
    stored = matters.comparisons() or _compared(tiny)
    return Runs(stored, matters.inside() or _seen(tiny), matters.times() or _taken(), analysis.load("pilco-paper"))


def _compared(tiny: Mapping[str, Any]) -> list[Comparison]:
    def learn(config: variants.VariantConfig) -> Learning:
        process = _finished(variants.start, replace(config, **tiny))
        return analysis.from_arrays("live", config.plant, process.result(), SEEDS)

    ours = learn(BASE)
    pairs = [matters.pair(name, learn(VARIANTS[name].config), ours) for name in LIVE]
    return [pair for pair in pairs if pair]


def _seen(tiny: Mapping[str, Any]) -> Inside:
    return Inside.of(_finished(variants.start_mechanism, replace(variants.MECHANISM, **{**TINY_MECHANISM, **tiny})))


def _taken() -> Times:
    return Times.of(_finished(scaling.start, replace(variants.SCALING, **TINY_SCALING)))


def _finished(start: Callable[..., Any], config: Any) -> Any:
    return finished(start(config, SEEDS))


def changes(base: variants.VariantConfig) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: every field in which a variant differs from ours, the base."""
    cells: list[list[object]] = [
        [variant.claim, variant.words, field, *(f"{x:.3g}" if isinstance(x, float) else x for x in values)]
        for variant in VARIANTS.values()
        for field, *values in config_diff(base, variant.config)
    ]
    return ["statement", "variant", "field", "ours", "here"], cells


def worse_and_better(found: Runs) -> Words:
    """Return which variants are worse than ours beyond their interval, and which are better."""

    def listed(names: Sequence[Comparison]) -> str:
        return "; ".join(VARIANTS[x.name].words for x in names) or "none"

    lost = [x for x in found.comparisons if x.solved_difference.high < 0 or x.cost_difference.low > 0]
    won = [x for x in found.comparisons if x.solved_difference.low > 0 or x.cost_difference.high < 0]
    ours, trials = found.ours, found.trials
    return Words(
        f"By trial {trials}, {ours.solved_by(trials).value:.0%} of the {len(ours.seeds)} repetitions of ours had been "
        f"solved. Of {len(found.comparisons)} variants these are **worse** beyond their interval, in success or in "
        f"cost: {listed(lost)}. These are **better**: {listed(won)}. About the others {len(ours.seeds)} repetitions "
        "do not tell. The intervals are not corrected for their number: about one in twenty leaves out 0 by chance."
    )


def matching(seen: Inside) -> Words:
    """Return how often particles part, and what a Gaussian in their place adds to the cost (DE4)."""
    free, matched = (seen.parted(cloud).mean() for cloud in ("held-free", "held-matched"))
    apart = seen.parted("held-free")
    where = [seen.arrays["penalty"][places] for places in (apart, ~apart)]
    had, had_not = (values.mean() if values.size else np.nan for values in where)
    return Words(
        f"Free particles had parted at {free:.0%} of the steps, matched ones at {matched:.0%}. Putting a Gaussian in "
        f"their place changes the cost of a step by {had:+.3f} where they had, by {had_not:+.3f} where they had not; "
        f"the rank correlation of the depth of the valley and that change is "
        f"{in_words(t_interval(seen.penalty_correlation()))}."
    )


def gradients(seen: Inside) -> Words:
    """Return how variance and noise of the gradient compare without and with matching (DE4)."""

    def against(first: str, second: str, **kind: bool) -> str:
        return in_words(factor(seen.log_gradient_ratio(first, second, **kind)))

    return Words(
        f"For the whole trial the variance without matching is {against('off', 'full')} times that with matching of "
        f"all dimensions together, and {against('off', 'diagonal')} times that of each alone. Relative to its mean, "
        f"the gradient's noise is {against('off', 'full', noise=True)} and {against('off', 'diagonal', noise=True)} "
        "times as large. A factor above 1 speaks for the thesis, below 1 against it."
    )


def searches(seen: Inside) -> Words:
    """Return what searches on fixed particles promise and keep, and how far the objective is off (DE5)."""
    few = min(range(len(seen.counts)), key=lambda i: abs(seen.counts[i] - 10))

    def tell(values: np.ndarray) -> str:
        return in_words(t_interval(values), ".3f")

    return Words(
        f"BFGS on fixed particles promised {tell(seen.optimism('fixed-bfgs'))} less than fresh particles then cost; "
        f"Adam on fixed ones {tell(seen.optimism('fixed-adam'))} less. On fresh particles BFGS ended "
        f"{tell(seen.behind('fixed-bfgs'))} above Adam with fresh particles (below it, if negative), Adam with fixed "
        f"ones {tell(seen.behind('fixed-adam'))}.\n\nThe thesis calls the estimate unbiased. Without matching it is. "
        f"With it, a Gaussian fitted to few particles is another Gaussian: with {seen.counts[few]} of them the "
        f"objective is off by {tell(seen.bias('full')[:, few])} (together) and "
        f"{tell(seen.bias('diagonal')[:, few])} (each alone), and by {tell(seen.bias('off')[:, few])} without "
        "matching, where only chance is left."
    )


def clouds(seen: Inside, pilco: Learning | None) -> Words:
    """Return how much wider held masks make the prediction, and how often the truth is within it (DE6)."""
    ratio = {k: in_words(factor(seen.log_std_ratio(f"held-{k}", f"redrawn-{k}"))) for k in ("free", "matched")}
    hit = {cloud: f"{seen.coverage(cloud).mean():.0%}" for cloud in CLOUDS}
    beside = f"; PILCO {matters.coverage_of_pilco(pilco, seen.measured).mean():.0%}" if pilco else ""
    return Words(
        f"**Plainly:** where particles are free, holding the masks makes the prediction of the later half of the "
        f"trial {ratio['free']} times as wide as redrawing them. With the moments of all dimensions matched, what is "
        f"left of that is a factor of {ratio['matched']}; 1 would mean that holding the masks does nothing there. Of "
        f"the true states {matters.NOMINAL:.1%} should lie within two standard deviations. There were: masks held and "
        f"free {hit['held-free']}, held and matched {hit['held-matched']}, redrawn and free {hit['redrawn-free']}, "
        f"redrawn and matched {hit['redrawn-matched']}{beside}."
    )


def sensitivity(found: Runs) -> dict[str, list[Comparison]]:
    """Return the variants that halve or double a hyper-parameter, by its name on two lines (DE10)."""
    groups = {text.replace(" ", "\n", 1): names for text, names in SENSITIVITY.items()}
    run = {text: [found.by[name] for name in names if name in found.by] for text, names in groups.items()}
    return {text: comparisons for text, comparisons in run.items() if comparisons}


def added(found: Runs) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: what we added to the method and what public ports do otherwise, beside ours."""
    heads = ["", f"share solved by {found.trials}", "cost - ours", "trials to solve - ours"]
    return heads, [
        [VARIANTS[x.name].words, in_words(x.solved), in_words(x.cost_difference), in_words(x.trials_difference, ".1f")]
        for x in (found.by[name] for name in ADDED if name in found.by)
    ]


def exponents(taken: Times) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: the exponents of the time per trial, the thesis's and ours (DE8)."""
    claimed = {"pilco": (2, 2, 2), "deep-pilco-diagonal": (0, 1, 1), "deep-pilco": (None, None, None)}
    cells: list[list[object]] = [
        [METHOD_STYLES[method][0], axis, thesis, in_words(t_interval(taken.exponents(method, axis))),
         int(taken.sizes(method, axis)[-1])]
        for method, row in claimed.items() for axis, thesis in zip(AXES, row, strict=True)
    ]  # fmt: skip
    return ["", "number of", "exponent, thesis", "ours", "up to"], cells


def times(taken: Times) -> Words:
    """Return how PILCO's time grows with the number of transitions, and from where on Deep PILCO is quicker (DE8)."""
    sizes = taken.sizes("pilco", "transitions")
    seconds = taken.seconds("pilco", "transitions").mean(0)
    local = taken.local_exponents("pilco", "transitions").mean(0)
    deep = taken.seconds("deep-pilco", "transitions").mean()
    faster = [int(n) for n, s in zip(sizes, seconds, strict=True) if s > deep]
    ends = f"PILCO takes longer from {faster[0]} transitions on." if faster else "PILCO is quicker at all these sizes."
    return Words(
        f"PILCO's slope in $N$ is {local[0]:.1f} between {sizes[0]:.0f} and {sizes[1]:.0f} transitions and "
        f"{local[-1]:.1f} between {sizes[-2]:.0f} and {sizes[-1]:.0f}: with few data what counts is the overhead of "
        "many small operations, and only later the square, and then the cube that the fit needs. Deep PILCO needs "
        f"{deep:.1f} s whatever $N$ is; {ends}"
    )
