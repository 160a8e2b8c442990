"""Frequency responses with the size of the terms that they are the sum of, and to the last digit where these cancel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.systems.array_cache import Latest, entries
from residua.linear.systems.resolvent import independent_parts, solutions, solver
from residua.linear.systems.state_space import StateSpace
from residua.linear.systems.units import pencil_units, system_units
from residua.progress import check_time

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SPLIT = 2.0**27 + 1.0
_REFINED = 2
#: Numbers that are worked on at a time: they stay near the processor.
_NEAR = 2**13


@dataclass(frozen=True, eq=False)
class ResponseTerms:
    r"""Responses ``C (s E - A)^-1 B + D`` and what rounding in them is relative to.

    With :math:`X = (sE - A)^{-1} B` and :math:`Y = C (sE - A)^{-1}` the terms are
    :math:`|C| |X| + |Y| |sE - A| |X| + |Y| |B| + |D|`, entry by entry. Changing every number of the system by a
    fraction ``eps`` changes a response by at most ``eps`` times its terms, to first order; so does solving for it.
    They change with the units of the channels as the response does, and not at all with those of the states.

    Attributes
    ----------
    values : ndarray of complex, shape (k, outputs, inputs)
        Exactly zero where no chain of couplings leads from the input to the output.
    terms : ndarray, shape (k, outputs, inputs)
    """

    values: Complex
    terms: Real


@dataclass(frozen=True, eq=False)
class EvenUnits:
    """A system in its own units, in which equal models are the same to the last bit, and the factors of its channels.

    Attributes
    ----------
    system : StateSpace
        ``R E S``, ``R A S``, ``R B V``, ``Y C S``, ``Y D V``; with ``E = I``, ``R`` is the inverse of ``S``.
    inputs, outputs : ndarray
        The diagonals of ``V`` and ``Y``, powers of two.
    equations : ndarray
        The diagonal of ``R``.
    """

    system: StateSpace
    inputs: Real
    outputs: Real
    equations: Real


_even: Latest[EvenUnits] = Latest()


def in_even_units(system: StateSpace) -> EvenUnits:
    """Return a system in the units that do not depend on those it was written in; the latest results are kept."""
    matrices = entries(system.A, system.B, system.C, system.D, system.E)
    names = (system.inputs, system.outputs, system.states)
    return _even.of((matrices, system.dt, *names), lambda: _in_even_units(system))


def _in_even_units(system: StateSpace) -> EvenUnits:
    A, B, C, D, E = system.A, system.B, system.C, system.D, system.E
    n = system.n_states
    if E is None:
        u = system_units(A, B, C, D)
        R, S, V, Y = 1 / u.states, u.states, u.inputs, u.outputs
    else:
        whole = np.block([[A, B], [C, D]])
        dynamic = np.zeros_like(whole)
        dynamic[:n, :n] = E
        p = pencil_units(whole, dynamic)
        R, S, V, Y = p.rows[:n], p.columns[:n], p.columns[n:], p.rows[n:]
        E = R[:, None] * E * S
    scaled = system.replaced(
        A=R[:, None] * A * S, B=R[:, None] * B * V, C=Y[:, None] * C * S, D=Y[:, None] * D * V, E=E
    )
    return EvenUnits(scaled, V, Y, R)


_known: Latest[ResponseTerms] = Latest()


def response_terms(
    system: StateSpace, points: Complex, B_terms: Real | None = None, D_terms: Real | None = None
) -> ResponseTerms:
    """Return the responses at complex points, with their terms; those of ``B`` and ``D`` are their own when omitted.

    The latest results are kept: of one plant every filter is checked by the same.
    """
    key = entries(system.A, system.B, system.C, system.D, system.E, points, B_terms, D_terms)
    return _known.of(key, lambda: _response_terms(system, points, B_terms, D_terms))


def _response_terms(system: StateSpace, points: Complex, B_terms: Real | None, D_terms: Real | None) -> ResponseTerms:
    B, D = np.abs(system.B) if B_terms is None else B_terms, np.abs(system.D) if D_terms is None else D_terms
    n, shape = system.n_states, (len(points), *system.D.shape)
    values, terms = np.broadcast_to(system.D, shape).astype(complex), np.broadcast_to(D, shape).astype(float)
    if not n:
        return ResponseTerms(values, terms)
    for part in independent_parts(system.A, system.E):
        A, E, C = system.A[np.ix_(part, part)], system.E, system.C[:, part]
        E = None if E is None else E[np.ix_(part, part)]
        driven, of_terms = system.B[part], B[part]
        rows = np.flatnonzero(C.any(axis=1))
        columns = np.flatnonzero(driven.any(axis=0) | of_terms.any(axis=0))
        C, driven, of_terms = C.take(rows, axis=0), driven.take(columns, axis=1), of_terms.take(columns, axis=1)
        X, Y = solutions(A, E, points, driven, C)
        inside, before = np.abs(X), np.abs(Y)
        through = before @ (_sizes_times(A, E, points, inside) + of_terms)
        at = slice(None), rows[:, None], columns
        values[at] += C @ X
        terms[at] += np.abs(C) @ inside + through
    # what pivoting leaves where no coupling leads is nothing, whatever stands beside it
    own = paths(system, system.B, system.D)
    values = np.where(own, values, 0.0)
    if B_terms is not None or D_terms is not None:
        own = paths(system, B, D)
    return ResponseTerms(values, np.where(own, terms, 0.0))


def accurate_response(system: StateSpace, points: Complex, signals: Complex | None = None) -> Complex:
    """Return the responses at complex points to working precision even where their terms cancel by many digits.

    The solution of the equations is refined with twice the digits, and ``C X + D`` is summed with twice the digits.

    Parameters
    ----------
    system : StateSpace
    points : ndarray of complex, shape (k,)
    signals : ndarray of complex, shape (k, inputs, columns), optional
        What drives the system at each point; each of its inputs by itself when omitted.
    """
    B, B_rest = _driven(system.B, points, signals)
    value, rest = _driven(system.D, points, signals)
    if not system.n_states or not value.shape[2]:
        return value + rest
    for part in independent_parts(system.A, system.E):
        rows = np.flatnonzero(system.C[:, part].any(axis=1))
        columns = np.flatnonzero(B[:, part].any(axis=(0, 1)))
        if rows.size and columns.size:
            at, C = np.ix_(np.arange(len(points)), rows, columns), system.C[np.ix_(rows, part)]
            here = np.ix_(np.arange(len(points)), part, columns)
            high, low = _accurate_states(system, part, points, B[here], B_rest[here])
            value[at], more = _product_added(C, high, value[at], rest[at])
            rest[at] = more + C @ low
    return value + rest


def _driven(M: Real, points: Complex, signals: Complex | None) -> tuple[Complex, Complex]:
    """Return what signals make of a matrix at each point, with twice the digits; without signals the matrix itself."""
    if signals is None:
        value = np.broadcast_to(M, (len(points), *M.shape)).astype(complex)
        return value, np.zeros_like(value)
    none = np.zeros((len(points), len(M), signals.shape[2]), dtype=complex)
    return _product_added(M, signals, none, none)


def _accurate_states(
    system: StateSpace, part: NDArray[np.int_], points: Complex, start: Complex, start_rest: Complex
) -> tuple[Complex, Complex]:
    """Return the responses of some states to what drives them, with twice the digits."""
    states = np.ix_(part, part)
    A, E = system.A[states], None if system.E is None else system.E[states]
    solve = solver(A, E, points)
    high, low = solve(start), np.zeros_like(start)
    for _ in range(_REFINED):
        step = solve(_residue(A, E, start, start_rest, points, high, low))
        high, low = _two_sum(high, low + step)
    return high, low


def _sizes_times(A: Real, E: Real | None, points: Complex, inside: Real) -> Real:
    """Return ``|s E - A| X`` for sizes ``X`` at each point; without ``E`` the points change the diagonal only."""
    if E is not None:
        return np.abs(points[:, None, None] * E - A) @ inside
    diagonal = np.abs(points[:, None] - A.diagonal())
    apart = np.abs(A)
    np.fill_diagonal(apart, 0.0)
    return apart @ inside + diagonal[:, :, None] * inside


def _residue(
    A: Real, E: Real | None, start: Complex, start_rest: Complex, points: Complex, high: Complex, low: Complex
) -> Complex:
    """Return ``B + A X - s E X`` with twice the digits, ``X = high + low``, from ``B`` at each point."""
    value, rest = _product_added(A, high, start, start_rest)
    rest = rest + A @ low
    through, through_rest = high, low
    if E is not None:
        none = np.zeros_like(high)
        through, through_rest = _product_added(E, high, none, none)
        through_rest = through_rest + E @ low
    s = points[:, None, None]
    for factor, part in ((-s.real, through), (-s.imag, 1j * through)):
        product, error = _two_product(factor, part)
        value, lost = _two_sum(value, product)
        rest = rest + (error + lost)
    return value + (rest - s * through_rest)


def _product_added(M: Real, X: Complex, high: Complex, low: Complex) -> tuple[Complex, Complex]:
    """Return ``high + low + M X`` with twice the digits; real and imaginary parts do not meet.

    By some points at a time, so that what every column of ``M`` adds to stays near the processor.
    """
    x = np.ascontiguousarray(X, dtype=complex).view(float)
    total, rest = (np.array(part, dtype=complex, order="C").view(float) for part in (high, low))
    used = np.flatnonzero(M.any(axis=0))
    first, second = _split(M)
    step = max(_NEAR // max(total[0].size, 1), 1) if len(total) else 1
    for start in range(0, len(total), step):
        check_time()
        at = slice(start, start + step)
        _columns_added(M.T[used], first.T[used], second.T[used], x[at][:, used], total[at], rest[at])
    return total.view(complex), rest.view(complex)


def _columns_added(M: Real, first: Real, second: Real, x: Real, total: Real, rest: Real) -> None:
    """Add the products of columns and what multiplies them in place: Dekker's products, Knuth's sums."""
    upper, lower = _split(x)
    shape = total.shape
    product, other, left, error = (np.empty(shape) for _ in range(4))
    for k in range(len(M)):
        m, a, c = M[k][None, :, None], first[k][None, :, None], second[k][None, :, None]
        y, b, d = x[:, k, None], upper[:, k, None], lower[:, k, None]
        np.multiply(m, y, out=product)
        np.subtract(product, np.multiply(a, b, out=other), out=error)
        np.subtract(error, np.multiply(c, b, out=other), out=error)
        np.subtract(error, np.multiply(a, d, out=other), out=error)
        np.subtract(np.multiply(c, d, out=other), error, out=error)  # of the product
        np.add(total, product, out=other)
        np.subtract(other, total, out=left)
        np.subtract(product, left, out=product)
        np.subtract(other, left, out=left)
        np.subtract(total, left, out=left)
        np.add(left, product, out=left)  # of the sum
        total[...] = other
        np.add(rest, np.add(error, left, out=error), out=rest)


def _two_sum(a: Complex, b: Complex) -> tuple[Complex, Complex]:
    """Return a sum and its rounding error (Knuth); real and imaginary parts do not meet."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def _two_product(real: Real, x: Complex) -> tuple[Complex, Complex]:
    """Return the product of a real and a complex number and its rounding error (Dekker)."""
    p = real * x
    a, c = _split(real)
    b, d = _split(x)
    return p, c * d - (((p - a * b) - c * b) - a * d)


def _split(x: NDArray) -> tuple[NDArray, NDArray]:
    big = _SPLIT * x
    high = big - (big - x)
    return high, x - high


def paths(system: StateSpace, B: Real, D: Real) -> NDArray[np.bool_]:
    """Tell from which inputs a chain of couplings leads to which outputs.

    Each state of a descriptor system follows from an equation of its own, matched to it: what the inverse of the pencil
    may couple is what chains of these do. From all to all where there are too few equations for that.
    """
    # Of truth values, which no BLAS multiplies: its kernel for small floats now and then raises a flag of its own.
    coupled, reached = system.A != 0, B != 0
    if system.E is not None:
        from scipy.sparse import csr_array  # slow to import, and needed only here
        from scipy.sparse.csgraph import maximum_bipartite_matching

        coupled |= system.E != 0
        of_state = maximum_bipartite_matching(csr_array(coupled), perm_type="row")
        if np.any(of_state < 0):
            return np.ones(D.shape, dtype=bool)
        coupled, reached = coupled[of_state], reached[of_state]
    for _ in range(system.n_states):
        more = reached | (coupled @ reached)
        if np.array_equal(more, reached):
            break
        reached = more
    return ((system.C != 0) @ reached) | (D != 0)
