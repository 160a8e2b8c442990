"""The middle of an uncertain set in units that suit it: of states, of what the parameters see, and of the outputs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.errors import DesignError, ModelError
from residua.linear.norms.impulse_terms import StableSystem, stable_system
from residua.linear.norms.star_norm import ellipsoid_shape, star_ellipsoid
from residua.linear.systems.state_space import StateSpace
from residua.robust.sets.uncertain_system import UncertainSystem

Matrix = NDArray[np.float64]
#: Inputs reach a state by way of so many parameters, one after the other.
_WIDENINGS = 3


@dataclass(frozen=True, eq=False)
class ReachedMiddle:
    """The middle of the set, and what inputs of unit size reach of it, by way of parameters as well.

    Attributes
    ----------
    middle : StableSystem
        In balanced units of its states.
    Q : ndarray, shape (n, n)
        An ellipsoid about what is reached, in these.
    reach : ndarray, shape (channels,)
        How large ``q`` gets, about; 0 if nothing drives it.
    unit : float
        How large the output gets, about; 1 if nothing reaches it.
    rate : float
        Of the smallest ellipsoid, for the outputs, about what is reached.
    """

    middle: StableSystem
    Q: Matrix
    reach: NDArray[np.float64]
    unit: float
    rate: float


def reached_middle(system: UncertainSystem) -> ReachedMiddle:
    """Return units for an uncertain system.

    Where the middle of the set is not driven or not seen, other members may be: units come from all that inputs reach
    by way of parameters, else they would be units of rounding.
    """
    s = _middle(system)
    half = (system.high - system.low)[list(system.channels)] / 2
    B, C, direct = half * system.Bp / s.units[:, None], system.Cq * s.units, half * system.Dzp
    # not the rate that is best for the outputs: what these do not see would grow without end
    rate = 0.5 * (1 - s.radius**2)
    Q, reach, wider = np.zeros_like(s.A), np.zeros(len(half)), s
    for _ in range(_WIDENINGS + 1):
        shape = ellipsoid_shape(s.A, wider.B, rate)
        if shape is None or not np.isfinite(shape).all():
            break
        Q = shape
        reach = np.sqrt(np.maximum(np.sum((C @ Q) * C, axis=1), 0.0))
        wider = replace(s, B=np.hstack([s.B, B * reach]), D=np.hstack([s.D, direct * reach]))
    star = star_ellipsoid(wider)
    return ReachedMiddle(s, Q, reach, float(star.bound) or 1.0, star.rate)


def _middle(system: UncertainSystem) -> StableSystem:
    """Return the middle of the set, in units of its states that suit the channels of the parameters as well."""
    middle = system.member((system.low + system.high) / 2)
    both = StateSpace(middle.A, np.hstack([middle.B, system.Bp]), np.vstack([middle.C, system.Cq]), dt=system.dt)
    try:
        s = stable_system(both)
    except ModelError as error:
        raise DesignError(f"the middle of the set has no peak norm: {error}") from error
    return replace(s, B=s.B[:, : middle.n_inputs], C=s.C[: middle.n_outputs], D=middle.D)
