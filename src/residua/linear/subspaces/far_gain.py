"""Gains that only what rounding left of nothing can ask for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear.poles.spectrum import describe_modes

#: A gain beyond this, where a pair is in even units, places a pole through a coupling below a thousand millionth.
_FAR = 1e9


def refuse_far_gain(A: NDArray, C: NDArray, K: NDArray, rate: float) -> None:
    r"""Raise where the gain of a pair in even units is beyond ``1e9 |A| / |C|``: rounding would be a coupling there.

    Poles that are asked for far beyond those of ``A`` take large gains honestly: the limit grows by
    :math:`(rate / |A|)^n` with the largest of them, ``rate``.
    """
    if not K.size or not np.any(C):
        return
    size = float(np.linalg.norm(A, 2)) or rate or 1.0
    gain = float(np.linalg.norm(K, 2) * np.linalg.norm(C, 2)) / size
    if gain <= _FAR * max(1.0, rate / size) ** min(len(A), 20):
        return
    modes = np.linalg.eigvals(A)
    scaled = C * (size / float(np.linalg.norm(C, 2)))
    seen = [np.linalg.svd(np.vstack([A - z * np.eye(len(A)), scaled]), compute_uv=False)[-1] / size for z in modes]
    weakest = int(np.argmin(seen))
    raise AccuracyError(
        f"the mode {describe_modes(modes[[weakest]])} is seen too weakly: the rank test of (A - zI, C) has "
        f"{seen[weakest]:.1g} |A| left, and to move it takes a gain of {gain:.2g} |A| / |C| in even units, more than "
        f"{_FAR:.0e}; what is so faint may be rounding: add a sensor that sees it, or ask for poles nearer to those of "
        "the plant"
    )
