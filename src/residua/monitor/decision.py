"""The decision on one sample."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.monitor.diagnosis import Candidate


@dataclass(frozen=True, eq=False)
class Decision:
    """What a monitor decided on one sample.

    Attributes
    ----------
    residual : ndarray, shape (residuals,)
        NaN when a value was missing.
    statistic : float
        Norm of the whitened residual; NaN when nothing was decided.
    alarm : bool
    decided : bool
        False while the filter settles and where data are missing.
    missing : bool
    candidates : tuple of Candidate
        Best first while the alarm is on; empty otherwise.
    """

    residual: NDArray[np.float64]
    statistic: float
    alarm: bool
    decided: bool
    missing: bool
    candidates: tuple[Candidate, ...] = field(default=())
