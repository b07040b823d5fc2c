"""What a reader sees first: nine statements and some findings, all made from the records, and ``page.pictures``.

The landing page computes numbers and findings whenever the book is built. The README is static text and the pictures
are files: ``dropout-uncertainty front`` writes them again, and a test holds them to the records.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from dropout_uncertainty import folders
from dropout_uncertainty.active_learning.report import analysis as active_learning
from dropout_uncertainty.data_efficiency.ablations.report import analysis as what_matters
from dropout_uncertainty.data_efficiency.ablations.report.worth import analysis as worth
from dropout_uncertainty.data_efficiency.report import analysis as data_efficiency
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.exploration.report import analysis as exploration
from dropout_uncertainty.exploration.report.deep_sea import dives
from dropout_uncertainty.judging.collect import SECTIONS, STATEMENTS, collect
from dropout_uncertainty.judging.results import Result, thesis_value
from dropout_uncertainty.judging.statements import KINDS, Judged, NotRun, Statement, StatementResult, judge, needed
from dropout_uncertainty.page.pictures import PICTURES
from dropout_uncertainty.page.tables import grid_of
from dropout_uncertainty.runs.records import root
from dropout_uncertainty.stats import Interval, in_words, t_interval

__all__ = ["FACTS", "SAID", "USED", "facts", "numbers", "readme", "tally", "write"]

README, FOLDER = Path("README.md"), Path("book", "_static", "front")
#: Where the numbers stand in the README.
BEGIN, END = "<!-- numbers: written by `dropout-uncertainty front` -->", "<!-- end of numbers -->"


# ------------------------------------------------------------------ nine statements


def numbers(found: Iterable[Result] | None = None, link: str = "{}.ipynb") -> tuple[list[str], list[list[str]]]:
    """Return heads and rows of the primary statements.

    Args:
        found: the results to look in; by default all that the stored records give.
        link: where a chapter is, with ``{}`` for its name.
    """
    results = {result.id: result for result in (collect() if found is None else found)}
    primary = [s for s in STATEMENTS.values() if s.primary]
    heads = ["section", "statement", "verdict", "difference [95 % interval]", "repetitions"]
    return heads, [_row(s, results.get(f"statement/{s.id}"), link) for s in primary]


def _row(statement: Statement, result: Result | None, link: str) -> list[str]:
    title = SECTIONS[statement.id[:2]].split()[0]
    section = f"[{title}]({link.format(statement.chapter)})"
    if not isinstance(result, StatementResult):
        return [section, statement.text, f"**untested**: {statement.would_test}", "–", "0"]
    open_still = f": {result.why}" if result.verdict == "untested" else ""
    return [section, statement.text, f"**{result.verdict}**{open_still}", _ours(result), str(result.n)]


def _ours(result: Result) -> str:
    """Return our value with its interval and unit; an end that was never reached is open, a single run has none."""
    if result.ours is None:
        return "–"
    low, high = (math.inf if end is None else end for end in (result.low, result.high))
    return f"{in_words(Interval(result.ours, low, high, result.n), '.2g', unbounded='…')} {result.unit}"


def tally(found: Iterable[Result] | None = None) -> str:
    """Return how many statements of each kind have which verdict, as one sentence."""
    results = [r for r in (collect() if found is None else found) if isinstance(r, StatementResult)]
    parts = []
    for words, (kinds, possible) in KINDS.items():
        verdicts = [result.verdict for result in results if result.kind in kinds]
        counts = ", ".join(f"{verdicts.count(v)} {v}" for v in possible if v in verdicts)
        parts += [f"{len(verdicts)} {words} ({counts})"] if verdicts else []
    return f"Of all statements: {'; '.join(parts)}."


def readme(text: str, found: Iterable[Result] | None = None) -> str:
    """Return the README's text with the nine statements between its marks written anew.

    Raises:
        UserError: if the marks are missing.
    """
    if not (BEGIN in text and END in text):
        raise UserError(f"the README must hold the lines {BEGIN!r} and {END!r}, between which the numbers are written")
    found = collect() if found is None else list(found)
    heads, rows = numbers(found, "notebooks/{}.ipynb")
    block = f"{BEGIN}\n{grid_of([heads, *rows])}\n\n{tally(found)}\n{END}"
    return re.sub(re.escape(BEGIN) + ".*?" + re.escape(END), lambda _: block, text, flags=re.DOTALL)


# ------------------------------------------------------------------ numbers in sentences

EARLY, LATE = (3_000, 50_000), (90_500, 200_000)  # ticks


def facts(folder: Path | None = None) -> dict[str, str]:
    """Return numbers and verdicts in the sentences of the first page, by their names there; a dash without records.

    By ``use_`` and its id verdict and number of each statement of the page "What to use when".
    """
    judged = _judged(folder)
    said = {name: "–" if judged[name].verdict == "untested" else judged[name].verdict for name in SAID}
    used = {f"use_{name}": _with_number(judged[name]) for name in USED}
    return {name: _told(fact, folder) for name, fact in FACTS.items()} | said | used


def _told(fact: Callable[[Path | None], str], folder: Path | None) -> str:
    try:
        return fact(folder)
    except NotRun:
        return "–"


def _judged(folder: Path | None) -> dict[str, Judged]:
    """Return what the two pages name, judged section by section with all primary statements."""
    found: dict[str, Judged] = {}
    for letters in SECTIONS:
        mine = [s for s in STATEMENTS.values() if s.id.startswith(letters) and (s.primary or s.id in {*SAID, *USED})]
        found |= {j.statement.id: j for j in judge(mine, folder)}
    return found


def _with_number(judged: Judged) -> str:
    if judged.verdict == "untested":
        return f"untested ({judged.why})"
    return judged.verdict if judged.statement.kind == "audit" else f"{judged.verdict}, {_ours(judged.result())}"


def _rows(family: str, folder: Path | None, *names: str) -> list[active_learning.Row]:
    rows = active_learning.load_rows(family, folder)
    return [needed(rows.get(name)) for name in names]


def _tied(folder: Path | None) -> str:
    rows = _rows("ours", folder, "softmax/bald", "softmax/variation-ratios")
    return f"{min(map(active_learning.share_tied, rows)):.0%}"


def _entropy(acquired: tuple[int, int], folder: Path | None) -> str:
    """Return the test error, in points, of acquiring by the entropy over weight draws minus by that of one pass."""
    draws, single = _rows("ours", folder, "dropout/max-entropy", "softmax/max-entropy")
    return in_words(active_learning.paired_error(draws, single, *acquired))


def _entropy_steps(family: str, name: str, folder: Path | None) -> str:
    """Return how many acquisitions a row chosen by an entropy needs to 5 % test error."""
    (row,) = _rows(family, folder, name)
    return in_words(row.crossing(), ".0f")


def _printed_cells(statistic: str) -> str:
    """Return how many of the printed errors are a statistic of the original program's curves, to two decimals."""
    rows = active_learning.original_rows()
    same = [
        f"{getattr(row, statistic).value:.2f}" == f"{thesis_value(f'table-5.1/{n}'):.2f}" for n, row in rows.items()
    ]
    return f"{sum(same)} of {len(same)}"


