"""The statements about hidden states and held masks: what the thesis says, and how it is judged."""

from functools import partial
from pathlib import Path

from dropout_uncertainty.data_efficiency.hidden_state.report.analysis import load, reading
from dropout_uncertainty.data_efficiency.report.statements import DEEP_TEXT, MARGIN_LOG
from dropout_uncertainty.data_efficiency.report.statements import stated as of_section
from dropout_uncertainty.judging.statements import Measured, Statement, needed, on_average
from dropout_uncertainty.stats import apart, t_interval

__all__ = ["STATEMENTS"]

CHAPTER = "5_4_hidden_state"
#: Margin of the surprise of a character [nats].
MARGIN_SURPRISE = 0.05

stated = partial(of_section, chapter=CHAPTER, unit="nats")


def predicts_better(first: str, second: str, folder: Path | None) -> Measured:
    """Return a model's log density less that of another, mean over sizes of data, paired by seed; each size beside."""
    one, two = (needed(load(name, folder)) for name in (first, second))
    difference = apart(lambda run: run.by_size, one, two)
    beside = {f"{size} trials": t_interval(column) for size, column in zip(one.sizes, difference.T, strict=True)}
    return on_average(difference.mean(1), [*one.records, *two.records], beside=beside)


def over_fits_less(first: str, second: str, folder: Path | None) -> Measured:
    """Return the surprise in test at the end with some masks less that with others, paired by seed."""
    one, two = (needed(reading(masks, load(f"language-{masks}", folder))) for masks in (first, second))
    return on_average(apart(lambda run: run.end, one, two), [*one.records, *two.records])


WAITS = "20 repetitions of both models on stored trials without their velocities"
READS = "five language models of each kind"

STATEMENTS: list[Statement] = [
    stated("DE13", "Where the state is not fully seen, a recurrent Bayesian network predicts better than a "
           "feed-forward one (log density of a predicted number).", DEEP_TEXT, "more", MARGIN_LOG,
           partial(predicts_better, "lstm-held", "last-one"), would_test=WAITS),
    stated("DE13b", "It does so also where the feed-forward network is given the last four observations.", DEEP_TEXT,
           "more", MARGIN_LOG, partial(predicts_better, "lstm-held", "last-four"), would_test=WAITS),
    stated("DE13c", "It does so with masks held over the sequence rather than fresh at every step.", DEEP_TEXT, "more",
           MARGIN_LOG, partial(predicts_better, "lstm-held", "lstm-fresh"), would_test=WAITS),
    stated("DE13d", "It does so with dropout rather than without.", DEEP_TEXT, "more", MARGIN_LOG,
           partial(predicts_better, "lstm-held", "lstm-no-dropout"), would_test=WAITS),
    stated("DE16a", "A recurrent language model over-fits less with masks held over the sequence than with fresh ones "
           "(surprise of a character of other text).", "Section 5.1", "less", MARGIN_SURPRISE,
           partial(over_fits_less, "held", "fresh"), would_test=READS),
    stated("DE16b", "It over-fits less with held masks than without dropout.", "Section 5.1", "less", MARGIN_SURPRISE,
           partial(over_fits_less, "held", "none"), would_test=READS),
]  # fmt: skip
