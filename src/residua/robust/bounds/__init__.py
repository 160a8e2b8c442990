"""Bounds of the peak norm and of the gain over all members of an uncertain system."""

from residua.robust.bounds.robust_peak_norm import RobustPeakNorm, robust_peak_norm
from residua.robust.bounds.smallest_gain import SmallestGain, smallest_gain

__all__ = ["RobustPeakNorm", "SmallestGain", "robust_peak_norm", "smallest_gain"]
