"""Minimising many functions at once."""
