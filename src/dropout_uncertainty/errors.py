"""The base of all errors that a user can mend."""

import difflib
from collections.abc import Iterable


class UserError(RuntimeError):
    """Something the reader can put right; the message is one sentence: what was expected, what came, what to do."""

    def _render_traceback_(self) -> list[str]:
        """Return what a notebook shows in place of a traceback."""
        return [f"{type(self).__name__}: {self}"]


def unknown(what: str, name: str, choices: Iterable[str]) -> str:
    """Return the sentence about a name that is none of the choices; it asks whether the nearest was meant."""
    choices = list(choices)
    near = difflib.get_close_matches(name, choices, 1)
    hint = f"; did you mean {near[0]}?" if near else ""
    return f"unknown {what} {name!r}, choose one of {', '.join(choices)}{hint}"
