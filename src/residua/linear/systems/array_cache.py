"""Results of functions of matrices, kept for the next call with the same entries.

A design asks for the units and the poles of the same few systems many times: for the filter as a whole, for each of its
members, for every check of the result. The functions are pure, so that a kept result is the result.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Iterator
from copy import copy
from dataclasses import dataclass
from functools import cache, cached_property, wraps
from hashlib import sha256
from itertools import count
from operator import is_
from struct import Struct
from sys import getsizeof
from typing import Any, Generic, TypeVar, cast
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from residua.errors import ResiduaError
from residua.forks import forkable_lock
from residua.progress import check_time

R = TypeVar("R")
#: Numbers and words whose value says all, once their type is known.
_PLAIN = frozenset((type(None), bool, int, str, bytes))
#: All bits of a float.
_bits = Struct("d").pack

#: Results of each function that are kept, ...
_KEPT = 512
#: ... and the bytes that those of all functions take together, with what they are known by.
_MOST_BYTES = 2**26
#: Beyond, a part of them is let go of at once: whose result is the oldest is asked of all functions each time.
_LET_GO = 1 / 16
#: Bytes of an array besides its entries.
_OBJECT = 128
#: The types of names.
_WORDS = {str}
#: What has no parts.
_SIMPLE = frozenset((*_PLAIN, float, complex))
#: Matrices of more bytes together are known by a digest of their entries.
_LARGE = 1024


_all: WeakSet[Latest[Any]] = WeakSet()
_uses = count()
#: One for all functions: it is held for moments only, never while a result is computed. In such a moment Python may
#: call the handler of a signal, and that another of these functions: the thread that holds it goes on.
_lock = forkable_lock()


def forget() -> None:
    """Let go of all results that any function keeps: what is asked for next is computed."""
    for latest in list(_all):
        latest.forget()


def kept_bytes() -> int:
    """Return the bytes that the results of all functions take, with what they are known by."""
    return sum([latest.bytes for latest in list(_all)])


@dataclass(eq=False, slots=True)
class _Bytes:
    """The bytes that all functions keep, and those that functions which are no more have kept since it was counted."""

    bytes: int = 0


_kept_at_most = _Bytes()


@dataclass(eq=False, slots=True)
class _Kept(Generic[R]):
    """A result, its bytes with those of its key, when it was used last, and what may grow, with its size."""

    result: R
    bytes: int
    used: int
    growing: list[dict[str, Any]]
    size: int


class Latest(Generic[R]):
    """The latest results of one function, by what they were computed from. Threads may share it.

    All functions have one limit together; what was used least recently goes first, of whichever function it is.

    Parameters
    ----------
    kept : int
        The most results that are kept.
    """

    def __init__(self, kept: int = _KEPT) -> None:
        self._results: OrderedDict[Hashable, _Kept[R]] = OrderedDict()
        self._kept, self.bytes = kept, 0
        self._last: _Kept[R] | None = None  # the one that was used last, and its key
        self._last_key: Hashable = None
        with _lock:
            _all.add(self)

    def forget(self) -> None:
        """Let go of all results."""
        with _lock:
            self._results.clear()
            self._last = self._last_key = None
            self._count(-self.bytes)

    def of(self, key: Hashable, compute: Callable[[], R]) -> R:
        """Return the result kept under a key, or compute it; an error is not kept, nor is what is too large."""
        check_time()
        known = self._kept_under(key)
        return self._keep(key, compute()) if known is None else known.result

    def _kept_under(self, key: Hashable) -> _Kept[R] | None:
        with _lock:
            known = self._results.get(key)
            if known is not None:
                if known is not self._last:
                    self._measure_again()
                    self._results.move_to_end(key)
                    self._last, self._last_key = known, key
                known.used = next(_uses)
        return known

    def _keep(self, key: Hashable, result: R) -> R:
        """Keep a result, which is read-only from then on."""
        size, growing = _bytes(result, freeze=True)
        size += _bytes_of_key(key)
        with _lock:
            if size <= _MOST_BYTES and key not in self._results:
                self._measure_again()
                self._results[key] = kept = _Kept(result, size, next(_uses), growing, _fields_of(growing))
                self._last, self._last_key = kept, key
                self._count(size)
                if len(self._results) > self._kept:
                    self._drop_oldest()
                if _kept_at_most.bytes > _MOST_BYTES:
                    _drop_to_limit()
        return result

    def _count(self, size: int) -> None:
        self.bytes += size
        _kept_at_most.bytes += size

    @property
    def _oldest_use(self) -> float:
        """When the result that was used least recently was used."""
        return next(iter(self._results.values())).used if self._results else float("inf")

    def _drop_oldest(self) -> None:
        oldest = self._results.popitem(last=False)[1]
        if oldest is self._last:
            self._last = self._last_key = None
        self._count(-oldest.bytes)

    def _measure_again(self) -> None:
        """Count what was added to the result that was used last, such as a cached property, since it was kept."""
        last = self._last
        if last is not None and last.growing and _fields_of(last.growing) != last.size:
            size, last.growing = _bytes(last.result)
            size += _bytes_of_key(self._last_key)
            self._count(size - last.bytes)
            last.bytes, last.size = size, _fields_of(last.growing)


def _answer(kept: R) -> R:
    """Return a kept result, or raise it if it is a refusal."""
    if isinstance(kept, ResiduaError):
        raise copy(kept)  # each with a traceback of its own
    return kept


def _fields_of(growing: list[dict[str, Any]]) -> int:
    """Return how many fields there are now."""
    return sum([len(one) for one in growing])


def _drop_to_limit() -> None:
    """Let go of the results that were used least recently until the others are below the limit. Needs the lock."""
    functions = list(_all)
    _kept_at_most.bytes = sum([one.bytes for one in functions])
    limit = (1 - _LET_GO) * _MOST_BYTES
    while _kept_at_most.bytes > limit:
        oldest = min(functions, key=lambda one: one._oldest_use)
        if not oldest._results:  # nor has any other: an interruption has come between a result and its count
            _kept_at_most.bytes = 0
            for one in functions:
                one.bytes = 0
        # all of one that are older than those of the others
        others = min([one._oldest_use for one in functions if one is not oldest], default=float("inf"))
        while _kept_at_most.bytes > limit and oldest._oldest_use < others:
            oldest._drop_oldest()


def entries(*matrices: NDArray | None) -> Hashable:
    """Return what tells matrices from all others: shapes and entries to the last bit, of large ones a digest of these.

    The digest is a cryptographic one of 32 bytes: no two systems of one design will ever share it.
    """
    # lists, which are made faster than what generators yield is collected
    shapes = tuple([None if M is None else M.shape for M in matrices])
    present = [M for M in matrices if M is not None]
    if sum([M.nbytes for M in present]) <= _LARGE:
        return shapes, tuple([M.tobytes() for M in present])
    return shapes, _digest(present)


def _digest(matrices: list[NDArray]) -> bytes:
    digest = sha256()
    for M in map(np.ascontiguousarray, matrices):
        digest.update(M.data if M.size else b"")
    return digest.digest()


def cached_by_entries(function: Callable[..., R]) -> Callable[..., R]:
    """Return a pure function of matrices that keeps its latest results; the arrays of these are read-only.

    Threads may share it. An error is not kept.
    """
    latest: Latest[R] = Latest()

    @wraps(function)
    def cached(*matrices: NDArray) -> R:
        arrays = [np.asarray(M, dtype=float) for M in matrices]
        # a copy: results may be views of the arguments, which the caller may write to
        return latest.of(entries(*arrays), lambda: function(*map(_own, arrays)))

    return cached


class UnkeyedError(TypeError):
    """A value is not made of arrays, numbers and words alone: nothing tells it from all others."""


def contents(value: object) -> Hashable:
    """Return what tells a value from all others: arrays, numbers, words, and tuples, lists and dataclasses of these.

    Of every part the type and every bit count, of large arrays a digest of these, as for :func:`entries`; of matrices
    the order in memory too, by which products and factorisations round.
    """
    kind = type(value)
    if kind in _PLAIN:
        return kind, value
    if isinstance(value, np.ndarray):
        if kind is not np.ndarray or value.dtype.hasobject:
            raise UnkeyedError
        ordered = value.ndim < 2 or value.flags.c_contiguous
        held = value.tobytes() if value.nbytes <= _LARGE else _digest([value])
        return value.dtype.str, value.shape, held, None if ordered else value.strides
    if isinstance(value, (tuple, list)):
        if set(map(type, value)) == _WORDS:  # names, which are many
            return kind, tuple(value)
        return kind, tuple([contents(part) for part in value])
    if kind is float:
        return kind, _bits(value)
    if names := _field_names(kind):
        return kind, tuple([contents(getattr(value, name)) for name in names])
    if isinstance(value, dict):
        return kind, tuple([(contents(name), contents(part)) for name, part in value.items()])
    if isinstance(value, (float, np.generic)):
        return kind, np.asarray(value).tobytes()
    raise UnkeyedError


def cached_by_contents(function: Callable[..., R]) -> Callable[..., R]:
    """Return a pure function that keeps its latest results by what its arguments hold; arrays of results are read-only.

    And by the unit that rates are worked on in where it is in the texts of a result. Arguments that :func:`contents`
    does not know, such as a user's own classes, are computed every time. Threads may share it. Of errors the refusals
    of the package are kept.
    """
    latest: Latest[R] = Latest()

    @wraps(function)
    def cached(*values: Any, **options: Any) -> R:
        # one order of the entries in memory, whichever the caller has: rounding depends on it
        own = [np.asarray(value, order="C") if type(value) is np.ndarray else value for value in values]
        try:
            key = contents((own, tuple(options.items())))
        except UnkeyedError:
            return function(*values, **options)

        def compute() -> R:
            # of the arrays among the values it has copies, and the dictionary with the options is its own
            others = *(value for value in values if type(value) is not np.ndarray), *options.values()
            return _apart_from(function(*map(_own, own), **options), others)

        return latest.of_texts(key, compute)

    return cached


def _own(value: Any) -> Any:
    """Return an argument that nobody else writes to, if it is an array."""
    if type(value) is np.ndarray:
        value = value.copy()
        value.flags.writeable = False
    return value


def copied(result: R) -> R:
    """Return a result to hand out: its arrays, lists and dictionaries, and those of its parts, may be written to."""
    return _rebuilt(result, lambda _: True)


def _apart_from(result: R, arguments: tuple[object, ...]) -> R:
    """Return a result with copies of what its arguments hold and their owner may write to, and of views of that."""
    theirs = {
        _memory(part)
        for part in _parts(arguments)
        if isinstance(part, (list, dict)) or (isinstance(part, np.ndarray) and _owner(part).flags.writeable)
    }
    return _rebuilt(result, lambda part: _memory(part) in theirs) if theirs else result


def _owner(array: NDArray) -> NDArray:
    """Return the array that an array is a view of, or itself."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _memory(part: object) -> int:
    """Return what two arrays have in common that share memory; of others what tells them apart."""
    if not isinstance(part, np.ndarray):
        return id(part)
    owner = _owner(part)
    return id(owner if owner.base is None else owner.base)


