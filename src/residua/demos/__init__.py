"""Whole diagnoses on data that the package makes itself."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.demos.outcome import Outcome

__all__ = ["Outcome"]

hand_on(
    __name__,
    {
        "residua.demos.outcome": ("Outcome",),
    },
)
