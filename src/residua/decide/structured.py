"""Isolation by code: which members of a bank fired, read against the code that each fault promises."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.analysis.codes import equal_codes, strongly_isolating
from residua.decide.norm_threshold import check_samples, is_number
from residua.errors import DataError, SettingError

#: Pairs of faults, and nearest codes, that a text names at most.
NAMED = 3

UNKNOWN = "more than one fault, or one that the bank does not know"


@dataclass(frozen=True)
class Structured:
    """Name the fault whose code the fired members of a bank spell.

    Parameters
    ----------
    window : int
        Samples over which it is judged which members fired: their alarms do not begin and end together.
    share : float
        A member counts as fired if it was in alarm, within the window, at least this fraction of the samples
        of the member that was in alarm the longest.
    distance : int
        Members in which a pattern may differ from the nearest code and still be read as it; 0 turns that off.

    References
    ----------
    Gertler (1991), section 4; Chen and Patton (1999), chapter 3; for sensors one by one, Clark (1978) and
    Frank (1987).
    """

    window: int = 50
    share: float = 0.5
    distance: int = 1

    def __post_init__(self) -> None:
        """Check the settings."""
        check_samples(self.window, "window")
        check_samples(self.distance, "distance", least=0)
        if not is_number(self.share) or not 0 < self.share <= 1:
            raise SettingError(f"share must lie between 0 and 1, got {self.share!r}")
        object.__setattr__(self, "window", int(self.window))
        object.__setattr__(self, "share", float(self.share))
        object.__setattr__(self, "distance", int(self.distance))


@dataclass(frozen=True)
class CodeReading:
    """What a pattern of fired members says.

    Attributes
    ----------
    answer : {"none", "exact", "degraded", "nearest", "unknown"}
        ``none``: no member fired, no fault. ``exact``: the pattern is the code of one fault. ``degraded``: it is
        the code of one fault with some members silent, and of no other. ``nearest``: one code is nearer than all
        others, within the distance that is allowed. ``unknown``: more than one fault, or one that the bank
        does not know.
    faults : tuple of str
        The fault that was read, with those that have the same code; empty for ``none`` and ``unknown``.
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
        Those of ``faults`` that fire these members only once they are constant.
    """

    answer: str
    faults: tuple[str, ...]
    distance: int
    pairs: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]
    nearest: tuple[tuple[str, ...], ...]
    pattern: tuple[bool, ...]
    members: tuple[str, ...]
    settled: tuple[str, ...] = ()

    @property
    def fired(self) -> tuple[str, ...]:
        """Names of the members that fired."""
        return tuple(name for name, on in zip(self.members, self.pattern, strict=True) if on)

    @property
    def meaning(self) -> str:
        """The answer in words."""
        name = quoted(self.faults, self.settled)
        if self.answer == "none":
            return "no fault"
        if self.answer == "exact":
            return f"code of {name} (exact){self._pairs(', or of two at once: ')}"
        if self.answer == "degraded":
            return f"code of {name} with {_count(self.distance)} silent (degraded){self._pairs(', or two at once: ')}"
        if self.answer == "nearest":
            return f"nearest code: {name}, {_count(self.distance)} off (nearest){self._pairs(', or two at once: ')}"
        together = self._pairs(": these two at once would fire the same members: ")
        if self.close:
            return f"nearest code: {quoted(self.close)}, 1 member off; but it may be {UNKNOWN}{together}"
        if self.pairs:
            return UNKNOWN + together
        if self.nearest:
            several = "codes" if len(self.nearest) > 1 else "code"
            return f"{UNKNOWN}: nearest {several} {_listed(map(quoted, self.nearest))}, {_count(self.distance)} off"
        return UNKNOWN

    @property
    def close(self) -> tuple[str, ...]:
        """For ``unknown``: the one group whose code is nearest, where only one member differs; else empty."""
        one = self.answer == "unknown" and self.distance == 1 and len(self.nearest) == 1
        return self.nearest[0] if one else ()

    def _pairs(self, before: str) -> str:
        if not self.pairs:
            return ""
        if all(self.pattern) and len(self.pairs) > NAMED:  # most pairs fire everything: their names say nothing
            return f"{before}{len(self.pairs)} pairs"
        return before + _listed(f"{quoted(a)} and {quoted(b)}" for a, b in self.pairs)

    def __str__(self) -> str:
        everyone = len(self.members) > NAMED and len(self.fired) == len(self.members)
        fired = f"all {len(self.members)} members" if everyone else ", ".join(self.fired) or "none"
        return f"fired: {fired}; {self.meaning}"


def quoted(faults: Sequence[str], settled: Sequence[str] = ()) -> str:
    """Return the faults of a group as text, those last that are meant only once they are constant."""
    own = " or ".join(f"'{name}'" for name in faults if name not in settled)
    later = " or ".join(f"'{name}'" for name in faults if name in settled)
    return f"{own}{', or of ' if own else ''}{later} once constant" if later else own


def _count(members: int) -> str:
    return f"{members} member{'' if members == 1 else 's'}"


def _listed(items: Iterable[str]) -> str:
    entries = list(items)
    more = len(entries) - NAMED
    return "; ".join(entries[:NAMED]) + (f"; and {more} more" if more > 0 else "")


@dataclass(frozen=True, eq=False)
class CodeTest:
    """Codes with equal ones grouped: what runs.

    A fault that some members see only while it changes has two codes, and may be in two groups: that of all members
    that it fires, and that of those which it still fires once it is constant.

    Attributes
    ----------
    window : int
    share : float
    distance : int
    members : tuple of str
    groups : tuple of tuple of str
        Faults with the same code are one group.
    codes : ndarray of bool, shape (members, groups)
    unjudged : tuple of str
        Faults that fire no member.
    settled : tuple of tuple of str
        For each group, those of its faults that have this code only once they are constant.
    """

    window: int
    share: float
    distance: int
    members: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    codes: NDArray[np.bool_]
    unjudged: tuple[str, ...]
    settled: tuple[tuple[str, ...], ...] = ()

    def __post_init__(self) -> None:
        """Fill in that no fault has another code once it is constant."""
        object.__setattr__(self, "settled", self.settled or ((),) * len(self.groups))

    @property
    def labels(self) -> tuple[str, ...]:
        """The groups as text, no two alike: a fault that has this code only once it is constant is marked *settled*."""
        return tuple(
            " or ".join(f"{name}, settled" if name in later else name for name in group)
            for group, later in zip(self.groups, self.settled, strict=True)
        )

    @cached_property
    def strongly_isolating(self) -> bool:
        """Whether no code turns into another one when members that should fire stay silent."""
        return strongly_isolating(self.codes)

    def read(self, fired: ArrayLike) -> CodeReading:
        """Return what one pattern of fired members says; see :func:`read_code`."""
        pattern = np.asarray(fired, dtype=bool)
        codes, groups, settled = self.codes, self.groups, self.settled
        made = (tuple(bool(x) for x in pattern), self.members)
        if not pattern.any():
            return CodeReading("none", (), 0, (), (), *made)
        off = np.count_nonzero(codes != pattern[:, None], axis=0)
        below = np.flatnonzero((off > 0) & (codes <= pattern[:, None]).all(axis=0))
        first, second = np.triu_indices(len(below), 1)
        whole = ((codes[:, below[first]] | codes[:, below[second]]) == pattern[:, None]).all(axis=0)
        pairs = _pairs_of(
            (groups[below[a]], groups[below[b]]) for a, b in zip(first[whole], second[whole], strict=True)
        )
        if (off == 0).any():
            g = int(off.argmin())
            return CodeReading("exact", groups[g], 0, pairs, (), *made, settled[g])
        above = np.flatnonzero((codes >= pattern[:, None]).all(axis=0))
        if len(above) == 1 and self.strongly_isolating:
            g = int(above[0])
            return CodeReading("degraded", groups[g], int(off[g]), pairs, (), *made, settled[g])
        smallest = int(off.min(initial=len(pattern) + 1))
        near = np.flatnonzero(off == smallest)
        nearest = tuple(dict.fromkeys(groups[g] for g in near))  # both codes of one fault can be equally near
        if len(nearest) == 1 and smallest <= self.distance and not pattern.all():
            return CodeReading("nearest", nearest[0], smallest, pairs, (), *made, settled[near[0]])
        return CodeReading("unknown", (), smallest if len(near) else -1, pairs, nearest, *made)


def _pairs_of(
    found: Iterable[tuple[tuple[str, ...], tuple[str, ...]]],
) -> tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]:
    """Return pairs of groups, each once; a fault with two codes makes no pair with itself."""
    out = []
    for one, other in found:
        if len(one) == 1:
            other = tuple(name for name in other if name not in one)
        elif len(other) == 1:
            one = tuple(name for name in one if name not in other)
        if one and other and (other, one) not in out:
            out.append((one, other))
    return tuple(dict.fromkeys(out))


def code_test(
    settings: Structured,
    codes: ArrayLike,
    faults: Sequence[str],
    members: Sequence[str] | None = None,
    *,
    settled: ArrayLike | None = None,
) -> CodeTest:
    """Return the codes with equal ones grouped, after checking their shape.

    ``settled``, of the same shape, are the codes of constant faults: one that is not empty, and not the fault's own
    code, is a further code of the fault.
    """
    table = np.asarray(codes, dtype=bool)
    if table.ndim != 2 or table.shape[1] != len(faults) or (members is not None and len(table) != len(members)):
        raise DataError(f"codes must have a row per member and a column per fault ({len(faults)}), got {table.shape}")
    names = tuple(members) if members is not None else tuple(str(i + 1) for i in range(len(table)))
    later = np.zeros_like(table) if settled is None else np.asarray(settled, dtype=bool)
    if later.shape != table.shape:
        raise DataError(f"settled must have the shape of codes, {table.shape}, got {later.shape}")
    later = later & (later != table).any(axis=0)
    both = np.hstack([table, later])
    found = equal_codes(both)
    n = len(faults)
    groups = tuple(tuple(faults[j % n] for j in group) for group in found)
    columns = both[:, [group[0] for group in found]]
    silent = tuple(fault for j, fault in enumerate(faults) if not table[:, j].any())
    marked = tuple(tuple(faults[j % n] for j in group if j >= n) for group in found)
    return CodeTest(settings.window, settings.share, settings.distance, names, groups, columns, silent, marked)


def read_code(
    fired: ArrayLike,
    codes: ArrayLike,
    faults: Sequence[str],
    *,
    members: Sequence[str] | None = None,
    distance: int = 1,
) -> CodeReading:
    """Read which members of a bank fired against the codes of the faults.

    In this order:

    1. no member fired: *none*, no fault;
    2. the pattern is the code of a fault: *exact*;
    3. it is the code of just one fault with some ones missing, and the set of codes is strongly isolating (no
       code is another one with ones missing): *degraded*. A fault too small, or too slow, for some members does that;
    4. one code is nearer than all others (Hamming distance), and differs in no more than ``distance`` members:
       *nearest*. Not for a pattern in which all members fired: two faults at once do that in most banks;
    5. anything else: *unknown*, more than one fault, or one that the bank does not know.

    Guaranteed: a fault that fires just the members that its code promises is read exactly. Two faults at once whose
    pattern is the code of a third, or comes near it, are read as that third; ``pairs`` then names them.

    Parameters
    ----------
    fired : array_like of bool, shape (members,)
    codes : array_like of bool, shape (members, faults)
        Which member each fault fires. Faults with equal codes are one group; one without any code is never read.
    faults : sequence of str
    members : sequence of str, optional
        Their names, for texts; numbers when omitted.
    distance : int

    Returns
    -------
    CodeReading

    Raises
    ------
    DataError
        If the shapes do not fit.

    References
    ----------
    Gertler (1991), section 4 (strongly isolating codes, degraded patterns).

    Examples
    --------
    >>> from residua.decide import read_code
    >>> codes = [[0, 1, 1], [1, 0, 1], [1, 1, 0]]
    >>> print(read_code([True, False, True], codes, ["y1", "y2", "y3"], members=["A", "B", "C"]))
    fired: A, C; code of 'y2' (exact)
    >>> read_code([True, True, True], codes, ["y1", "y2", "y3"]).answer
    'unknown'
    """
    test = code_test(Structured(distance=distance), codes, faults, members)
    pattern = np.asarray(fired)
    if pattern.shape != (len(test.members),):
        raise DataError(f"fired must have one entry per member ({len(test.members)}), got shape {pattern.shape}")
    return test.read(pattern)


def read_codes(
    fired: ArrayLike,
    codes: ArrayLike,
    faults: Sequence[str],
    *,
    members: Sequence[str] | None = None,
    distance: int = 1,
) -> tuple[NDArray[np.int64], tuple[CodeReading, ...]]:
    """Read many patterns at once, such as those of a fleet; see :func:`read_code`.

    Parameters
    ----------
    fired : array_like of bool, shape (..., members)
        Such as (plants, time, members).
    codes, faults, members, distance
        As for :func:`read_code`.

    Returns
    -------
    index : ndarray of int, shape (...)
        Number of the reading of each pattern.
    readings : tuple of CodeReading
        One for each pattern that occurs.

    Raises
    ------
    DataError
        If the shapes do not fit.

    Examples
    --------
    >>> from residua.decide import read_codes
    >>> index, readings = read_codes([[0, 1], [1, 1], [0, 1]], [[1, 0], [0, 1]], ["a", "b"])
    >>> [readings[k].answer for k in index]
    ['exact', 'unknown', 'exact']
    """
    test = code_test(Structured(distance=distance), codes, faults, members)
    patterns = np.asarray(fired, dtype=bool)
    if patterns.ndim < 1 or patterns.shape[-1] != len(test.members):
        raise DataError(f"fired must have {len(test.members)} members in its last axis, got shape {patterns.shape}")
    rows = patterns.reshape(-1, patterns.shape[-1])
    _, first, index = distinct_rows(rows)
    return index.reshape(patterns.shape[:-1]), tuple(test.read(rows[k]) for k in first)


def distinct_rows(rows: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return how often each distinct row of a boolean matrix occurs, where first, and which one each row is."""
    if not len(rows):
        nothing = np.zeros(0, dtype=np.int64)
        return nothing, nothing, nothing
    packed = np.ascontiguousarray(np.packbits(rows, axis=1))
    keys = packed.view(f"V{packed.shape[1]}")[:, 0] if packed.shape[1] > 1 else packed[:, 0]
    _, first, index, counts = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    return counts.astype(np.int64), first.astype(np.int64), index.astype(np.int64).ravel()


__all__ = ["CodeReading", "CodeTest", "Structured", "code_test", "distinct_rows", "quoted", "read_code", "read_codes"]