def _rebuilt(value: R, to_copy: Callable[[Any], bool]) -> R:
    """Return a value with copies of some arrays, lists and dictionaries in it; itself when there are none."""
    kind: Any = type(value)
    if isinstance(value, np.ndarray):
        return cast("R", value.copy(order="K")) if to_copy(value) else value
    if isinstance(value, dict):
        parts, same = _rebuilt_parts(value.values(), to_copy)
        return value if same and not to_copy(value) else cast("R", dict(zip(value, parts, strict=True)))
    if isinstance(value, (tuple, list)):
        parts, same = _rebuilt_parts(value, to_copy)
        if same and not (isinstance(value, list) and to_copy(value)):
            return value
        make = getattr(kind, "_make", kind)  # of named tuples
        return cast("R", make(parts))
    if hasattr(value, "__dict__") and (names := _field_names(kind)):
        own = vars(value)
        given = [name for name in names if name in own]
        parts, same = _rebuilt_parts([own[name] for name in given], to_copy)
        if not same:
            value = copy(value)
            own = vars(value)
            for name in _kept_properties(kind):
                own.pop(name, None)  # computed from what was copied
            own.update(zip(given, parts, strict=True))
    return value


def _rebuilt_parts(parts: Collection[Any], to_copy: Callable[[Any], bool]) -> tuple[list[Any], bool]:
    """Return the same of each part, and whether all are the parts themselves."""
    new = [part if type(part) in _SIMPLE else _rebuilt(part, to_copy) for part in parts]
    return new, all(map(is_, new, parts))


