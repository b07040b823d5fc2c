"""What the notebook on hidden states asks for in one call: the runs of a profile, and their sentences."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.hidden_state.prediction import FAMILY
from dropout_uncertainty.data_efficiency.hidden_state.report import analysis
from dropout_uncertainty.data_efficiency.hidden_state.report.analysis import (
    LANGUAGES,
    MODELS,
    Reading,
    Run,
    reading,
)
from dropout_uncertainty.page.profiles import complete
from dropout_uncertainty.page.tables import Words
from dropout_uncertainty.runs.process import finished
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.settings import config_dict
from dropout_uncertainty.stats import apart, in_words, t_interval, told

__all__ = ["Runs", "answers", "models_table", "over_fitting", "runs"]

SEEDS = (100, 101)
#: What is smaller in live runs.
TINY: dict[str, Any] = {"sizes": (5, 10), "steps": 150, "particles": 20}
TINY_TEXT: dict[str, Any] = {"train": 5_000, "test": 2_500, "width": 32, "passes": 6}


@dataclass(frozen=True)
class Runs:
    """What the chapter shows, as far as it has been run."""

    models: Sequence[Run]
    languages: Sequence[Reading]

    @classmethod
    def of(cls, find: Callable[[str], Run | None]) -> "Runs":
        """Return what is found by the names of configs."""
        languages = (reading(masks, find(f"language-{masks}")) for masks in LANGUAGES)
        return cls([run for name in MODELS if (run := find(name))], [run for run in languages if run])

    @property
    def records(self) -> list[Record]:
        """The records of all this."""
        found = [run.records for run in self.models] + [run.records for run in self.languages]
        return [record for records in found for record in records]

    @property
    def missing(self) -> Words:
        """Return in a line what has not been run; nothing where all has."""
        have = {run.name for run in self.models} | {f"language-{run.name}" for run in self.languages}
        wanted = [*MODELS, *(f"language-{masks}" for masks in LANGUAGES)]
        names = ", ".join(f"`{FAMILY}/{name}`" for name in wanted if name not in have)
        return Words(f"*Not run yet: {names}.*" if names else "")


def runs(profile: str) -> Runs:
    """Return the stored runs; in ``quick`` live ones, too short to tell anything, on stored trials."""
    names = [name for name in configs.CONFIGS if name.startswith(f"{FAMILY}/")]
    complete(profile, [unit for name in names for unit in configs.units(name)])
    return Runs.of(_live if profile == "quick" else analysis.load)


def _live(name: str) -> Run:
    full = f"{FAMILY}/{name}"
    config = replace(configs.CONFIGS[full], **(TINY if name in MODELS else TINY_TEXT))
    (unit,) = configs.units(full, SEEDS)
    return Run(name, SEEDS, config_dict(config), finished(unit.start(config, SEEDS)).result())


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
