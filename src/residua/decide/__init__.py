"""From residuals to alarms and named faults."""

from residua.decide.consistency import ConsistentFault, Explanation, code_likelihoods, consistent_faults
from residua.decide.directional import Directional, DirectionTest, correlation, projection_distance
from residua.decide.matched import Matched, MatchedTest
from residua.decide.matched_hold import Match
from residua.decide.member_thresholds import BankTest
from residua.decide.norm_threshold import NormTest, NormThreshold
from residua.decide.peak_threshold import PeakThreshold, peak_over_window
from residua.decide.residual_groups import GroupTest
from residua.decide.structured import CodeReading, CodeTest, Structured, read_code, read_codes
from residua.decide.whitening import whitening_matrix

__all__ = [
    "BankTest",
    "CodeReading",
    "CodeTest",
    "ConsistentFault",
    "DirectionTest",
    "Directional",
    "Explanation",
    "GroupTest",
    "Match",
    "Matched",
    "MatchedTest",
    "NormTest",
    "NormThreshold",
    "PeakThreshold",
    "Structured",
    "code_likelihoods",
    "consistent_faults",
    "correlation",
    "peak_over_window",
    "projection_distance",
    "read_code",
    "read_codes",
    "whitening_matrix",
]
