"""Whole diagnoses on data that the package makes itself."""

from residua.demos.outcome import Outcome

__all__ = ["Outcome"]
