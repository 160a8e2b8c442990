"""Input-output models from transfer functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import modes_with_uncertainty
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.linear.polynomials.polynomial_null_space import shortest_left_null_vectors
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.plant.conversion import system_labels, system_step
from residua.plant.input_output_conversion import as_matrices
from residua.plant.input_output_entries import polynomial
from residua.plant.input_output_model import InputOutputModel
from residua.plant.input_output_realization import lost_modes
from residua.plant.observer_form import check_response, response_error, response_points, unit_of_variable
from residua.tolerances import RESIDUE

Entry = tuple[NDArray[np.float64], NDArray[np.float64]]


def input_output_from_transfer_functions(
    system: Any, *, dt: float | None = None, rtol: float = DEFAULT_RTOL, tolerance: float = 1e-6, **options: Any
) -> InputOutputModel:
    r"""Return an input-output model of transfer functions, with the least common denominator of each row.

    For the entries :math:`n_j / d_j` of a row, the smallest polynomial row with :math:`h n_j = g_j d_j` for all ``j``
    gives :math:`h\, y_i = \sum_j g_j u_j`. Common factors of numerator and denominator are divided out.

    Parameters
    ----------
    system : object
        Rows of entries ``(numerator, denominator)`` or numbers, coefficients highest power first; or whatever has the
        attributes ``num`` and ``den``: python-control's and SciPy's transfer functions.
    dt : float, optional
        The step in seconds (0: continuous); 1.0 for rows of entries when omitted. It cannot contradict the system.
    rtol : float
        For the rank decisions that find the degrees.
    tolerance : float
        Largest error of the frequency response, of each entry relative to itself or to a thousandth of its peak.
    **options
        Further arguments of :class:`InputOutputModel`: ``inputs``, ``outputs``, ``measured_inputs``, ``name``, ...

    Returns
    -------
    InputOutputModel

    Raises
    ------
    ModelError
        If an entry is malformed or not proper, the time base is open, or a mode that is not stable is divided out: in
        a denominator, and in no equation that is left.
    AccuracyError
        If the frequency response is missed by more than the tolerance.

    Examples
    --------
    >>> S = [[([1], [1, -0.5]), ([1], [1, -0.9, 0.2])]]
    >>> print(input_output_from_transfer_functions(S, inputs=["valve", "pump"]))
    (z^2 - 0.9 z + 0.2) y1 = (z - 0.4) valve + pump
    """
    entries, step, labels = _entries(system, dt)
    if not entries or len({len(row) for row in entries}) != 1:
        raise ModelError("transfer functions must be rows of equal length, one per output")
    m, k = len(entries), len(entries[0])
    denominators = [den for row in entries for _, den in row]
    unit = unit_of_variable(_diagonal(denominators)) if denominators else 1.0
    rows = [_least_common_row(row, unit, rtol) for row in entries]
    roots = [_roots(np.ones(1)), *(_roots(h[::-1]) for h, _ in rows)]
    kept, moved = map(np.concatenate, zip(*roots, strict=True))
    lost = []
    for modes, doubt in map(_roots, denominators):
        lost += lost_modes(modes, doubt, kept, moved, step, float(np.abs(modes).max(initial=0.0)))
    if lost:
        raise ModelError(
            f"mode {describe_modes(lost)} is in a denominator but cancels against the numerator, and it is not "
            "stable: a plant without it would not behave like these transfer functions; divide the common factor out "
            "if it does not belong to the plant, or give the equations with the disturbance or fault that reaches it"
        )
    H, N = as_matrices(rows, 1.0, m, k)
    model = InputOutputModel(H, N, dt=step, rtol=rtol, **(labels | options))
    poles = np.concatenate([np.zeros(0, complex), *(np.roots(den).astype(complex) for den in denominators)])
    points = response_points(poles, step)
    exact = [[np.polyval(num, points) / np.polyval(den, points) for num, den in row] for row in entries]
    response = np.array(exact, dtype=complex).reshape(m, k, len(points)).transpose(2, 0, 1)
    check_response(
        response_error(model.transfer(points), response, np.abs(response)),
        tolerance,
        f"the common denominators of degree {max(H.row_degrees)}",
        "some denominators are nearly the same; round what is meant to be equal, or give H and G",
    )
    return model


def _roots(polynomial: NDArray) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return the roots of a polynomial, highest power first, and the effect of rounding on each."""
    found = np.trim_zeros(np.asarray(polynomial, dtype=float), "f")
    return modes_with_uncertainty(scipy.linalg.companion(found) if len(found) > 1 else np.zeros((0, 0)))


