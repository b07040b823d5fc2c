"""What the scoreboard shows: every statement with its verdict and what it rests on, and what records and pages took."""

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any, get_args

import numpy as np
from matplotlib.axes import Axes

from dropout_uncertainty import folders
from dropout_uncertainty.judging.collect import SECTIONS
from dropout_uncertainty.judging.rules import Verdict
from dropout_uncertainty.judging.statements import KINDS, Judged, Statement
from dropout_uncertainty.page.curve_toggles import CONTROLS
from dropout_uncertainty.page.tables import Table, command
from dropout_uncertainty.runs import records as stored
from dropout_uncertainty.runs.records import Record
from dropout_uncertainty.stats import Interval, in_digits, in_words

__all__ = [
    "VERDICTS", "Board", "at_a_glance", "costs", "how_long", "run_times", "since_version_1", "tally", "verdicts",
]  # fmt: skip

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
#: Colours by verdict: for the thesis, against it, neither.
COLOURS = {
    **dict.fromkeys(("agrees", "supported", "confirmed"), "#0072b2"),
    **dict.fromkeys(("differs", "contradicted", "refuted"), "#d55e00"),
    "no difference": "#cc79a7",
}
GREY = "#888888"
Cells = tuple[list[str], list[list[Any]]]


# ------------------------------------------------------------------ verdicts


def tally(judged: Sequence[Judged]) -> Cells:
    """Return how many statements of each section and kind have which verdict, as heads and rows of a table."""
    rows = []
    for letters, title in [*SECTIONS.items(), ("", "all")]:
        for words, (kinds, possible) in KINDS.items():
            counts: Counter[str] = Counter(
                j.verdict for j in judged if j.statement.id.startswith(letters) and j.statement.kind in kinds
            )
            if counts:
                said = ", ".join(f"{counts[verdict]} {verdict}" for verdict in possible if counts[verdict])
                rows.append([title, words, counts.total(), said])
    return ["section", "kind", "statements", "verdicts"], rows


def measured(judged: Judged) -> str | None:
    """Return our value in words with its unit; None where nothing was measured."""
    if judged.measured is None:
        return None
    if judged.statement.kind == "audit" and not judged.measured.ours.n:
        return "evidence in the repository"
    return f"{in_words(judged.measured.ours, '.3g')} {judged.statement.unit}".strip()


def with_beside(judged: Judged) -> str | None:
    """Return the same with what is shown beside it."""
    beside = "".join(f"; {words}: {in_words(interval, '.3g')}" for words, interval in beside_of(judged).items())
    return value + beside if (value := measured(judged)) is not None else None


def said(judged: Judged) -> str:
    """Return the verdict in words: that of a primary statement adjusted, and why where that needs saying."""
    both = judged.verdict if judged.plain == judged.verdict else f"{judged.verdict} (by itself {judged.plain})"
    return f"**{both}**" + (f"; {judged.why}" if judged.why else "")


def verdicts(judged: Iterable[Judged]) -> Table:
    """Return the statements at the end of a chapter, grouped under the places of the thesis that they come from."""
    rows: list[list[Any]] = []
    for place, group in groupby(judged, lambda j: j.statement.where):
        for first, j in enumerate(group):
            star = " (primary)" if j.statement.primary else ""
            rows.append([None if first else place, j.statement.id, j.statement.text + star, with_beside(j), said(j)])
    return Table(
        [["" if cell is None and not column else cell for column, cell in enumerate(row)] for row in rows],
        ["of the thesis", "", "statement", "ours [95 % interval]", "verdict"],
    )


def beside_of(judged: Judged) -> Mapping[str, Interval]:
    """Return what is shown beside the judged value."""
    return judged.measured.beside if judged.measured else {}


# ------------------------------------------------------------------ the board

DETAILS = "#{name} details {{ font-size: 0.85em; overflow-wrap: anywhere; }}\n"
HIDE = "#{name}:has(input[value='{verdict}']:checked) tbody tr:not([data-verdict='{verdict}']) {{ display: none; }}\n"
CHOICE = '<label><input type="radio" name="{name}" value="{verdict}"{checked}/> {verdict} ({count})</label>'
HEADS = [
    "", "statement", "thesis", "ours [95 % interval]", "margin", "repetitions", "by itself", "adjusted", "rests on",
]  # fmt: skip


