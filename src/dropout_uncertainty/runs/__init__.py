"""Runs: units of work, the process that computes one, its execution, its record, and recomputing it."""
