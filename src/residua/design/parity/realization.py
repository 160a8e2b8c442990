"""Polynomial relations as filters with chosen poles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.observers.observer_gain import default_weights
from residua.linear.poles.observer_gain import observer_gain
from residua.linear.polynomials.pair_relations import PairRelations
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.quotient import observable_split, without_rounding
from residua.plant import Plant

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Realization:
    """A filter from inputs and outputs, with the maps that say what its states are: ``xi = T E x`` without faults."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    state_map: Matrix
    static_map: Matrix


def realize_relation(p: Matrix, q: Matrix, controls: tuple[Matrix, Matrix], basis: PolynomialBasis) -> Realization:
    r"""Return one relation divided by :math:`\prod_i (z - \lambda_i)`, as a chain of first and second order sections.

    In the basis :math:`N_0 = 1, \rho N_{j+1} = (z - \lambda_{j+1}) N_j` the relation has the coefficients ``q_j`` and
    ``p_j``; the state ``j`` obeys

    .. math:: \xi_j^+ = \lambda_j \xi_j + \rho \xi_{j-1} + q_j y - (p_j B + q_j D) u, \qquad
              r = \rho \xi_{k-1} + q_k y - (p_k B + q_k D) u

    so that its poles stand on the diagonal, exact whatever the order. Conjugate poles make sections of order two.

    Parameters
    ----------
    p : ndarray, shape (order + 1, states of the plant)
        With ``p (zE - A) = q C``, as coefficients in the basis.
    q : ndarray, shape (order + 1, outputs)
    controls : tuple of ndarray
        ``B`` and ``D``.
    basis : PolynomialBasis
        On the poles, of one size.

    Returns
    -------
    Realization

    References
    ----------
    Gertler (1991), section 3.5 (poles assigned to parity equations by division) and eq. (4-18).
    """
    k = len(q) - 1
    entering = np.hstack([-(p @ controls[0] + q @ controls[1]), q])
    last = basis.sizes[0] * np.eye(k)[-1:] if k else np.zeros((1, 0))
    return Realization(chain(basis, k), entering[:k], last, entering[k:], -p[:k], p[k:])


def chain(basis: PolynomialBasis, k: int) -> Matrix:
    """Return the state matrix of the first sections."""
    M = np.diag(basis.real[:k]) + np.diag(basis.sizes[: max(k - 1, 0)], -1)[:k, :k]
    for j in np.flatnonzero(basis.imaginary[:k]):  # the first of a conjugate pair
        M[j, j + 1] = -basis.links[j + 1]
    return M


def pole_basis(poles: NDArray[np.complex128], size: float = 1.0) -> PolynomialBasis:
    """Return the basis on the poles of a filter: real ones first, then the pairs, conjugates side by side."""
    upper = poles[poles.imag > 0]
    upper = upper[np.argsort(np.abs(upper), kind="stable")]
    pairs = np.column_stack([upper, upper.conj()]).ravel()
    real = np.sort(poles[poles.imag == 0].real)
    nodes = np.concatenate([real, pairs, [0.0]]).astype(np.complex128)
    return PolynomialBasis(nodes.real, np.where(nodes.imag > 0, nodes.imag, 0.0), np.full(len(nodes), size))


def controls_of(plant: Plant) -> tuple[Matrix, Matrix]:
    """Return ``B`` and ``D`` of the controls in balanced equations and outputs."""
    units = plant.balanced.units
    return units.equations[:, None] * plant.B / units.rate, units.outputs[:, None] * plant.D


def realize_by_least_squares(p: Matrix, q: Matrix, equations: PairRelations, plant: Plant) -> Realization:
    r"""Return one relation divided by the polynomial of the poles that a gain by least squares makes.

    With ``T`` a basis of the coefficients of ``w``, of which :math:`w (zI - F) = v G`, and :math:`T F = M T + N G`, the
    relation is the error of an observer of as many states as its order,

    .. math:: \xi^+ = (M - L c) \xi + (N H + T J + L v_k H) y + \dots, \qquad r = v_k H y - c \xi, \quad
              c T = v_k G

    in coordinates that lose no digits, whatever the order.

    Parameters
    ----------
    p : ndarray, shape (order + 1, states)
        With :math:`p (zI - A) = q C` of the balanced plant, as coefficients in any basis.
    q : ndarray, shape (order + 1, outputs)
        The outputs include the algebraic equations.
    equations : PairRelations
        All relations of its kind.
    plant : Plant

    Returns
    -------
    Realization
        Of which the newest sample of an output has coefficient one.
    """
    model, k, m = plant.balanced, len(q) - 1, plant.n_outputs
    (F, G), quotient = equations.pair, equations.quotient
    newest = q[-1] @ quotient.H.T
    newest = newest / np.linalg.norm(newest)
    w = p[:k] @ quotient.N.T @ equations.seen
    T = np.eye(k) if k == len(F) else np.linalg.qr(w[::-1].T)[0].T
    both = np.linalg.lstsq(np.vstack([T, G]).T, (T @ F).T, rcond=None)[0].T
    M, N, c = without_rounding(both[:, :k]), both[:, k:], newest @ G @ T.T
    P, H = T @ equations.seen.T, newest @ quotient.H
    process, measurement = default_weights(model)
    states = P @ quotient.N
    gain = observer_gain(
        M,
        c[None],
        observable_split(M, c[None]),
        sampled=plant.is_discrete,
        process=states @ process @ states.T,
        measurement=(H @ measurement @ H)[None, None],
        rate=model.units.rate,
    )
    K = without_rounding(N @ quotient.H + P @ quotient.J + gain.K * H)
    state_map = without_rounding(states @ model.derivative - K[:, m:] @ model.algebra)
    static_map = (H[m:] @ model.algebra)[None]
    first = H[:m][np.abs(H[:m]) >= 0.1 * np.abs(H[:m]).max()][0]
    B, D = controls_of(plant)
    return Realization(
        M - gain.K * c,
        np.hstack([state_map @ B - K[:, :m] @ D, K[:, :m]]),
        -c[None] / first,
        np.hstack([-static_map @ B - H[None, :m] @ D, H[None, :m]]) / first,
        state_map,
        static_map / first,
    )
