"""Coding sets: their quality, their attainability for a plant, and the choice of a good one."""

from residua.analysis.attainability import Attainability, MutualIsolability, attainable, mutually_isolable
from residua.analysis.coding_choice import choose
from residua.analysis.coding_sets import CodingSet, isolation_quality

__all__ = [
    "Attainability",
    "CodingSet",
    "MutualIsolability",
    "attainable",
    "choose",
    "isolation_quality",
    "mutually_isolable",
]
