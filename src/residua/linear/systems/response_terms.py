"""Frequency responses with the size of the terms that they are the sum of, and to the last digit where these cancel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear.systems.array_cache import MOST_BYTES, read_only
from residua.linear.systems.state_space import StateSpace
from residua.linear.systems.units import pencil_units, system_units

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SPLIT = 2.0**27 + 1.0
_REFINED = 2


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


def in_even_units(system: StateSpace) -> EvenUnits:
    """Return a system in the units that do not depend on those it was written in; the latest results are kept."""
    matrices = (system.A, system.B, system.C, system.D, system.E)
    if sum(M.nbytes for M in matrices if M is not None) > MOST_BYTES:
        return _in_even_units(system)
    entries = tuple(None if M is None else (M.shape, M.tobytes()) for M in matrices)
    return _kept((entries, system.dt, system.inputs, system.outputs, system.states))


@lru_cache(maxsize=512)
def _kept(content: tuple) -> EvenUnits:
    """Return it of a system of this content: matrices, step and names."""
    entries, dt, inputs, outputs, states = content
    A, B, C, D = (np.frombuffer(data).reshape(shape) for shape, data in entries[:4])
    E = None if entries[4] is None else np.frombuffer(entries[4][1]).reshape(entries[4][0])
    return read_only(_in_even_units(StateSpace(A, B, C, D, E=E, dt=dt, inputs=inputs, outputs=outputs, states=states)))


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


def response_terms(
    system: StateSpace, points: Complex, B_terms: Real | None = None, D_terms: Real | None = None
) -> ResponseTerms:
    """Return the responses at complex points, with their terms; those of ``B`` and ``D`` are their own when omitted."""
    B, D = np.abs(system.B) if B_terms is None else B_terms, np.abs(system.D) if D_terms is None else D_terms
    n, shape = system.n_states, (len(points), *system.D.shape)
    if not n:
        return ResponseTerms(np.broadcast_to(system.D, shape).astype(complex), np.broadcast_to(D, shape).astype(float))
    M = _pencil(system, points)
    try:
        X = np.linalg.solve(M, np.broadcast_to(system.B, (len(points), *system.B.shape)).astype(complex))
        Y = np.linalg.solve(M.swapaxes(1, 2), np.broadcast_to(system.C.T, (len(points), n, shape[1])).astype(complex))
    except np.linalg.LinAlgError as error:
        raise ModelError(f"the system has a pole at one of the points asked for: {error}") from error
    inside, before = np.abs(X), np.abs(Y).swapaxes(1, 2)
    terms = np.abs(system.C) @ inside + before @ (np.abs(M) @ inside + B) + D
    path = paths(system, B, D)
    return ResponseTerms(np.where(path, system.C @ X + system.D, 0.0), np.where(path, terms, 0.0))


def accurate_response(system: StateSpace, points: Complex) -> Complex:
    """Return the responses at complex points to working precision even where their terms cancel by many digits.

    The solution of the equations is refined with twice the digits, and ``C X + D`` is summed with twice the digits.
    """
    shape = (len(points), *system.D.shape)
    if not system.n_states or not system.n_inputs:
        return np.broadcast_to(system.D, shape).astype(complex)
    M = _pencil(system, points)
    B = np.broadcast_to(system.B, (len(points), *system.B.shape)).astype(complex)
    high, low = np.asarray(np.linalg.solve(M, B), dtype=complex), np.zeros_like(B)
    for _ in range(_REFINED):
        step = np.asarray(np.linalg.solve(M, _residue(system, points, high, low)), dtype=complex)
        high, low = _two_sum(high, low + step)
    direct = np.broadcast_to(system.D, shape).astype(complex)
    value, rest = _product_added(system.C, high, direct, np.zeros_like(direct))
    return value + (rest + system.C @ low)


def _pencil(system: StateSpace, points: Complex) -> Complex:
    E = np.eye(system.n_states) if system.E is None else system.E
    return points[:, None, None] * E - system.A


def _residue(system: StateSpace, points: Complex, high: Complex, low: Complex) -> Complex:
    """Return ``B + A X - s E X`` with twice the digits, ``X = high + low``."""
    start = np.broadcast_to(system.B, high.shape).astype(complex)
    value, rest = _product_added(system.A, high, start, np.zeros_like(start))
    rest = rest + system.A @ low
    through, through_rest = high, low
    if system.E is not None:
        none = np.zeros_like(high)
        through, through_rest = _product_added(system.E, high, none, none)
        through_rest = through_rest + system.E @ low
    s = points[:, None, None]
    for factor, part in ((-s.real, through), (-s.imag, 1j * through)):
        product, error = _two_product(factor, part)
        value, lost = _two_sum(value, product)
        rest = rest + (error + lost)
    return value + (rest - s * through_rest)


def _product_added(M: Real, X: Complex, high: Complex, low: Complex) -> tuple[Complex, Complex]:
    """Return ``high + low + M X`` with twice the digits."""
    for k in range(M.shape[1]):
        column = M[:, k]
        if np.any(column):
            product, error = _two_product(column[None, :, None], X[:, k, None, :])
            high, lost = _two_sum(high, product)
            low = low + (error + lost)
    return high, low


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
    """Tell from which inputs a chain of couplings leads to which outputs; from all to all of a descriptor system."""
    if system.E is not None:
        return np.ones(D.shape, dtype=bool)
    coupled, reached = (system.A != 0).astype(np.float32), (B != 0).astype(np.float32)
    for _ in range(system.n_states):
        more = np.minimum(reached + coupled @ reached, 1.0)
        if np.array_equal(more, reached):
            break
        reached = more
    return ((system.C != 0).astype(np.float32) @ reached > 0) | (D != 0)
