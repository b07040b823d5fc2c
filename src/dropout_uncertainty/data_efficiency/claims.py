"""Claims about PILCO as code: quantity, rule, verdict. The rules were fixed before the published runs."""

from collections.abc import Callable
from pathlib import Path

from dropout_uncertainty.data_efficiency.analysis import LATER, Learning, excess_on_predictable, load
from dropout_uncertainty.records import Record
from dropout_uncertainty.results import Claim, Part, direction, missing, same_value, thesis_value
from dropout_uncertainty.stats import t_interval

__all__ = ["CLAIMS"]


def claim(identifier: str, where: str, text: str, rule: str) -> Callable[[Callable[[Learning], list[Part]]], Claim]:
    """Turn a function from PILCO's repetitions on the ``paper`` plant to parts into a claim."""

    def decorate(function: Callable[[Learning], list[Part]]) -> Claim:
        def measure(folder: Path | None) -> tuple[list[Part], list[Record]]:
            learning = load("pilco-paper", folder)
            if learning is None:
                return [missing("PILCO")], []
            return function(learning), list(learning.records)

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
    printed = thesis_value("figure-5.7/pilco/trials-to-solve")
    assert printed is not None
    return [
        Part("share solved by trial 7", share, "", direction(share, expected="positive", null=0.5)),
        Part(f"trials until half are solved (thesis {printed:g})", trials, "", same_value(trials, printed)),
    ]


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


CLAIMS: list[Claim] = [de1, de11]
