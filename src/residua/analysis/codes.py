"""Codes of faults, which residuals each of them fires: which are equal, and whether one is part of another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def equal_codes(codes: NDArray[np.bool_]) -> list[list[int]]:
    """Return the columns of a structure in groups of equal ones; those without any entry are left out."""
    found: dict[bytes, list[int]] = {}
    for j, code in enumerate(codes.T):
        if code.any():
            found.setdefault(code.tobytes(), []).append(j)
    return list(found.values())


def strongly_isolating(codes: NDArray[np.bool_]) -> bool:
    """Tell whether no code becomes another one when some of its residuals stay silent: columns form an antichain.

    References
    ----------
    Gertler (1991), section 4.
    """
    different = codes[:, [group[0] for group in equal_codes(codes)]]
    within = (different[:, :, None] <= different[:, None, :]).all(axis=0)
    return int(within.sum()) == different.shape[1]  # each within itself alone
