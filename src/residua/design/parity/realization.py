"""Polynomial relations as filters with chosen poles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.polynomials.polynomial_basis import PolynomialBasis

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
