"""Bounds of the peak norm over all members of an uncertain system."""

from residua.linear.robust_norm.robust_peak_norm import RobustPeakNorm, robust_peak_norm

__all__ = ["RobustPeakNorm", "robust_peak_norm"]
