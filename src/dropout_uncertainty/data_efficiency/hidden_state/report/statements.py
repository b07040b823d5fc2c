"""The statements about hidden states and held masks: what the thesis says, and how it is judged."""

from functools import partial
from pathlib import Path

from dropout_uncertainty.data_efficiency.hidden_state.report.analysis import CONTROL, load
from dropout_uncertainty.data_efficiency.report.statements import DEEP_TEXT, MARGIN_COST, MARGIN_LOG, dearer
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


def less_surprised(first: str, second: str, folder: Path | None) -> Measured:
    """Return the surprise in test at the end with some masks less that with others, paired by seed."""
    one, two = (needed(load(f"language-{masks}", folder)) for masks in (first, second))
    return on_average(apart(lambda run: run.end, one, two), [*one.records, *two.records])


def cheaper(model: str, folder: Path | None) -> Measured:
    """Return what learning costs with the LSTM with held masks less what it costs with another model."""
    return dearer((CONTROL["lstm-held"],), CONTROL[model], 25, folder)


WAITS = "20 repetitions of both models on stored trials without their velocities"
LEARNS = "ten runs of Deep PILCO with both models, which see x and θ alone"
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
    stated("DE13e", "Where the state is not fully seen, Deep PILCO learns cheaper with a recurrent model than with a "
           "feed-forward one of the last observation.", DEEP_TEXT, "less", MARGIN_COST, partial(cheaper, "last-one"),
           unit="cost per step", would_test=LEARNS),
    stated("DE13f", "It does so also where the feed-forward network is given the last four observations.", DEEP_TEXT,
           "less", MARGIN_COST, partial(cheaper, "last-four"), unit="cost per step", would_test=LEARNS),
    stated("DE16a", "A recurrent language model that has read a text many times is less surprised by other text with "
           "masks held over the sequence than with fresh ones.", "Section 5.1", "less", MARGIN_SURPRISE,
           partial(less_surprised, "held", "fresh"), would_test=READS),
    stated("DE16b", "It is so with held masks rather than without dropout.", "Section 5.1", "less", MARGIN_SURPRISE,
           partial(less_surprised, "held", "none"), would_test=READS),
]  # fmt: skip
