"""Bounds of the peak norm and of the gain over all members of an uncertain system."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.robust.bounds.robust_peak_norm import RobustPeakNorm, robust_peak_norm
    from residua.robust.bounds.smallest_gain import SmallestGain, smallest_gain

__all__ = ["RobustPeakNorm", "SmallestGain", "robust_peak_norm", "smallest_gain"]

hand_on(
    __name__,
    {
        "residua.robust.bounds.robust_peak_norm": ("RobustPeakNorm", "robust_peak_norm"),
        "residua.robust.bounds.smallest_gain": ("SmallestGain", "smallest_gain"),
    },
)
