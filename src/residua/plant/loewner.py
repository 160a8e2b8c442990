r"""Plants of least order from values of a response: singular values of divided differences give the order.

Of :math:`G(s) = C (sI - A)^{-1} B` with values at points :math:`\mu_i` and :math:`\lambda_j` the Loewner matrix

.. math::
   L_{ij} = \frac{G(\mu_i) - G(\lambda_j)}{\mu_i - \lambda_j} = -C (\mu_i I - A)^{-1} (\lambda_j I - A)^{-1} B

has as its rank the order of the least system, whatever states the response was written with: copies of a mode that
rounding sets apart, and modes that nothing reaches, are not in it. With the points spread over all rates its singular
values keep to a few decades, where the couplings of a staircase, powers of ``A``, fall by ten and more.

References
----------
Mayo and Antoulas (2007), A framework for the solution of the generalized realization problem, Linear Algebra and its
Applications 425, 634-662.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.poles.stability import hidden_modes
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.linear.subspaces.rank import RankDecision, spectral_norm
from residua.linear.systems.scaling import power_near, scaling
from residua.linear.systems.state_space import StateSpace
from residua.plant.observer_form import ReachablePart, quotient, response_points
from residua.tolerances import RESIDUE, RESPONSE_ROUNDING, TINY

_EPS = float(np.finfo(float).eps)
#: Points on each side at least: a plant of few states has its rates anywhere between the slowest and the fastest.
_FEWEST = 10
#: How often rows and columns are brought to one size in turn.
_ROUNDS = 4
#: Copies, and by how many units in the last place their entries differ at most.
_COPIES, _LAST_PLACES = 2, 4
#: Beyond so many times the difference between copies, a value is not rounding.
_SURELY = 4.0


@dataclass(frozen=True, eq=False)
class Loewner:
    """Divided differences of a response, with balanced rows and columns, and their singular values.

    Attributes
    ----------
    shifted : ndarray
        The same of ``s G(s)``: ``L`` with ``A`` in its midst.
    values_left, values_right : ndarray
        ``G`` at the points of the rows, and at those of the columns.
    rows, columns : ndarray
        Units, powers of two; zero where there is nothing but rounding.
    U, singular_values, Vh : ndarray
        Of ``L`` in these units.
    rounding : float
        Effect of the last digits of the coefficients on ``L`` in these units.
    points : ndarray of complex
        Of the columns, and their conjugates.
    """

    shifted: NDArray[np.float64]
    values_left: NDArray[np.float64]
    values_right: NDArray[np.float64]
    rows: NDArray[np.float64]
    columns: NDArray[np.float64]
    U: NDArray[np.float64]
    singular_values: NDArray[np.float64]
    Vh: NDArray[np.float64]
    rounding: float
    points: NDArray[np.complex128]

    def decided(self, k: int) -> RankDecision:
        """Return the decision for an order, with the size of rounding and of the values that it sets apart."""
        s = self.singular_values
        below = float(s[k]) if k < len(s) else 0.0
        return RankDecision(k, s, max(below, _SURELY * self.rounding, RESIDUE * float(s.max(initial=0.0))))

    def system(self, k: int, whole: StateSpace) -> StateSpace:
        """Return the balanced system of given order with these values, and the feedthrough of ``whole``.

        Inputs that reach no state of ``whole``, and outputs that see none, do not here either.
        """
        size = np.sqrt(self.singular_values[:k])
        left, right = (self.U[:, :k] / size).T * self.rows, (self.Vh[:k].T / size) * self.columns[:, None]
        A = left @ self.shifted @ right
        B = left @ self.values_left * np.any(whole.B, axis=0)
        C = -self.values_right @ right * np.any(whole.C, axis=1)[:, None]
        T = scaling(A, B, C, whole.D, sampled=whole.is_discrete).states
        return whole.replaced(A=A / T[:, None] * T, B=B / T[:, None], C=C * T, states=None)


def loewner(H: PolynomialMatrix, N: PolynomialMatrix, whole: StateSpace) -> Loewner:
    """Return the divided differences of ``H^-1 N`` less its feedthrough, with ``whole`` as a realisation of it."""
    n, dt = whole.n_states, whole.dt
    points = response_points(whole.poles(), dt, count=2 * max(_FEWEST, n // 2 + 2))
    points = points[np.argsort(np.abs(np.angle(points) if dt else points))]
    left, right = points[::2], points[1::2]
    L, shifted, V, W = _differences(H, N, whole.D, left, right)
    moved = [
        _differences(PolynomialMatrix(P), PolynomialMatrix(Q), whole.D, left, right)[0] - L
        for P, Q in _copies(H.coefficients, N.coefficients)
    ]
    rows, columns = _even_units(L, np.sqrt(np.sum(np.square(moved), axis=0)))
    U, s, Vh = np.linalg.svd(rows[:, None] * L * columns, full_matrices=False)
    rounding = max(spectral_norm(rows[:, None] * off * columns) for off in moved)
    return Loewner(shifted, V, W, rows, columns, U, s, Vh, rounding, np.concatenate([right, right.conj()]))


def _copies(*matrices: NDArray[np.float64]) -> list[list[NDArray[np.float64]]]:
    """Return copies of matrices with perturbed last digits, equal in every call."""
    rng = np.random.default_rng(0)
    return [
        [M * (1 + _EPS * rng.integers(-_LAST_PLACES, _LAST_PLACES + 1, M.shape)) for M in matrices]
        for _ in range(_COPIES)
    ]


def loewner_part(found: Loewner, k: int, whole: StateSpace) -> ReachablePart:
    """Return the system of given order without the modes of ``whole`` that are extra.

    They are what is left of ``whole`` beside the ``k`` directions that its inputs reach, by the states at the points.
    """
    n = whole.n_states
    units = scaling(whole.A, whole.B, np.zeros((0, n)), np.zeros((0, whole.n_inputs)), sampled=whole.is_discrete)
    A = units.equations[:, None] * whole.A * units.states
    B = units.equations[:, None] * whole.B * units.inputs
    shifted = found.points[:, None, None] * np.eye(n) - A
    states = np.asarray(np.linalg.solve(shifted, B.astype(complex)), dtype=complex)
    reached = _columns(states).real.transpose(1, 0, 2).reshape(n, -1) @ (found.Vh[:k] * found.columns).T
    Q = np.linalg.qr(reached / np.maximum(np.linalg.norm(reached, axis=0), TINY), mode="complete")[0]
    left_over = spectral_norm(Q[:, k:].T @ A @ Q[:, :k]) + 10 * n * _EPS * spectral_norm(A)
    removed, uncertainty = hidden_modes(A.T, Q, k, left_over)
    return ReachablePart(found.system(k, whole), removed, uncertainty, (found.decided(k),))


def _differences(
    H: PolynomialMatrix, N: PolynomialMatrix, D: NDArray, left: NDArray, right: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return ``L``, the shifted ``L`` of ``s G(s)``, and the values that rows and columns have, all as real numbers."""
    mu, la = (np.concatenate([points, points.conj()]) for points in (left, right))
    G, F = (quotient(H, N, points) - D for points in (left, right))
    G, F = np.concatenate([G, G.conj()]), np.concatenate([F, F.conj()])
    between = (mu[:, None] - la)[:, :, None, None]
    out = []
    for a, b in ((G, F), (mu[:, None, None] * G, la[:, None, None] * F)):
        both = (a[:, None] - b) / between
        whole = _columns(_rows(both).swapaxes(0, 1)).real  # right, left, outputs, inputs
        out.append(whole.transpose(1, 2, 0, 3).reshape(len(G) * len(D), -1))
    V = _rows(G).real.reshape(-1, D.shape[1])
    W = _columns(F).real.transpose(1, 0, 2).reshape(len(D), -1)
    return out[0], out[1], V, W


def _rows(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the real and imaginary parts of conjugate pairs of rows, one in each half."""
    one, other = np.split(values, 2)
    return np.concatenate([one + other, -1j * (one - other)]) / np.sqrt(2)


def _columns(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the real and imaginary parts of conjugate pairs along the first axis."""
    one, other = np.split(values, 2)
    return np.concatenate([one + other, 1j * (one - other)]) / np.sqrt(2)


def _even_units(
    L: NDArray[np.float64], rounding: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return factors that balance rows and columns without much rounding in any; zero for pure rounding."""
    units = [np.ones(count) for count in L.shape]
    for _ in range(_ROUNDS):
        for axis in (0, 1):
            scaled, noise = (np.linalg.norm(units[0][:, None] * M * units[1], axis=1 - axis) for M in (L, rounding))
            factor = np.minimum(1 / np.maximum(scaled, TINY), RESPONSE_ROUNDING / np.maximum(noise, TINY))
            units[axis] = units[axis] * np.where(scaled > _SURELY * noise, power_near(factor), 0.0)
    return units[0], units[1]
