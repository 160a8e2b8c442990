"""Oracles that share no code with the package: responses with seventy digits, and ranks modulo a prime.

Every float is a fraction with a power of two below, so that both are exact about the numbers that a filter is made of.
"""

from __future__ import annotations

import numpy as np
from flint import acb, acb_mat, arb, ctx
from numpy.typing import NDArray

import residua as rs
from exact.matrices import PRIME, exact, rank_modulo, residues

_BITS = 240  # seventy digits


def _matrix(M: NDArray) -> acb_mat:
    rows, columns = M.shape
    return acb_mat(rows, columns, M.ravel().tolist())


def response(system: rs.StateSpace, z: complex) -> acb_mat:
    """Return ``C (z I - A)^-1 B + D``."""
    D = _matrix(system.D)
    if not system.n_states:
        return D
    shifted = _matrix(np.eye(system.n_states)) * acb(z.real, z.imag) - _matrix(system.A)
    return _matrix(system.C) * shifted.solve(_matrix(system.B)) + D


def exact_leaks(
    system: rs.StateSpace, plant: rs.Plant, points: NDArray[np.complex128]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the peaks over points of what controls and disturbances do to residuals, and of the sum of its terms."""
    n_u, roles = len(plant.inputs), plant.system(("control", "disturbance"))
    shape = len(points), system.n_outputs, roles.n_inputs
    leaks, sizes = np.zeros(shape), np.zeros(shape)
    before, ctx.prec = ctx.prec, _BITS
    try:
        for k, z in enumerate(points.tolist()):
            Q, P = response(system, z), response(roles, z)
            for i, j in np.ndindex(shape[1:]):
                terms = [Q[i, n_u + m] * P[m, j] for m in range(P.nrows())] + ([Q[i, j]] if j < n_u else [])
                leaks[k, i, j] = float(abs(sum(terms, acb(0))).mid())
                sizes[k, i, j] = float(sum((abs(x) for x in terms), arb(0)).mid())
    finally:
        ctx.prec = before
    return leaks.max(axis=0), sizes.max(axis=0)


def normal_rank(A: NDArray, B: NDArray, C: NDArray, D: NDArray, z: int) -> int:
    """Return the rank of ``C (z I - A)^-1 B + D`` over the rational functions, but for an unlucky ``z``."""
    n = len(A)
    rows = residues(exact(np.block([[A, B], [C, D]])))
    return rank_modulo([[(x - z * (i == j < n)) % PRIME for j, x in enumerate(row)] for i, row in enumerate(rows)]) - n


def reaches(A: NDArray, B: NDArray, C: NDArray, D: NDArray, z: int) -> NDArray[np.bool_]:
    """Tell which entries of ``C (z I - A)^-1 B + D`` are not zero."""
    rows, columns = range(len(C)), range(B.shape[1])
    return np.array(
        [[normal_rank(A, B[:, [j]], C[[i]], D[[i]][:, [j]], z) > 0 for j in columns] for i in rows], dtype=bool
    ).reshape(len(C), B.shape[1])
