"""What can be detected and isolated, before any design."""

from residua.analysis.diagnosability import Diagnosability, diagnosability
from residua.analysis.unknown_input import UnknownInputExistence, unknown_input_observer_existence

__all__ = [
    "Diagnosability",
    "UnknownInputExistence",
    "diagnosability",
    "unknown_input_observer_existence",
]
