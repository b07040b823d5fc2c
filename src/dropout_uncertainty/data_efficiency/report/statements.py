"""Claims about both learners as code: quantity, rule, verdict. The rules were fixed before the published runs."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import LABELS, LATER, Learning, excess_on_predictable, load
from dropout_uncertainty.judging.results import Claim, Part, direction, missing, same_value, thesis_value
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Interval, paired_difference, t_interval

__all__ = ["CLAIMS"]

#: Deep PILCO's configs, in the order in which claims about it are judged.
DEEP = ("deep-pilco-as-written", "deep-pilco-ours")


def claim(
    identifier: str, where: str, text: str, rule: str, configs: Sequence[str] = ("pilco-paper",)
) -> Callable[[Callable[[Learning], list[Part]]], Claim]:
    """Turn a function from the repetitions of one config to parts into a claim about each of ``configs``."""

    def decorate(function: Callable[[Learning], list[Part]]) -> Claim:
        def measure(folder: Path | None) -> tuple[list[Part], list[Record]]:
            parts: list[Part] = []
            found: list[Record] = []
            for config in configs:
                learning = load(config, folder)
                mine = [missing(LABELS[config])] if learning is None else function(learning)
                if len(configs) > 1 and learning is not None:
                    mine = [replace(part, what=f"{learning.label}, {part.what}") for part in mine]
                parts += mine
                found += learning.records if learning is not None else ()
            return parts, found

        return Claim(identifier, text, where, rule, "5_4_data_efficiency", measure)

    return decorate


@claim(
    "DE1", "Section 5.4.3 and Figure 5.7",
    "PILCO balances the pole within 6 to 7 trials in most runs.",
    "the share of repetitions solved by trial 7 is above one half; the trial by which half of them are solved has an "
    "interval that holds 6.5",
)  # fmt: skip
def de1(pilco: Learning) -> list[Part]:
    share, trials = pilco.solved_by(7), pilco.trials_to_solve
    printed = _printed("figure-5.7/pilco/trials-to-solve")
    return [
        Part("share solved by trial 7", share, "", direction(share, expected="positive", null=0.5)),
        Part(f"trials until half are solved (thesis {printed:g})", trials, "", same_value(trials, printed)),
    ]


@claim(
    "DE2", "Section 5.4.3, Figure 5.7",
    "Deep PILCO balances the pole within 20 to 25 trials in most runs.",
    "as written and in our setting: the share of repetitions solved by trial 25 is above one half; the trial by which "
    "half of them are solved has an interval that holds 22.5",
    DEEP,
)  # fmt: skip
def de2(deep: Learning) -> list[Part]:
    share, trials = deep.solved_by(25), deep.trials_to_solve
    printed = _printed("figure-5.7/deep-pilco/trials-to-solve")
    return [
        Part("share solved by trial 25", share, "", direction(share, expected="positive", null=0.5)),
        Part(f"trials until half are solved (thesis {printed:g})", trials, "", same_value(trials, printed)),
    ]


@claim(
    "DE3", "Figure 5.8",
    "After one trial the model is of no use; after 10 it predicts about 13 steps and the pole is held for about 10; "
    "after 20 a little better; from about 26 most trials are stable.",
    "as written and in our setting, of true trials of the controllers after 1, 10, 20 and 26 trials of data: steps "
    "that the model had predicted, after 10 trials more than after 1, with an interval that holds 13, and after 20 "
    "more than after 10; steps for which the pole stood after 10 trials, with an interval that holds 10; the share of "
    "solved ones after 26 trials is above one half",
    DEEP,
)  # fmt: skip
def de3(deep: Learning) -> list[Part]:
    predicted = {trial: analysis.steps_predicted(deep, trial) for trial in (1, 10, 20)}
    sooner = paired_difference(predicted[10], predicted[1])
    later = paired_difference(predicted[20], predicted[10])
    ten, held, stable = (
        t_interval(values) for values in (predicted[10], analysis.steps_held(deep, 10), analysis.share_solved(deep, 26))
    )
    thirteen, stood = (_printed(f"figure-5.8/deep-pilco/{kind}-after-10") for kind in ("steps-predicted", "steps-held"))
    return [
        Part("steps predicted after 10 trials - after 1", sooner, "", direction(sooner, expected="positive")),
        Part(f"steps predicted after 10 (thesis {thirteen:g})", ten, "", same_value(ten, thirteen)),
        Part("steps predicted after 20 trials - after 10", later, "", direction(later, expected="positive")),
        Part(f"steps held after 10 (thesis {stood:g})", held, "", same_value(held, stood)),
        Part("share solved after 26", stable, "", direction(stable, expected="positive", null=0.5)),
    ]


@claim(
    "DE9", "Section 5.4.3, Figure 5.7",
    "Both need orders of magnitude fewer trials than model-free learners, which take about 400 and 2500.",
    "the printed numbers of trials are more than ten times ours; and a model-free learner run on our cart-pole needs "
    "more than ten times as many, which has not been run, so that the claim stays undecided",
    ("pilco-paper", "deep-pilco-ours"),
)  # fmt: skip
def de9(learning: Learning) -> list[Part]:
    parts = []
    for identifier, name in (("gu-2016", "Gu et al."), ("lillicrap-2015", "Lillicrap et al.")):
        trials, printed = learning.trials_to_solve, _printed(f"literature/{identifier}/trials")
        ratio = Interval(printed / trials.value, printed / trials.high, printed / trials.low, trials.n)
        parts.append(Part(f"trials of {name} / ours", ratio, "", direction(ratio, expected="positive", null=10.0)))
    return [*parts, missing("a model-free learner on this cart-pole")]


@claim(
    "DE11", "Section 5.4.1, last paragraph",
    "PILCO optimises the policy on the states that it can predict well.",
    f"at the beginning of the policy searches of trials {LATER[0]}-{LATER[-1]}: the more doubt about the angle at a "
    "step, the less that step counts in the gradient compared with a model without doubt (rank correlation negative); "
    "steps at which a standard deviation of the angle moves the tip by less than the width of the cost have a larger "
    "share of the gradient than in a model without doubt",
)  # fmt: skip
def de11(pilco: Learning) -> list[Part]:
    correlation, difference = map(t_interval, excess_on_predictable(pilco))
    share = "share of the gradient on well predicted steps, with doubt - without"
    return [
        Part("rank correlation over steps", correlation, "", direction(correlation, expected="negative")),
        Part(share, difference, "", direction(difference, expected="positive")),
    ]


def _printed(identifier: str) -> float:
    """Return a value of ``records/thesis.csv`` that must be there."""
    value = thesis_value(identifier)
    if value is None:
        raise KeyError(f"records/thesis.csv has no {identifier}")
    return value


CLAIMS: list[Claim] = [de1, de2, de3, de9, de11]
