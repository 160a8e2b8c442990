"""Descriptor systems ``E x' = A x + B v``: regularity, and the split into a dynamic and an algebraic part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError, ModelError
from residua.linear.poles.zero_structure import explicit_poles, scatter_of, without_zero_eigenvalues
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision, null_basis, range_basis
from residua.linear.systems.scaling import scaling
from residua.tolerances import above_rounding

Matrix = NDArray[np.float64]
#: A rank decision with less than this between what it kept and what it dropped is none.
_GAP = 1e3
#: Points at which the determinant is tried: a regular pencil is singular at finitely many only.
_POINTS = np.array([0.31, 1.0, 3.7, 0.9, 1.3]) * np.exp(1j * np.array([0.4, 1.1, 1.9, 2.6, 3.0]))


@dataclass(frozen=True, eq=False)
class ScaledPencil:
    """A pencil in comparable units: ``A = r A0 c``, ``E = r E0 c unit``, for ``s / unit`` in place of ``s``.

    All factors are powers of two, so that scaling rounds nothing.
    """

    A: Matrix
    E: Matrix
    rows: Matrix
    columns: Matrix
    unit: float


def balanced_pencil(A: NDArray, E: NDArray) -> ScaledPencil:
    """Return a square pencil in balanced units, in which ranks and the index do not depend on those of a user."""
    n = len(A)
    units = scaling(A, np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), E, sampled=False)
    rows, columns, unit = units.equations / units.rate, units.states, units.rate
    return ScaledPencil(rows[:, None] * A * columns, unit * rows[:, None] * E * columns, rows, columns, unit)


def checked_pencil(A: ArrayLike, E: ArrayLike | None) -> tuple[Matrix, Matrix]:
    """Return ``A`` and ``E`` (the identity when omitted) as square matrices of one size."""
    A = arrays.matrix(A, "A", (None, None))
    n = A.shape[0]
    A = arrays.matrix(A, "A", (n, n))
    E_ = np.eye(n) if E is None else arrays.matrix(E, "E", (n, n))
    return A, E_


def pencil_decision(p: ScaledPencil, rtol: float) -> RankDecision:
    """Return the normal rank of a pencil: the largest rank at points that are no special ones."""
    best = None
    for s in _POINTS:
        values = np.asarray(np.linalg.svd(s * p.E - p.A, compute_uv=False) if p.A.size else np.zeros(0), dtype=float)
        tolerance = rtol * (float(values[0]) if values.size else 0.0)
        decision = RankDecision(int(np.count_nonzero(values > tolerance)), values, tolerance)
        gap = float(values[-1] / values[0]) if values.size and values[0] else 0.0
        if best is None or (decision.rank, gap) > best[0]:
            best = ((decision.rank, gap), decision)
    assert best is not None
    return best[1]


def is_regular(A: ArrayLike, E: ArrayLike | None = None, *, rtol: float = DEFAULT_RTOL) -> bool:
    r"""Tell whether :math:`\det(sE - A)` is not zero for every ``s``.

    Exactly then ``E x' = A x + B v`` has one solution for every smooth input and every consistent initial state.
    The determinant is never formed: the pencil is scaled, and its rank decided at several points of the plane.

    Parameters
    ----------
    A : array_like, shape (n, n)
    E : array_like, shape (n, n), optional
        Identity when omitted.
    rtol : float
        Singular values below this fraction of the largest count as zero.

    Returns
    -------
    bool

    Raises
    ------
    ModelError
        If a matrix is malformed.

    References
    ----------
    Twardy and Kaczorek, part I, eq. (31b).

    Examples
    --------
    >>> is_regular([[1, 2], [3, 4]], [[1, 0], [0, 0]])
    True
    >>> is_regular([[1, 0], [0, 0]], [[1, 0], [0, 0]])
    False
    """
    A, E = checked_pencil(A, E)
    return pencil_decision(balanced_pencil(A, E), rtol).rank == len(A)


@dataclass(frozen=True, eq=False)
class WeierstrassForm:
    r"""A regular pencil split into a dynamic and an algebraic part.

    .. math:: P E Q = \begin{bmatrix} I & 0 \\ 0 & N \end{bmatrix}, \qquad
              P A Q = \begin{bmatrix} A_1 & 0 \\ 0 & I \end{bmatrix}

    With :math:`(x_1, x_2) = Q^{-1} x` and :math:`(B_1, B_2) = P B`: :math:`\dot x_1 = A_1 x_1 + B_1 v` and
    :math:`x_2 = -\sum_{i < \nu} N^i B_2 v^{(i)}`.

    Attributes
    ----------
    P, Q : ndarray, shape (n, n)
    A1 : ndarray, shape (n1, n1)
        ``n1`` is the degree of ``det(sE - A)``; the eigenvalues are the finite poles.
    N : ndarray, shape (n - n1, n - n1)
        Strictly upper block triangular, hence nilpotent, exactly.
    index : int
        The nilpotency index: the smallest ``k`` with ``N^k = 0``; 0 when ``E`` is invertible.
    Q_inverse : ndarray, shape (n, n)
    residual : float
        What the zeros of the form are missed by, in scaled units.
    condition : float
        Condition number of ``Q`` in scaled units: how far the two parts are from each other.
    decisions : tuple of RankDecision
        Every rank decision on the way.
    """

    P: Matrix
    Q: Matrix
    A1: Matrix
    N: Matrix
    index: int
    Q_inverse: Matrix
    residual: float
    condition: float
    decisions: tuple[RankDecision, ...]

    @property
    def n_finite(self) -> int:
        """``n1``, the order of the dynamic part."""
        return len(self.A1)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """The finite poles."""
        return explicit_poles(self.A1)


def weierstrass_form(
    A: ArrayLike, E: ArrayLike | None = None, *, rtol: float = DEFAULT_RTOL, tolerance: float = 1e-8
) -> WeierstrassForm:
    r"""Split a regular pencil into its finite and its infinite part.

    The two parts are the limits of the Wong sequences :math:`V_{i+1} = A^{-1}(E V_i)` from the whole space and
    :math:`W_{i+1} = E^{-1}(A W_i)` from zero, held by orthonormal bases; then :math:`Q = [V\ W]`,
    :math:`P = [E V\ A W]^{-1}`. No eigenvalue has to be separated from infinity: rank decisions reveal those
    at infinity in long chains, which rounding throws far into the plane.

    Parameters
    ----------
    A : array_like, shape (n, n)
    E : array_like, shape (n, n), optional
        Identity when omitted.
    rtol : float
        For the rank decisions, in scaled units.
    tolerance : float
        Largest residual of the form, in scaled units.

    Returns
    -------
    WeierstrassForm

    Raises
    ------
    ModelError
        If a matrix is malformed or the pencil is not regular.
    AccuracyError
        If the form misses the tolerance, or a rank decision left the two parts without the right sizes.

    References
    ----------
    Twardy and Kaczorek, part I, eqs. (15), (16); T. Berger, A. Ilchmann and S. Trenn, The quasi-Weierstrass form for
    regular matrix pencils, Linear Algebra Appl. 436 (2012) 4052-4069.

    Examples
    --------
    >>> form = weierstrass_form([[1, 2], [3, 4]], [[1, 0], [0, 0]])
    >>> form.index, form.A1.round(12)
    (1, array([[-0.5]]))
    """
    A, E = checked_pencil(A, E)
    n = len(A)
    p = balanced_pencil(A, E)
    regular = pencil_decision(p, rtol)
    if regular.rank < n:
        raise ModelError(
            f"det(sE - A) is zero for every s (normal rank {regular.rank} < {n}, the rest "
            f"{regular.largest_dropped:.2g} in scaled units): the equations do not determine the states; remove "
            "redundant ones, add missing ones"
        )
    decisions: list[RankDecision] = [regular]
    W, levels = _infinite_part(p, rtol, decisions)
    V = _finite_part(p, rtol, decisions)
    if V.shape[1] + W.shape[1] != n:
        raise AccuracyError(
            f"the finite part has {V.shape[1]} and the infinite part {W.shape[1]} of {n} states: a rank decision with "
            f"rtol={rtol:.3g} was not clear; choose another rtol, or rescale the model"
        )
    unclear = [d for d in decisions if d.rank and not d.largest_dropped * _GAP < d.smallest_kept]
    if unclear:
        raise AccuracyError(
            f"a rank decision with rtol={rtol:.3g} was not clear: {unclear[0]} in scaled units; choose another rtol, "
            "or rescale the model"
        )
    return _assembled(p, V, W, levels, tolerance, decisions)


def finite_poles(A: NDArray, E: NDArray) -> NDArray[np.complex128]:
    """Return the finite poles of a regular pencil: all eigenvalues where ``E`` is invertible, else those of ``A1``."""
    p = balanced_pencil(A, E)
    values = np.linalg.svd(p.E, compute_uv=False) if p.E.size else np.ones(1)
    if not values[-1] > DEFAULT_RTOL * values[0]:
        return weierstrass_form(A, E).poles
    found: NDArray[np.complex128] = np.asarray(scipy.linalg.eigvals(p.A, p.E), dtype=complex).reshape(-1)
    size = float(np.linalg.norm(p.A))
    rest, under, count = without_zero_eigenvalues(p.A, p.E, size)
    # rounding scatters those at zero
    if count and np.count_nonzero(np.abs(found) <= scatter_of(count, len(A), size / float(values[-1]))) >= count:
        found = np.concatenate([np.zeros(count, dtype=complex), scipy.linalg.eigvals(rest, under).reshape(-1)])
    return p.unit * found


def _preimage(M: Matrix, X: Matrix, rtol: float, decisions: list[RankDecision]) -> Matrix:
    """Return an orthonormal basis of ``{x : M x is in the range of X}``."""
    basis, decided = range_basis(X, rtol=rtol, scale=1.0)
    decisions.append(decided)
    rest = M - basis @ (basis.T @ M)
    preimage, decided = null_basis(rest, rtol=rtol, scale=max(float(np.linalg.norm(M, 2)), np.finfo(float).tiny))
    decisions.append(decided)
    return preimage


def _infinite_part(p: ScaledPencil, rtol: float, decisions: list[RankDecision]) -> tuple[Matrix, list[int]]:
    """Return nested orthonormal directions of the infinite part and how many came with each step."""
    n = len(p.A)
    W, levels = np.zeros((n, 0)), []
    while W.shape[1] < n:
        X = _preimage(p.E, p.A @ W, rtol, decisions)
        fresh = X - W @ (W.T @ X)
        U, s, _ = np.linalg.svd(fresh, full_matrices=False)
        # Directions of the preimage that were there already leave singular values of rounding, new ones leave 1.
        fresh = U[:, s > 0.5]
        if not fresh.shape[1]:
            break
        fresh = fresh - W @ (W.T @ fresh)
        W = np.hstack([W, np.linalg.qr(fresh)[0]])
        levels.append(fresh.shape[1])
    return W, levels


def _finite_part(p: ScaledPencil, rtol: float, decisions: list[RankDecision]) -> Matrix:
    V = np.eye(len(p.A))
    while True:
        smaller = _preimage(p.A, p.E @ V, rtol, decisions)
        if smaller.shape[1] >= V.shape[1]:
            return V
        V = smaller


def _assembled(
    p: ScaledPencil, V: Matrix, W: Matrix, levels: list[int], tolerance: float, decisions: list[RankDecision]
) -> WeierstrassForm:
    n, k = len(p.A), V.shape[1]
    Q = np.hstack([V, W])
    left = np.hstack([p.E @ V, p.A @ W])
    condition = float(np.linalg.cond(Q)) if n else 1.0
    worst = float(np.linalg.cond(left)) if n else 1.0
    if not max(condition, worst) < 1e12:
        raise AccuracyError(
            "the finite and the infinite part are not apart to working precision (condition "
            f"{max(condition, worst):.2g}): a finite pole is as good as infinite; drop the fastest dynamics from the "
            "model or rescale it"
        )
    P: Matrix = np.asarray(np.linalg.solve(left, np.eye(n)), dtype=float)
    # What is rounding of its terms would be a pole near zero, which has a size of its own.
    A1 = above_rounding(P[:k] @ p.A @ V, n * np.abs(P[:k]) @ np.abs(p.A) @ np.abs(V))
    N = (P @ p.E @ Q)[k:, k:]
    target_E, target_A = np.zeros((n, n)), np.zeros((n, n))
    target_E[:k, :k], target_A[:k, :k], target_A[k:, k:] = np.eye(k), A1, np.eye(n - k)
    nilpotent, start = np.zeros_like(N), 0
    for count in levels:
        nilpotent[:start, start : start + count] = N[:start, start : start + count]
        start += count
    target_E[k:, k:] = nilpotent
    # Against the plant, not against the form: this is what the equations are solved to.
    back_E = left @ target_E - p.E @ Q
    back_A = left @ target_A - p.A @ Q
    size = max(float(np.linalg.norm(p.A)), float(np.linalg.norm(p.E)), np.finfo(float).tiny)
    residual = max(float(np.linalg.norm(back_E)), float(np.linalg.norm(back_A))) / size if n else 0.0
    if not residual <= tolerance:
        raise AccuracyError(
            f"the Weierstrass form misses its equations by {residual:.2g} > {tolerance:.0e} (condition of the parts "
            f"{condition:.2g}): choose another rtol, or rescale the model"
        )
    lift = np.concatenate([np.full(k, p.unit), np.ones(n - k)])
    P = lift[:, None] * P * p.rows
    Q_inverse = np.linalg.solve(Q, np.eye(n)) / p.columns
    return WeierstrassForm(
        P,
        p.columns[:, None] * Q,
        p.unit * A1,
        nilpotent / p.unit,
        len(levels),
        Q_inverse,
        residual,
        max(condition, worst),
        tuple(decisions),
    )
