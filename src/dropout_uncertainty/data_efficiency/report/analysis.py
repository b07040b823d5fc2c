"""From records to the numbers of Figures 5.7 and 5.8 and of their statements. Nothing is run and nothing is drawn here.

PILCO's and Deep PILCO's records keep costs and predictions under the same names, so that one class reads both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from scipy import stats as scipy_stats
from torch import Tensor

from dropout_uncertainty.data_efficiency.learning import EXPERIMENT
from dropout_uncertainty.data_efficiency.pilco.learner import LONGER
from dropout_uncertainty.data_efficiency.plant import cost
from dropout_uncertainty.data_efficiency.plant.cartpole import MATLAB, CartPole
from dropout_uncertainty.judging.results import Result, listed, thesis_value
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.settings import config_diff
from dropout_uncertainty.stats import Interval, in_words, median_interval, share_interval, t_interval

__all__ = [
    "LABELS", "LATER", "PANELS", "TRIALS", "Learning", "at_equal_times", "check_quick", "check_quick_deep",
    "cpu_seconds", "doubt_and_gradient", "excess_on_predictable", "fitting_table", "from_arrays", "from_records",
    "load", "original", "repeats", "results", "run_time_table", "search_table", "share_solved", "solved_table",
    "steps_held", "steps_predicted", "time_table",
]  # fmt: skip

#: How each config is called in figures and tables; those of Figure 5.7 first.
LABELS: dict[str, str] = {
    "pilco-paper": "PILCO",
    "deep-pilco-ours": "Deep PILCO",
    "deep-pilco-as-written": "Deep PILCO, as written",
    "deep-pilco-as-text": "Deep PILCO, as the text has it",
    "ddpg": "DDPG",
    "naf": "NAF",
    "pilco-paper-15": "PILCO",
    "pilco-matlab": "PILCO, cart-pole of its own code",
    "pilco-paper-40": "PILCO, one repetition of 40 trials",
    "original": "PILCO's own code",
    "doubt/ensemble": "the ensemble",
}
#: Configs by the names that results go by (figure-5.7/<name>/...).
NAMES: dict[str, str] = {
    "pilco-paper": "pilco",
    "deep-pilco-ours": "deep-pilco",
    "deep-pilco-as-written": "deep-pilco/as-written",
    "deep-pilco-as-text": "deep-pilco/as-text",
    "pilco-matlab": "pilco/matlab",
    "ddpg": "ddpg",
    "naf": "naf",
}
#: Trials at which curves are read off: those that thesis text and captions name, and round ones.
TRIALS = (1, 5, 7, 10, 15, 20, 25, 26, 40, 100, 400, 1000, 2500)
#: Arrays [R, trial, ...] that a part of a run keeps, as far as there are any.
CUT = ("costs", "predicted_cost", "states", "predicted_mean", "predicted_std", "predicted_variance")
#: A repetition keeps its solution if at least this share of the trials after the first solved one are solved.
KEPT = 0.8
#: What computing time is shown of, as the records call it and in words.
TIMED = {"model": "model", "policy": "search for the policy", "trial": "trial of the plant"}
#: Panels of Figure 5.8: trials of data that the model had seen.
PANELS = (1, 10, 20, 26)
#: Trials over which statement DE11 is judged: those before most repetitions are solved.
LATER = (1, 2, 3, 4, 5)


@dataclass(frozen=True)
class Learning:
    """R repetitions of a learner on a plant; trial 0 is the random one."""

    config: str  #: name of its config, e.g. "pilco-paper".
    plant: CartPole  #: the cart-pole.
    costs: Float[np.ndarray, "R trials T"]  #: [R, trials + 1, T] realised cost of each step.
    seeds: tuple[int, ...]  #: one per repetition.
    arrays: Mapping[str, np.ndarray]  #: all arrays of the records, R first.
    records: tuple[Record, ...] = ()  #: where they come from; none for a live run.

    @property
    def label(self) -> str:
        """Name of the learner in words."""
        return LABELS.get(self.config, self.config)

    @property
    def trials(self) -> int:
        """Number of controlled trials."""
        return self.costs.shape[1] - 1

    @property
    def trial_costs(self) -> Float[np.ndarray, "R trials"]:
        """Mean cost per step of each trial, in [0, 1]: the curve of Figure 5.7."""
        return self.costs.mean(-1)

    @property
    def tested(self) -> Int[np.ndarray, " tests"]:
        """Numbers of the controlled trials that count: all, or those without noise of a learner without a model.

        They go on to the last trial also where all repetitions have ended before it.
        """
        first = 1 + int(np.isfinite(self.trial_costs[:, 1:]).any(0).argmax())
        return np.arange(first, self.trials + 1, first)

    def counted(self, values: Shaped[np.ndarray, "R trials"]) -> Shaped[np.ndarray, "R tests"]:
        """Return the values of the trials that count; a repetition that has ended keeps its last."""
        there = np.isfinite(self.trial_costs[:, self.tested])
        last = np.maximum.accumulate(np.where(there, np.arange(there.shape[1]), 0), 1)
        return np.take_along_axis(values[:, self.tested], last, 1)

    @property
    def predicted_costs(self) -> Float[np.ndarray, "R trials"]:
        """Mean cost per step that the model expected of each trial; NaN for the random one."""
        return self.arrays["predicted_cost"].astype(float).mean(-1)

    @property
    def predicted_std(self) -> Float[np.ndarray, "R trials times 4"]:
        """Standard deviation of the state that the model expected at each time; NaN for the random trial."""
        if "predicted_std" in self.arrays:
            return self.arrays["predicted_std"].astype(float)
        return np.sqrt(self.arrays["predicted_variance"].astype(float))

    @property
    def covered(self) -> Bool[np.ndarray, "R trials T 4"]:
        """Whether the true states of times 1 ... T lay within two standard deviations of the predicted mean."""
        true, mean = (self.arrays[name][:, :, 1:].astype(float) for name in ("states", "predicted_mean"))
        return np.abs(true - mean) <= 2 * self.predicted_std[:, :, 1:]

    @property
    def broken_promise(self) -> Float[np.ndarray, " R"]:
        """By how much a step of the controlled trials cost more than was predicted, mean over trials."""
        return (self.trial_costs - self.predicted_costs)[:, 1:].mean(1)

    @property
    def solved(self) -> Bool[np.ndarray, "R trials"]:
        """Which trials ended with the pole balanced (``cost.solved``)."""
        return cost.solved(self.plant, torch.from_numpy(self.costs)).numpy()

    @property
    def first_solved(self) -> Float[np.ndarray, " R"]:
        """First controlled trial that is solved in each repetition; inf if there is none."""
        controlled = self.solved[:, 1:]
        return np.where(controlled.any(1), controlled.argmax(1) + 1.0, np.inf)

    @property
    def later(self) -> Bool[np.ndarray, "R trials"]:
        """Which trials that count come after the first solved one of their repetition."""
        return (np.arange(self.trials + 1) > self.first_solved[:, None]) & np.isfinite(self.trial_costs)

    @property
    def kept_share(self) -> Float[np.ndarray, " R"]:
        """Share of the later trials that are solved; NaN where there is none."""
        count = self.later.sum(1)
        return np.where(count > 0, (self.solved & self.later).sum(1) / np.maximum(count, 1), np.nan)

    @property
    def typical(self) -> int:
        """Number of a repetition whose first solved trial is in the middle of all: the one to show."""
        return int(np.argsort(self.first_solved, kind="stable")[(len(self.costs) - 1) // 2])

    def spread(self, count: int = 5) -> list[int]:
        """Return numbers of repetitions that lie evenly in the order of first solved trials, among them the typical."""
        middles = (2 * np.arange(count) + 1) / (2 * count) * (len(self.costs) - 1)
        order = np.argsort(self.first_solved, kind="stable")
        return order[np.unique(middles.astype(int))].tolist()

    @property
    def trials_to_solve(self) -> Interval:
        """Trial by which at least half of the repetitions are solved; inf if they are not."""
        return median_interval(self.first_solved)

    def part(self, places: Sequence[int], trials: int) -> "Learning":
        """Return some of the repetitions up to a trial, with their costs, states and predictions."""
        arrays = {name: self.arrays[name][places, : trials + 1] for name in CUT if name in self.arrays}
        seeds = tuple(self.seeds[place] for place in places)
        return replace(self, costs=self.costs[places, : trials + 1], seeds=seeds, arrays=arrays)

    def solved_by(self, trial: int) -> Interval:
        """Share of the repetitions solved by a trial, with its Wilson interval."""
        return share_interval(self.first_solved <= trial)

    def cost_at(self, trial: int) -> Interval:
        """Mean cost per step of a trial."""
        return t_interval(self.counted(self.trial_costs)[:, np.searchsorted(self.tested, trial)])

    @property
    def kept(self) -> Interval:
        """Share of the solved repetitions, with trials left, that keep at least ``KEPT`` of those solved.

        Of none where a repetition ends once it has kept its solution for a while, as those without a model do.
        """
        share = self.kept_share if len(self.tested) == self.trials else np.empty(0)
        return share_interval(share[~np.isnan(share)] >= KEPT)


def load(config: str, folder: Path | None = None) -> Learning | None:
    """Return the published repetitions (seeds below 100) of a config; None if there are none yet.

    Where longer runs go on from all of its repetitions (``pilco.learner.LONGER``), these are returned: they begin with
    the same trials.

    Raises:
        RecordError: if a record cannot be trusted.
    """
    best = None
    for name in (config, *(longer for longer in LONGER if longer.startswith(f"{config}-"))):
        found = records.find(EXPERIMENT, name=name, folder=folder, published=True)
        seeds = {seed for record in found for seed in record.seeds}
        if found and (best is None or seeds >= set(best.seeds)):
            best = from_records(config, found)
    return best


def original() -> Learning:
    """Return a run of PILCO's own code on its own cart-pole, one repetition (``records/original``); costs only."""
    lines = records.table("original/pilco_octave_cartpole")
    costs = [[float(line[f"c{step:02d}"]) for step in range(1, MATLAB.steps + 1)] for line in lines]
    return from_arrays("original", MATLAB, {"costs": np.array([costs])}, [int(lines[0]["seed"])])


