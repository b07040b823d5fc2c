"""The base of all errors that a user can mend."""


class UserError(RuntimeError):
    """Something the reader can put right; the message is one sentence: what was expected, what came, what to do."""

    def _render_traceback_(self) -> list[str]:
        """Return what a notebook shows in place of a traceback."""
        return [f"{type(self).__name__}: {self}"]
