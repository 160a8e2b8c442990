"""Ranks of pencils over the rational functions, zero polynomials, null spaces and minimal indices, exactly."""

from __future__ import annotations

import random

from flint import fmpq, fmpq_mat, fmpq_poly

from exact.matrices import (
    PRIME,
    block,
    identity,
    is_zero,
    left_null_space,
    part,
    rank,
    rank_modulo,
    residues,
    row_basis,
    zeros,
)
from exact.plants import at

Pencil = tuple[fmpq_mat, fmpq_mat]


def normal_rank(P: Pencil) -> int:
    """Return the rank at almost every ``s``: modulo a prime, at two points far from everything."""
    return max(rank_modulo(values) for values in generic_values(P))


def generic_values(P: Pencil) -> list[list[list[int]]]:
    """Return a pencil modulo a prime at two points far from everything."""
    P0, P1 = residues(P[0]), residues(P[1])
    points = (1234567890123456789, 987654321987654321)
    return [
        [[(a + s * b) % PRIME for a, b in zip(x, y, strict=True)] for x, y in zip(P0, P1, strict=True)] for s in points
    ]


# -------------------------------------------------------------------------------- zeros


def zero_polynomial(P: Pencil, *, tries: int = 3, seed: int = 5) -> fmpq_poly:
    """Return the monic greatest common divisor of the largest minors: its roots are the zeros, with multiplicity.

    Minors are combined at random: by the formula of Cauchy and Binet two random combinations have no common
    divisor beyond that of all minors, but for an accident that the third try rules out.
    """
    draw = random.Random(seed)
    r = normal_rank(P)
    out = fmpq_poly([0])
    if r == 0:
        return fmpq_poly([1])
    rows, columns = P[0].nrows(), P[0].ncols()
    degree = rank(P[1])
    points = list(range(-(degree // 2), degree - degree // 2 + 1))
    vandermonde = fmpq_mat(len(points), len(points), [fmpq(x) ** k for x in points for k in range(len(points))])
    for _ in range(tries):
        U = fmpq_mat(r, rows, [draw.randint(-9999, 9999) for _ in range(r * rows)]) if r < rows else identity(rows)
        V = (
            fmpq_mat(columns, r, [draw.randint(-9999, 9999) for _ in range(r * columns)])
            if r < columns
            else identity(columns)
        )
        values = fmpq_mat(len(points), 1, [(U * at(P, x) * V).det() for x in points])
        found = fmpq_poly([vandermonde.solve(values)[k, 0] for k in range(len(points))])
        out = found if out == 0 else out.gcd(found)
        if r == rows == columns:
            break
    return monic(out)


def monic(p: fmpq_poly) -> fmpq_poly:
    """Return a polynomial with leading coefficient one."""
    return p * (1 / p[p.degree()])


def zero_polynomial_by_reduction(P: Pencil, n: int) -> fmpq_poly:
    """Return the same by another way: constraints are eliminated exactly, from the outputs and then from the inputs."""
    S = _standard(P, n)
    S = _reduced(S)
    A, B, C, D = (M.transpose() for M in S)
    A, B, C, D = _reduced((A, C, B, D))
    if not A.nrows():
        return fmpq_poly([1])
    if not D.nrows():
        return A.charpoly()
    return (A - B * D.solve(C)).charpoly()


def _standard(P: Pencil, n: int) -> tuple[fmpq_mat, fmpq_mat, fmpq_mat, fmpq_mat]:
    """Return the pencil as a system with ``E = I``: algebraic variables are inputs, algebraic equations outputs."""
    rows, columns = P[0].nrows(), P[0].ncols()
    E = -part(P[1], rows=range(n), columns=range(n))
    k = rank(E)
    left = _compressing(E)  # left E = [E1; 0]
    right = _compressing((left * E).transpose()).transpose()  # (left E) right = [E11 0; 0 0]
    L = block([[left, zeros(n, rows - n)], [zeros(rows - n, n), identity(rows - n)]])
    R = block([[right, zeros(n, columns - n)], [zeros(columns - n, n), identity(columns - n)]])
    M, E11 = L * P[0] * R, part(left * E * right, rows=range(k), columns=range(k))
    top, low = list(range(k)), list(range(k, rows))
    A, B = part(M, top, range(k)), part(M, top, range(k, columns))
    if k:
        A, B = E11.solve(A), E11.solve(B) if B.ncols() else B
    return A, B, part(M, low, range(k)), part(M, low, range(k, columns))


def _compressing(M: fmpq_mat) -> fmpq_mat:
    """Return an invertible ``T`` such that the last rows of ``T M`` are zero and the others independent."""
    if not M.nrows():
        return identity(0)
    if not M.ncols():
        return identity(M.nrows())
    R, r = block([[M, identity(M.nrows())]]).rref()
    T = part(R, columns=range(M.ncols(), M.ncols() + M.nrows()))
    del r
    return T


def _reduced(S: tuple[fmpq_mat, fmpq_mat, fmpq_mat, fmpq_mat]) -> tuple[fmpq_mat, fmpq_mat, fmpq_mat, fmpq_mat]:
    """Remove what forces states to zero, and outputs that say nothing, until ``D`` has full row rank."""
    A, B, C, D = S
    while True:
        r = rank(D)
        if r == D.nrows():
            return A, B, C, D
        T = _compressing(D)
        C, D = T * C, part(T * D, rows=range(r))
        silent, C = part(C, rows=range(r, C.nrows())), part(C, rows=range(r))
        if is_zero(silent):
            return A, B, C, D
        mu, n = rank(silent), A.nrows()
        W = _compressing(silent.transpose()).transpose()  # silent W = [X 0], X of full column rank
        order = [*range(mu, n), *range(mu)]
        W = part(W, columns=order)  # silent W = [0 X]: the last states are forced to zero
        A, B, C = W.solve(A * W), W.solve(B) if B.ncols() else B, C * W
        k = n - mu
        C, D = (
            block([[part(C, columns=range(k))], [part(A, range(k, n), range(k))]]),
            block([[D], [part(B, rows=range(k, n))]]),
        )
        A, B = part(A, range(k), range(k)), part(B, rows=range(k))


# -------------------------------------------------------------------------------- null spaces


def null_space_in_the_limit(P: Pencil, s: fmpq | int) -> fmpq_mat:
    """Return a basis, in rows, of what the left null vectors of a pencil tend to at a point, be it a zero or not.

    ``q0`` is the value of a null vector at the point when the equations of its power series can be solved to any order.
    """
    P0, P1 = at(P, s), P[1]
    N = P0.nrows()
    R = identity(N)
    while True:
        pairs = left_null_space(block([[P1], [R * P0]]))
        following = row_basis(part(pairs, columns=range(N)))
        if following.nrows() == R.nrows():
            break
        R = following
    return row_basis(left_null_space(R * P0) * R) if R.nrows() else R


def left_indices(P: Pencil) -> list[int]:
    """Return the degrees of a minimal polynomial basis of the left null space, smallest first."""
    P0, P1 = residues(P[0]), residues(P[1])
    N, M = P[0].nrows(), P[0].ncols()
    wanted = N - normal_rank(P)
    out: list[int] = []
    before = 0
    k = 0
    while len(out) < wanted:
        rows = []
        for i in range(k + 1):  # q_i meets P0 in block i and P1 in block i + 1
            for j in range(N):
                rows.append([0] * (i * M) + P0[j] + P1[j] + [0] * ((k - i) * M))
        dimension = (k + 1) * N - rank_modulo(rows)
        out += [k] * (dimension - before - len(out))
        before = dimension
        k += 1
        if k > N + 1:
            raise AssertionError("minimal indices do not end")
    return out
