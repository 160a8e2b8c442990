"""The point at which a user's model rests: Newton's method in units that its own slopes give."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.identify.jacobian import Function, checked, first_look
from residua.linear.subspaces.rank import decide_rank
from residua.tolerances import ROUNDING, SAME, TINY
from residua.words import number, some

Vector = NDArray[np.float64]
_MOST_STEPS, _MOST_HALVINGS = 100, 40
#: Singular values this far below the largest are zero: slopes of a first look are known to some 2^-30.
_ROUGH_RANK = 2.0**-23


@dataclass(frozen=True, eq=False)
class SteadyState:
    """A point at which equations hold.

    Attributes
    ----------
    point : ndarray
    residual : float
        The largest equation's value, relative to its terms.
    steps : int
    """

    point: Vector
    residual: float
    steps: int


def steady_state(
    function: Function,
    start: Vector,
    free: NDArray[np.bool_],
    rows: tuple[str, ...],
    columns: tuple[str, ...],
    sizes: Mapping[str, float] | None = None,
) -> SteadyState:
    """Return a point where the function is zero, moving the free variables only.

    Newton's method with halved steps. Equations are measured by their terms (the sum over variables of slope times
    size), variables by their sizes, so that units have no say; where the equations leave a variable open, as an
    integrator does, the step is the shortest.

    Raises
    ------
    AccuracyError
        If no such point was reached from the start; the message says where it ended and what was left.
    """
    f = checked(function, rows)
    z = start.copy()
    look = first_look(f, z, columns, sizes)
    steps = 0
    while steps < _MOST_STEPS:
        scale = np.maximum(look.terms, TINY)
        left = look.value / scale
        size = np.where(free, look.sizes, 0.0)
        if np.abs(left).max(initial=0.0) <= ROUNDING:
            break
        slopes = look.slopes * size / scale[:, None]
        move = np.asarray(size * np.linalg.lstsq(slopes, -left, rcond=_ROUGH_RANK)[0], dtype=np.float64)
        better = _shorter_until_better(f, z, move, scale, float(np.linalg.norm(left)))
        if better is None:
            break
        z, steps = better, steps + 1
        look = first_look(f, z, columns, sizes)
    left = np.abs(look.value) / np.maximum(look.terms, TINY)
    residual = float(left.max(initial=0.0))
    if residual > SAME:
        slopes = look.slopes * np.where(free, look.sizes, 0.0) / np.maximum(look.terms, TINY)[:, None]
        raise AccuracyError(_nothing_reached(look.value, left, slopes, z, steps, rows, columns))
    return SteadyState(z, residual, steps)


def _shorter_until_better(
    f: Callable[[Vector], Vector], z: Vector, move: Vector, scale: Vector, before: float
) -> Vector | None:
    """Return the point after a step, halved until the equations hold better; None where no length does that."""
    for halvings in range(_MOST_HALVINGS):
        at = z + move * 2.0**-halvings
        after = float(np.linalg.norm(f(at) / scale))
        if np.isfinite(after) and after < before:
            return at
    return None


def _nothing_reached(
    value: Vector, left: Vector, slopes: NDArray, z: Vector, steps: int, rows: tuple[str, ...], columns: tuple[str, ...]
) -> str:
    worst = int(left.argmax())
    rank = decide_rank(slopes, rtol=_ROUGH_RANK).rank
    where = some(f"{name} = {number(x)}" for name, x in zip(columns, z, strict=True))
    why = ""
    if rank < len(rows):
        why = f"; there the {len(rows)} equations can be moved in {rank} directions only, so there may be none"
    return (
        f"no steady state was reached from this start: after {steps} steps of Newton's method {rows[worst]} is still "
        f"{number(value[worst])}, {number(left[worst], 2)} of its terms, at {where}{why}. Give a start that is nearer, "
        "or inputs for which the plant can rest"
    )
