"""Solutions of ``(s E - A) X = B`` at many points ``s``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from residua.errors import ModelError
from residua.linear.subspaces.parts import connected_parts
from residua.linear.systems.array_cache import Latest, entries

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: From so many states on factors are computed point by point: below, one call for all points is faster.
_STATES = 32
#: Factors of more bytes are made for one point at a time, and not kept.
_MOST_BYTES = 2**24


def independent_parts(A: Real, E: Real | None) -> list[NDArray[np.int_]]:
    """Return the states of a system in groups that nothing couples; those of small systems in one."""
    if len(A) < _STATES:
        return [np.arange(len(A))]
    return connected_parts(A != 0 if E is None else (A != 0) | (E != 0))


def solutions(A: Real, E: Real | None, points: Complex, B: Real, C: Real | None = None) -> tuple[Complex, Complex]:
    r"""Return :math:`X = (sE - A)^{-1} B` and :math:`Y = C (sE - A)^{-1}` at complex points.

    By Gaussian elimination, once for both. A Hessenberg form, the same for all points, would take fewer operations
    where there are few inputs and outputs, but it mixes all entries: responses far smaller than others, as through a
    long chain of states, would be lost in its rounding, and elimination keeps them.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    E : ndarray, shape (n, n), or None
    points : ndarray of complex, shape (k,)
    B : ndarray, shape (n, m)
    C : ndarray, shape (p, n), optional

    Returns
    -------
    X : ndarray of complex, shape (k, n, m)
    Y : ndarray of complex, shape (k, p, n)
        Without rows if there is no ``C``.

    Raises
    ------
    ModelError
        If a point is a pole.
    """
    C = np.zeros((0, len(A))) if C is None else C
    with _poles_named():
        if len(A) < _STATES:
            M = _at_points(A, E, points)
            X, Y = np.linalg.solve(M, _at_each(B, points)), _at_each(C, points)
            if len(C):
                Y = np.linalg.solve(M.swapaxes(1, 2), Y.swapaxes(1, 2)).swapaxes(1, 2)
            return np.asarray(X, dtype=complex), np.asarray(Y, dtype=complex)
        rows, columns = _at_each(B.T, points), _at_each(C, points)
        for of_point, x, y in zip(_factored(A, E, points), rows, columns, strict=True):
            _solve(of_point, x, 0)
            _solve(of_point, y, 1)
        return rows.swapaxes(1, 2), columns


def solver(A: Real, E: Real | None, points: Complex) -> Callable[[Complex], Complex]:
    """Return what solves ``(s E - A) X = B`` for a ``B`` at each point, shape (k, n, m), any number of times.

    Raises
    ------
    ModelError
        If a point is a pole.
    """
    if len(A) < _STATES:
        M = _at_points(A, E, points)

        def solved(B: Complex) -> Complex:
            with _poles_named():
                return np.asarray(np.linalg.solve(M, B), dtype=complex)

        return solved
    with _poles_named():
        factors = list(_each(*_all_factors(A, E, points)))

    def eliminated(B: Complex) -> Complex:
        rows = B.swapaxes(1, 2).copy()
        for of_point, x in zip(factors, rows, strict=True):
            _solve(of_point, x, 0)
        return rows.swapaxes(1, 2)

    return eliminated


@contextmanager
def _poles_named() -> Iterator[None]:
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise ModelError(f"the system has a pole at one of the points asked for: {error}") from error


def _at_each(M: Real, points: Complex) -> Complex:
    return np.broadcast_to(M, (len(points), *M.shape)).astype(complex, order="C")


def _at_points(A: Real, E: Real | None, points: Complex) -> Complex:
    return points[:, None, None] * (np.eye(len(A)) if E is None else E) - A


_latest: Latest[tuple[Complex, NDArray]] = Latest(kept=4)


def _factored(A: Real, E: Real | None, points: Complex) -> Iterator[tuple[Complex, NDArray]]:
    """Return for each point the triangular factors of ``s E - A`` and the order of its rows, to use before the next.

    The latest are kept: a check of a design often asks for the points of the one before it.
    """
    if _are_many(A, points):
        return _eliminated(A, E, points)
    return _each(*_all_factors(A, E, points))


def _are_many(A: Real, points: Complex) -> bool:
    return 2 * A.nbytes * len(points) > _MOST_BYTES


def _all_factors(A: Real, E: Real | None, points: Complex) -> tuple[Complex, NDArray]:
    """Return the factors at all points; if they are not too many they are kept."""
    if _are_many(A, points):
        return _factors(A, E, points)
    return _latest.of(entries(A, E, points), lambda: _factors(A, E, points))


def _each(factors: Complex, pivots: NDArray) -> Iterator[tuple[Complex, NDArray]]:
    return zip(factors.swapaxes(1, 2), pivots, strict=True)


def _factors(A: Real, E: Real | None, points: Complex) -> tuple[Complex, NDArray]:
    """Return the transposes of the triangular factors of ``s E - A`` at each point, and the orders of its rows."""
    M, pivots = np.empty((len(points), *A.shape), dtype=complex), np.zeros((len(points), len(A)), dtype=np.int32)
    for k, (_, order) in enumerate(_eliminated(A, E, points, M)):
        pivots[k] = order
    return M, pivots


def _eliminated(
    A: Real, E: Real | None, points: Complex, place: Complex | None = None
) -> Iterator[tuple[Complex, NDArray]]:
    """Yield the factors at each point and the orders of rows: each in its place, or each in that of the one before."""
    constant = (-A.T).astype(complex, order="C")  # LAPACK wants columns
    n, diagonal = len(A), A.diagonal()
    one = np.empty(A.shape, dtype=complex)
    for k, s in enumerate(points):
        M = one if place is None else place[k]
        M[...] = constant
        if E is None:
            M.ravel()[:: n + 1] = s - diagonal
        else:
            M += s * E.T
        _, pivots, info = lapack.zgetrf(M.T, overwrite_a=1)  # in place
        if info > 0:
            raise np.linalg.LinAlgError("Singular matrix")
        yield M.T, pivots


def _solve(factors: tuple[Complex, NDArray], right: Complex, transposed: int) -> None:
    """Replace the rows of right-hand sides by the solutions."""
    if right.size:
        right[...] = lapack.zgetrs(*factors, right.T, trans=transposed, overwrite_b=1)[0].T
