"""Isolation by code: which members of a bank fired, read against the code that each fault promises."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.analysis.codes import equal_codes, strongly_isolating
from residua.decide.code_reading import CodeReading
from residua.decide.norm_threshold import check_samples, is_number
from residua.errors import DataError, SettingError
from residua.visible import echo


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
            raise SettingError(f"share must lie between 0 and 1, got {echo(self.share)}")
        object.__setattr__(self, "window", int(self.window))
        object.__setattr__(self, "share", float(self.share))
        object.__setattr__(self, "distance", int(self.distance))


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
        return strongly_isolating(self.codes, self.groups)

    @cached_property
    def dedicated(self) -> bool:
        """Whether every code is a single member: then each fault fires its own, and several at once are all read."""
        return bool(self.groups) and bool((self.codes.sum(axis=0) == 1).all())

    def member_of(self, group: tuple[str, ...]) -> int:
        """Return the number of the first member that a group of faults fires; of a dedicated bank the only one."""
        return int(self.codes[:, self.groups.index(group)].argmax())

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
        if self.dedicated and (codes.any(axis=1) | ~pattern).all():  # each member that fired has a fault of its own
            own = sorted((groups[g] for g in np.flatnonzero(pattern @ codes)), key=self.member_of)
            return CodeReading("several", (), 0, pairs, (), *made, together=tuple(own))
        above = np.flatnonzero((codes >= pattern[:, None]).all(axis=0))
        if len({groups[g] for g in above}) == 1 and self.strongly_isolating:  # its own settled code may be there too
            g = int(above[np.argmin(off[above])])
            return CodeReading("degraded", groups[g], int(off[g]), pairs, (), *made, settled[g])
        smallest = int(off.min(initial=len(pattern) + 1))
        near = np.flatnonzero(off == smallest)
        nearest = tuple(dict.fromkeys(groups[g] for g in near))  # both codes of one fault can be equally near
        possible = _each_once(groups[g] for g in above[np.argsort(off[above], kind="stable")])
        alone = len(nearest) == 1 and all(set(group) <= set(nearest[0]) for group in possible)
        if alone and smallest <= self.distance and not pattern.all():
            return CodeReading("nearest", nearest[0], smallest, pairs, (), *made, settled[near[0]])
        return CodeReading("unknown", (), smallest if len(near) else -1, pairs, nearest, *made, possible=possible)


def _each_once(groups: Iterable[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Return groups without the faults that an earlier one has named."""
    named: set[str] = set()
    out = []
    for group in groups:
        left = tuple(name for name in group if name not in named)
        named.update(left)
        out += [left] if left else []
    return tuple(out)


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
    3. every code is a single member (a dedicated bank), and each member that fired is one: *several*. There is just
       one way to fire them, all of ``together`` at once;
    4. it is the code of just one fault with some ones missing, and the set of codes is strongly isolating (no
       code is another one with ones missing): *degraded*. A fault too small, or too slow, for some members does that;
    5. one code is nearer than all others (Hamming distance), differs in no more than ``distance`` members, and the
       pattern is part of no other fault's code: *nearest*. Not for a pattern in which all members fired: two faults
       at once do that in most banks;
    6. anything else: *unknown*: a single fault of whose code the pattern is part (``possible`` lists them), more than
       one fault, or one that the bank does not know.

    Guaranteed: a fault that fires just the members that its code promises is read exactly. A fault that fires only
    some of them is not read as another one by a *degraded* or *nearest* code: as another one only where it fires all
    members of that one's code and no more (*exact*; never in a strongly isolating set). Two faults at once whose
    pattern is the code of a third, or comes near it, are read as that third; ``pairs`` then names them. In a dedicated
    bank any number of faults at once that each fire their member, and no other, are read as just these. A fault that
    the bank does not know may fire the members of others there, as in any bank.

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
    >>> dedicated = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> print(read_code([True, False, True], dedicated, ["y1", "y2", "y3"], members=["A", "B", "C"]))
    fired: A, C; several faults: 'y1' and 'y3'
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
    ['exact', 'several', 'exact']
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


__all__ = ["CodeReading", "CodeTest", "Structured", "code_test", "distinct_rows", "read_code", "read_codes"]