def _greedy(ticks: tuple[int, int], folder: Path | None) -> str:
    """Return by how much the agent without exploration earns more than Thompson sampling per tick."""
    agents = exploration.load("ours", folder)
    greedy, thompson = (needed(agents.get(name)) for name in ("greedy", "thompson"))
    return in_words(exploration.compare(greedy, thompson, *ticks))


def _thompson(config: str, folder: Path | None, ticks: tuple[int, int], what: str | None = None) -> str:
    """Return the mean reward per tick of a Thompson agent, or the share of its moves that are ``what``."""
    curves = needed(exploration.load(config, folder).get("thompson"))
    return f"{curves.mean(*ticks).mean():.2f}" if what is None else f"{curves.share(what, *ticks).mean():.0%}"


def _sea(agent: str, folder: Path | None) -> str:
    """Return how many seas of size 10 an agent solves within the episodes that statement EX9 counts."""
    found = needed(dives.load(folder).get((agent, 10)))
    return f"{found.within().sum()} of {len(found.seeds)}"


def _solved(config: str, trial: int, folder: Path | None) -> str:
    learning = needed(data_efficiency.load(config, folder))
    if learning.trials < trial:
        raise NotRun
    return f"{(learning.first_solved <= trial).sum()} of {len(learning.seeds)}"


