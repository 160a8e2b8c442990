"""State-space realisations of ``H(z) y = N(z) v``: observer form, without unreachable parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.linear.subspaces.observability import staircase
from residua.linear.subspaces.rank import RankDecision, decide_rank, equilibrated
from residua.linear.systems.descriptor import weierstrass_form
from residua.linear.systems.scaling import power_near, scaling
from residua.linear.systems.state_space import StateSpace
from residua.tolerances import TINY

#: Points, in the unit of the variable, at which the determinant is tried: it vanishes at finitely many only.
_POINTS = np.array([0.31, 1.0, 3.7, 0.9, 1.3]) * np.exp(1j * np.array([0.4, 1.1, 1.9, 2.6, 3.0]))
#: Impulses of a realisation below this fraction of the terms that they are made of are rounding.
_IMPULSE = 1e-8
#: Differences below this fraction of their terms are rounding.
_DIFFERENCE = 16 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class ReachablePart:
    """Reachable part of a system, and its unreachable modes.

    Attributes
    ----------
    system : StateSpace
    removed : ndarray of complex
    uncertainty : ndarray
        A bound, to first order, on the error of each removed mode.
    decisions : tuple of RankDecision
    """

    system: StateSpace
    removed: NDArray[np.complex128]
    uncertainty: NDArray[np.float64]
    decisions: tuple[RankDecision, ...]


def unit_of_variable(H: PolynomialMatrix, N: PolynomialMatrix | None = None) -> float:
    """Return the size of the variable, a power of two, that balances the powers of a square matrix.

    Of one in which no row has two powers, as of integrators, the size at which those of its right side do, if it is
    there. In another variable, a power of two times this one, it is exactly that many times as large; one if neither
    has a size.
    """
    unit = _size_of_variable(np.abs(H.coefficients).max(axis=2))
    if not unit and N is not None:  # inputs have units of their own: each entry for itself
        unit = _size_of_variable(np.abs(N.coefficients).reshape(len(N.coefficients), -1))
    return unit or 1.0


def _size_of_variable(coefficients: NDArray[np.float64]) -> float:
    """Return the size that balances the first and the last power of polynomials, in columns; 0 without."""
    parts, exponents, weights = 0.0, 0, 0
    for one in coefficients.T:
        used = np.flatnonzero(one)
        if len(used) > 1:
            # Roots r_1 ... r_k give end coefficients in the ratio of their product.
            (first, last), powers = np.frexp(one[used[[0, -1]]])
            parts += float(np.log2(first / last))
            exponents += int(powers[0] - powers[1])
            weights += int(used[-1] - used[0])
    if not weights:
        return 0.0
    whole, rest = divmod(exponents, weights)  # apart, so that a whole number more rounds nothing
    return float(2.0 ** np.clip(whole + np.round((rest + parts) / weights), -200, 200))


def check_regular(H: PolynomialMatrix, rtol: float) -> None:
    """Raise if ``det H`` vanishes for every value of the variable."""
    values = H.scaled(unit_of_variable(H)).evaluate(_POINTS)
    best = max((decide_rank(equilibrated(M), rtol=rtol) for M in values), key=lambda decided: decided.rank)
    if best.rank < H.shape[0]:
        raise ModelError(
            f"det H is zero everywhere: the {H.shape[0]} equations determine only {best.rank} outputs "
            f"({best}); remove equations that follow from others, add missing ones"
        )


def leading_rows(P: PolynomialMatrix, degrees: tuple[int, ...]) -> NDArray[np.float64]:
    """Return for each row its coefficients at a given power."""
    C = P.padded(max(degrees))
    return np.array([C[degree, i] for i, degree in enumerate(degrees)])


def check_proper(H: PolynomialMatrix, N: PolynomialMatrix, outputs: tuple[str, ...], dt: float, rtol: float) -> None:
    """Raise if the outputs depend on later inputs (continuous time: on derivatives of inputs)."""
    if decide_rank(equilibrated(leading_rows(H, H.row_degrees)), rtol=rtol).rank < H.shape[0]:
        observer_form(H, N, outputs, dt, rtol)
        return
    for i, (own, other) in enumerate(zip(H.row_degrees, N.row_degrees, strict=True)):
        if other > own:
            raise _improper(outputs[i], dt, f"the right side has degree {other}, the left side {own}")


def observer_form(
    H: PolynomialMatrix, N: PolynomialMatrix, outputs: tuple[str, ...], dt: float, rtol: float
) -> StateSpace:
    r"""Return an observable state-space system with ``H y = N v``.

    With :math:`e_j = H_j y - N_j v` for the coefficients of one row, highest power :math:`k`, the states
    :math:`z \xi_1 = -e_0`, :math:`z \xi_j = \xi_{j-1} - e_{j-1}` turn the row into :math:`\xi_k = e_k`. When ``H`` is
    row reduced these equations give ``y``; otherwise they are algebraic equations of a descriptor system, whose
    infinite part is split off.

    Raises
    ------
    ModelError
        If ``y`` is not a proper function of ``v``, with the output.
    """
    unit = unit_of_variable(H)
    H, N = H.scaled(unit), N.scaled(unit)
    size = power_near(np.abs(H.coefficients).max(axis=(0, 2)))
    H, N = (PolynomialMatrix(P.coefficients / size[:, None]) for P in (H, N))
    degrees = tuple(max(pair) for pair in zip(H.row_degrees, N.row_degrees, strict=True))
    order, m = sum(degrees), len(degrees)
    P, Q = H.padded(max(degrees)), N.padded(max(degrees))
    # the shifts within the chains of states, the last state of each chain, and the lower coefficients
    shift, last = np.zeros((order, order)), np.zeros((m, order))
    low_H, low_N = np.zeros((order, m)), np.zeros((order, N.shape[1]))
    start = 0
    for i, k in enumerate(degrees):
        shift[start : start + k, start : start + k] = np.eye(k, k=-1)
        low_H[start : start + k], low_N[start : start + k] = P[:k, i], Q[:k, i]
        if k:
            last[i, start + k - 1] = 1.0
        start += k
    top_H, top_N = leading_rows(H, degrees), leading_rows(N, degrees)
    if decide_rank(equilibrated(top_H), rtol=rtol).rank == len(top_H):
        C, D = np.linalg.solve(top_H, last), np.linalg.solve(top_H, top_N)
        A, B = shift - low_H @ C, low_N - low_H @ D
        # The fault of a sensor has no path through the states: nothing but rounding may remain of its difference.
        B = np.where(np.abs(B) > _DIFFERENCE * (np.abs(low_N) + np.abs(low_H) @ np.abs(D)), B, 0.0)
    else:
        E = np.zeros((order + m, order + m))
        E[:order, :order] = np.eye(order)
        form = weierstrass_form(np.block([[shift, -low_H], [last, -top_H]]), E, rtol=rtol)
        k = form.n_finite
        right = np.vstack([low_N, top_N])
        B = form.P @ right
        C = form.Q[order:]
        D, impulse = -C[:, k:] @ B[k:], B[k:]
        size = np.abs(form.P[k:]) @ np.abs(right)  # an impulse that cancels is rounding of this
        for power in range(1, form.index):
            size = np.abs(form.N) @ size
            terms = np.abs(C[:, k:]) @ size
            impulse = form.N @ impulse
            found = np.abs(C[:, k:] @ impulse)
            wrong = np.flatnonzero(np.any(found > _IMPULSE * max(float(terms.max(initial=0.0)), TINY), axis=1))
            if len(wrong):
                raise _improper(outputs[wrong[0]], dt, f"the power {power} of the variable acts on the inputs")
        A, B, C = form.A1, B[:k], C[:, :k]
    return StateSpace(unit * A, unit * B, C, D, dt=dt, outputs=outputs)


def _improper(output: str, dt: float, why: str) -> ModelError:
    what = "later inputs" if dt else "derivatives of inputs"
    return ModelError(
        f"output {output!r} is not a proper function of the inputs, it would depend on {what}: {why}; delay these "
        "or raise the degree of its equation"
    )


def reachable_part(system: StateSpace) -> ReachablePart:
    """Return the reachable part of a system, in balanced units; its transfer matrix is unchanged."""
    At, Bt = np.ascontiguousarray(system.A.T), np.ascontiguousarray(system.B.T)
    form = staircase(At, Bt)  # callers compare responses, which tell more
    k = form.n_observable
    removed, uncertainty = form.hidden_modes
    if k < system.n_states:
        Q = form.Q[:, :k]
        system = system.replaced(
            A=(Q.T @ form.A @ Q).T,
            B=(system.B.T * form.states @ Q).T,
            C=(system.C / form.states) @ Q,
            states=None,
        )
    T = scaling(system.A, system.B, system.C, system.D, sampled=system.is_discrete).states
    system = system.replaced(A=system.A / T[:, None] * T, B=system.B / T[:, None], C=system.C * T)
    return ReachablePart(system, removed, uncertainty, form.decisions)


def response_points(poles: NDArray[np.complex128], dt: float, *, count: int = 60) -> NDArray[np.complex128]:
    """Return points on the stability boundary that span the dynamics of some poles, away from round numbers."""
    if dt:
        slow = np.abs(np.log(poles[np.abs(poles) > 0.5]))  # poles at one itself do not need a closer look
        slow = slow[slow > 1e-12]
        low = 0.1 * float(np.min(slow, initial=1e-3)) / np.pi
        return np.exp(1j * np.pi * np.concatenate([np.geomspace(low, 0.97, count - 1), [0.37]]))
    size = np.abs(poles)
    size = size[size > np.sqrt(np.finfo(float).eps) * size.max(initial=0.0)]
    low, high = (float(size.min()), float(size.max())) if size.size else (1.0, 1.0)
    return 1.0371j * np.logspace(np.log10(low) - 1, np.log10(high) + 1, count)


def response_error(found: NDArray[np.complex128], wanted: NDArray[np.complex128], terms: NDArray[np.float64]) -> float:
    """Return the largest error of a response: of each entry relative to itself, or to a thousandth of its peak.

    An entry that is small beside its row and its column counts with a millionth of these at least, and one that is
    small beside the ``terms`` that it is made of with a millionth of those: paths that are not there come out as
    rounding.
    """
    if not wanted.size:
        return 0.0
    peak = np.abs(wanted).max(axis=0)
    floor = 1e-6 * np.minimum(peak.max(axis=0, keepdims=True), peak.max(axis=1, keepdims=True))
    scale = np.maximum(np.abs(wanted), np.maximum(1e-3 * peak, floor))
    scale = np.maximum(scale, 1e-6 * terms)
    missed = np.abs(found - wanted)
    return float(np.max(missed / np.where(scale > 0, scale, 1.0), initial=0.0))


def state_terms(system: StateSpace, points: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the sizes of the terms of a system's response: states seen by outputs, and feedthrough."""
    n = system.n_states
    states = system.replaced(C=np.eye(n), D=None, outputs=None) if n else None
    through = 0.0 if states is None else np.abs(system.C) @ np.abs(states.evaluate(points))
    return through + np.broadcast_to(np.abs(system.D), (len(points), *system.D.shape))


def quotient(H: PolynomialMatrix, N: PolynomialMatrix, points: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return ``H^-1 N`` at some points."""
    left, right = H.evaluate(points), N.evaluate(points)
    size = np.abs(left).max(axis=2, keepdims=True, initial=0.0)
    size = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.solve(left / size, right / size), dtype=complex)


def polynomial_terms(H: PolynomialMatrix, N: PolynomialMatrix, points: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the sizes of the terms of ``H^-1 N``, row by row of ``H``."""
    values = H.evaluate(points)
    size = np.abs(values).max(axis=2, keepdims=True)
    return np.abs(np.linalg.inv(values / size)) @ (np.abs(N.evaluate(points)) / size)


def check_response(error: float, tolerance: float, what: str, advice: str) -> None:
    """Raise if the error of a response exceeds a tolerance."""
    if not error <= tolerance:
        raise AccuracyError(
            f"the frequency response of {what} is off by {error:.2g} > {tolerance:.2g} of itself: {advice}"
        )
