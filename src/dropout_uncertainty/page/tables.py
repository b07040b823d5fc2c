"""Tables and provenance lines that read well both in JupyterLab (HTML) and in the book (MyST Markdown)."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from markdown_it import MarkdownIt

from dropout_uncertainty.runs.records import Record

#: How the line begins that says which records a page rests on.
ORIGIN = "Where these numbers come from"


class Rendered:
    """Something a cell shows: ``markdown`` (MyST) goes into the book, ``html`` onto the screen of a notebook."""

    def __init__(self, markdown: str, html: str) -> None:
        self.markdown, self.html = markdown, html

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, str]:
        return {"text/markdown": self.markdown, "text/html": self.html, "text/plain": self.markdown}

    def _ipython_display_(self) -> None:
        """Show nothing where there is nothing to say; otherwise what ``_repr_mimebundle_`` returns is shown."""
        if self.markdown:
            raise NotImplementedError


class Table(Rendered):
    """A table of strings and numbers.

    Args:
        rows: one sequence of cells per row; a cell is shown as ``str`` writes it, None as a dash, settings by
            name. Markdown is allowed.
        columns: the heads.
        caption: one or two sentences which can be read alone.
        name: the label of a table of the thesis, such as "tab-5-1": the book numbers it and can refer to it. A table
            without a name gets no number.

    The first column is set left, columns of numbers right.

    Raises:
        ValueError: if a row has not as many cells as there are columns.
    """

    def __init__(
        self, rows: Iterable[Sequence[Any]], columns: Sequence[str], caption: str = "", name: str | None = None
    ) -> None:
        cells = [[_cell(value) for value in row] for row in rows]
        for row in cells:
            if len(row) != len(columns):
                raise ValueError(f"a table of {len(columns)} columns got a row of {len(row)} cells: {row}")
        grid = grid_of([list(map(_cell, columns)), *cells])
        if name is None:
            markdown = f"*{caption}*\n\n{grid}" if caption else grid
        else:
            markdown = f"```{{table}} {caption}\n:name: {name}\n\n{grid}\n```"
        heading = f"<p><em>{_inline(caption)}</em></p>\n" if caption else ""
        html = _markdown().render(grid).replace("<table>", '<table class="table">', 1)  # as the book's own tables
        super().__init__(markdown, heading + html)


class Words(Rendered):
    """A paragraph of Markdown, such as one with computed numbers."""

    def __init__(self, text: str) -> None:
        super().__init__(text, _markdown().render(text))


class Folded(Rendered):
    """Something that shows its title only until it is clicked at.

    Args:
        title: one line of plain text.
        body: Markdown, or what has ``markdown`` and ``html``.
    """

    def __init__(self, title: str, body: Rendered | str) -> None:
        if isinstance(body, str):
            body = Words(body)
        super().__init__(
            f"````{{dropdown}} {title}\n{body.markdown}\n````",
            f"<details><summary>{escape(title)}</summary>\n{body.html}</details>",
        )


def provenance(records: Sequence[Record], profile: str = "recorded", without: str | None = None) -> Rendered:
    """Return the line that says where numbers come from, with the details folded away.

    The line names profile, seeds, date, processor, commit and computing time of the records; below it stand, for each
    named config, the command that makes its records, their files and the config itself. A page that may have no records
    says ``without`` which words stand then.

    Raises:
        ValueError: if there is no record, and no words for that.
    """
    if not records:
        if without is not None:
            return Words(without)
        raise ValueError("provenance needs at least one record")
    names = dict.fromkeys((record.header["experiment"], record.header["name"]) for record in records)
    groups = [[r for r in records if (r.header["experiment"], r.header["name"]) == name] for name in names]
    title = f"{ORIGIN}: profile {profile}; {_origin(records)}"
    return Folded(title, "\n\n".join(map(_details, groups)))


def command(records: Sequence[Record]) -> str:
    """Return the command that makes records of one named config."""
    header = records[0].header
    seeds = _ranges(sorted({seed for record in records for seed in record.seeds}))
    return f"dropout-uncertainty run {header['experiment']} --config {header['name']} --seeds {seeds}"


def _origin(records: Sequence[Record]) -> str:
    """Return seeds, dates, processors, commits and computing time of records in one line."""
    origins = [record.header["provenance"] for record in records]
    seeds = sorted({seed for record in records for seed in record.header["seeds"]})
    dates = sorted(origin["date"][:10] for origin in origins)
    commits = dict.fromkeys(commit for origin in origins for commit in _commits(origin))
    hours = sum(origin["wall_s"] for origin in origins) / 3600
    parts = [
        f"{'seed' if len(seeds) == 1 else 'seeds'} {_ranges(seeds)}",
        dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}",
        " and ".join(dict.fromkeys(origin["processor"] for origin in origins)),
        f"commit {', '.join(commits)}",
        f"{hours:.1f} h of computing" if hours >= 1 else f"{60 * hours:.1f} min of computing",
    ]
    return "; ".join(parts)


def _details(records: Sequence[Record]) -> str:
    """Return command, files and config of the records of one named config as Markdown."""
    header = records[0].header
    files = ", ".join(f"`{record.label}`" for record in records)
    config = json.dumps(header["config"], indent=1, ensure_ascii=False)
    return (
        f"**{header['experiment']}/{header['name']}**: {_origin(records)}. Files: {files}.\n\n"
        f"```console\n$ {command(records)}\n```\n\n```json\n{config}\n```"
    )


def _commits(origin: dict[str, Any]) -> list[str]:
    """Return the commits of the sittings of a run, in order."""
    changed = {True: " with changes", False: "", None: ""}
    return [
        (sitting["commit"] or "unknown")[:8] + changed[sitting.get("dirty", origin["dirty"])]
        for sitting in origin.get("commits", [origin])
    ]


def _ranges(numbers: Sequence[int]) -> str:
    """Return sorted integers with runs shortened: 0-4,7."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def _cell(value: object) -> str:
    if isinstance(value, Mapping):
        value = ", ".join(f"{name} {item}" for name, item in value.items())
    elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        value = "; ".join(map(_cell, value))
    text = "–" if value is None else str(value)
    text = re.sub(r"\[([^][ ]+), ([^][ ]+)\]", "[\\1,\u00a0\\2]", text)  # an interval stays on one line
    return text.replace("|", "\\|").replace("\n", " ")


def grid_of(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of plain cells, the first of which is the head, as a Markdown table; numbers stand right."""
    numeric = [all(_is_number(row[i]) for row in rows[1:]) for i in range(len(rows[0]))]
    rule = ["---:" if right and i else ":---" for i, right in enumerate(numeric)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [rows[0], rule, *rows[1:]])


def _is_number(text: str) -> bool:
    return text[:1].isdigit() or text[:1] in "–−-+><±≥≤" or text in ("NA", "")


def _markdown() -> MarkdownIt:
    return MarkdownIt("commonmark", {"html": False}).enable("table")


def _inline(text: str) -> str:
    return _markdown().renderInline(text)