def _solved_later(config: str, folder: Path | None) -> str:
    """Return the share of solved trials among those after the first solved one of a repetition."""
    learning = needed(data_efficiency.load(config, folder))
    return f"{learning.solved[learning.later].mean():.0%}"


def _held(kind: str, folder: Path | None) -> str:
    """Return how many times as wide Deep PILCO's prediction is if masks are held rather than redrawn."""
    seen = needed(what_matters.inside(folder))
    return in_words(what_matters.factor(seen.log_std_ratio(f"held-{kind}", f"redrawn-{kind}")))


def _needs_more(name: str, what: str, spec: str, folder: Path | None) -> str:
    """Return what the learner named in a pair of ``worth.PAIRS`` needs more than the one that it is held against."""
    pairs = {pair.name: pair for pair in worth.pairs(worth.stored(folder))}
    return in_words(getattr(needed(pairs.get(name)), what), spec)


def _first_trial(name: str, what: str, folder: Path | None) -> str:
    """Return what a learner's first controlled trial costs, as its model had said or as it was."""
    return in_words(t_interval(getattr(needed(data_efficiency.load(name, folder)), what)[:, 1]))


def _doubt(folder: Path | None) -> str:
    """Return how a step's part in PILCO's gradient goes with the doubt about it, as statement DE11a measures it."""
    learning = needed(data_efficiency.load("pilco-paper", folder))
    return in_words(t_interval(data_efficiency.excess_on_predictable(learning)[0]))


