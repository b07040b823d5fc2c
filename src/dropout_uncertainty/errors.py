"""The base of all errors that a user can mend."""

__all__ = ["UserError"]


class UserError(RuntimeError):
    """Something the reader can put right; the message is one sentence: what was expected, what came, what to do."""
