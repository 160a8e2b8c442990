"""The threshold below which the alarm would be on: the alarm logic for every threshold at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def alarm_levels(statistic: NDArray[np.float64], persistence: int, release: int) -> NDArray[np.float64]:
    r"""Return for every sample the level :math:`a_t` with: the alarm is on if and only if the threshold is below it.

    With :math:`m_t` the smallest of the last ``persistence`` values of the statistic, and :math:`M_t` the largest of
    the last ``release``, an alarm of threshold :math:`h` is raised where :math:`m_t > h` and ends where :math:`M_t \le
    h`. So

    .. math:: a_t = \min(\max(a_{t-1}, m_t), M_t)

    and the fraction of samples in alarm is, for all thresholds at once, the fraction of levels above it. Before
    ``persistence`` samples the level is minus infinity.

    Parameters
    ----------
    statistic : ndarray, shape (time,)
        Of usable samples only: others change nothing, see :func:`residua.decide.persistence.alarm_logic`.
    persistence, release : int
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # slow to import, and needed only here

    time = len(statistic)
    if not time:
        return np.zeros(0)
    low = minimum_filter1d(statistic, persistence, origin=(persistence - 1) // 2, mode="nearest")
    high = maximum_filter1d(statistic, release, origin=(release - 1) // 2, mode="nearest")
    low[: persistence - 1] = -np.inf
    if release > 1:  # fewer samples than that end no alarm
        high[: release - 1] = np.inf
    # limits of the composition of the last 1, 2, 4, ... samples: a map that clamps, after one that clamps, clamps
    reach = 1
    while reach < time:
        later_low, later_high = low[reach:], high[reach:]
        low_now = np.minimum(np.maximum(low[:-reach], later_low), later_high)
        high_now = np.minimum(np.maximum(high[:-reach], later_low), later_high)
        low[reach:], high[reach:] = low_now, high_now
        reach *= 2
    return low


__all__ = ["alarm_levels"]