#: The statements whose verdicts the sentences of the first page give.
SAID = (
    "AL3f", "AL3g", "AL7a", "AL7b", "AL8a", "EX3a", "EX3c", "EX3e", "EX4", "EX7e", "EX7f", "DE2d", "DE3h", "DE6b",
    "DE6c", "DE7a", "DE7b", "DE7c", "DE11a",
)  # fmt: skip
#: The statements on which the lines of the page "What to use when" rest.
USED = (
    "AL3e", "AL3f", "AL3g", "AL4a", "AL4b", "AL5b", "AL5c", "AL5e", "AL5f", "AL7a", "AL7b", "AL9c", "AL11",
    "AL11b", "AL11c", "AL11d", "AL11e", "AL11i", "AL11l", "AL11m", "EX2d", "EX5a", "EX5b", "EX6c", "EX7a", "EX7b",
    "EX7f", "EX9", "DE1a", "DE2a", "DE2d", "DE2g", "DE3h", "DE4a", "DE4d", "DE5b", "DE5d", "DE6b", "DE6c", "DE7a",
    "DE7b", "DE7c", "DE8a", "DE8d", "DE9a", "DE9b", "DE13", "DE13b", "DE13e", "DE13f", "DE14a", "DE15",
)  # fmt: skip
#: The numbers by name; each is computed from the records of a folder, and raises NotRun without them.
FACTS: Mapping[str, Callable[[Path | None], str]] = {
    "tied": _tied,
    "entropy_early": lambda folder: _entropy(active_learning.EARLY, folder),
    "entropy_end": lambda folder: _entropy(active_learning.END, folder),
    "entropy_steps_draws": lambda folder: _entropy_steps("ours", "dropout/max-entropy", folder),
    "entropy_steps": lambda folder: _entropy_steps("ours", "softmax/max-entropy", folder),
    "entropy_steps_recorded": lambda folder: _entropy_steps("as-recorded", "softmax/max-entropy", folder),
    "cells_minimum": lambda folder: _printed_cells("minimum"),
    "cells_last": lambda folder: _printed_cells("last"),
    "greedy_early": lambda folder: _greedy(EARLY, folder),
    "greedy_late": lambda folder: _greedy(LATE, folder),
    "departs": lambda folder: _thompson("as-demo", folder, (500_000, 1_000_000), "explored"),
    "dropout_of_text": lambda folder: _thompson("as-written", folder, LATE),
    "dropout_of_program": lambda folder: _thompson("as-demo", folder, LATE),
    "sea_held": lambda folder: _sea("dropout-per-episode", folder),
    "sea_epsilon": lambda folder: _sea("epsilon-greedy", folder),
    "sea_priors": lambda folder: _sea("ensemble-priors", folder),
    "solved_as_written": lambda folder: _solved("deep-pilco-as-written", 25, folder),
    "solved_ours": lambda folder: _solved("deep-pilco-ours", 25, folder),
    "later_as_written": lambda folder: _solved_later("deep-pilco-as-written", folder),
    "later_ours": lambda folder: _solved_later("deep-pilco-ours", folder),
    "held_free": lambda folder: _held("free", folder),
    "held_matched": lambda folder: _held("matched", folder),
    "no_dropout_trials": lambda folder: _needs_more("no-dropout", "trials_difference", ".1f", folder),
    "no_dropout_cost": lambda folder: _needs_more("no-dropout", "cost_difference", ".2f", folder),
    "on_mean_cost": lambda folder: _needs_more("mean-network", "cost_difference", ".2f", folder),
    "ensemble_cost": lambda folder: _needs_more("ensemble", "cost_difference", ".2f", folder),
    "alone_cost": lambda folder: _needs_more(worth.ALONE, "cost_difference", ".2f", folder),
    "sure_pilco_cost": lambda folder: _needs_more("pilco-mean", "cost_difference", ".2f", folder),
    "sure_pilco_said": lambda folder: _first_trial("doubt/pilco-mean", "predicted_costs", folder),
    "sure_pilco_was": lambda folder: _first_trial("doubt/pilco-mean", "trial_costs", folder),
    "doubt": _doubt,
}


def write(folder: Path | None = None) -> list[str]:
    """Write the README's numbers and the pictures from the records; return what was done, one line each.

    A picture whose records are missing stays as it is.

    Raises:
        UserError: outside a clone, or if the README's numbers rest on more repetitions than there are records of, or
            if a file cannot be written.
    """
    clone = folders.checkout()
    if clone is None:
        raise UserError("README and pictures belong to a clone of the repository, and this is an installed package")
    old = (clone / README).read_text(encoding="utf-8")
    new = readme(old, collect(folder))
    now = _repetitions(new)
    for what, before in _repetitions(old).items():
        if now.get(what, before) < before:
            raise UserError(
                f"{README} has {before} repetitions of {what!r}, the records in {folder or root()} {now[what]}: "
                "it stays as it is"
            )
    drawn = {FOLDER / f"{name}.svg": draw(folder) for name, draw in PICTURES.items()}
    try:
        (clone / FOLDER).mkdir(parents=True, exist_ok=True)
        for target, content in {README: new, **drawn}.items():
            if content is not None:
                (clone / target).write_text(content, encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {error.filename} ({error.strerror}): is the clone read-only?") from None
    done = [f"{README} has the numbers of the records"]
    for target, svg in drawn.items():
        done.append(f"{target} {'stays as it is: its records are missing' if svg is None else 'is drawn anew'}")
    return done


def _repetitions(text: str) -> dict[str, int]:
    """Return how many repetitions each of the README's statements rests on, by its sentence."""
    block = text.partition(BEGIN)[2].partition(END)[0]
    rows = [line.strip("| ").split(" | ") for line in block.splitlines()]
    return {row[1]: int(row[4]) for row in rows if len(row) == 5 and row[4].isdigit()}
