"""A bank for any attainable structure: who fires when what fails."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.banks.bank import Bank, Wanted, build_bank
from residua.design.banks.decoupled_residual import decoupled_residual
from residua.errors import DesignError
from residua.linear import arrays
from residua.linear.rank import DEFAULT_RTOL
from residua.plant import Plant

Structure = ArrayLike | Sequence[str] | Mapping[str, Iterable[str]]


def structured_bank(
    plant: Plant,
    structure: Structure,
    *,
    margin: float | None = None,
    allow_missing: bool = False,
    rtol: float = DEFAULT_RTOL,
) -> Bank:
    r"""Design one residual per row of an incidence matrix: it answers to the ones and ignores the zeros.

    Each row is a :func:`decoupled_residual` that ignores its zeros and all disturbances. Since every residual that
    ignores them is a filtered version of that one, a row that fails here is attainable by no method.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not.
    structure : array_like of bool, shape (residuals, faults), or sequence of str, or mapping
        Columns in the order of ``plant.faults``; rows may be written ``"0111"``. A mapping gives for each residual
        name the faults that it answers to.
    margin : float, optional
        Stability margin of every member in 1/s; chosen for each when omitted.
    allow_missing : bool
        Whether rows that are not attainable are left out, and told in ``failures``, instead of raised.
    rtol : float
        Relative tolerance of every rank decision, in balanced units.

    Returns
    -------
    Bank

    Raises
    ------
    DesignError
        If a row is not attainable: with the faults that a residual which ignores its zeros cannot see.

    References
    ----------
    Gertler (1991), section 4; Massoumnia, Verghese and Willsky (1989), IEEE TAC 34(3).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.gertler()
    >>> print(rs.design.structured_bank(plant, ["01", "10"]))
    structured bank, 2 members
         1  2
    r1   .  x
    r2   x  .
      1: p1
      2: p2
    """
    wanted = [
        Wanted(
            name,
            tuple(fault for fault, one in zip(plant.faults, row, strict=True) if not one),
            tuple(fault for fault, one in zip(plant.faults, row, strict=True) if one),
        )
        for name, row in _rows(structure, plant).items()
    ]
    return build_bank(
        plant,
        wanted,
        lambda p: decoupled_residual(p, margin=margin, rtol=rtol),
        "structured bank",
        allow_missing=allow_missing,
        reference="Gertler (1991), section 4",
    )


def _rows(structure: Structure, plant: Plant) -> dict[str, NDArray[np.bool_]]:
    """Return the rows of a structure by name."""
    faults = plant.faults
    if not faults:
        raise DesignError("the plant has no faults: add some with with_sensor_faults or with_faults")
    if isinstance(structure, Mapping):
        rows = {}
        for name, seen in structure.items():
            rows[str(name)] = np.zeros(len(faults), dtype=bool)
            rows[str(name)][arrays.positions(seen, faults, "fault")] = True
        return _without_empty(rows)
    given: Any = [structure] if isinstance(structure, str) else structure
    if isinstance(given, Sequence) and given and all(isinstance(row, str) for row in given):
        wrong = [row for row in given if set(row) - {"0", "1"} or len(row) != len(faults)]
        if wrong:
            raise DesignError(f"row {wrong[0]!r}: expected {len(faults)} digits 0 or 1, one per fault")
        given = [[digit == "1" for digit in row] for row in given]
    try:
        M = np.atleast_2d(np.asarray(given, dtype=float))
    except (TypeError, ValueError) as error:
        raise DesignError(f"structure must be a matrix of 0 and 1: {error}") from error
    if M.ndim != 2 or M.shape[1] != len(faults) or not np.isin(M, (0, 1)).all():
        raise DesignError(
            f"structure must be 0 or 1, residuals x {len(faults)} faults ({', '.join(faults)}), got shape {M.shape}"
        )
    return _without_empty({f"r{i + 1}": row.astype(bool) for i, row in enumerate(M)})


def _without_empty(rows: dict[str, NDArray[np.bool_]]) -> dict[str, NDArray[np.bool_]]:
    """Raise for rows that would answer to nothing."""
    for name, row in rows.items():
        if not row.any():
            raise DesignError(f"row {name!r} of the structure answers to no fault")
    if not rows:
        raise DesignError("the structure has no rows")
    return rows
