"""Judging: what the thesis says beside what we measured, and the verdicts."""
