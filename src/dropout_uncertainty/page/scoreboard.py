"""What the scoreboard shows: verdicts with one sentence each, what stands behind them, what records and pages took."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, get_args

from dropout_uncertainty import folders
from dropout_uncertainty.judging.collect import SECTIONS
from dropout_uncertainty.judging.results import MIN_REPETITIONS, Claim, Judgement, Verdict
from dropout_uncertainty.page.tables import command
from dropout_uncertainty.runs.records import Record

__all__ = ["VERDICTS", "behind", "costs", "how_long", "run_times", "sentence", "tally", "verdicts"]

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)

Cells = tuple[list[str], list[list[Any]]]


def tally(judged: Sequence[Judgement]) -> Cells:
    """Return how many claims of each section have which verdict, as heads and rows of a table."""
    rows = []
    for letters, title in [*SECTIONS.items(), ("", "all")]:
        counts = Counter(j.verdict for j in judged if j.claim.id.startswith(letters))
        rows.append([title, *(counts[verdict] for verdict in VERDICTS), counts.total()])
    return ["section", *VERDICTS, "claims"], rows


def verdicts(judged: Sequence[Judgement]) -> Cells:
    """Return one row per claim: id, text, where it stands, verdict and why."""
    heads = ["", "claim", "where", "verdict", "because"]
    return heads, [[j.claim.id, j.claim.text, _where(j.claim), f"**{j.verdict}**", sentence(j)] for j in judged]


def sentence(judgement: Judgement) -> str:
    """Return why a claim has its verdict: its parts if they are few, else how many of them came out how."""
    parts = judgement.parts
    if not any(part.interval.n for part in parts):
        return "No records yet."
    if len(parts) <= 2:
        return judgement.sentence
    counts = Counter(part.verdict for part in parts)
    text = f"{len(parts)} parts: " + ", ".join(f"{counts[v]} {v}" for v in VERDICTS if counts[v])
    missing = sum(part.interval.n == 0 for part in parts)
    few = sum(0 < part.interval.n < MIN_REPETITIONS for part in parts)
    reasons = [f"no records yet for {missing}"] * (missing > 0)
    reasons += [f"fewer than {MIN_REPETITIONS} repetitions for {few}"] * (few > 0)
    return text + (f" ({'; '.join(reasons)})." if reasons else ".")


def behind(judged: Sequence[Judgement]) -> str:
    """Return Markdown: for each claim its rule, all its parts, its record files and the commands that make them."""
    return "\n\n".join(map(_behind, judged))


def _behind(judgement: Judgement) -> str:
    claim, found = judgement.claim, judgement.records
    parts = "\n".join(f"- {part} (*{part.verdict}*)" for part in judgement.parts)
    text = f"**{claim.id}** is judged by: {claim.rule}.\n\n{parts}"
    if not found:
        return text
    files = ", ".join(f"[{record.label}](../records/{record.label})" for record in found)
    groups = [list(group) for _, group in groupby(found, lambda record: record.label.rsplit("/", 1)[0])]
    commands = "\n".join(f"$ {command(group)}" for group in groups)
    return f"{text}\n\nRecords: {files}\n\n```console\n{commands}\n```"


def _where(claim: Claim) -> str:
    """Return the place in the thesis, with links to figures and tables of the book, and the chapter."""
    clone = folders.checkout()
    notebook = (clone or Path()) / "notebooks" / f"{claim.chapter}.ipynb"
    if clone is None or not notebook.exists():
        return claim.where
    labels = set(re.findall(r"\b(?:fig|tab)-5-\d+\b", notebook.read_text(encoding="utf-8")))

    def link(match: re.Match) -> str:
        label = f"{match[1][:3].lower()}-5-{match[2]}"
        return f"[{match[0]}](#{label})" if label in labels else match[0]

    place = re.sub(r"(Figure|Table) 5\.(\d+)", link, claim.where)
    return f"{place} ([chapter]({claim.chapter}.ipynb))"


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


def how_long(
    times: Mapping[str, Mapping[str, Mapping[str, Any]]], names: Sequence[str], found: Sequence[Record]
) -> Cells:
    """Return what a reader has to wait for each notebook, by profile, from ``book.times()`` and the stored records.

    The records of a notebook stand for profile ``full``: core-hours of all that are stored, and hours of a GPU. They
    are those whose experiment, or family of configs, has the name of the notebook after its numbers.
    """
    heads = ["notebook", "`recorded`", "`quick`", "`full`: CPU", "`full`: GPU"]
    plain = {name.lstrip("0123456789_"): name for name in names}
    of: dict[str | None, list[Record]] = {}
    for record in found:
        family = record.header["name"].split("/")[0].replace("-", "_")
        of.setdefault(plain.get(family, plain.get(record.header["experiment"])), []).append(record)
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
