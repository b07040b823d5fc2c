"""What the notebook on hidden states asks for in one call: the runs of a profile, and their sentences."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.hidden_state.control import ControlConfig
from dropout_uncertainty.data_efficiency.hidden_state.prediction import FAMILY
from dropout_uncertainty.data_efficiency.hidden_state.report.analysis import (
    LANGUAGES,
    MODELS,
    SEEN,
    Run,
    learners,
    load,
)
from dropout_uncertainty.data_efficiency.report import analysis as data_efficiency
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.data_efficiency.report.statements import cost_of_learning
from dropout_uncertainty.page.profiles import complete
from dropout_uncertainty.page.tables import Words
from dropout_uncertainty.runs.process import finished
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.settings import config_dict
from dropout_uncertainty.stats import apart, in_words, t_interval, told

__all__ = ["Runs", "answers", "learners_table", "models_table", "over_fitting", "runs"]

SEEDS = (100, 101)
#: Configs of this page.
CONFIGS = [name for name in configs.CONFIGS if name.startswith(f"{FAMILY}/")]
#: What is smaller in live runs.
TINY: dict[str, Any] = {"sizes": (5, 10), "steps": 150, "particles": 20}
TINY_CONTROL: dict[str, Any] = {"trials": 2, "particles": 10, "policy_steps": 10}
TINY_TEXT: dict[str, Any] = {"train": 5_000, "test": 2_500, "width": 32, "passes": 6}


@dataclass(frozen=True)
class Runs:
    """What the chapter shows, as far as it has been run."""

    models: Sequence[Run]
    languages: Sequence[Run]
    learners: Mapping[str, Learning]

    @classmethod
    def of(cls, find: Callable[[str], Run | None], learned: Callable[[str], Learning | None]) -> "Runs":
        """Return what is found by the names of configs."""
        models, languages = ([run for name in names if (run := find(name))] for names in (MODELS, LANGUAGES))
        return cls(models, languages, learners(learned))

    @property
    def records(self) -> list[Record]:
        """The records of all this."""
        every: list[Run | Learning] = [*self.models, *self.languages, *self.learners.values()]
        return [record for run in every for record in run.records]

    @property
    def missing(self) -> Words:
        """Return in a line what has not been run; nothing where all has."""
        have = {f"{FAMILY}/{run.name}" for run in (*self.models, *self.languages)}
        have |= {learning.config for learning in self.learners.values()}
        names = ", ".join(f"`{name}`" for name in CONFIGS if name not in have)
        return Words(f"*Not run yet: {names}.*" if names else "")


def runs(profile: str) -> Runs:
    """Return the stored runs; in ``quick`` live ones, too short to tell anything, on stored trials."""
    complete(profile, [unit for name in CONFIGS for unit in configs.units(name)])
    if profile == "quick":
        return Runs.of(_live, _live_learning)
    return Runs.of(load, data_efficiency.load)


def _live(name: str) -> Run:
    full = f"{FAMILY}/{name}"
    config = replace(configs.CONFIGS[full], **(TINY if name in MODELS else TINY_TEXT))
    return Run(name, SEEDS, config_dict(config), _finished(full, config))


def _live_learning(name: str) -> Learning | None:
    config = configs.CONFIGS[name]
    if isinstance(config, ControlConfig):
        config = replace(config, model=replace(config.model, steps=TINY["steps"]), **TINY_CONTROL)
    else:
        config = replace(config, model_steps=TINY["steps"], **TINY_CONTROL)
    return data_efficiency.from_arrays(name, config.plant, _finished(name, config), SEEDS)


def _finished(name: str, config: Any) -> dict[str, np.ndarray]:
    return finished(configs.units(name, SEEDS)[0].start(config, SEEDS)).result()


def models_table(found: Runs) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: each model's log density, coverage and computing time."""
    heads = ["", "repetitions", "log density of a number [nats]", "within two std", "CPU seconds of a repetition"]
    return heads, [
        [
            MODELS[run.name], len(run.seeds), in_words(t_interval(run.score)), f"{run.covered.mean():.0%}",
            f"{run.cpu:.1f}" if run.records else "",
        ]
        for run in found.models
    ]  # fmt: skip


def learners_table(found: Runs) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: what learning costs with each model, how soon it solves, what it promises and takes."""
    heads = ["model", "repetitions", "cost per step", "trials to solve", "solved", "promise broken by", "CPU seconds"]

    def row(name: str, x: Learning) -> list[object]:
        spent = [data_efficiency.cpu_seconds(r, x.trials) / len(r.seeds) / x.trials for r in x.records]
        return [
            MODELS.get(name, SEEN), len(x.seeds), in_words(t_interval(cost_of_learning(x))),
            in_words(x.trials_to_solve, ".0f"), in_words(x.solved_by(x.trials), ".0%"),
            in_words(t_interval(x.broken_promise)), f"{np.mean(spent):.1f}" if spent else "",
        ]  # fmt: skip

    return heads, [row(name, learning) for name, learning in found.learners.items()]


def answers(found: Runs) -> Words:
    """Return by how much the recurrent network with held masks predicts better than each of the others."""
    by_name = {run.name: run for run in found.models}
    held = by_name.pop("lstm-held", None)
    if held is None:
        return Words("")
    lines = []
    for name, run in by_name.items():
        difference = t_interval(apart(lambda x: x.score, held, run))
        words = told(difference, "predicts better", "predicts worse", "may predict better or worse")
        lines.append(f"- than the **{MODELS[name]}** it {words}: {in_words(difference)} nats a number.")
    return Words("The LSTM with held masks, its log density less that of the other:\n\n" + "\n".join(lines))


def over_fitting(found: Runs) -> Words:
    """Return how surprised each language model is by other text in the end, and how much less it once was."""
    lines = [
        f"- **{LANGUAGES[run.name]}**: {in_words(t_interval(run.end))} nats a character of other text in the end, "
        f"{in_words(t_interval(run.lost))} above the least on the way, {in_words(t_interval(run.gap))} above the text "
        "that it was trained on."
        for run in found.languages
    ]
    return Words("\n".join(lines))
