"""Zeros of a system in rational numbers, which is what floating-point numbers are: where rounding leaves a doubt.

Couplings that are weak one after the other multiply until they are no more than rounding, and zeros that coincide are
scattered by its root. In rational numbers nothing is rounded: the infinite zeros and the null structure are eliminated,
and what is left has a characteristic polynomial whose repeated factors are divided out before any root is computed.

References
----------
Emami-Naeini and Van Dooren, Computation of zeros of linear multivariable systems, Automatica 18 (1982) 415-430.
D. Y. Y. Yun, On square-free decomposition algorithms, Proc. SYMSAC (1976) 26-35. O. Aberth, Iteration methods for
finding all zeros of a polynomial simultaneously, Math. Comp. 27 (1973) 339-344.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import floor, lcm
from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Rows = list[list[Any]]

_EPS = float(np.finfo(float).eps)
#: Ranks modulo this prime, the first after 10^18 pi, are those of the rational numbers, but for an accident of one in
#: 10^17. Of a prime beside a power of two, powers of two that are so far apart would be the same.
_PRIME = 3141592653589793239
#: Binary digits of all entries of a matrix up to which its characteristic polynomial takes less than a second.
_LONGEST = 2**18
#: Roots are there after a few rounds; where they are not, nothing is returned.
_ROUNDS = 100


@dataclass(frozen=True, eq=False)
class Field:
    """Numbers in which a matrix is eliminated: the rational ones, or their residues modulo a prime.

    Attributes
    ----------
    of : callable
        Makes a number of the field of a float.
    reduced, inverse : callable
        Of a number of the field.
    """

    of: Callable[[float], Any]
    reduced: Callable[[Any], Any]
    inverse: Callable[[Any], Any]


def _residue(x: float | Fraction) -> int:
    top, bottom = x.as_integer_ratio()
    return top * pow(bottom, -1, _PRIME) % _PRIME


RATIONAL = Field(Fraction, lambda x: x, lambda x: 1 / x)
MODULAR = Field(_residue, lambda x: x % _PRIME, lambda x: pow(x, -1, _PRIME))


@dataclass(frozen=True, eq=False)
class Reduced:
    """What is left of a system without its infinite zeros and its null structure.

    Attributes
    ----------
    A : list of rows
        Its eigenvalues are the finite zeros.
    rank : int
        Normal rank of the transfer matrix.
    basis : list of rows
        Which states, in columns, of the system those that are left before inputs are eliminated are.
    """

    A: Rows
    rank: int
    basis: Rows


def reduced(A: Matrix, B: Matrix, C: Matrix, D: Matrix, field: Field) -> Reduced:
    """Eliminate what forces states to zero, and outputs that say nothing; and then the same of the dual system."""
    M = [[[field.of(x) for x in row] for row in X.tolist()] for X in (A, B, C, D)]
    unit = [[field.of(float(i == j)) for j in range(len(A))] for i in range(len(A))]
    A1, B1, C1, D1, basis = _without_forced_states(M[0], M[1], M[2], M[3], unit, field)
    n, m = len(A1), B.shape[1]
    A1, B1, C1, D1 = (_transposed(M, k) for M, k in ((A1, n), (C1, n), (B1, m), (D1, m)))
    A2, B2, C2, D2, _ = _without_forced_states(A1, B1, C1, D1, [], field)
    return Reduced(_without_inputs(A2, B2, C2, D2, field), len(D2), basis)


def _transposed(M: Rows, columns: int) -> Rows:
    return [[row[j] for row in M] for j in range(columns)]


def _without_forced_states(
    A: Rows, B: Rows, C: Rows, D: Rows, basis: Rows, field: Field
) -> tuple[Rows, Rows, Rows, Rows, Rows]:
    """Substitute the states that outputs without inputs give by the others, until the rows of ``D`` are independent.

    The equations of states that are given so are outputs in turn.
    """
    while True:
        m, n = len(B[0]) if B else len(D[0]) if D else 0, len(A)
        rows = [[*d, *c] for c, d in zip(C, D, strict=True)]
        pivots = eliminated(rows, m, field)
        live = rows[: len(pivots)]
        silent = [row[m:] for row in rows[len(pivots) :]]
        C, D = [row[m:] for row in live], [row[:m] for row in live]
        given = eliminated(silent, n, field)
        if not given:
            return A, B, C, D, basis
        free = [j for j in range(n) if j not in set(given)]
        # of the states given, x_p = -R x_f
        R = [[row[j] for j in free] for row in silent[: len(given)]]

        def substituted(M: Rows, free: list[int] = free, given: list[int] = given, R: Rows = R) -> Rows:
            out = []
            for row in M:
                new = [row[j] for j in free]
                for p, r in zip(given, R, strict=True):
                    if row[p]:
                        new = _minus(new, row[p], r, field)
                out.append(new)
            return out

        def equations(M: Rows, free: list[int] = free, given: list[int] = given, R: Rows = R) -> Rows:
            out = []
            for p, r in zip(given, R, strict=True):
                new = M[p]
                for f, factor in zip(free, r, strict=True):
                    if factor:
                        new = _minus(new, -factor, M[f], field)
                out.append(new)
            return out

        A = substituted(A)
        C, D = substituted(C) + equations(A), D + equations(B)
        A, B, basis = [A[j] for j in free], [B[j] for j in free], substituted(basis)


def _minus(row: list[Any], factor: Any, other: list[Any], field: Field) -> list[Any]:
    """Return ``row - factor other``."""
    return [field.reduced(a - factor * b) if b else a for a, b in zip(row, other, strict=True)]


def eliminated(rows: Rows, columns: int, field: Field) -> list[int]:
    """Bring the first columns of rows to reduced echelon form, in place, and return the columns of the pivots."""
    pivots: list[int] = []
    for j in range(columns):
        k = len(pivots)
        found = next((i for i in range(k, len(rows)) if rows[i][j]), None)
        if found is None:
            continue
        rows[k], rows[found] = rows[found], rows[k]
        inverse = field.inverse(rows[k][j])
        rows[k] = [field.reduced(x * inverse) if x else x for x in rows[k]]
        for i, row in enumerate(rows):
            if i != k and row[j]:
                rows[i] = _minus(row, row[j], rows[k], field)
        pivots.append(j)
        if len(pivots) == len(rows):
            break
    return pivots


def _without_inputs(A: Rows, B: Rows, C: Rows, D: Rows, field: Field) -> Rows:
    """Return ``A - B D^-1 C``."""
    if not D or not A:
        return A
    m = len(D)
    rows = [[*d, *c] for c, d in zip(C, D, strict=True)]
    eliminated(rows, m, field)
    out = []
    for row, b in zip(A, B, strict=True):
        new = row
        for factor, other in zip(b, rows, strict=True):
            if factor:
                new = _minus(new, factor, other[m:], field)
        out.append(new)
    return out


def characteristic_polynomial(A: Rows) -> list[Fraction] | None:
    """Return the coefficients of ``det(sI - A)``, highest first; nothing where they are too long to wait for.

    By the method of Faddeev and Le Verrier in whole numbers: its divisions leave no rest. Fractions would be shortened
    at every step, which takes longer than all else.
    """
    n, unit = len(A), lcm(*(x.denominator for row in A for x in row))
    M = np.array([[x.numerator * (unit // x.denominator) for x in row] for row in A], dtype=object).reshape(n, n)
    if n * n * max((x.bit_length() for x in M.flat), default=0) > _LONGEST:
        return None
    out, P, diagonal = [Fraction(1)], np.eye(n, dtype=int).astype(object), np.arange(n)
    for k in range(1, n + 1):
        P = M @ P
        c = -sum(P[diagonal, diagonal].tolist()) // k
        out.append(Fraction(c, unit**k))
        P[diagonal, diagonal] += c
    return out


def _derivative(p: list[Any], field: Field) -> list[Any]:
    n = len(p) - 1
    return [field.reduced(a * (n - i)) for i, a in enumerate(p[:-1])]


def _divided(p: list[Any], q: list[Any], field: Field) -> tuple[list[Any], list[Any]]:
    """Return quotient and remainder, both without leading zeros."""
    p, out, inverse = list(p), [], field.inverse(q[0])
    for i in range(len(p) - len(q) + 1):
        factor = field.reduced(p[i] * inverse)
        out.append(factor)
        if factor:
            p[i : i + len(q)] = _minus(p[i : i + len(q)], factor, q, field)
    return out, _without_leading_zeros(p[max(len(p) - len(q) + 1, 0) :])


def _without_leading_zeros(p: list[Any]) -> list[Any]:
    return p[next((i for i, a in enumerate(p) if a), len(p)) :]


def _monic(p: list[Any], field: Field) -> list[Any]:
    inverse = field.inverse(p[0])
    return [field.reduced(a * inverse) for a in p]


def _common(p: list[Any], q: list[Any], field: Field) -> list[Any]:
    """Return the greatest common divisor, monic."""
    while q:
        p, q = q, _divided(p, q, field)[1]
        q = _monic(q, field) if q else q
    return _monic(p, field)


def different_factors(p: list[Fraction]) -> list[tuple[list[Fraction], int]]:
    """Return factors without repeated roots, and how often each divides a monic polynomial."""
    out: list[tuple[list[Fraction], int]] = []
    if len(p) == 1:
        return out
    if _has_no_repeated_root(p):
        return [(p, 1)]
    slope = _derivative(p, RATIONAL)
    common = _common(p, slope, RATIONAL)
    rest, times = _divided(p, common, RATIONAL)[0], 0
    other = _divided(slope, common, RATIONAL)[0]
    while len(rest) > 1:
        times += 1
        own = _derivative(rest, RATIONAL)
        padded = [Fraction(0)] * (len(other) - len(own)) + own
        whole = [Fraction(0)] * (len(own) - len(other)) + other
        left = _without_leading_zeros([a - b for a, b in zip(whole, padded, strict=True)])
        factor = _common(rest, left, RATIONAL) if left else rest
        if len(factor) > 1:
            out.append((factor, times))
        rest = _divided(rest, factor, RATIONAL)[0]
        other = _divided(left, factor, RATIONAL)[0] if left else []
        other = other or [Fraction(0)]
    return out


def _has_no_repeated_root(p: list[Fraction]) -> bool:
    """Tell by residues, which is sure, and fast; what is not told so may have one, or not."""
    if any(a.denominator % _PRIME == 0 for a in p):
        return False
    residues = [_residue(a) for a in p]
    return len(_common(residues, _derivative(residues, MODULAR), MODULAR)) == 1


def roots(p: list[Fraction]) -> NDArray[np.complex128] | None:
    """Return the roots of a monic polynomial without repeated ones, each to the last digits; or nothing."""
    z = _first_roots(p)
    if z is None:
        return None
    unit = lcm(*(a.denominator for a in p))
    whole = [a.numerator * (unit // a.denominator) for a in p]
    slope = [a * (len(p) - 1 - i) for i, a in enumerate(whole[:-1])]
    for _ in range(_ROUNDS):
        if not np.all(np.isfinite(z)):
            return None
        step = np.array([_newton(whole, slope, x) for x in z.tolist()])
        apart = z[:, None] - z
        np.fill_diagonal(apart, 1.0)
        if not np.all(apart):
            return None
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite ends it
            inverse = 1.0 / apart
            np.fill_diagonal(inverse, 0.0)
            moved = step / (1.0 - step * inverse.sum(axis=1))
            z = z - moved
        if np.all(np.abs(moved) <= 4 * _EPS * np.abs(z)):
            return _mirrored(z)
    return None


def _first_roots(p: list[Fraction]) -> NDArray[np.complex128] | None:
    """Return roots to begin with, off the real axis: those of the companion matrix where they are of size one."""
    n = len(p) - 1
    sizes = [(a.numerator.bit_length() - a.denominator.bit_length()) / i for i, a in enumerate(p) if i and a]
    shift = floor(max(sizes, default=0.0) + 0.5)
    try:
        scaled = [float(a / Fraction(2) ** (shift * i)) for i, a in enumerate(p)]
    except OverflowError:
        return None
    z: NDArray[np.complex128] = np.linalg.eigvals(np.eye(n, k=-1) - np.outer(np.eye(n)[0], scaled[1:])).astype(complex)
    if len(z) != n or not np.all(np.isfinite(z)) or not np.all(z):
        return None
    turn = np.exp(1e-6j * (1 + np.arange(n)))
    return np.asarray(np.ldexp(z.real, shift) + 1j * np.ldexp(z.imag, shift)) * turn


def _newton(p: list[int], slope: list[int], z: complex) -> complex:
    """Return the step of Newton's method, without rounding but that of the result; nan where there is none."""
    (x, below_x), (y, below_y) = z.real.as_integer_ratio(), z.imag.as_integer_ratio()
    places = max(below_x, below_y).bit_length() - 1  # both are powers of two
    x, y = x << places - below_x.bit_length() + 1, y << places - below_y.bit_length() + 1
    value, own = _value(p, x, y, places), _value(slope, x, y, places)
    size = (own[0] ** 2 + own[1] ** 2) << places
    if not size:
        return complex(np.nan)
    try:
        real = (value[0] * own[0] + value[1] * own[1]) / size
        return complex(real, (value[1] * own[0] - value[0] * own[1]) / size)
    except OverflowError:
        return complex(np.nan)