def from_records(config: str, found: Sequence[Record]) -> Learning:
    """Return the repetitions that some records of one config hold."""
    seeds, arrays = records.joined(found)
    plant = dict(found[0].header["config"]["plant"])
    plant["start_mean"] = tuple(plant["start_mean"])
    return from_arrays(config, CartPole(**plant), arrays, seeds, found)


def from_arrays(
    config: str, plant: CartPole, arrays: Mapping[str, np.ndarray], seeds: Sequence[int], found: Sequence[Record] = ()
) -> Learning:
    """Return the repetitions of a run, from the arrays that a process's ``result`` gives."""
    return Learning(config, plant, arrays["costs"].astype(float), tuple(seeds), arrays, tuple(found))


def doubt_and_gradient(learning: Learning, trial: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what statement DE11 compares, at the beginning of a trial's policy search; each [R, T].

    Predicted standard deviation of the pole's angle [rad]; share that each step has in the gradient (norms of the
    steps' gradients, which sum to 1); the same share had the model taken its mean for the truth.
    """
    doubt = np.sqrt(learning.arrays["search_variance"][:, trial, 1:, 3].astype(float))
    norms = [learning.arrays[name][:, trial].astype(float) for name in ("search_gradient", "search_gradient_sure")]
    with_doubt, sure = (norm / norm.sum(1, keepdims=True) for norm in norms)
    return doubt, with_doubt, sure


def excess_on_predictable(learning: Learning, trials: Sequence[int] = LATER) -> tuple[np.ndarray, np.ndarray]:
    """Return two statistics of statement DE11 for each repetition, means over ``trials``; each [R].

    First the rank correlation over steps of predicted doubt and of how much less a step counts than in a model
    without doubt (share of the gradient with doubt over that without); then the share of the gradient on the steps
    that are predicted well, with doubt minus without. A step is predicted well if one standard deviation of the angle
    moves the tip by less than the width of the cost.
    """
    correlations, differences = [], []
    for trial in (t for t in trials if t <= learning.trials):
        doubt, with_doubt, sure = doubt_and_gradient(learning, trial)
        ratio = with_doubt / np.maximum(sure, np.finfo(float).tiny)
        correlations.append([scipy_stats.spearmanr(d, r).statistic for d, r in zip(doubt, ratio, strict=True)])
        well = doubt * learning.plant.pole_length < learning.plant.cost_width
        differences.append(((with_doubt - sure) * well).sum(1))
    return np.mean(correlations, 0), np.mean(differences, 0)


def at_equal_times(learning: Learning, trials: Sequence[int] = LATER) -> dict[str, Float[np.ndarray, " R"]]:
    """Return rank correlations over steps with the time step held fixed, means over ``trials``; each [R].

    Doubt grows with time within a trial. Of predicted doubt with the ratio of ``excess_on_predictable``, and with the
    share that a step has in the gradient itself; a trial whose doubt only grows says nothing and is left out.
    """
    found: dict[str, list[np.ndarray]] = {"share against that without uncertainty": [], "share itself": []}
    for trial in (t for t in trials if t <= learning.trials):
        doubt, with_doubt, sure = doubt_and_gradient(learning, trial)
        for name, share in zip(found, (with_doubt / np.maximum(sure, np.finfo(float).tiny), with_doubt), strict=True):
            found[name].append(np.array([_partial_rank_correlation(*pair) for pair in zip(doubt, share, strict=True)]))
    return {name: np.ma.masked_invalid(values).mean(0).filled(np.nan) for name, values in found.items()}


def _partial_rank_correlation(first: Float[np.ndarray, " T"], second: Float[np.ndarray, " T"]) -> float:
    """Return the rank correlation with the place held fixed; NaN where one of the two only grows or only falls."""
    columns = np.stack((np.arange(len(first)), first, second), 1)
    (_, one, two), (_, _, both), _ = scipy_stats.spearmanr(columns).statistic
    rest = (1 - one**2) * (1 - two**2)
    return float((both - one * two) / rest**0.5) if rest > 1e-12 else np.nan


def repeats(learning: Learning, trial: int) -> Float[np.ndarray, "R M times 4"]:
    """Return the true states of a trial of Deep PILCO and of further trials of its policy (green in Figure 5.8).

    Raises:
        ValueError: if the policy of that trial was not kept.
    """
    shown = [int(i) for i in learning.arrays["shown"]]
    if trial not in shown:
        raise ValueError(f"the trials that were repeated are {shown}, not {trial}")
    further = learning.arrays["repeats"][:, shown.index(trial)].astype(float)
    return np.concatenate((learning.arrays["states"][:, trial, None].astype(float), further), 1)


def angles(states: Float[np.ndarray, "R trial times 4"], trials: Sequence[int]) -> Float[np.ndarray, "R trials T"]:
    """Return the pole's angle at times 1 ... T of some trials; a list and a number in one index would move axes."""
    return states[:, list(trials), 1:][..., 3].astype(float)


def steps_predicted(learning: Learning, trial: int) -> Float[np.ndarray, " R"]:
    """Return for how many steps from the start the true trials of a policy went as the model had said.

    A step counts if the true angle is within two standard deviations of the prediction and that prediction says
    something: a standard deviation of the angle moves the tip by less than the width of the cost. Mean over the trials
    of each repetition (thesis Figure 5.8 reads 13 off after 10 trials).
    """
    mean = learning.arrays["predicted_mean"][:, trial, None, 1:, 3].astype(float)
    std = learning.predicted_std[:, trial, None, 1:, 3]
    true = repeats(learning, trial)[:, :, 1:, 3]
    good = (np.abs(true - mean) <= 2 * std) & (std * learning.plant.pole_length < learning.plant.cost_width)
    return np.logical_and.accumulate(good, -1).sum(-1).mean(1)


def steps_held(learning: Learning, trial: int) -> Float[np.ndarray, " R"]:
    """Return for how many steps the pole stood, at the mean over the true trials of a policy.

    It stands where the cost of a step is below the bound that a solved trial has to keep.
    """
    return (_repeated_costs(learning, trial) < cost.SOLVED_BELOW).double().sum(-1).mean(1).numpy()


def share_solved(learning: Learning, trial: int) -> Float[np.ndarray, " R"]:
    """Return the share of the true trials of a policy that were solved."""
    return cost.solved(learning.plant, _repeated_costs(learning, trial)).double().mean(1).numpy()


def _repeated_costs(learning: Learning, trial: int) -> Tensor:
    return cost.cost(learning.plant, torch.from_numpy(repeats(learning, trial)[:, :, 1:]))


#: What to do if numbers of a reader's own leave the band.
OWN_NUMBERS = "; this checks the page as it stands: for numbers of your own take the profile recorded"


def check_quick(learning: Learning) -> None:
    """Check a short live run of PILCO, three controlled trials or more, against wide bands set before it was first run.

    Raises:
        ValueError: naming the band that it leaves.
    """
    trial_costs = learning.trial_costs
    if not (trial_costs[:, 0] > 0.9).all():
        raise ValueError(f"random trials cost {trial_costs[:, 0].round(2)} per step, expected more than 0.9")
    best = float(trial_costs[:, 1:].min(1).mean())
    if not 0.2 <= best <= 0.9:
        raise ValueError(
            f"the best controlled trials cost {best:.2f} per step at the mean, outside 0.2 to 0.9{OWN_NUMBERS}"
        )


def check_quick_deep(learning: Learning) -> None:
    """Check a short live run of Deep PILCO, five controlled trials, against wide bands set before it was first run.

    Raises:
        ValueError: naming the band that it leaves.
    """
    trial_costs, predicted = learning.trial_costs, learning.predicted_costs[:, 1:]
    if not (trial_costs[:, 0] > 0.9).all():
        raise ValueError(f"random trials cost {trial_costs[:, 0].round(2)} per step, expected more than 0.9")
    if not ((predicted >= 0) & (predicted <= 1)).all():
        raise ValueError(f"predicted costs per step lie between 0 and 1, got {predicted.round(2).tolist()}")
    best = float(trial_costs[:, 1:].min())
    if not 0.2 <= best <= 0.98:
        raise ValueError(f"the best controlled trial costs {best:.2f} per step, outside 0.2 to 0.98{OWN_NUMBERS}")


def results(folder: Path | None = None) -> list[Result]:
    """Return the numbers of Figure 5.7, with ids as in ``python -m dropout_uncertainty results``."""
    found = []
    for config, name in NAMES.items():
        learning = load(config, folder)
        if learning is not None:
            found += _results(learning, f"figure-5.7/{name}")
            if "shown" in learning.arrays:
                found += _fitting_results(learning, f"figure-5.8/{name}")
    return found


def _results(learning: Learning, name: str) -> list[Result]:
    """Return the statistics of one config; the trials to solve have a printed value."""
    solve = "first trial by which at least half of the repetitions had a solved one"
    statistics = [
        ("trials-to-solve", learning.trials_to_solve, "trials", solve),
        ("kept", learning.kept, "share", f"solved repetitions with at least {KEPT:.0%} of the later trials solved"),
    ]
    ended = "" if len(learning.tested) == learning.trials else "; of a repetition that has ended that of its last test"
    for trial in (t for t in TRIALS if t in learning.tested):
        statistics += [
            (f"solved-by-{trial}", learning.solved_by(trial), "share", f"repetitions solved by trial {trial}"),
            (f"cost-at-{trial}", learning.cost_at(trial), "cost per step", f"mean cost of trial {trial}{ended}"),
        ]
    return listed(name, statistics, learning.records, learning.config)


def fitting(learning: Learning, trial: int) -> list[tuple[str, str, str, Interval]]:
    """Return what Figure 5.8 shows of a trial in numbers: kind, unit, words, and the mean over repetitions."""
    return [
        (
            "steps-predicted",
            "steps",
            "steps that the model had predicted",
            t_interval(steps_predicted(learning, trial)),
        ),
        ("steps-held", "steps", "steps for which the pole stood", t_interval(steps_held(learning, trial))),
        ("share-solved", "share", "true trials that were solved", t_interval(share_solved(learning, trial))),
    ]


def _fitting_results(learning: Learning, name: str) -> list[Result]:
    rows = [
        (f"{kind}-after-{trial}", interval, unit, f"{words}, policy after {trial} trials")
        for trial in PANELS
        if trial <= learning.trials
        for kind, unit, words, interval in fitting(learning, trial)
    ]
    return listed(name, rows, learning.records, learning.config)


def fitting_table(learnings: Sequence[Learning]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: for each panel of Figure 5.8 its numbers, the thesis's and those of each learner."""
    heads = ["after trial", "", "thesis", *(learning.label for learning in learnings)]
    cells: list[list[object]] = []
    for trial in (t for t in PANELS if t <= min(learning.trials for learning in learnings)):
        for rows in zip(*(fitting(learning, trial) for learning in learnings), strict=True):
            kind, _, words, _ = rows[0]
            printed = thesis_value(f"figure-5.8/deep-pilco/{kind}-after-{trial}")
            cells.append(
                [trial, words, printed and f"{printed:g}", *(in_words(interval, ".2g") for *_, interval in rows)]
            )
    return heads, cells


def solved_table(learnings: Sequence[Learning], trials: Sequence[int]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: trials to solve beside those of the thesis, and shares of repetitions solved by then."""
    heads = ["", "trials to solve, thesis", "ours", *(f"solved by {t}" for t in trials), "kept"]
    cells: list[list[object]] = []
    for learning in learnings:
        printed = thesis_value(f"figure-5.7/{NAMES.get(learning.config, learning.config)}/trials-to-solve")
        ours = in_words(learning.trials_to_solve, ".0f", unbounded=f"> {learning.trials}")
        shares = [_share(learning.solved_by(t)) if t <= learning.trials else None for t in trials]
        label = f"{learning.label} ({len(learning.seeds)})"
        cells.append([label, printed and f"{printed:g}", ours, *shares, _share(learning.kept)])
    return heads, cells


def _share(interval: Interval) -> str | None:
    return in_words(interval, ".0%") if interval.n else None


def time_table(learning: Learning, trials: Sequence[int]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: CPU seconds of a trial and repetition by part, mean over the records made on a CPU."""
    origins = [(record.header["provenance"], len(record.seeds)) for record in _on_cpu(learning)]
    heads = ["trial", "transitions", *TIMED.values()]
    cells: list[list[object]] = []
    for trial in (t for t in trials if origins and t <= learning.trials):
        seconds = [sum(o[f"{part}_cpu_s"][trial] for o, _ in origins) for part in TIMED]
        runs = sum(n for _, n in origins)
        cells.append([trial, trial * learning.plant.steps, *(f"{s / runs:.2f}" for s in seconds)])
    return heads, cells


def cpu_seconds(record: Record, trials: int) -> float:
    """Return the CPU seconds of all repetitions of a record up to a controlled trial."""
    return float(sum(sum(record.header["provenance"][f"{part}_cpu_s"][: trials + 1]) for part in TIMED))


def _on_cpu(learning: Learning) -> list[Record]:
    return [record for record in learning.records if record.header["device"] == "cpu"]


def run_time_table(learnings: Sequence[Learning]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: what the trials of one repetition take, the thesis's hours beside our CPU hours.

    Of records that were made on a CPU. Repetitions of a unit are computed together, so a repetition by itself would
    take longer than its share.
    """
    heads = ["", "thesis, 40 trials [h]", "trials", "ours [CPU h]", "side by side", "on"]
    cells: list[list[object]] = []
    for learning in learnings:
        if not (found := _on_cpu(learning)):
            continue
        origins = [record.header["provenance"] for record in found]
        # by parts, since a run that goes on from a shorter one has only these of its first trials
        seconds = sum(sum(origin[f"{part}_cpu_s"]) for origin in origins for part in TIMED)
        hours = seconds / 3600 / sum(len(record.seeds) for record in found)
        method = NAMES.get(learning.config, "pilco").split("/")[0]
        printed = thesis_value(f"figure-5.7/{method}/hours-40-trials")
        together = sorted({len(record.seeds) for record in found})
        on = ", ".join(dict.fromkeys(origin["processor"] for origin in origins))
        row = [learning.trials, f"{hours:.3f}", "-".join(map(str, together)), f"one core, {on}"]
        cells.append([learning.label, printed and f"{printed:g}", *row])
    return heads, cells


def search_table(folder: Path | None = None) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: every setting that was tried for Deep PILCO on development seeds, and how it did."""
    heads = [
        "tried",
        "changed",
        "seeds",
        "trials",
        *(f"solved by {t}" for t in (10, 15, 20)),
        "kept",
        "cost at the end",
    ]
    found = records.find(EXPERIMENT, name=None, folder=folder)
    tried = [r for r in found if r.header["name"].startswith("search/")]
    base = next((r for r in tried if r.header["name"] == "search/start"), None)
    cells: list[list[object]] = []
    for name in sorted({r.header["name"] for r in tried}, key=lambda name: (name != "search/start", name)):
        learning = from_records(name, [r for r in tried if r.header["name"] == name])
        config = learning.records[0].header["config"]
        changes = config_diff(base.header["config"], config) if base else []
        words = ", ".join(f"`{key}` {old} → {new}" for key, old, new in changes) or "the settings it began with"
        by = [_share(learning.solved_by(t)) for t in (10, 15, 20)]
        cells.append([
            name.removeprefix("search/"), words, f"{min(learning.seeds)}-{max(learning.seeds)}", learning.trials,
            *by, _share(learning.kept), in_words(learning.cost_at(learning.trials), ".2g"),
        ])  # fmt: skip
    return heads, cells
