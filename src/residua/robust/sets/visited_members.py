"""Members of an uncertain system that are visited: corners of its parameters, and the error for unstable ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from residua.errors import DesignError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.robust.sets.uncertain_system import MOST_CORNERS

Points = NDArray[np.float64]
#: What to do about a member that is not stable, of a loop with an estimator.
REMEDY = "narrow the set, or change the controller or estimator"


def corner_points(low: Points, high: Points, samples: int, rng: np.random.Generator) -> Points:
    """Return all corners of the parameters, or, of more than 12 that vary, as many as ``samples`` at random, or 256."""
    moving = np.flatnonzero(high > low)
    k = len(moving)
    every = k <= MOST_CORNERS
    bits = (np.arange(2**k)[:, None] >> np.arange(k)) & 1 if every else rng.integers(0, 2, (max(samples, 256), k))
    points = np.repeat(low[None], len(bits), axis=0)
    points[:, moving] = np.where(bits.astype(bool), high[moving], low[moving])
    return points


def check_modes(modes: NDArray, values: Points, parameters: Sequence[str], dt: float, consequence: str) -> None:
    """Raise unless members are stable; the message names the least stable, and says what follows.

    Parameters
    ----------
    modes : ndarray, shape (members, n)
    values : ndarray, shape (members, parameters)
    parameters : sequence of str
    dt : float
    consequence : str
        What follows from it, and what to do.
    """
    modes = np.asarray(modes, dtype=complex)
    if not modes.size or is_stable_mode(modes.ravel(), dt).all():
        return
    size = np.abs(modes) if dt else np.real(modes)
    i, j = np.unravel_index(int(np.argmax(size)), size.shape)
    named = ", ".join(f"{name} = {v:g}" for name, v in zip(parameters, values[i], strict=True))
    raise DesignError(
        f"a member of the set is not stable: pole {describe_modes(modes[i, [j]])}{f' at {named}' if named else ''}; "
        f"{consequence}"
    )