def _parts(value: object) -> Iterator[object]:
    """Yield a value and its parts, of tuples, lists, dictionaries and dataclasses, each once; no numbers and words."""
    seen: set[int] = set()
    left = [value]
    while left:
        part = left.pop()
        kind = type(part)
        if kind in _SIMPLE or id(part) in seen:
            continue
        seen.add(id(part))
        yield part
        if kind is np.ndarray:
            continue
        if isinstance(part, (tuple, list)):
            left += part
        elif isinstance(part, dict):
            left += part.values()
        elif _is_dataclass(kind):
            left += getattr(part, "__dict__", {}).values()


def _bytes(value: object, *, freeze: bool = False) -> tuple[int, list[dict[str, Any]]]:
    """Return the bytes that a value takes, each counted once, and the fields of parts that may keep properties later.

    Of a view those of what it keeps alive. Numbers and words count nothing. ``freeze``: arrays become read-only.
    """
    whole = 0
    growing: list[dict[str, Any]] = []
    seen: set[int] = set()
    owners: set[int] = set()
    left = [value]
    while left:
        part = left.pop()
        kind = type(part)
        if kind in _SIMPLE or id(part) in seen:
            continue
        seen.add(id(part))
        if isinstance(part, np.ndarray):
            if freeze:
                part.flags.writeable = False
            whole += _OBJECT
            owner = part if part.base is None else _owner(part)
            if id(owner) not in owners:
                owners.add(id(owner))
                whole += owner.nbytes
        elif isinstance(part, (tuple, list)):
            whole += getsizeof(part)
            left += part
        elif isinstance(part, dict):
            whole += getsizeof(part)
            left += part.values()
        elif _is_dataclass(kind):
            fields = getattr(part, "__dict__", {})
            whole += _OBJECT + getsizeof(fields)
            left += fields.values()
            if _kept_properties(kind):
                growing.append(fields)
    return whole, growing


@cache
def _is_dataclass(kind: type) -> bool:
    return hasattr(kind, "__dataclass_fields__")


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    """Return the names of the fields of a dataclass; none of other classes."""
    return tuple(getattr(kind, "__dataclass_fields__", ()))


@cache
def _kept_properties(kind: type) -> tuple[str, ...]:
    """Return the names of the properties of a class that are kept once they were asked for."""
    names = dict.fromkeys(name for one in kind.__mro__ for name in vars(one))
    return tuple([name for name in names if isinstance(getattr(kind, name, None), cached_property)])


def _bytes_of_key(key: Hashable) -> int:
    """Return the bytes that a key takes: tuples of the bytes of arrays, and of what counts nothing."""
    whole, parts = 0, cast("list[Any]", [key])
    for part in parts:  # which grows on the way
        kind = type(part)
        if kind is tuple:
            whole += 40 + 8 * len(part)
            parts += part
        elif kind is bytes:
            whole += 33 + len(part)
    return whole
