"""Where the state is hidden, from records: how models predict, what is learned with them, how language models over-fit.

Nothing is run and nothing is drawn here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from dropout_uncertainty.data_efficiency.hidden_state import control, language, prediction
from dropout_uncertainty.data_efficiency.hidden_state.prediction import FAMILY
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.data_efficiency.report.statements import cost_of_learning
from dropout_uncertainty.judging.results import Result, listed
from dropout_uncertainty.runs import records
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import common, paired_difference, t_interval

#: Models in words, by their configs.
MODELS = {
    "last-one": "last observation",
    "last-four": "last four observations",
    "lstm-held": "LSTM, held masks",
    "lstm-fresh": "LSTM, fresh masks",
    "lstm-no-dropout": "LSTM, no dropout",
}
#: The models of these that a policy is improved on, and the learner that sees the whole state, by config.
CONTROL = {name.removeprefix(f"{FAMILY}/control-"): name for name in control.CONFIGS} | {"seen": "deep-pilco-ours"}
SEEN = "the whole state, Deep PILCO's own network"
#: Language models in words, by their configs.
LANGUAGES = {"language-none": "no dropout", "language-fresh": "fresh masks", "language-held": "held masks"}


@dataclass(frozen=True)
class Run:
    """R repetitions of a config: its settings, and its arrays, R first; no records of a live one."""

    name: str
    seeds: tuple[int, ...]
    config: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]
    records: tuple[Record, ...] = ()

    @property
    def sizes(self) -> tuple[int, ...]:
        """Trials of data."""
        return tuple(self.config["sizes"])

    @property
    def cpu(self) -> float:
        """CPU seconds of a repetition: all its fits and predictions; NaN of a live run."""
        spent = [record.header["provenance"].get("cpu_s", np.nan) for record in self.records]
        return sum(spent) / len(self.seeds) if spent else np.nan

    @property
    def _error(self) -> Float[np.ndarray, "R sizes trials T 2"]:
        """Observed less predicted, in predicted standard deviations."""
        observed, mean, std = (
            self.arrays[name].astype(float) for name in ("observed", "predicted_mean", "predicted_std")
        )
        return (observed - mean) / std

    @property
    def log_density(self) -> Float[np.ndarray, "R sizes trials T 2"]:
        """Log density of what was observed under the predicted Gaussian, nats, of x [m] and θ [rad]."""
        spread = np.log(self.arrays["predicted_std"].astype(float))
        return -np.log(2 * np.pi) / 2 - spread - self._error**2 / 2

    @property
    def covered(self) -> Bool[np.ndarray, "R sizes trials T 2"]:
        """Whether what was observed lies within two predicted standard deviations."""
        return np.abs(self._error) < 2

    @property
    def by_size(self) -> Float[np.ndarray, "R sizes"]:
        """Log density of a number [nats], mean over trials, steps, x and θ."""
        return self.log_density.mean((2, 3, 4))

    @property
    def score(self) -> Float[np.ndarray, " R"]:
        """The same, mean over sizes of data: what DE13 is judged by."""
        return self.by_size.mean(1)

    @property
    def end(self) -> Float[np.ndarray, " R"]:
        """Surprise of a character [nats] of a language model in test, after its last reading of the text."""
        return self.arrays["test"][:, -1].astype(float)

    @property
    def lost(self) -> Float[np.ndarray, " R"]:
        """By how much that is above the least in test after any reading."""
        return self.end - self.arrays["test"].min(1)

    @property
    def gap(self) -> Float[np.ndarray, " R"]:
        """By how much that is above the surprise in training, after the last reading."""
        return self.end - self.arrays["train"][:, -1]


def load(name: str, folder: Path | None = None) -> Run | None:
    """Return the stored repetitions of ``hidden/<name>``; None if there are none."""
    config = {**prediction.CONFIGS, **language.CONFIGS}[f"{FAMILY}/{name}"]
    found = records.find(EXPERIMENT, config, name=f"{FAMILY}/{name}", folder=folder, published=True)
    if not found:
        return None
    seeds, arrays = records.joined(found)
    return Run(name, seeds, found[0].header["config"], arrays, tuple(found))


def learners(find: Callable[[str], Learning | None]) -> dict[str, Learning]:
    """Return the learners of ``CONTROL`` that are found, with the seeds and trials that all of them have."""
    found = {name: learning for name, config in CONTROL.items() if (learning := find(config))}
    if found.keys() <= {"seen"}:
        return {}
    trials, places = min(x.trials for x in found.values()), common(*(x.seeds for x in found.values()))
    return {name: x.part(own, trials) for (name, x), own in zip(found.items(), places, strict=True) if own}


def results(folder: Path | None = None) -> list[Result]:
    """Return the numbers of this page, with ids as in ``python -m dropout_uncertainty results``."""
    found = []
    for name in MODELS:
        if run := load(name, folder):
            found += _of_prediction(run)
    for name in LANGUAGES:
        if read := load(name, folder):
            rows = (
                ("test", t_interval(read.end), "nats", "surprise of a character of other text after the last pass"),
                ("lost", t_interval(read.lost), "nats", "that, less the least after any pass"),
                ("gap", t_interval(read.gap), "nats", "that, less the surprise of the text that was trained on"),
            )
            found += listed(f"{FAMILY}/{name}", rows, read.records, f"{FAMILY}/{name}")
    there = learners(partial(analysis.load, folder=folder))
    for name, learning in there.items():
        if name != "seen":
            found += _of_control(name, learning, there.get("seen"))
    return found


def _of_control(name: str, learning: Learning, seen: Learning | None) -> list[Result]:
    last, cost = learning.trials, cost_of_learning(learning)
    rows = [
        ("trials-to-solve", learning.trials_to_solve, "trials", "first trial by which at least half were solved"),
        (f"solved-by-{last}", learning.solved_by(last), "share", f"repetitions solved by trial {last}"),
        ("kept", learning.kept, "share", "solved repetitions that keep their solution"),
        ("cost", t_interval(cost), "cost per step", "mean over trials"),
        ("promise", t_interval(learning.broken_promise), "cost per step", "realised less predicted, mean over trials"),
    ]
    if seen:
        apart_from = paired_difference(cost, cost_of_learning(seen))
        rows.append(("cost/difference", apart_from, "cost per step", f"that, less {seen.config}'s"))
    return listed(f"{FAMILY}/{name}", rows, learning.records, learning.config)


def _of_prediction(run: Run) -> list[Result]:
    words = "log density of x [m] or θ [rad], mean over 25 predicted steps"
    rows = [("log-density", t_interval(run.score), "nats", f"{words} and all sizes of data")]
    rows += [
        (f"log-density/{size}", t_interval(column), "nats", f"{words}, {size} trials of data")
        for size, column in zip(run.sizes, run.by_size.T, strict=True)
    ]
    covered = t_interval(run.covered.mean((1, 2, 3, 4)))
    rows.append(("coverage", covered, "share", "observations within two predicted std"))
    name = f"{FAMILY}/{run.name}"
    return listed(name, rows, run.records, name)
