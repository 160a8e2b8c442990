"""Attainable rows of a structure, and the reasons against the others."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.analysis.codes import code_table
from residua.analysis.coding_sets import CodingSet, Structure, structure_rows
from residua.analysis.diagnosability import group_twins
from residua.analysis.fault_space import FaultSpace, fault_space
from residua.plant import Plant
from residua.shown import Shown
from residua.words import counted

#: Attainable rows that are listed, unless the caller says otherwise.
MOST_ROWS = 5000


@dataclass(frozen=True, eq=False, repr=False)
class Attainability(Shown):
    """Attainable rows of a structure: some residual answers to their ones and ignores their zeros.

    Prints as a table.

    Attributes
    ----------
    plant : Plant
    faults : tuple of str
    residuals : tuple of str
        Names of the rows.
    structure : ndarray of bool, shape (rows, faults)
    attainable : ndarray of bool, shape (rows,)
    reasons : mapping of str to str
        For each row that is not attainable, why.
    independent : int
        How many independent residuals ignore the disturbances: one more than the independent faults that one residual
        can ignore.
    constant : bool
        Whether the ones must answer for as long as a constant fault lasts.
    """

    plant: Plant = field(repr=False)
    faults: tuple[str, ...]
    residuals: tuple[str, ...]
    structure: NDArray[np.bool_]
    attainable: NDArray[np.bool_]
    reasons: dict[str, str]
    independent: int
    constant: bool = False

    def __bool__(self) -> bool:
        """True if all rows are attainable."""
        return bool(self.attainable.all())

    @property
    def digits(self) -> tuple[str, ...]:
        """The attainable rows as text, ``"0111"``."""
        return self.coding_set.digits

    @property
    def coding_set(self) -> CodingSet:
        """The attainable rows."""
        kept = np.flatnonzero(self.attainable)
        return CodingSet(self.structure[kept], self.faults, tuple(self.residuals[i] for i in kept))

    def __str__(self) -> str:
        first = (
            f"{self.plant.name}: {int(self.attainable.sum())} of {counted(len(self.residuals), 'row')} attainable"
            f"{' for constant faults' if self.constant else ''}; {counted(self.independent, 'independent residual')}"
        )
        return "\n".join([first, *code_table(self.residuals, self.structure, self.faults, self.reasons)])


def attainable(
    plant: Plant,
    structure: Structure | None = None,
    *,
    constant: bool = False,
    most: int = MOST_ROWS,
) -> Attainability:
    r"""Test rows of a structure for attainability, or list all that are attainable.

    A row is attainable when for every fault ``i`` that it answers to

    .. math:: \operatorname{rank}\begin{bmatrix} A-sE & B_d & B_0 & b_i\\ C & D_d & D_0 & d_i \end{bmatrix} >
       \operatorname{rank}\begin{bmatrix} A-sE & B_d & B_0\\ C & D_d & D_0 \end{bmatrix}

    for almost every ``s``, with the columns :math:`B_0, D_0` of the faults that it ignores.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not.
    structure : array_like of bool, sequence of str, mapping or CodingSet, optional
        As for :func:`residua.design.structured_bank`. All attainable rows are listed when omitted.
    constant : bool
        Whether a residual must answer for as long as a constant fault lasts, and not only while it changes. What it
        ignores it ignores for any time course.
    most : int
        Rows that are listed at most.

    Returns
    -------
    Attainability
        With the reason of each failure; prints as a table.

    Raises
    ------
    DesignError
        If the plant has no faults, the structure does not fit, or more than ``most`` rows are attainable.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant; disturbances and ignored faults may be any signals.

    After the disturbances are divided out, faults are columns over the rational functions. A residual that ignores
    some of them ignores all combinations of theirs, the *closure*; so the attainable rows are the complements of the
    closed sets, the flats of a matroid, and are enumerated as such. Of ``m`` independent residuals, one can ignore at
    most ``m - 1`` independent faults. Decided like :func:`residua.diagnosability`.

    References
    ----------
    Gertler (1991), section 4.1 (attainability).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.gertler(sensor_faults=True)
    >>> rs.coding.attainable(plant).digits
    ('1111', '0111', '1011', '1101', '1110')
    >>> print(rs.coding.attainable(plant, ["0111", "0011"]))
    Gertler, example 2: 1 of 2 rows attainable; 2 independent residuals
         1  2  3  4
    r1   .  x  x  x
    r2   .  .  x  x   a residual that ignores p1, p2 sees nothing: all measurements are used up
      1: p1
      2: p2
      3: y1 sensor
      4: y2 sensor
    """
    space = fault_space(plant)
    if structure is None:
        rows, reasons = {f"r{i + 1}": row for i, row in enumerate(all_rows(space, constant, most))}, {}
    else:
        rows = structure_rows(structure, plant.faults)
        reasons = {name: why for name, row in rows.items() if (why := _failure(space, row, constant))}
    table = np.array([*rows.values()], dtype=bool).reshape(len(rows), len(plant.faults))
    fine = np.array([name not in reasons for name in rows], dtype=bool)
    return Attainability(plant, plant.faults, tuple(rows), table, fine, reasons, space.dimension, constant)


def all_rows(space: FaultSpace, constant: bool, most: int) -> NDArray[np.bool_]:
    """Return every attainable row, those with fewest zeros first."""
    flats = space.flats(most)
    rows = [~flat for flat, basis in flats if not constant or space.lasting(basis)[~flat].all()]
    rows.sort(key=lambda row: (np.count_nonzero(~row), row.tolist()))
    return np.array(rows, dtype=bool).reshape(len(rows), len(space.faults))


def _failure(space: FaultSpace, row: NDArray[np.bool_], constant: bool) -> str:
    """Return why a row is not attainable; empty when it is."""
    ignored = [int(j) for j in np.flatnonzero(~row)]
    basis = space.basis(ignored)
    hidden = [int(j) for j in np.flatnonzero(space.closure(basis) & row)]
    who = f"a residual that ignores {_listed(space, ignored) or 'the disturbances'}"
    if hidden and space.dimension and len(basis) >= space.dimension:
        return f"{who} sees nothing: all measurements are used up"
    unseen = [j for j in hidden if not space.visible[j]]
    reasons = [f"no residual that ignores the disturbances sees {_listed(space, unseen)}"] if unseen else []
    by_hiders: dict[tuple[int, ...], list[int]] = {}
    for j in hidden:
        if space.visible[j]:
            by_hiders.setdefault(tuple(sorted(space.hiders(j, ignored))), []).append(j)
    for hiders, faults in by_hiders.items():
        one = f"a residual that ignores {_listed(space, hiders)} cannot see {_listed(space, faults)}"
        imitated = "it" if len(faults) == 1 else "them"
        because = "they span the same direction" if len(hiders) == 1 else f"together they can imitate {imitated}"
        reasons.append(f"{one}: {because}")
    if constant and not reasons:
        passing = [int(j) for j in np.flatnonzero(row & ~space.lasting(basis))]
        if passing:
            reasons.append(f"a constant {_listed(space, passing)} leaves no lasting trace in {who}")
    return "; ".join(reasons)


def _listed(space: FaultSpace, faults: list[int] | tuple[int, ...]) -> str:
    return ", ".join(space.faults[j] for j in faults)


@dataclass(frozen=True, eq=False, repr=False)
class MutualIsolability(Shown):
    """Pairs of faults that some residual tells apart, in both directions.

    Prints as a table.

    Attributes
    ----------
    faults : tuple of str
    matrix : ndarray of bool, shape (faults, faults)
        Symmetric: one residual answers to the first and ignores the second, and another one the other way round.
    groups : tuple of tuple of str
        Faults that are not mutually isolable; undetectable ones are in no group.
    reasons : mapping of str to str
        For each fault that is not mutually isolable from all others, why.
    """

    faults: tuple[str, ...]
    matrix: NDArray[np.bool_]
    groups: tuple[tuple[str, ...], ...]
    reasons: dict[str, str]

    def __bool__(self) -> bool:
        """True if all pairs are mutually isolable."""
        return not self.reasons

    def __str__(self) -> str:
        width = max(len(name) for name in self.faults) + 2
        lines = [" " * width + " ".join(f"{k + 1:>2}" for k in range(len(self.faults)))]
        for k, (name, row) in enumerate(zip(self.faults, self.matrix, strict=True)):
            cells = (" -" if j == k else " x" if apart else " ." for j, apart in enumerate(row))
            lines.append(f"{name:<{width}}" + " ".join(cells))
        return "\n".join([*lines, *(f"{name}: {why}" for name, why in self.reasons.items())])


def mutually_isolable(plant: Plant) -> MutualIsolability:
    r"""Find the pairs of faults that residuals can separate, whatever the method.

    Two faults are not mutually isolable when their columns :math:`g_i, g_j`, after the disturbances are divided out,
    are dependent over the polynomials, :math:`c_i(z) g_i(z) + c_j(z) g_j(z) = 0`: then no residual answers to one and
    ignores the other. Only another sensor cures that.

    Parameters
    ----------
    plant : Plant

    Returns
    -------
    MutualIsolability

    Raises
    ------
    DesignError
        If the plant has no faults.

    See Also
    --------
    residua.diagnosability : which of them are detectable, and what holds for constant faults.

    References
    ----------
    Gertler (1991), eq. (4-3).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[-1, 0], [1, -2]], [[1], [0]], [[1, 0], [0, 1]])
    >>> plant = plant.with_faults({"valve": [1, 0], "leak": [2, 0], "clog": [0, 1]})
    >>> print(rs.coding.mutually_isolable(plant))
            1  2  3
    valve   -  .  x
    leak    .  -  x
    clog    x  x  -
    valve: same effect on the outputs as leak, up to a filter
    leak: same effect on the outputs as valve, up to a filter
    """
    space = fault_space(plant)
    n = len(plant.faults)
    hidden = np.array([space.closure([i]) if space.visible[i] else np.ones(n, dtype=bool) for i in range(n)])
    apart = np.asarray(~hidden & ~hidden.T)
    reasons = {}
    for i, name in enumerate(plant.faults):
        others = [plant.faults[j] for j in np.flatnonzero(space.visible & ~apart[i]) if j != i]
        if not space.visible[i]:
            reasons[name] = space.why_unseen(i)
        elif others:
            reasons[name] = f"same effect on the outputs as {', '.join(others)}, up to a filter"
    return MutualIsolability(plant.faults, apart, group_twins(plant.faults, space.visible, ~hidden.T), reasons)
