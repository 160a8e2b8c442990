"""Results of functions of small matrices, kept for the next call with the same entries.

A design asks for the units and the poles of the same few systems many times: for the filter as a whole, for each of its
members, for every check of the result. The functions are pure, so that a kept result is the result.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

R = TypeVar("R")

#: Results of each function that are kept.
_KEPT = 512
#: Matrices of more bytes together are not kept: their results are asked for more rarely than they take room.
MOST_BYTES = 16384


def cached_by_entries(function: Callable[..., R]) -> Callable[..., R]:
    """Return a pure function of matrices that keeps its latest results; the arrays of these are read-only.

    Threads may share it. An error is not kept.
    """

    @lru_cache(maxsize=_KEPT)
    def kept(*entries: tuple[tuple[int, ...], bytes]) -> R:
        return read_only(function(*(np.frombuffer(data).reshape(shape) for shape, data in entries)))

    @wraps(function)
    def cached(*matrices: NDArray) -> R:
        arrays = [np.asarray(M, dtype=float) for M in matrices]
        if sum(M.nbytes for M in arrays) > MOST_BYTES:
            return read_only(function(*arrays))
        return kept(*((M.shape, M.tobytes()) for M in arrays))

    return cached


def read_only(result: R) -> R:
    """Return a result whose arrays, its own or those of its fields, refuse to be written to."""
    parts = result if isinstance(result, tuple) else getattr(result, "__dict__", {}).values()
    for part in (result, *parts):
        if isinstance(part, np.ndarray):
            part.flags.writeable = False
    return result
