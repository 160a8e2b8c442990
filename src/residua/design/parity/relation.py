"""One parity relation, as polynomials in a basis that keeps their digits and as a filter, in balanced units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.core.internal_form import frequency_grid
from residua.design.observers.observer_gain import default_weights, pair_gain
from residua.errors import ModelError
from residua.linear.poles.placement import default_margin
from residua.linear.poles.pole_assignment import real_block_diagonal
from residua.linear.polynomials.pair_relations import PairRelations
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.quotient import without_rounding
from residua.plant import Plant
from residua.tolerances import TINY

#: Rad per sample, below which no residual of a sampled plant is looked at.
_SLOWEST = 1e-3
#: Of the balanced rate, below which poles are integrators that rounding has moved.
_INTEGRATES = 1e-5
Matrix = NDArray[np.float64]
#: Poles that meet those of the plant are this part of the plant's distance from them apart.
_MEET = 1e-3
_NONE = np.zeros(0, dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class Relation:
    r"""One relation: polynomials ``p``, ``q`` with :math:`p (zI - A) = q C` of the balanced plant.

    Attributes
    ----------
    equations : PairRelations
        All relations of its kind.
    p, q : ndarray, shape (order + 1, states) and (order + 1, outputs)
        Coefficients; the outputs include the algebraic equations.
    basis : PolynomialBasis
        In units of the rate of the plant.
    divided : ndarray
        Roots of the common factor that was divided out, in 1/s.
    """

    equations: PairRelations = field(repr=False)
    p: Matrix
    q: Matrix
    basis: PolynomialBasis
    divided: NDArray[np.complex128] = field(default_factory=_NONE.copy)

    @property
    def order(self) -> int:
        """The degree."""
        return len(self.q) - 1

    def times(self, factor: float) -> Relation:
        """Return a multiple."""
        return replace(self, p=factor * self.p, q=factor * self.q)

    def moved(self, basis: PolynomialBasis) -> Relation:
        """Return the same relation in another basis, made exact there."""
        p, q = self.equations.moved(self.p, self.q, self.basis, basis)
        return replace(self, p=p, q=q, basis=basis)

    def in_equations(self, plant: Plant) -> tuple[Matrix, Matrix]:
        """Return ``p`` and ``q`` with :math:`p (zE - A) = q C` of the balanced equations of the plant itself."""
        model, m = plant.balanced, plant.n_outputs
        return self.p @ model.derivative + self.q[:, m:] @ model.algebra, self.q[:, :m]


def lost_digits(rows: Sequence[Relation], generator: ResidualGenerator) -> float | None:
    """Return the digits of the data that cancel in residuals of faults, the faintest one; ``None`` without faults.

    In a filter on the poles of the rows' bases the terms are :math:`q_j N_j / N_k y`. What is left of them of the
    response to a fault, at frequencies below the rate of the plant (the median), is what rounding in data and
    arithmetic is relative to. A sampled plant that integrates answers to ever slower faults by ever more: frequencies
    begin at periods of 6,000 samples.
    """
    plant = generator.plant
    model = plant.balanced
    if not plant.faults:
        return None
    w = frequency_grid(generator.system, plant.system(()))
    w = w[w >= _SLOWEST / plant.dt] if plant.is_discrete else w
    w = w[w <= max(plant_rate(plant), w[len(w) // 4])]
    points = np.exp(1j * w * plant.dt) if plant.is_discrete else 1j * w / model.units.rate
    faults = np.abs(plant.system("fault").frequency_response(w))
    faults = faults * model.units.inputs[-len(plant.faults) :] * model.units.outputs[:, None]
    left = 1.0
    for row, seen in zip(rows, generator.structure, strict=True):
        N = row.basis.values(points, row.order) / row.basis.values(points, row.order)[:, -1:]
        response = np.abs(N @ (row.p @ model.faults[0] + row.q @ model.faults[1]))
        terms = np.einsum("wj,jm,wmf->wf", np.abs(N), np.abs(row.q[:, : plant.n_outputs]), faults)
        share = np.median(response / np.where(terms > 0, terms, 1.0), axis=0)
        left = min(left, float(share[seen].min(initial=1.0)))
    return float(-np.log10(max(left, TINY)))


def plant_rate(plant: Plant) -> float:
    """Return the rate in 1/s at which a continuous filter has its poles when the user lists none.

    The mean rate of the poles of the plant; where all of them integrate, the rate of the balanced plant.
    """
    rate = plant.balanced.units.rate
    try:
        A = plant.balanced.A if plant.E is None else real_block_diagonal(plant.system(()).poles() / rate)
    except ModelError:  # a singular plant may have no poles
        return 1.0
    margin = default_margin(A, plant.dt)
    return rate * (margin if plant.is_discrete or margin > _INTEGRATES else 1.0)


def filter_basis(plant: Plant, poles: NDArray[np.complex128]) -> PolynomialBasis:
    """Return the basis on the poles of a filter, in 1/s, of the size of their distance from those of the plant."""
    model, at = plant.balanced, poles / plant.balanced.units.rate
    if not len(at) or not len(model.A) or (plant.is_discrete and not np.any(at)):  # a moving average stays one
        return pole_basis(at)
    apart = float(np.median(np.abs(model.modes[:, None] - at)))
    least = _MEET * float(np.abs(model.A - at.real.mean() * np.eye(len(model.A))).max())
    return pole_basis(at, float(np.exp2(np.round(np.log2(max(apart, least) or 1.0)))))


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
    A = np.diag(basis.real[:k]) + np.diag(basis.sizes[: max(k - 1, 0)], -1)[:k, :k]
    for j in np.flatnonzero(basis.imaginary[:k]):  # the first of a conjugate pair
        A[j, j + 1] = -basis.links[j + 1]
    return A


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
    noise = states @ process @ states.T, (H @ measurement @ H)[None, None]
    gain = pair_gain(model, M, c[None], noise, None, None)
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
