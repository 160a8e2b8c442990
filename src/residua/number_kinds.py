"""Kinds of numbers in files: allowed values, one check, and one wording of errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.arrays import LARGEST
from residua.errors import FileFormatError
from residua.visible import echo

#: Largest whole number: sums of a few of them are still 64-bit numbers.
_MOST = 2**62
#: Longest window: its samples are kept in memory for every plant.
MAX_WINDOW = 10**6


@dataclass(frozen=True)
class NumberKind:
    """Kind of a number: its type and allowed values.

    Attributes
    ----------
    words : str
        One of them, for messages: "a positive number".
    dtype : str
        ``f`` real, ``c`` complex, ``i`` whole, ``b`` true or false.
    allows : callable
        From an array of that type to an array of bool.
    """

    words: str
    dtype: str
    allows: Callable[[NDArray[Any]], NDArray[np.bool_]]

    def check(self, values: NDArray[Any], where: str) -> NDArray[Any]:
        """Return the values, or raise an error that names the first invalid one."""
        allowed = np.asarray(self.allows(values))
        if not allowed.all():
            place = np.argwhere(~allowed)[0].tolist()
            at = f"{where}[{', '.join(map(str, place))}]" if place else where
            raise self.error(at, values[tuple(place)].item())
        return values

    def error(self, where: str, value: object) -> FileFormatError:
        """Return the error about an invalid value."""
        return FileFormatError(f"{where}: expected {self.words}, got {kind_of(value)}")


def _all(values: NDArray) -> NDArray[np.bool_]:
    return np.ones(values.shape, dtype=bool)


#: Reports about a design, which may be infinite or not known; nothing that runs.
ANY = NumberKind("a number", "f", _all)
FINITE = NumberKind("a finite number", "f", np.isfinite)
#: Of a model or filter; see :data:`residua.arrays.LARGEST`.
ENTRY = NumberKind(f"a finite number of at most {LARGEST:g}", "f", lambda x: np.abs(x) <= LARGEST)
KNOWN_OR_NOT = NumberKind("a finite number or nan", "f", lambda x: ~np.isinf(x))
POSITIVE = NumberKind("a positive, finite number", "f", lambda x: np.isfinite(x) & (x > 0))
NOT_NEGATIVE = NumberKind("a finite number, 0 or more", "f", lambda x: np.isfinite(x) & (x >= 0))
#: A bound that was not proved is infinite.
BOUND = NumberKind("a number, 0 or more", "f", lambda x: x >= 0)
STEP = NumberKind(f"0, or a positive number of at most {LARGEST:g}", "f", lambda x: (x >= 0) & (x <= LARGEST))
PROBABILITY = NumberKind("a number between 0 and 1", "f", lambda x: (x > 0) & (x < 1))
SHARE = NumberKind("a number over 0 and up to 1", "f", lambda x: (x > 0) & (x <= 1))
PART = NumberKind("a number from 0 to 1", "f", lambda x: (x >= 0) & (x <= 1))
COMPLEX = NumberKind("a finite complex number", "c", np.isfinite)
INDEX = NumberKind("a whole number, 0 or more", "i", lambda n: n >= 0)
WHOLE = NumberKind("a whole number", "i", _all)
COUNT = NumberKind("a whole number, 1 or more", "i", lambda n: n >= 1)
WINDOW = NumberKind(f"a whole number from 1 to {MAX_WINDOW}", "i", lambda n: (n >= 1) & (n <= MAX_WINDOW))
FLAG = NumberKind("true or false", "b", _all)

#: Default kind of a number, by its type; products of running values stay finite.
USUAL = {"f": ENTRY, "c": COMPLEX, "i": INDEX, "b": FLAG}

#: The same of results, of which nothing runs: they may be infinite or not known.
REPORTED = USUAL | {"f": ANY, "i": WHOLE}

#: Texts for values that JSON does not have.
SPECIAL = ("nan", "inf", "-inf")


def number_in(value: Any, where: str, kind: NumberKind) -> Any:
    """Return an entry of a file as a number of a kind: ``float``, ``complex``, ``int`` or ``bool``."""
    plain = _plain(value, where, kind)
    if not bool(np.asarray(kind.allows(np.asarray(plain))).all()):
        raise kind.error(where, value)
    return plain


def numbers_in(values: list[Any], where: str, kind: NumberKind, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the entries of a list as an array of a kind and shape."""
    types: dict[str, Any] = {"f": np.float64, "c": np.complex128, "i": np.int64, "b": np.bool_}
    plain = np.array([_plain(value, where, kind) for value in values], dtype=types[kind.dtype])
    return kind.check(plain.reshape(shape), where)


def _plain(value: Any, where: str, kind: NumberKind) -> Any:
    """Return an entry as a Python number of the type of a kind."""
    if kind.dtype == "b":
        if isinstance(value, bool):
            return value
    elif kind.dtype == "i":
        if isinstance(value, int) and not isinstance(value, bool) and -_MOST < value < _MOST:
            return value
    elif kind.dtype == "c":
        if isinstance(value, list) and len(value) == 2:
            return complex(_real(value[0], where, kind), _real(value[1], where, kind))
    else:
        return _real(value, where, kind)
    raise kind.error(where, value)


def _real(value: Any, where: str, kind: NumberKind) -> float:
    if isinstance(value, str) and value in SPECIAL:
        return float(value)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            out = float(value)
        except OverflowError:
            out = math.inf
        if math.isfinite(out):
            return out
    raise kind.error(where, value)


def kind_of(value: Any) -> str:
    """Describe an entry of a file, briefly."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"a list of {len(value)}" if value else "an empty list"
    try:
        return echo(value, 40)
    except ValueError:  # Python does not write out whole numbers of thousands of digits
        return "a whole number of thousands of digits"
