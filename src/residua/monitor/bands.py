"""The band of each residual on its own, and what it means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.member_thresholds import BankTest
from residua.decide.norm_threshold import NormTest

#: Share of the fault-free samples of one residual that its band holds, if its noise is Gaussian; in deviations.
BAND_SHARE, BAND_DEVIATIONS = 0.999, 3.2905267314918945


def residual_bands(test: NormTest | BankTest) -> tuple[NDArray[np.float64], float]:
    """Return half the width of each residual's band, and the share of its fault-free samples that it holds.

    Where the covariance is known the band is that of the residual alone, whatever the threshold on all together is; of
    its average over the window where the test has one. Where it is not, the band ends where the residual alone would
    be over the threshold, and the share is 0.
    """
    W = test.whitening
    plain = bool(
        ((W == 0) | (W == 1)).all() and (np.count_nonzero(W, axis=0) == 1).all()
    )  # none: a choice of residuals
    if test.kind == "peak" or plain:
        return test.band, 0.0
    if isinstance(test, BankTest):
        return BAND_DEVIATIONS * replace(test, thresholds=np.ones(len(test.thresholds))).band, BAND_SHARE
    return BAND_DEVIATIONS * replace(test, threshold=1.0).band, BAND_SHARE
