"""User input of the polynomial matrices of an input-output model, as checked values in powers of z or s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import index_of
from residua.errors import ModelError
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix

#: A polynomial per output: a sequence, or ``{output: polynomial}`` with zeros where nothing is given.
Column = Sequence[ArrayLike] | Mapping[str, ArrayLike]


def checked_variable(variable: str | None, dt: float) -> str:
    """Return the variable of the polynomials, ``"z"``, ``"1/z"`` or ``"s"``."""
    known = ("z", "1/z") if dt else ("s",)
    if variable is None:
        return known[0]
    if variable not in known:
        kind = f"sampled model (dt={dt:g})" if dt else "continuous model (dt=0)"
        raise ModelError(f"variable must be {' or '.join(map(repr, known))} for a {kind}, got {variable!r}")
    return variable


def output_polynomials(H: Any, variable: str) -> PolynomialMatrix:
    """Return ``H`` as a square matrix, from a matrix, nested lists or the list of its diagonal."""
    if not isinstance(H, PolynomialMatrix):
        rows = _listed(H, "H")
        if not rows or not all(_is_sequence(row) and len(row) for row in rows):
            raise ModelError(
                "H must be a list of one polynomial per output (its diagonal), or of rows of polynomials; a single "
                "output with z - 0.9 is [[1, -0.9]]"
            )
        if not any(_is_sequence(entry) for row in rows for entry in row):
            m = len(rows)
            rows = [[row if i == j else [0.0] for j in range(m)] for i, row in enumerate(rows)]
        H = _from_entries(rows, variable, "H")
    if H.shape[0] != H.shape[1] or not H.shape[0]:
        raise ModelError(f"H must be square, one row and one column per output, got {H.shape[0]} x {H.shape[1]}")
    return H


def input_polynomials(G: Any, outputs: int, variable: str) -> PolynomialMatrix:
    """Return ``G`` as a matrix with one row per output, from a matrix or nested lists."""
    if not isinstance(G, PolynomialMatrix):
        rows = _listed(G, "G")
        if not all(_is_sequence(row) for row in rows):
            raise ModelError("G must be a list of rows, one per output, each a list of one polynomial per input")
        if not any(_is_sequence(entry) for row in rows for entry in row) and any(len(row) > 1 for row in rows):
            raise ModelError(
                "G is a matrix of numbers, which may mean constants or one list of coefficients per output: write "
                "every entry as a list of coefficients, [[[1.5, -0.65]], [[1.1, -0.95]]] for two outputs and one input"
            )
        G = _from_entries(rows, variable, "G")
    if G.shape[0] != outputs:
        raise ModelError(f"G must have one row per output, {outputs}, got {G.shape[0]}")
    return G


def columns(given: Mapping[str, Column], outputs: tuple[str, ...], what: str, variable: str) -> PolynomialMatrix:
    """Return one column of polynomials per disturbance or fault."""
    if not isinstance(given, Mapping):
        raise ModelError(f"{what}s must be a mapping {{name: one polynomial per output}}")
    found: list[list[Any]] = [[] for _ in outputs]
    for name, value in given.items():
        if isinstance(value, Mapping):
            entries: list[Any] = [[0.0] for _ in outputs]
            for key, entry in value.items():
                try:
                    at = index_of(key, outputs, "output")
                except ModelError as error:
                    raise ModelError(f"{what} {name!r}: {error}") from None
                entries[at] = entry
        else:
            entries = _listed(value, f"{what} {name!r}")
        if len(entries) != len(outputs):
            raise ModelError(
                f"{what} {name!r}: expected {len(outputs)} polynomials, one per output, got {len(entries)}"
            )
        for row, entry, output in zip(found, entries, outputs, strict=True):
            row.append(polynomial(entry, f"{what} {name!r}, output {output!r}"))
    P = _from_entries(found, variable, what)
    for j, name in enumerate(given):
        if not np.any(P.coefficients[:, :, j]):
            raise ModelError(f"{what} {name!r} has no effect: its polynomials are zero")
    return P


def row_delays(*parts: PolynomialMatrix) -> tuple[int, ...]:
    """Return for each row the highest power of the variable in any of the matrices."""
    return tuple(max(degrees) for degrees in zip(*(part.row_degrees for part in parts), strict=True))


def in_z(P: PolynomialMatrix, delays: Sequence[int]) -> PolynomialMatrix:
    """Return a matrix in powers of ``1/z`` with row ``i`` multiplied by ``z**delays[i]``, in powers of ``z``."""
    C = P.padded(max(delays, default=0))
    out = np.zeros((max(delays, default=0) + 1, *P.shape))
    for i, delay in enumerate(delays):
        out[: delay + 1, i] = C[: delay + 1, i][::-1]
    return PolynomialMatrix(out)


def multiplied(P: PolynomialMatrix, powers: Sequence[int]) -> PolynomialMatrix:
    """Return a matrix with row ``i`` multiplied by ``z**powers[i]``."""
    C = P.coefficients
    out = np.zeros((len(C) + max(powers, default=0), *P.shape))
    for i, power in enumerate(powers):
        out[power : power + len(C), i] = C[:, i]
    return PolynomialMatrix(out)


def in_other_time(P: PolynomialMatrix, factor: float, degrees: Sequence[int]) -> PolynomialMatrix:
    """Return a matrix in ``s``, given its row degrees, in a unit of time in which rates are ``factor`` as large."""
    powers = factor ** (np.array(degrees) - np.arange(P.degree + 1.0)[:, None])
    return PolynomialMatrix(P.coefficients * powers[:, :, None])


def polynomial(entry: Any, where: str) -> NDArray[np.float64]:
    """Return the coefficients of one entry in the given order, or raise with the mistake."""
    kind = "a polynomial must be a number or a list of coefficients"
    try:
        if np.iscomplexobj(entry):
            kind = f"{kind}, real ones"
        values = np.atleast_1d(np.asarray(entry, dtype=float))
    except (TypeError, ValueError):
        raise ModelError(f"{where}: {kind}, got {entry!r}") from None
    if values.ndim != 1:
        raise ModelError(f"{where}: {kind}, got {entry!r}")
    if not values.size:
        raise ModelError(f"{where} is an empty list: write 0 for a polynomial that is zero")
    if not np.isfinite(values).all():
        raise ModelError(f"{where} has the coefficient {values[~np.isfinite(values)][0]}: all must be finite numbers")
    return values


def _from_entries(rows: Sequence[Sequence[Any]], variable: str, name: str) -> PolynomialMatrix:
    """Return the matrix in powers of ``z`` or ``s``, or of ``1/z`` if that is the variable."""
    lengths = [len(row) for row in rows]
    if len(set(lengths)) > 1:
        raise ModelError(f"the rows of {name} must have one length, got {', '.join(map(str, lengths))} entries")
    checked = [[polynomial(e, f"{name}[{i}, {j}]") for j, e in enumerate(row)] for i, row in enumerate(rows)]
    if variable == "1/z":  # coefficients of 1, 1/z, 1/z^2, ...: the first is that of the lowest power
        checked = [[entry[::-1] for entry in row] for row in checked]
    return PolynomialMatrix.from_entries(checked)


def _is_sequence(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))


def _listed(value: Any, what: str) -> list[Any]:
    if not isinstance(value, (Sequence, np.ndarray)) or isinstance(value, (str, bytes)):
        raise ModelError(f"{what} must be a PolynomialMatrix or nested lists of coefficients, got {value!r}")
    return list(value)