def _diagonal(polynomials: Sequence[NDArray[np.float64]]) -> PolynomialMatrix:
    zero = np.zeros(1)
    count = range(len(polynomials))
    return PolynomialMatrix.from_entries([[polynomials[i] if i == j else zero for j in count] for i in count])


def _least_common_row(row: Sequence[Entry], unit: float, rtol: float) -> tuple[NDArray, NDArray]:
    """Return ``h`` and the numerators of one row, lowest power first."""
    if not row:
        return np.ones(1), np.zeros((1, 0))
    top = PolynomialMatrix.from_entries([[num for num, _ in row]])
    P = top.above(-_diagonal([den for _, den in row]))
    most = sum(max(len(num), len(den)) - 1 for num, den in row)
    found = shortest_left_null_vectors(P, most=most, rtol=rtol, variable=unit)
    if found is None or len(found.vectors) != 1:
        raise AccuracyError(
            f"the least common denominator is not clear with rtol={rtol:.3g}: choose another rtol, or round "
            "denominators that are meant to be equal"
        )
    scaled = found.vectors[0] * unit ** np.arange(found.degree + 1.0)[:, None]
    h = scaled[:, 0]
    size = np.abs(h).max()
    if not size:
        raise AccuracyError("the least common denominator came out zero: choose another rtol")
    g = np.where(np.abs(scaled[:, 1:]) > RESIDUE * np.abs(scaled[:, 1:]).max(axis=0), scaled[:, 1:], 0.0)
    h = np.where(np.abs(h) > RESIDUE * size, h, 0.0)
    powers = unit ** -np.arange(found.degree + 1.0)
    return h * powers, g * powers[:, None]


def _entries(system: Any, dt: float | None) -> tuple[list[list[Entry]], float, dict[str, Any]]:
    """Return checked entries, the step, and the labels of a system."""
    if all(hasattr(system, letter) for letter in "ABCD"):
        raise ModelError(
            "this is a state-space system: make a plant of it with Plant.from_state_space, and the model with "
            "InputOutputModel.from_plant"
        )
    if not hasattr(system, "num") or not hasattr(system, "den"):
        try:
            rows = [list(row) for row in system]
        except TypeError as error:
            raise ModelError(f"expected rows of (numerator, denominator), got {type(system).__name__}") from error
        return _checked(rows), 1.0 if dt is None else float(dt), {}
    step = system_step(getattr(system, "dt", None), dt, system)
    num, den = system.num, system.den
    if _depth(den) < 2:  # SciPy: one denominator, and one numerator or one per output
        rows = [[(row, den)] for row in np.atleast_2d(np.asarray(num, dtype=float))]
    else:
        rows = [list(zip(*pair, strict=True)) for pair in zip(num, den, strict=True)]
    labels: dict[str, Any] = {
        "inputs": system_labels(system, "input", len(rows[0])),
        "outputs": system_labels(system, "output", len(rows)),
    }
    if isinstance(getattr(system, "name", None), str):
        labels["name"] = system.name
    return _checked(rows), step, labels


def _depth(value: Any) -> int:
    """Return the number of brackets around the first number."""
    return 0 if np.isscalar(value) or not len(value) else 1 + _depth(value[0])


def _checked(rows: Sequence[Sequence[Any]]) -> list[list[Entry]]:
    return [[_entry(entry, f"entry [{i}, {j}]") for j, entry in enumerate(row)] for i, row in enumerate(rows)]


def _entry(entry: Any, where: str) -> Entry:
    """Return numerator and denominator of one entry, without leading zeros."""
    pair = (entry, [1.0]) if np.isscalar(entry) else entry
    if isinstance(pair, (str, bytes)) or not hasattr(pair, "__len__") or len(pair) != 2:
        raise ModelError(f"{where} must be a number or (numerator, denominator), got {entry!r}")
    num = np.trim_zeros(polynomial(pair[0], f"the numerator of {where}"), "f")
    den = np.trim_zeros(polynomial(pair[1], f"the denominator of {where}"), "f")
    if not len(den):
        raise ModelError(f"the denominator of {where} is zero")
    return num if len(num) else np.zeros(1), den