def _value(p: list[int], x: int, y: int, places: int) -> tuple[int, int]:
    """Return the real and the imaginary part of a polynomial at a point, each with so many places for every degree."""
    real, imaginary = 0, 0
    for i, a in enumerate(p):
        real, imaginary = real * x - imaginary * y + (a << places * i), real * y + imaginary * x
    return real, imaginary


def _mirrored(z: NDArray[np.complex128]) -> NDArray[np.complex128] | None:
    """Return roots of a polynomial with real coefficients, the real ones exactly so, and the others in pairs."""
    real = np.abs(z.imag) <= 8 * _EPS * np.abs(z)
    upper, lower = z[~real & (z.imag > 0)], z[~real & (z.imag < 0)]
    if len(upper) != len(lower):
        return None
    return np.concatenate([z[real].real.astype(complex), upper, upper.conj()])


def rational_roots(p: list[Fraction]) -> NDArray[np.complex128] | None:
    """Return the roots of a monic polynomial, each as often as it is one."""
    at_zero = next(i for i, a in enumerate(reversed(p)) if a)
    found: list[NDArray[np.complex128]] = [np.zeros(at_zero, dtype=complex)]
    for factor, times in different_factors(p[: len(p) - at_zero]):
        own = roots(factor)
        if own is None:
            return None
        found += [own] * times
    return np.concatenate(found)
