"""From residuals to alarms and named faults."""

from residua.decide.directional import Directional, DirectionTest, correlation, projection_distance
from residua.decide.norm_threshold import NormTest, NormThreshold
from residua.decide.whitening import whitening_matrix

__all__ = [
    "DirectionTest",
    "Directional",
    "NormTest",
    "NormThreshold",
    "correlation",
    "projection_distance",
    "whitening_matrix",
]
