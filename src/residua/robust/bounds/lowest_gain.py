"""The member of an uncertain system, and the frequency, with the smallest gain that a search reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.robust.bounds.member_response import MemberResponse
from residua.robust.sets.uncertain_system import REMEDY, check_modes, corner_points

Points = NDArray[np.float64]
_FREQUENCIES = 9
#: Corners whose poles are computed.
_CHECKED = 128
_STEPS = 12
#: Numbers held at a time.
_CHUNK = 2_000_000


@dataclass(frozen=True, eq=False)
class LowestGain:
    """A gain that some member has at some frequency.

    Attributes
    ----------
    gain : float
    point : ndarray, shape (parameters + 1,)
        The last is the frequency, in rad/s or rad/sample.
    rounding : float
        What rounding of the sizes that cancel may have left of a gain of zero.
    """

    gain: float
    point: Points
    rounding: float


def lowest_gain(response: MemberResponse, low: Points, high: Points, *, samples: int, seed: int) -> LowestGain:
    """Visit points inside, all corners of the parameters or many, then descend.

    Raises
    ------
    DesignError
        If a member is not stable: of those inside, and of some corners.
    """
    rng = np.random.default_rng(seed)
    inside = np.vstack([(low + high) / 2, rng.uniform(low, high, (samples, len(low)))])
    corner = corner_points(low[:-1], high[:-1], samples, rng)
    corner = np.hstack([corner, np.full((len(corner), 1), low[-1])])
    some = corner[rng.permutation(len(corner))[:_CHECKED]]
    check_stable(response, np.vstack([inside, some])[:, :-1])
    first, gain = _lowest(response, _at_frequencies(inside, low[-1], high[-1]))
    corner[:, -1] = first[-1]
    second, other = _lowest(response, corner)
    lowest = min(
        descended(response, low, high, first, gain),
        descended(response, low, high, second, other),
        key=lambda one: one.gain,
    )
    check_stable(response, lowest.point[None, :-1])
    return lowest


def descended(response: MemberResponse, low: Points, high: Points, point: Points, gain: float) -> LowestGain:
    """Descend from a point by Gauss-Newton steps within the box, halved until the gain falls."""
    from scipy.optimize import lsq_linear  # slow to import

    moving = np.flatnonzero(high > low)
    width = (high - low)[moving]
    T, slopes, rounding = response.slopes(point)
    for _ in range(_STEPS):
        J = np.vstack([np.real(slopes), np.imag(slopes)])[:, moving] * width
        size = float(np.abs(J).max(initial=0.0))
        if gain <= rounding or size == 0:
            break
        span = (low - point)[moving] / width, (high - point)[moving] / width
        target = -np.concatenate([np.real(T), np.imag(T)]) / size
        step = np.zeros(len(point))
        step[moving] = lsq_linear(J / size, target, span, method="bvls").x * width
        tries = np.clip(point + step * 0.5 ** np.arange(12)[:, None], low, high)
        gains = response.gains(tries)
        best = int(np.argmin(gains))
        if gains[best] >= gain * (1 - 1e-6):
            break
        point, gain = tries[best], float(gains[best])
        T, slopes, rounding = response.slopes(point)
    return LowestGain(gain, point, rounding)


def check_stable(response: MemberResponse, values: Points) -> None:
    """Raise unless members are stable; the message names the least stable."""
    A = response.members(values)[0]
    if not A.shape[1]:
        return
    consequence = f"its output does not settle, so that it has no gain: {REMEDY}"
    modes = np.linalg.eigvals(A + response.origin * np.eye(A.shape[1]))
    check_modes(modes, values, response.parameters, response.dt, consequence)


def _at_frequencies(points: Points, first: float, last: float) -> Points:
    """Return points, and the same at frequencies of a grid."""
    if first == last:
        return points
    grid = np.linspace(first, last, _FREQUENCIES)
    moved = np.repeat(points, len(grid), axis=0)
    moved[:, -1] = np.tile(grid, len(points))
    return np.vstack([points, moved])


def _lowest(response: MemberResponse, points: Points) -> tuple[Points, float]:
    step = max(1, _CHUNK // max(len(response.A) ** 2, 1))
    gains = np.concatenate([response.gains(points[i : i + step]) for i in range(0, len(points), step)])
    best = int(np.argmin(gains))
    return points[best].copy(), float(gains[best])
