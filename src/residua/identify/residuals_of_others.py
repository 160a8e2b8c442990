"""Residuals that someone else computed: another program, or another model, as a generator that a monitor can run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import names as checked_names, positions
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import Member, ResidualGenerator, make_generator
from residua.errors import DataError, ModelError
from residua.linear import StateSpace
from residua.plant import Plant

#: The limit of a signature matrix.
_CODES = "a signature matrix says which residuals answer to a fault, not by how much: isolate by code (Structured)"


def given_residuals(
    residuals: int | Iterable[str],
    structure: ArrayLike | Mapping[str, Iterable[str]] | None = None,
    *,
    faults: Iterable[str] | None = None,
    dt: float = 1.0,
    units: Mapping[str, str] | None = None,
    name: str = "given residuals",
) -> ResidualGenerator:
    r"""Return a generator that hands on residuals which were computed elsewhere.

    .. math:: r_k = y_k

    where the "outputs" of its plant are the residuals themselves. So they have what residuals of a model have here:
    a monitor with thresholds from fault-free samples, isolation by the fault signature matrix, pages and files.

    Guaranteed: the residual of sample ``k`` is row ``k`` of the data, to the last bit, and nothing settles.

    Parameters
    ----------
    residuals : int or sequence of str
        Their number (``r1``, ``r2``, ...), or their names: the columns of the data.
    structure : array_like of bool, shape (residuals, faults), or mapping of str to sequence of str, optional
        The fault signature matrix: which residuals answer to which fault. A mapping has the residuals of each fault, by
        name. Without it faults are detected and not named.
    faults : sequence of str, optional
        Their names, for a matrix: ``f1``, ``f2``, ... when omitted.
    dt : float
        Seconds from one sample to the next.
    units : mapping of str to str, optional
        Units of the residuals, for plots and tables.
    name : str
        Used in tables and reports.

    Returns
    -------
    ResidualGenerator
        With a signature matrix a bank of as many members as there are residuals, whose codes are its rows.

    Raises
    ------
    ModelError
        If a name occurs twice, or is not known; or a fault moves no residual.
    DataError
        If the matrix is not of zeros and ones, or has not a row for each residual.

    See Also
    --------
    residua.Monitor : Fit it with ``fit(None, samples)``, run it with ``run(None, samples)``.
    residua.decide.Structured : Names the fault whose residuals fired.
    residua.decide.consistent_faults : Ranks the faults that can explain which residuals fired, where few of them do.

    Notes
    -----
    Assumes: the rows of a recording follow upon one another in time, ``dt`` apart. Windows, persistence, and how many
    independent samples a recording is worth go by that. Rows of several recordings, or shuffled ones, are several
    recordings: ``fit([(None, first), (None, second)])``. The residuals need no normalisation, and no zero mean.

    References
    ----------
    Gertler (1991), section 4 (signature matrices); Frisk and Krysander (2018), IFAC SAFEPROCESS.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> made = rs.identify.given_residuals(["r1", "r2", "r3"], {"pump": ["r1", "r2"], "valve": ["r2", "r3"]})
    >>> monitor = rs.Monitor(made)
    >>> normal, new = np.split(np.random.default_rng(0).standard_normal((2200, 3)), [2000])
    >>> diagnosis = monitor.fit(None, normal).run(None, new + [9, 9, 0])
    >>> diagnosis.candidates[0].name
    'pump'
    """
    if isinstance(residuals, (int, np.integer)) and not isinstance(residuals, bool):
        columns = checked_names(None, int(residuals), "r", "residuals")
    else:
        wanted = tuple(residuals) if not isinstance(residuals, str) else (residuals,)  # pyright: ignore
        columns = checked_names(wanted, len(wanted), "r", "residuals")
    k = len(columns)
    plant = Plant(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((k, 0)), dt=dt, outputs=columns, name=name, units=units)
    codes = None if structure is None else _codes(structure, faults, columns)
    if codes is None and faults is not None:
        raise ModelError("faults are named, and no structure says which residuals answer to them")
    if codes is not None:
        plant = plant.with_faults({fault: ([], column.astype(float)) for fault, column in codes.items()})
    nothing = np.zeros((0, 0))
    system = StateSpace(nothing, np.zeros((0, k)), np.zeros((k, 0)), np.eye(k), dt=dt, inputs=columns, outputs=columns)
    table = None if codes is None else np.array(list(codes.values()), dtype=bool).T
    members = (
        ()
        if table is None
        else tuple(Member(columns[i], (i,), tuple(np.array(plant.faults)[row].tolist())) for i, row in enumerate(table))
    )
    return make_generator(
        system,
        plant,
        "residuals computed elsewhere",
        Evidence("residuals computed elsewhere", notes=() if codes is None else (_CODES,)),
        decouples=Decoupled(),
        state_map=nothing,
        members=members,
        codes=table,
    )


def _codes(structure: Any, faults: Iterable[str] | None, residuals: tuple[str, ...]) -> dict[str, NDArray[np.bool_]]:
    """Return the column of each fault of a signature matrix."""
    if isinstance(structure, Mapping):
        if faults is not None:
            raise ModelError("a structure that is a mapping names the faults itself: leave faults out")
        columns = {}
        for fault, named in structure.items():
            columns[str(fault)] = np.zeros(len(residuals), dtype=bool)
            columns[str(fault)][positions(named, residuals, "residual")] = True
    else:
        table = np.asarray(structure)
        if table.ndim != 2 or len(table) != len(residuals):
            raise DataError(f"structure must have a row for each residual ({len(residuals)}), got shape {table.shape}")
        if table.dtype != bool and (table.dtype.kind not in "iuf" or not np.isin(table, (0, 1)).all()):
            raise DataError("structure must be true or false, or 0 or 1")
        wanted = None if faults is None else (faults,) if isinstance(faults, str) else tuple(faults)
        fault_names = checked_names(wanted, table.shape[1], "f", "faults")
        columns = dict(zip(fault_names, table.astype(bool).T, strict=True))
    silent = [fault for fault, column in columns.items() if not column.any()]
    if silent:
        them = "it" if len(silent) == 1 else "them"
        raise ModelError(
            f"no residual answers to {', '.join(map(repr, silent))}: leave {them} out, nothing can show {them}"
        )
    return columns
