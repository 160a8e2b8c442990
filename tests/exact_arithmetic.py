"""Oracles that share no code with the package: responses with seventy digits, and ranks and zeros modulo a prime.

Every float is a fraction with a power of two below, so that both are exact about the numbers that a filter is made of.
"""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

import residua as rs

PRIME = 2**61 - 1
DIGITS = 70

Number = tuple[Decimal, Decimal]


def _times(a: Number, b: Number) -> Number:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _minus(a: Number, b: Number) -> Number:
    return a[0] - b[0], a[1] - b[1]


def _size(a: Number) -> Decimal:
    return (a[0] * a[0] + a[1] * a[1]).sqrt()


def _over(a: Number, b: Number) -> Number:
    q = b[0] * b[0] + b[1] * b[1]
    return (a[0] * b[0] + a[1] * b[1]) / q, (a[1] * b[0] - a[0] * b[1]) / q


def _number(x: complex) -> Number:
    return Decimal(float(np.real(x))), Decimal(float(np.imag(x)))


def _solved(M: list[list[Number]], B: list[list[Number]]) -> list[list[Number]]:
    n = len(M)
    rows = [list(M[i]) + list(B[i]) for i in range(n)]
    for c in range(n):
        best = max(range(c, n), key=lambda i: _size(rows[i][c]))
        rows[c], rows[best] = rows[best], rows[c]
        for i in range(n):
            if i != c and any(rows[i][c]):
                f = _over(rows[i][c], rows[c][c])
                rows[i] = [_minus(x, _times(f, y)) for x, y in zip(rows[i], rows[c], strict=True)]
    return [[_over(x, rows[i][i]) for x in rows[i][n:]] for i in range(n)]


def response(system: rs.StateSpace, z: complex) -> list[list[Number]]:
    """Return ``C (z I - A)^-1 B + D``; call it within ``localcontext(prec=DIGITS)``."""
    n = system.n_states
    s, zero = _number(z), (Decimal(0), Decimal(0))
    M = [[_minus(s if i == j else zero, _number(system.A[i, j])) for j in range(n)] for i in range(n)]
    X = _solved(M, [[_number(x) for x in row] for row in system.B])
    out = []
    for i in range(system.n_outputs):
        row = []
        for j in range(system.n_inputs):
            total = _number(system.D[i, j])
            for k in range(n):
                term = _times(_number(system.C[i, k]), X[k][j])
                total = total[0] + term[0], total[1] + term[1]
            row.append(total)
        out.append(row)
    return out


def exact_leaks(
    system: rs.StateSpace, plant: rs.Plant, points: NDArray[np.complex128]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the peaks over points of what controls and disturbances do to residuals, and of the sum of its terms."""
    n_u, roles = len(plant.inputs), plant.system(("control", "disturbance"))
    shape = len(points), system.n_outputs, roles.n_inputs
    leaks, sizes = np.zeros(shape), np.zeros(shape)
    with localcontext() as context:
        context.prec = DIGITS
        for k, z in enumerate(points):
            Q, P = response(system, z), response(roles, z)
            for i, j in np.ndindex(shape[1:]):
                terms = [_times(Q[i][n_u + m], P[m][j]) for m in range(len(P))] + ([Q[i][j]] if j < n_u else [])
                total = sum((x[0] for x in terms), Decimal(0)), sum((x[1] for x in terms), Decimal(0))
                leaks[k, i, j], sizes[k, i, j] = _size(total), sum((_size(x) for x in terms), Decimal(0))
    return leaks.max(axis=0), sizes.max(axis=0)


def modular(M: NDArray) -> list[list[int]]:
    """Return a matrix of floats, which are fractions, modulo the prime."""
    out = []
    for row in np.atleast_2d(M):
        pairs = [float(x).as_integer_ratio() for x in row]
        out.append([p % PRIME * pow(q, -1, PRIME) % PRIME for p, q in pairs])
    return out


def rank(M: NDArray, z: int, E: NDArray) -> int:
    """Return the rank of ``M - z E`` modulo the prime: that over the rational functions, but for an unlucky ``z``."""
    a, e = modular(M), modular(E)
    rows = [[(x - z * y) % PRIME for x, y in zip(r, s, strict=True)] for r, s in zip(a, e, strict=True)]
    done = 0
    for c in range(len(rows[0]) if rows else 0):
        pivot = next((i for i in range(done, len(rows)) if rows[i][c]), None)
        if pivot is None:
            continue
        rows[done], rows[pivot] = rows[pivot], rows[done]
        inverse = pow(rows[done][c], -1, PRIME)
        for i in range(done + 1, len(rows)):
            f = rows[i][c] * inverse % PRIME
            if f:
                rows[i] = [(x - f * y) % PRIME for x, y in zip(rows[i], rows[done], strict=True)]
        done += 1
    return done


def normal_rank(A: NDArray, B: NDArray, C: NDArray, D: NDArray, z: int) -> int:
    """Return the rank of ``C (z I - A)^-1 B + D`` over the rational functions."""
    n = len(A)
    E = np.zeros((n + len(C), n + B.shape[1]))
    E[:n, :n] = np.eye(n)
    return rank(np.block([[A, B], [C, D]]), z, E) - n


def reaches(A: NDArray, B: NDArray, C: NDArray, D: NDArray, z: int) -> NDArray[np.bool_]:
    """Tell which entries of ``C (z I - A)^-1 B + D`` are not zero."""
    rows, columns = range(len(C)), range(B.shape[1])
    return np.array(
        [[normal_rank(A, B[:, [j]], C[[i]], D[[i]][:, [j]], z) > 0 for j in columns] for i in rows], dtype=bool
    ).reshape(len(C), B.shape[1])
