"""Polynomial relations as filters with chosen poles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear import StateSpace
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.systems.balancing import balance_system, descriptor_units
from residua.plant import Plant


@dataclass(frozen=True, eq=False)
class Realization:
    """A filter with the maps that say what its states are: ``xi = T E x`` while nothing fails."""

    system: StateSpace
    state_map: NDArray[np.float64]
    static_map: NDArray[np.float64]


def realize_relation(
    p: NDArray[np.float64], q: NDArray[np.float64], plant: Plant, basis: PolynomialBasis
) -> Realization:
    r"""Return one relation divided by :math:`\prod_i (z - \lambda_i)`, as a chain of first and second order sections.

    In the basis :math:`N_0 = 1, N_{j+1} = (z - \lambda_{j+1}) N_j` the relation has the coefficients ``q_j`` and
    ``p_j``; the state ``j`` obeys

    .. math:: \xi_j^+ = \lambda_j \xi_j + \xi_{j-1} + q_j y - (p_j B + q_j D) u, \qquad
              r = \xi_{k-1} + q_k y - (p_k B + q_k D) u

    so that its poles stand on the diagonal, exact whatever the order. Conjugate poles make sections of order two.

    Parameters
    ----------
    p : ndarray, shape (order + 1, states of the plant)
        With ``p (zE - A) = q C``, as coefficients in the basis.
    q : ndarray, shape (order + 1, outputs)
    plant : Plant
    basis : PolynomialBasis
        On the poles, with sizes one.

    Returns
    -------
    Realization

    References
    ----------
    Gertler (1991), section 3.5 (poles assigned to parity equations by division) and eq. (4-18).
    """
    k = len(q) - 1
    M = np.diag(basis.real[:k]) + np.eye(k, k=-1)
    for j in np.flatnonzero(basis.imaginary[:k]):  # the first of a conjugate pair
        M[j, j + 1] = -basis.links[j + 1]
    U = -(p @ plant.B + q @ plant.D)
    B, D = np.hstack([U[:k], q[:k]]), np.hstack([U[k:], q[k:]])
    C = np.eye(k)[-1:] if k else np.zeros((1, 0))
    # what the filter remembers of the plant has a size too: a state that its inputs reach by rounding only has no other
    known = p / _equation_units(plant)
    balanced = balance_system(M, np.hstack([B, known[:k]]), C, np.hstack([D, known[k:]]))
    units = balanced.states / balanced.states[-1] if k else np.ones(0)  # C stays one
    system = StateSpace(M / units[:, None] * units, B / units[:, None], C * units, D, dt=plant.dt)
    return Realization(system, -p[:k] / units[:, None], p[k:])


def _equation_units(plant: Plant) -> NDArray[np.float64]:
    s = plant.system(("control", "disturbance", "fault"))
    return descriptor_units(s.A, s.E, s.B, s.C, s.D).equations


def pole_basis(poles: NDArray[np.complex128]) -> PolynomialBasis:
    """Return the basis on the poles of a filter: real ones first, then the pairs, conjugates side by side."""
    upper = poles[poles.imag > 0]
    upper = upper[np.argsort(np.abs(upper), kind="stable")]
    pairs = np.column_stack([upper, upper.conj()]).ravel()
    real = np.sort(poles[poles.imag == 0].real)
    return PolynomialBasis.on(np.concatenate([real, pairs, [0.0]]), in_order=True)
