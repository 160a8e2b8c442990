"""Results of functions of matrices, kept for the next call with the same entries.

A design asks for the units and the poles of the same few systems many times: for the filter as a whole, for each of its
members, for every check of the result. The functions are pure, so that a kept result is the result.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from functools import wraps
from hashlib import blake2b
from threading import Lock
from typing import Any, Generic, TypeVar
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from residua.words import unit_of_rates

R = TypeVar("R")
#: Numbers and words whose value says all, once their type is known.
_PLAIN = (type(None), bool, int, str, bytes)

#: Results of each function that are kept, ...
_KEPT = 512
#: ... and the bytes that those of one function take together.
_MOST_BYTES = 2**24
#: Matrices of more bytes together are known by a digest of their entries.
_LARGE = 1024


_all: WeakSet[Latest[Any]] = WeakSet()


def forget() -> None:
    """Let go of all results that any function keeps: what is asked for next is computed."""
    for latest in list(_all):
        latest.forget()


class Latest(Generic[R]):
    """The latest results of one function, by what they were computed from. Threads may share it.

    Parameters
    ----------
    kept : int
        The most results that are kept.
    times : int
        Of how many times the bytes that the results of other functions may take.
    """

    def __init__(self, kept: int = _KEPT, times: int = 1) -> None:
        self._results: OrderedDict[Hashable, tuple[R, int]] = OrderedDict()
        self._kept, self._bytes, self._times = kept, 0, times
        _all.add(self)
        self._lock = Lock()

    def forget(self) -> None:
        """Let go of all results."""
        with self._lock:
            self._results.clear()
            self._bytes = 0

    def of(self, key: Hashable, compute: Callable[[], R]) -> R:
        """Return the result kept under a key, or compute it; an error is not kept, nor is what is too large."""
        with self._lock:
            if key in self._results:
                self._results.move_to_end(key)
                return self._results[key][0]
        result = read_only(compute())
        size = _bytes(result)
        most = self._times * _MOST_BYTES
        with self._lock:
            if size <= most and key not in self._results:
                self._results[key] = (result, size)
                self._bytes += size
                while len(self._results) > self._kept or self._bytes > most:
                    self._bytes -= self._results.popitem(last=False)[1][1]
        return result


def entries(*matrices: NDArray | None) -> Hashable:
    """Return what tells matrices from all others: shapes and entries to the last bit, of large ones a digest of these.

    The digest is a cryptographic one of 32 bytes: no two systems of one design will ever share it.
    """
    # lists, which are made faster than what generators yield is collected
    shapes = tuple([None if M is None else M.shape for M in matrices])
    present = [M for M in matrices if M is not None]
    if sum([M.nbytes for M in present]) <= _LARGE:
        return shapes, tuple([M.tobytes() for M in present])
    digest = blake2b(digest_size=32)
    for M in map(np.ascontiguousarray, present):
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


class UnkeyedError(TypeError):
    """A value is not made of arrays, numbers and words alone: nothing tells it from all others."""


def contents(value: object) -> Hashable:
    """Return what tells a value from all others: arrays, numbers, words, and tuples, lists and dataclasses of these.

    Of every part the type and every bit count, of large arrays a digest of these, as for :func:`entries`.
    """
    kind = type(value)
    if kind in _PLAIN:
        return kind, value
    if isinstance(value, np.ndarray):
        if kind is not np.ndarray or value.dtype.hasobject:
            raise UnkeyedError
        return value.dtype.str, entries(value)
    if isinstance(value, (float, np.generic)):
        return kind, np.asarray(value).tobytes()
    if isinstance(value, (tuple, list)):
        return kind, tuple([contents(part) for part in value])
    if isinstance(value, dict):
        return kind, tuple([(contents(name), contents(part)) for name, part in value.items()])
    if names := getattr(value, "__dataclass_fields__", None):
        return kind, tuple([contents(getattr(value, name)) for name in names])
    raise UnkeyedError


def cached_by_contents(function: Callable[..., R]) -> Callable[..., R]:
    """Return a pure function that keeps its latest results by what its arguments hold; arrays of results are read-only.

    And by the unit that rates are worked on in, which is in the texts of results. Arguments that :func:`contents` does
    not know, such as a user's own classes, are computed every time. Threads may share it. An error is not kept.
    """
    latest: Latest[R] = Latest()

    @wraps(function)
    def cached(*values: Any, **options: Any) -> R:
        try:
            key = unit_of_rates(), contents((values, tuple(options.items())))
        except UnkeyedError:
            return function(*values, **options)
        # copies of arrays: results may be views of the arguments, which the caller may write to
        own = [read_only(value.copy()) if isinstance(value, np.ndarray) else value for value in values]
        return latest.of(key, lambda: function(*own, **options))

    return cached


def read_only(result: R) -> R:
    """Return a result whose arrays, its own or those of its parts, refuse to be written to."""
    for part in _arrays(result):
        part.flags.writeable = False
    return result


def _arrays(result: object) -> Iterator[NDArray]:
    """Return the arrays of a result: itself, or those in it and in its parts."""
    if isinstance(result, np.ndarray):
        yield result
        return
    parts = result if isinstance(result, (tuple, list)) else getattr(result, "__dict__", result)
    for part in parts.values() if isinstance(parts, dict) else parts if isinstance(parts, (tuple, list)) else ():
        if isinstance(part, (np.ndarray, tuple, list, dict)) or hasattr(part, "__dataclass_fields__"):
            yield from _arrays(part)


def _bytes(result: object) -> int:
    """Return the bytes of the arrays of a result and of its parts, each counted once."""
    return sum(M.nbytes for M in {id(M): M for M in _arrays(result)}.values())
