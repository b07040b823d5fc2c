"""The profiles in which notebooks run."""

from dropout_uncertainty.errors import UserError

__all__ = ["PROFILES", "check"]

PROFILES = ("recorded", "quick", "full")


def check(profile: str) -> None:
    """Raise UserError if ``profile`` is none of ``PROFILES``."""
    if profile not in PROFILES:
        raise UserError(f"unknown profile {profile!r}, choose one of {', '.join(PROFILES)}")