class Board:
    """Statements as a table from which a reader picks one verdict; style sheets do it, no script."""

    def __init__(self, judged: Sequence[Judged]) -> None:
        self.judged = judged

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, str]:
        return {
            "text/html": self.html(),
            "text/plain": "\n".join(f"{j.statement.id}: {j.verdict}" for j in self.judged),
        }

    def html(self) -> str:
        """Return choices and table; one choice per verdict that occurs."""
        rows = "\n".join(map(_row, self.judged))
        name = "board-" + hashlib.sha256(rows.encode()).hexdigest()[:8]
        counts = Counter(j.verdict for j in self.judged)
        present = [verdict for verdict in VERDICTS if counts[verdict]]
        hide = "".join(HIDE.format(name=name, verdict=verdict) for verdict in present)
        choices = [CHOICE.format(name=name, verdict="all", checked=' checked=""', count=len(self.judged))]
        choices += [CHOICE.format(name=name, verdict=v, checked="", count=counts[v]) for v in present]
        heads = "".join(f"<th>{head}</th>" for head in HEADS)
        return (
            f'<div id="{name}"><style>{(CONTROLS + DETAILS).format(name=name)}{hide}</style>\n'
            f"<fieldset><legend>Show</legend>{''.join(choices)}</fieldset>\n"
            f'<table class="table"><thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>'
        )


def _row(judged: Judged) -> str:
    """Return a statement as a row of the board."""
    s, m = judged.statement, judged.measured
    mark = " (primary)" if s.primary else ""
    thesis = "" if s.thesis is None else in_digits(s.thesis, ".3g")
    margin = f"{s.margin:.2g} {s.unit}" if s.margin else ""
    why = f"<br/><small>{escape(judged.why)}</small>" if judged.why else ""
    cells = [
        f'<span id="{s.id}">{s.id}</span>', f"{escape(s.text)}{mark}<br/><small>{_where(s)}</small>", thesis,
        escape(measured(judged) or "–"), margin, str(m.difference.n) if m and m.difference.n else "–",
        judged.plain, f"<strong>{judged.verdict}</strong>{why}", _sources(judged),
    ]  # fmt: skip
    return f'<tr data-verdict="{judged.verdict}">' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _sources(judged: Judged) -> str:
    """Return the record files of a statement and the commands that make them, folded away."""
    found = judged.sources
    if not found:
        return "–"
    groups = [list(group) for _, group in groupby(found, lambda record: record.label.rsplit("/", 1)[0])]
    commands = "<br/>".join(f"<code>{escape(command(group))}</code>" for group in groups)
    files = ", ".join(escape(record.label) for record in found)
    return f"<details><summary>{len(found)} records</summary>{files}<br/>{commands}</details>"


def _where(statement: Statement) -> str:
    """Return the place in the thesis, with a link to the chapter of the book if there is one."""
    clone = folders.checkout()
    if clone is None or not (clone / "notebooks" / f"{statement.chapter}.ipynb").exists():
        return escape(statement.where)
    text = (clone / "notebooks" / f"{statement.chapter}.ipynb").read_text(encoding="utf-8")
    found = re.search(r"(Figure|Table) 5\.(\d+)", statement.where)
    label = f"{found[1][:3].lower()}-5-{found[2]}" if found else ""
    anchor = f"#{label}" if found and f'"{label}"' in text else ""
    return f'<a href="{statement.chapter}.ipynb{anchor}">{escape(statement.where)}</a>'


def at_a_glance(ax: Axes, judged: Sequence[Judged], reach: float = 5.0) -> Axes:
    """Draw all measured statements: interval by margin, what the thesis says at 0.

    A comparison is turned so that the claimed side is right; ends beyond ``reach`` margins are cut off.
    """
    shown = [(j, j.measured.difference) for j in judged if j.statement.margin and j.measured and j.plain != "untested"]
    ax.axvspan(-1, 1, color="#eeeeee")
    ax.axvline(0, color="black", linewidth=0.8)
    for place, (j, difference) in enumerate(shown):
        sign = -1 if j.statement.kind == "less" else 1
        value, *ends = np.clip([sign * x / j.statement.margin for x in difference[:3]], -reach, reach)
        colour = COLOURS.get(j.verdict, GREY)
        ax.plot(ends, [place, place], color=colour, linewidth=1.5)
        ax.plot(value, place, "D" if j.statement.primary else "o", color=colour, markersize=4)
    ax.set_yticks(range(len(shown)), [j.statement.id for j, _ in shown], fontsize=7)
    ax.set(ylim=(len(shown), -1), xlim=(-reach, reach), xlabel="difference from what is said, in margins")
    return ax


# ------------------------------------------------------------------ version 1


def since_version_1(judged: Sequence[Judged]) -> Cells:
    """Return each claim of ``records/verdicts-v1.csv``: its verdict then, those of its statements, and what changed."""
    rows = []
    for row in stored.table("verdicts-v1"):
        if not row["part"]:
            mine = [j for j in judged if re.fullmatch(rf"{row['id']}[a-z]?", j.statement.id)]
            now = Counter(j.verdict for j in mine)
            said_now = ", ".join(f"{now[verdict]} {verdict}" for verdict in VERDICTS if now[verdict])
            rows.append([row["id"], row["sentence"], row["verdict"], said_now, row["changed"]])
    return ["", "claim of version 1", "then", "its statements now", "what changed"], rows


