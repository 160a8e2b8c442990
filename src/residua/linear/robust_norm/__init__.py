"""Bounds of the peak norm and of the gain over all members of an uncertain system."""

from residua.linear.robust_norm.robust_peak_norm import RobustPeakNorm, robust_peak_norm
from residua.linear.robust_norm.smallest_gain import SmallestGain, smallest_gain

__all__ = ["RobustPeakNorm", "SmallestGain", "robust_peak_norm", "smallest_gain"]
