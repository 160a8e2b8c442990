"""Detectability and isolability of faults, before any design."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.analysis.diagnosability import Diagnosability, diagnosability
    from residua.analysis.existence import UnknownInputExistence, unknown_input_observer_existence

__all__ = [
    "Diagnosability",
    "UnknownInputExistence",
    "diagnosability",
    "unknown_input_observer_existence",
]

hand_on(
    __name__,
    {
        "residua.analysis.diagnosability": ("Diagnosability", "diagnosability"),
        "residua.analysis.existence": ("UnknownInputExistence", "unknown_input_observer_existence"),
    },
)
