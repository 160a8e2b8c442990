"""Members of an uncertain system that are visited: corners of its parameters, and what is said of unstable ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from residua.errors import DesignError
from residua.linear.observability import is_stable_mode
from residua.linear.spectrum import describe_modes
from residua.linear.uncertain_system import MOST_CORNERS

Points = NDArray[np.float64]


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
    """Raise unless members are stable; the message names the first that is not, and says what follows.

    Parameters
    ----------
    modes : ndarray, shape (members, n)
    values : ndarray, shape (members, parameters)
    parameters : sequence of str
    dt : float
    consequence : str
        What follows from it.
    """
    stable = is_stable_mode(modes, dt)
    if np.all(stable):
        return
    i = int(np.argmin(stable.all(axis=1)))
    named = ", ".join(f"{name} = {v:g}" for name, v in zip(parameters, values[i], strict=True))
    raise DesignError(
        f"a member of the set is not stable: pole {describe_modes(modes[i][~stable[i]][:1])}"
        f"{f' at {named}' if named else ''}; {consequence}: narrow the set, or change the controller or estimator"
    )
