"""Coding sets: the faults that each residual answers to, and the distances between the codes of faults."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.analysis.codes import code_table, equal_codes, strongly_isolating
from residua.errors import DesignError
from residua.shown import Shown
from residua.words import counted

#: Codes that may become others, as a text names them at most.
NAMED = 6


@dataclass(frozen=True, eq=False, repr=False)
class CodingSet(Shown):
    """Structure of a set of residuals; the column of a fault is its code.

    Prints as a table, with all that keeps the codes from isolating strongly.

    Attributes
    ----------
    structure : ndarray of bool, shape (residuals, faults)
    faults : tuple of str
    residuals : tuple of str
    ignored : tuple of str
        Faults that all residuals are meant to ignore, as if they were disturbances.
    undetectable : tuple of str
        Faults that no residual of any method sees.
    inseparable : tuple of tuple of str
        Faults that no method tells apart: each group has one code by necessity.
    notes : tuple of str
        How it was chosen.

    References
    ----------
    Gertler (1991), section 4.

    Examples
    --------
    >>> from residua import coding
    >>> print(coding.CodingSet.of(["101", "011"], ["leak", "clog", "sensor"]))
    2 residuals, 3 faults: weakly isolating
         1  2  3
    r1   x  .  x
    r2   .  x  x
      1: leak
      2: clog
      3: sensor
    the code of 'sensor' becomes that of 'leak' or 'clog' when residuals stay silent
    codes differ in 1 residual at least; ones per fault: 1 to 2; zeros per residual: 1
    """

    structure: NDArray[np.bool_]
    faults: tuple[str, ...]
    residuals: tuple[str, ...]
    ignored: tuple[str, ...] = ()
    undetectable: tuple[str, ...] = ()
    inseparable: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, structure: Structure, faults: Sequence[str] | None = None) -> CodingSet:
        """Return the coding set of a structure as :func:`residua.design.structured_bank` takes it.

        Without names the faults are ``f1``, ``f2`` and so on. Residuals may be blind to all faults here.
        """
        structure = _plain(structure)
        if isinstance(structure, CodingSet) and faults is None:
            return structure
        if isinstance(structure, Mapping) and faults is None:
            structure = {name: [seen] if isinstance(seen, str) else list(seen) for name, seen in structure.items()}
            faults = list(dict.fromkeys(fault for seen in structure.values() for fault in seen))
        names = tuple(faults) if faults is not None else tuple(f"f{j + 1}" for j in range(_width(structure)))
        rows = _named_rows(structure, names)
        return cls(np.array(list(rows.values()), dtype=bool).reshape(len(rows), len(names)), names, tuple(rows))

    @property
    def quality(self) -> str:
        """Isolation by the codes: "none", "weak" or "strong"; see :func:`isolation_quality`."""
        return _quality(self.structure)

    @property
    def quality_of_groups(self) -> str:
        """The same for what is possible: inseparable faults count as one, undetectable and ignored ones not at all."""
        return _quality(self.structure[:, self._apart])

    @property
    def undetected(self) -> tuple[str, ...]:
        """Faults that no residual of this set answers to."""
        return tuple(name for name, code in zip(self.faults, self.structure.T, strict=True) if not code.any())

    @property
    def equal(self) -> tuple[tuple[str, ...], ...]:
        """Groups of faults with the same code; those without any one are left out."""
        groups = equal_codes(self.structure)
        return tuple(tuple(self.faults[j] for j in group) for group in groups if len(group) > 1)

    @cached_property
    def degradations(self) -> dict[str, tuple[str, ...]]:
        """For each fault the others whose code its own becomes when residuals that should fire stay silent.

        Equal codes and empty ones are not counted.
        """
        S = self.structure
        within = (S[:, :, None] <= S[:, None, :]).all(axis=0)  # [k, j]: code k is part of code j
        proper = np.asarray(within & ~within.T)
        proper[np.asarray(~S.any(axis=0))] = False
        return {
            name: tuple(self.faults[k] for k in np.flatnonzero(proper[:, j]))
            for j, name in enumerate(self.faults)
            if proper[:, j].any()
        }

    @property
    def distance(self) -> int:
        """The smallest number of residuals in which two codes differ; of a single code, its ones.

        Inseparable faults count as one, undetectable and ignored ones not at all.
        """
        codes = self.structure[:, self._apart]
        if codes.shape[1] < 2:
            return int(codes.sum())
        apart = np.count_nonzero(codes[:, :, None] != codes[:, None, :], axis=0)
        first, second = np.triu_indices(codes.shape[1], 1)
        return int(apart[first, second].min())

    @property
    def ones(self) -> NDArray[np.int64]:
        """Numbers of residuals that answer to each fault."""
        return self.structure.sum(axis=0)

    @property
    def zeros(self) -> NDArray[np.int64]:
        """Numbers of faults that each residual ignores; inseparable ones count as one, undetectable ones not."""
        return np.asarray((~self.structure[:, self._apart]).sum(axis=1))

    @property
    def canonical(self) -> bool:
        """True if all codes have the same number of ones, and all residuals the same number of zeros."""
        return len(set(self.ones[self._apart].tolist())) <= 1 and len(set(self.zeros.tolist())) <= 1

    @property
    def digits(self) -> tuple[str, ...]:
        """The rows as text, ``"0111"``."""
        return tuple("".join("01"[int(one)] for one in row) for row in self.structure)

    @cached_property
    def _apart(self) -> list[int]:
        """One fault of each inseparable group, without the undetectable and the ignored."""
        left_out = {*self.undetectable, *self.ignored, *(name for group in self.inseparable for name in group[1:])}
        return [j for j, name in enumerate(self.faults) if name not in left_out]

    def __str__(self) -> str:
        n_r, n_f = self.structure.shape
        lines = [f"{counted(n_r, 'residual')}, {counted(n_f, 'fault')}: {self._verdict()}"]
        lines += code_table(self.residuals, self.structure, self.faults)
        lines += self._defects()
        if self._apart and n_r:
            ones, zeros = self.ones[self._apart], self.zeros
            lines.append(
                f"codes differ in {counted(self.distance, 'residual')} at least; ones per fault: {_range(ones)}; "
                f"zeros per residual: {_range(zeros)}{' (canonical)' if self.canonical else ''}"
            )
        return "\n".join([*lines, *self.notes])

    def _verdict(self) -> str:
        words = {"none": "not isolating", "weak": "weakly isolating", "strong": "strongly isolating"}
        quality, possible = self.quality, self.quality_of_groups
        return words[quality] if quality == possible else f"{words[possible]} what can be told apart"

    def _defects(self) -> list[str]:
        """Return the obstacles to strong isolation, in words."""
        lines = []
        unseen = [name for name in self.undetected if name not in {*self.undetectable, *self.ignored}]
        lines += [f"ignored by all residuals: {', '.join(self.ignored)}"] if self.ignored else []
        lines += [f"seen by no residual of any method: {', '.join(self.undetectable)}"] if self.undetectable else []
        lines += [f"seen by no residual: {', '.join(unseen)}"] if unseen else []
        lines += [f"no method distinguishes: {', '.join(group)}" for group in self.inseparable]
        known = {frozenset(group) for group in self.inseparable}
        lines += [f"same code: {', '.join(group)}" for group in self.equal if frozenset(group) not in known]
        pairs = [
            f"the code of '{name}' becomes that of {either(others)} when residuals stay silent"
            for name, others in self.degradations.items()
        ]
        more = [f"and {len(pairs) - NAMED} more codes that become others"] if len(pairs) > NAMED else []
        return lines + pairs[:NAMED] + more


class HasCodingSet(Protocol):
    """Answers with a coding set, such as that of :func:`attainable`: the attainable rows."""

    @property
    def coding_set(self) -> CodingSet:
        """The coding set."""
        ...


_WANTED = (
    'structure must be a matrix of 0 and 1, residuals x faults, with rows of one length, rows such as "0111", or a '
    "mapping from the name of each residual to the faults that it answers to"
)

#: What says which residual answers to which fault: a coding set, the attainable rows of a plant, a matrix, rows such as
#: ``"0111"``, or a mapping from the name of each residual to the faults that it answers to.
Structure = CodingSet | HasCodingSet | ArrayLike | Sequence[str] | Mapping[str, Iterable[str]]


def isolation_quality(structure: Structure) -> str:
    r"""Tell whether the codes of a structure isolate the faults: not, weakly or strongly.

    Weakly: all columns are distinct and none is zero. Strongly: besides, no column becomes another one when some of
    its ones are replaced by zeros, that is, the columns are an antichain. A fault too small to fire all of its
    residuals is then read as no other.

    Parameters
    ----------
    structure : array_like of bool, shape (residuals, faults), sequence of str, mapping or CodingSet
        Rows may be written ``"0111"``.

    Returns
    -------
    {"none", "weak", "strong"}

    Raises
    ------
    DesignError
        If it is not a matrix of 0 and 1, or has no residuals or no faults.

    See Also
    --------
    CodingSet : tells why.

    References
    ----------
    Gertler (1991), section 4, Example 1.

    Examples
    --------
    >>> from residua import coding
    >>> [coding.isolation_quality(S) for S in (["110", "111", "111"], ["110", "101", "111"], ["110", "101", "011"])]
    ['none', 'weak', 'strong']
    """
    coding = CodingSet.of(structure)
    if not coding.structure.size:
        rows, columns = coding.structure.shape
        raise DesignError(
            f"the structure has {counted(rows, 'residual')} and {counted(columns, 'fault')}: "
            "there is nothing to isolate"
        )
    return coding.quality


def structure_rows(structure: Structure, faults: tuple[str, ...]) -> dict[str, NDArray[np.bool_]]:
    """Return the rows of a structure by name, each with one entry per fault; none may answer to nothing."""
    if not faults:
        raise DesignError("the plant has no faults: add some with with_sensor_faults or with_faults")
    rows = _named_rows(structure, faults)
    for name, row in rows.items():
        if not row.any():
            raise DesignError(f"row {name!r} of the structure answers to no fault")
    if not rows:
        raise DesignError("the structure has no rows")
    return rows


def _plain(structure: Any) -> Any:
    """Return the structure, or its ``coding_set`` if it has one: that of the attainable rows."""
    return getattr(structure, "coding_set", structure)


def _quality(codes: NDArray[np.bool_]) -> str:
    """Return the quality of the columns."""
    if not codes.any(axis=0).all() or len(equal_codes(codes)) < codes.shape[1]:
        return "none"
    return "strong" if strongly_isolating(codes) else "weak"


def _width(structure: Any) -> int:
    """Return the number of columns of a structure without names."""
    if isinstance(structure, str):
        return len(structure)
    if not isinstance(structure, (Sequence, np.ndarray)):
        raise DesignError(f"{_WANTED}; got {structure!r}")
    first = structure[0] if len(structure) else None
    return len(first) if isinstance(first, (str, Sequence, np.ndarray)) else len(structure)


def _named_rows(structure: Structure, faults: tuple[str, ...]) -> dict[str, NDArray[np.bool_]]:
    """Return the rows of a structure by name."""
    structure = _plain(structure)
    if isinstance(structure, CodingSet):
        if set(structure.faults) != set(faults):
            other = ", ".join(sorted(set(structure.faults) ^ set(faults)))
            raise DesignError(
                f"the coding set is for other faults than the plant's: {other}; choose one for this plant"
            )
        order = [structure.faults.index(name) for name in faults]
        return {name: row[order] for name, row in zip(structure.residuals, structure.structure, strict=True)}
    if isinstance(structure, Mapping):
        rows = {}
        for name, seen in structure.items():
            rows[str(name)] = np.zeros(len(faults), dtype=bool)
            rows[str(name)][arrays.positions(seen, faults, "fault")] = True
        return rows
    listed: Any = [structure] if isinstance(structure, str) else structure
    if isinstance(listed, Sequence) and listed and all(isinstance(row, str) for row in listed):
        wrong = [row for row in listed if set(row) - {"0", "1"} or len(row) != len(faults)]
        if wrong:
            raise DesignError(f"row {wrong[0]!r}: expected {len(faults)} digits 0 or 1, one per fault")
        listed = [[digit == "1" for digit in row] for row in listed]
    try:
        M = np.atleast_2d(np.asarray(listed, dtype=float))
    except (TypeError, ValueError) as error:
        lengths = [len(row) for row in listed if isinstance(row, (str, Sequence, np.ndarray))]
        several = (
            f"; the rows have {', '.join(map(str, lengths[:-1]))} and {lengths[-1]} entries"
            if len(set(lengths)) > 1
            else ""
        )
        raise DesignError(f"{_WANTED}{several}") from error
    if M.ndim != 2 or M.shape[1] != len(faults) or not np.isin(M, (0, 1)).all():
        raise DesignError(
            f"structure must be 0 or 1, residuals x {len(faults)} faults ({', '.join(faults)}), got shape {M.shape}"
        )
    return {f"r{i + 1}": row.astype(bool) for i, row in enumerate(M)}


def _range(values: NDArray) -> str:
    low, high = int(values.min()), int(values.max())
    return f"{low}" if low == high else f"{low} to {high}"


def either(names: Sequence[str]) -> str:
    """Return names as alternatives, in words."""
    return " or ".join(f"'{name}'" for name in names)