# ------------------------------------------------------------------ what it took


def costs(found: Sequence[Record]) -> Cells:
    """Return what records took: one row per family of configs and kind of device, and one for all of an experiment."""
    heads = ["experiment", "configs", "repetitions", "core-minutes each", "core-hours", "GPU-minutes each", "on"]
    rows = []
    for experiment, same in groupby(found, lambda record: record.header["experiment"]):
        records = sorted(same, key=_kind)
        for (family, device), group in groupby(records, _kind):
            rows.append([experiment, family, *_cost(list(group), device)])
        rows.append([experiment, "**all**", *_cost(records, None)])
    return heads, rows


def _kind(record: Record) -> tuple[str, str]:
    """Return config and device of a record; of configs such as "ours/random" the family, "ours/…"."""
    family, *member = record.header["name"].split("/", 1)
    return family + "/…" * bool(member), record.header["device"]


def _cost(found: Sequence[Record], device: str | None) -> list[Any]:
    """Return the last cells of a row of ``costs``; without a device only sums."""
    seeds = sum(len(record.seeds) for record in found)
    cpu = sum(r.header["provenance"]["cpu_s"] for r in found if r.header["device"] == "cpu")
    gpu = sum(r.header["provenance"]["wall_s"] for r in found if r.header["device"] == "cuda")
    on = ", ".join(dict.fromkeys(record.header["provenance"]["processor"] for record in found))
    each = [f"{cpu / 60 / seeds:.1f}" if device == "cpu" else None, f"{cpu / 3600:.2f}"]
    return [seeds, *each, f"{gpu / 60 / seeds:.1f}" if device == "cuda" else None, on]


def run_times(times: Mapping[str, Mapping[str, Mapping[str, Any]]], names: Sequence[str]) -> Cells:
    """Return what the last run of each notebook in each profile took, from ``book.times()``."""
    heads = ["notebook", "profile", "seconds", "CPU seconds", "memory in MB", "machine", "date"]
    rows = []
    for name in names:
        for profile, of_profile in times.items():
            if name in of_profile:
                took = of_profile[name]
                numbers = [round(took[key]) for key in ("seconds", "cpu_seconds", "megabytes")]
                rows.append([name, profile, *numbers, f"{took['cores']} × {took['processor']}", took["date"][:10]])
    return heads, rows


#: The notebooks that show families of configs, where the names do not say it.
SHOWN = {
    **dict.fromkeys(("pools", "pools_sensitivity"), "5_2_when_draws_help"),
    **dict.fromkeys(("two_by_two", "deep_sea"), "5_3_is_it_exploration"),
    **dict.fromkeys(("doubt", "literal", "mchutchon", "shrinking", "gradients"), "5_4_what_doubt_is_worth"),
    **dict.fromkeys(("ddpg", "naf", "ddpg_search", "naf_search", "ends"), "5_4_without_a_model"),
    "hidden": "5_4_hidden_state",
}


def how_long(
    times: Mapping[str, Mapping[str, Mapping[str, Any]]], names: Sequence[str], found: Sequence[Record]
) -> Cells:
    """Return what a reader has to wait for each notebook, by profile, from ``book.times()`` and the stored records.

    The records of a notebook stand for profile ``full``: core-hours of all that are stored, and hours of a GPU. They
    are those of the families of configs in ``SHOWN``, else those whose family or experiment has its name.
    """
    heads = ["notebook", "`recorded`", "`quick`", "`full`: CPU", "`full`: GPU"]
    plain = {name.lstrip("0123456789_"): name for name in names}
    of: dict[str | None, list[Record]] = {}
    for record in found:
        family = record.header["name"].split("/")[0].replace("-", "_")
        shown = SHOWN.get(family, plain.get(family, plain.get(record.header["experiment"])))
        of.setdefault(shown, []).append(record)
    rows = []
    for name in names:
        own = of.get(name, [])
        cpu, gpu = ([r for r in own if r.header["device"] == device] for device in ("cpu", "cuda"))
        full = [f"{_hours(cpu, 'cpu_s'):.1f} core-hours" if cpu else None, "not measured" if own else None]
        if gpu:
            full[1] = f"{_hours(gpu, 'wall_s'):.1f} h"
        live = [_wait(times.get(profile, {}).get(name)) for profile in ("recorded", "quick")]
        rows.append([f"[{name}]({name}.ipynb)", *live, *full])
    return heads, rows


def _hours(found: Sequence[Record], clock: str) -> float:
    return sum(record.header["provenance"][clock] for record in found) / 3600


def _wait(took: Mapping[str, Any] | None) -> str:
    if took is None:
        return "not run here"
    return f"{took['seconds']:.0f} s" if took["seconds"] < 100 else f"{took['seconds'] / 60:.0f} min"
