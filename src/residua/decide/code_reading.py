"""Reading of a pattern of fired members, as values and as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import DataError
from residua.words import counted

#: Pairs of faults, and nearest codes, that a text names at most.
NAMED = 3
#: Single faults that explain a pattern, as a text names them at most.
LISTED = 8

UNKNOWN = "more than one fault, or one that the bank does not know"


@dataclass(frozen=True)
class CodeReading:
    """Reading of a pattern of fired members.

    Attributes
    ----------
    answer : {"none", "exact", "several", "degraded", "nearest", "unknown"}
        ``none``: no member fired, no fault. ``exact``: the pattern is the code of one fault. ``several``: every code
        of the bank is a single member, and the pattern is those of the faults in ``together``. ``degraded``: it is
        the code of one fault with some members silent, and of no other. ``nearest``: one code is nearer than all
        others, within the distance that is allowed, and no other fault has the pattern as part of its code.
        ``unknown``: one of the faults in ``possible``, more than one fault, or one that the bank does not know.
    faults : tuple of str
        The fault that was read, with those that have the same code; empty for ``none``, ``several`` and ``unknown``.
    distance : int
        Members that differ from the code that was read; for ``unknown`` from the nearest code, -1 if there is none.
    pairs : tuple of pairs
        Two (groups of) faults at once that would fire just these members, each of them fewer.
    nearest : tuple of tuple of str
        For ``unknown``: the groups whose codes are nearest.
    pattern : tuple of bool
        Which members fired.
    members : tuple of str
    settled : tuple of str
        The ones of ``faults`` that fire these members only once they are constant.
    possible : tuple of tuple of str
        For ``unknown`` and ``exact``: the single faults, other than those read, that explain the pattern by members
        that stay silent, those with the fewest silent members first. Faults with the same code are together, each is
        named once.
    together : tuple of tuple of str
        For ``several``: the faults that are there at once, in the order of their members; those with the same member
        are one group, of which one fault or more is there.
    """

    answer: str
    faults: tuple[str, ...]
    distance: int
    pairs: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]
    nearest: tuple[tuple[str, ...], ...]
    pattern: tuple[bool, ...]
    members: tuple[str, ...]
    settled: tuple[str, ...] = ()
    possible: tuple[tuple[str, ...], ...] = ()
    together: tuple[tuple[str, ...], ...] = ()

    @property
    def named(self) -> tuple[tuple[str, ...], ...]:
        """The groups of faults in this reading: the one that was read, or all of several."""
        return self.together or ((self.faults,) if self.faults else ())

    @property
    def fired(self) -> tuple[str, ...]:
        """Names of the members that fired."""
        return tuple(name for name, on in zip(self.members, self.pattern, strict=True) if on)

    @property
    def meaning(self) -> str:
        """The meaning of the answer as text."""
        name = quoted(self.faults, self.settled)
        if self.answer == "none":
            return "no fault"
        off = counted(self.distance, "member")
        if self.answer == "exact":
            also = f", or {self.either} with members silent" if self.possible else ""
            return f"code of {name} (exact){also}{self._pairs(', or of two at once: ')}"
        if self.answer == "degraded":
            return f"code of {name} with {off} silent (degraded){self._pairs(', or two at once: ')}"
        if self.answer == "nearest":
            return f"nearest code: {name}, {off} off (nearest){self._pairs(', or two at once: ')}"
        if self.answer == "several":
            *others, last = (f"({quoted(group)})" if len(group) > 1 else quoted(group) for group in self.together)
            return f"several faults: {', '.join(others)} and {last}"
        together = self._pairs(": these two at once would fire the same members: ")
        if self.possible:
            return f"undecided: {self.either} with members silent, {UNKNOWN}{together}"
        if self.close:
            return f"nearest code: {quoted(self.close)}, 1 member off; but it may be {UNKNOWN}{together}"
        if self.pairs:
            return UNKNOWN + together
        if self.nearest:
            several = "codes" if len(self.nearest) > 1 else "code"
            return f"{UNKNOWN}: nearest {several} {_some_of(map(quoted, self.nearest))}, {off} off"
        return UNKNOWN

    @property
    def close(self) -> tuple[str, ...]:
        """For ``unknown``: the one group whose code is nearest, where only one member differs; else empty.

        Empty also where single faults are ``possible``: none of them comes before the others.
        """
        one = self.answer == "unknown" and self.distance == 1 and len(self.nearest) == 1 and not self.possible
        return self.nearest[0] if one else ()

    @property
    def either(self) -> str:
        """The faults in ``possible`` as text; empty without any."""
        more = sum(len(group) for group in self.possible[LISTED:])
        return " or ".join(quoted(group) for group in self.possible[:LISTED]) + (f" or {more} more" if more else "")

    def _pairs(self, before: str) -> str:
        if not self.pairs:
            return ""
        if all(self.pattern) and len(self.pairs) > NAMED:  # most pairs fire everything: their names say nothing
            return f"{before}{len(self.pairs)} pairs"
        return before + _some_of(f"{quoted(a)} and {quoted(b)}" for a, b in self.pairs)

    def __str__(self) -> str:
        everyone = len(self.members) > NAMED and len(self.fired) == len(self.members)
        fired = f"all {len(self.members)} members" if everyone else ", ".join(self.fired) or "none"
        return f"fired: {fired}; {self.meaning}"


def quoted(faults: Sequence[str], settled: Sequence[str] = ()) -> str:
    """Return the faults of a group as text, ending with those that apply only once constant."""
    at_once = " or ".join(f"'{name}'" for name in faults if name not in settled)
    later = " or ".join(f"'{name}'" for name in faults if name in settled)
    return f"{at_once}{', or of ' if at_once else ''}{later} once constant" if later else at_once


def _some_of(items: Iterable[str]) -> str:
    entries = list(items)
    more = len(entries) - NAMED
    return "; ".join(entries[:NAMED]) + (f"; and {more} more" if more > 0 else "")


def each_once(groups: Iterable[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Return groups without the faults that an earlier group has named."""
    named: set[str] = set()
    out = []
    for group in groups:
        left = tuple(name for name in group if name not in named)
        named.update(left)
        out += [left] if left else []
    return tuple(out)


def pairs_of(
    pairs: Iterable[tuple[tuple[str, ...], tuple[str, ...]]],
) -> tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]:
    """Return pairs of groups, each once; a fault with two codes makes no pair with itself."""
    out = []
    for one, other in pairs:
        if len(one) == 1:
            other = tuple(name for name in other if name not in one)
        elif len(other) == 1:
            one = tuple(name for name in one if name not in other)
        if one and other and (other, one) not in out:
            out.append((one, other))
    return tuple(dict.fromkeys(out))


def distinct_rows(rows: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the count and first place of each distinct row of a boolean matrix, and the number of each row."""
    if not len(rows):
        nothing = np.zeros(0, dtype=np.int64)
        return nothing, nothing, nothing
    packed = np.ascontiguousarray(np.packbits(rows, axis=1))
    keys = packed.view(f"V{packed.shape[1]}")[:, 0] if packed.shape[1] > 1 else packed[:, 0]
    _, first, index, counts = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    return counts.astype(np.int64), first.astype(np.int64), index.astype(np.int64).ravel()


def booleans(values: ArrayLike, name: str) -> NDArray[np.bool_]:
    """Return an array of booleans from one of booleans, or of zeros and ones."""
    array = np.asarray(values)
    if array.dtype == bool:
        return array
    if array.dtype.kind not in "iuf" or not np.isin(array, (0, 1)).all():
        raise DataError(f"{name} must be true or false, or 0 or 1")
    return array.astype(bool)
