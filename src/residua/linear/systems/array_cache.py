"""Results of functions of matrices, kept for the next call with the same entries.

A design asks for the units and the poles of the same few systems many times: for the filter as a whole, for each of its
members, for every check of the result. The functions are pure, so that a kept result is the result.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import wraps
from hashlib import blake2b
from threading import Lock
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

R = TypeVar("R")

#: Results of each function that are kept, ...
_KEPT = 512
#: ... and the bytes that those of large matrices take together.
_MOST_BYTES = 2**26
#: Matrices of more bytes together are known by a digest of their entries.
_LARGE = 16384


class Latest(Generic[R]):
    """The latest results of one function, by what they were computed from. Threads may share it.

    Parameters
    ----------
    kept : int
        The most results that are kept.
    """

    def __init__(self, kept: int = _KEPT) -> None:
        self._results: OrderedDict[Hashable, tuple[R, int]] = OrderedDict()
        self._kept, self._bytes = kept, 0
        self._lock = Lock()

    def of(self, key: Hashable, compute: Callable[[], R]) -> R:
        """Return the result kept under a key, or compute it; an error is not kept, nor is what is too large."""
        with self._lock:
            if key in self._results:
                self._results.move_to_end(key)
                return self._results[key][0]
        result = read_only(compute())
        size = _bytes(result)
        with self._lock:
            if size <= _MOST_BYTES and key not in self._results:
                self._results[key] = (result, size)
                self._bytes += size
                while len(self._results) > self._kept or self._bytes > _MOST_BYTES:
                    self._bytes -= self._results.popitem(last=False)[1][1]
        return result


def entries(*matrices: NDArray | None) -> Hashable:
    """Return what tells matrices from all others: shapes and entries to the last bit, of large ones a digest of these.

    The digest is a cryptographic one of 32 bytes: no two systems of one design will ever share it.
    """
    shapes = tuple(None if M is None else M.shape for M in matrices)
    present = [np.ascontiguousarray(M) for M in matrices if M is not None]
    if sum(M.nbytes for M in present) <= _LARGE:
        return shapes, tuple(M.tobytes() for M in present)
    digest = blake2b(digest_size=32)
    for M in present:
        digest.update(M.data if M.size else b"")
    return shapes, digest.digest()


def cached_by_entries(function: Callable[..., R]) -> Callable[..., R]:
    """Return a pure function of matrices that keeps its latest results; the arrays of these are read-only.

    Threads may share it. An error is not kept.
    """
    latest: Latest[R] = Latest()

    @wraps(function)
    def cached(*matrices: NDArray) -> R:
        arrays = [np.asarray(M, dtype=float) for M in matrices]
        # a copy: results may be views of the arguments, which the caller may write to
        return latest.of(entries(*arrays), lambda: function(*(read_only(M.copy()) for M in arrays)))

    return cached


def read_only(result: R) -> R:
    """Return a result whose arrays, its own or those of its fields, refuse to be written to."""
    for part in _arrays(result):
        part.flags.writeable = False
    return result


def _arrays(result: object) -> list[NDArray]:
    """Return the arrays of a result: itself, or those in it."""
    parts = result if isinstance(result, tuple) else getattr(result, "__dict__", {}).values()
    return [part for part in (result, *parts) if isinstance(part, np.ndarray)]


def _bytes(result: object) -> int:
    """Return the bytes of the arrays of a result and of the systems in it."""
    parts = (result, *getattr(result, "__dict__", {}).values())
    return sum(M.nbytes for M in {id(M): M for part in parts for M in _arrays(part)}.values())
