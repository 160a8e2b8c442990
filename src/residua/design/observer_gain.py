"""What every observer asks of pole placement: the poles given, or all beyond a margin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.directional_gain import checked_options
from residua.errors import DesignError
from residua.linear.placement import Placement, default_margin, place_observer_margin, place_observer_poles


def place(
    A: NDArray,
    C: NDArray,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    dt: float,
    rtol: float,
) -> Placement:
    """Place the poles that were asked for, or all of them beyond a margin."""
    poles, margin = checked_options(poles, margin)
    if isinstance(poles, Mapping):
        raise DesignError("an observer takes a list of poles; poles per fault are for the detection filters")
    if poles is None:
        return place_observer_margin(A, C, default_margin(A, dt) if margin is None else margin, dt=dt, rtol=rtol)
    return place_observer_poles(A, C, poles, dt=dt, rtol=rtol)


def pole_evidence(placed: Placement, F: NDArray) -> dict[str, Any]:
    """Return the poles of an observer with state matrix ``F`` as fields of its evidence."""
    return {
        "poles": np.linalg.eigvals(F).astype(complex),
        "requested_poles": np.asarray(placed.requested, dtype=complex),
        "fixed_poles": np.asarray(placed.fixed, dtype=complex),
    }
