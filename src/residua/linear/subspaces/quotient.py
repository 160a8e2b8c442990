"""The quotient of a system by everything that unknown inputs reach unseen: one staircase for all.

Zeros, hidden modes, the existence of observers, and which fault a residual can see are read from it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.rank import RankDecision
from residua.tolerances import BALANCED_RANK, above_rounding

Matrix = NDArray[np.float64]
#: Balanced numbers below this are rounding: nothing is coupled by them.
NEGLIGIBLE = 8 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Quotient:
    r"""A system divided by what its unknown inputs ``v`` reach without being seen.

    Of :math:`\dot x = A x + B v, \; y = C x + D v` there remains

    .. math:: \dot z = A_q z + B_q v_q, \qquad y = C_q z + D_q v_q, \qquad z = N x, \quad x = P z + R v_q

    with ``D_q`` of full column rank, so that the inputs that are left are known from the outputs:
    :math:`v_q = D_q^+ (y - C_q z)` and

    .. math:: \dot z = F z + J y, \qquad 0 = H y - G z, \qquad J = B_q D_q^+, \; F = A_q - J C_q, \; G = H C_q

    Attributes
    ----------
    A, B, C, D : ndarray
        Of the quotient.
    N, P, R : ndarray
    proper : bool
        Whether ``x`` follows from ``z`` and ``v_q``: no input that is not seen moves it otherwise.
    decisions : list of RankDecision
    tolerance : float
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    N: Matrix
    P: Matrix
    R: Matrix
    proper: bool
    decisions: list[RankDecision] = field(repr=False)
    tolerance: float = BALANCED_RANK

    @cached_property
    def known(self) -> tuple[Matrix, Matrix]:
        """``D_q^+`` and ``H``: rows that read the inputs from the outputs, and rows that read none of them.

        An output that no input enters has a row of its own: a dead sensor with much noise is not mixed with the others.
        """
        p, k = self.D.shape
        entered = np.flatnonzero(self.D.any(axis=1))
        U, s, Vh = np.linalg.svd(self.D[entered])
        inverse, H = np.zeros((k, p)), np.eye(p)
        inverse[:, entered] = Vh.T / s @ U[:, :k].T
        H[np.ix_(entered, entered)] = U.T
        return without_rounding(inverse), without_rounding(np.delete(H, entered[:k], axis=0))

    @cached_property
    def J(self) -> Matrix:
        """``B_q D_q^+``."""
        return self.B @ self.known[0]

    @property
    def H(self) -> Matrix:
        """Rows that annihilate ``D_q``."""
        return self.known[1]

    @cached_property
    def pair(self) -> tuple[Matrix, Matrix]:
        """``(F, G)``."""
        return without_rounding(self.A - self.J @ self.C), without_rounding(self.H @ self.C)

    @cached_property
    def split(self) -> ObservableSplit:
        """The states that ``G`` sees, and those that it does not."""
        return observable_split(*self.pair, self.tolerance)

    @property
    def near(self) -> tuple[RankDecision, ...]:
        """The rank decisions that double precision hardly allows."""
        return tuple(one for one in (*self.decisions, *self.split.decisions) if not one.is_clear)

    @cached_property
    def hidden_modes(self) -> NDArray[np.complex128]:
        """Eigenvalues of what is not seen: poles of every filter that estimates ``z``."""
        rest = self.split.hidden
        return np.asarray(np.linalg.eigvals(rest.T @ self.pair[0] @ rest), dtype=complex)

    def drive(self, b: Matrix, d: Matrix) -> Matrix:
        """Return how further inputs enter the part that is seen, and below it how they enter ``H y``."""
        return np.vstack([self.split.seen.T @ (self.N @ b - self.J @ d), self.H @ d])


@dataclass(frozen=True, eq=False)
class ObservableSplit:
    """Orthonormal bases of the states that outputs see, and of those that they do not.

    Attributes
    ----------
    seen, hidden : ndarray, shapes (n, k) and (n, n - k)
    decisions : list of RankDecision
    """

    seen: Matrix
    hidden: Matrix
    decisions: list[RankDecision] = field(repr=False)


def quotient(
    A: Matrix,
    B: Matrix,
    C: Matrix,
    D: Matrix,
    P: Matrix | None = None,
    R: Matrix | None = None,
    *,
    tolerance: float = BALANCED_RANK,
) -> Quotient:
    r"""Divide a balanced system by what its unknown inputs reach unseen.

    In each round, with :math:`D Z = [0 \; D_2]`, :math:`B Z = [B_1 \; B_2]`, ``W`` the range of ``B_1`` and ``U`` its
    complement, the states along ``W`` become unknown inputs, until none is driven by what no output shows.

    Parameters
    ----------
    A, B, C, D : ndarray
        In balanced units.
    P, R : ndarray, optional
        What is to be had from the states and the inputs, ``P x + R v``; the states when omitted.
    tolerance : float
        Singular values below it are zero, here and in what is asked of the quotient.

    References
    ----------
    Massoumnia, Verghese and Willsky (1989), IEEE TAC 34(3): the smallest unobservability subspace that holds ``B``.
    """
    n = len(A)
    N = np.eye(n)
    P = N if P is None else P
    R = np.zeros((len(P), B.shape[1])) if R is None else R
    proper, decisions = True, []
    while True:
        _, _, unseen, rest, decision = _split(D, tolerance)
        decisions.append(decision)
        B1, D, B, lost, R = B @ unseen, D @ rest, B @ rest, R @ unseen, R @ rest
        proper = proper and bool(np.linalg.norm(lost) <= BALANCED_RANK * max(1.0, float(np.linalg.norm(R))))
        W, U, _, _, decision = _split(B1, tolerance)
        decisions.append(decision)
        if not W.shape[1]:
            return Quotient(A, B, C, D, N, P, R, proper, decisions, tolerance)
        B, D = np.hstack([U.T @ A @ W, U.T @ B]), np.hstack([C @ W, D])
        R, P, N = np.hstack([P @ W, R]), P @ U, U.T @ N
        A, C = U.T @ A @ U, C @ U
        A, B, C, D, N, P, R = (without_rounding(M) for M in (A, B, C, D, N, P, R))


def observable_split(A: Matrix, C: Matrix, tolerance: float = BALANCED_RANK) -> ObservableSplit:
    """Split the states of a balanced pair into those that the outputs see and those that they do not."""
    n = len(A)
    seen, hidden, rows, decisions = np.zeros((n, 0)), np.eye(n), C, []
    while hidden.shape[1]:
        _, _, rest, reading, decision = _split(rows @ hidden, tolerance)
        decisions.append(decision)
        if not reading.shape[1]:
            break
        reading = hidden @ reading
        seen, hidden, rows = np.hstack([seen, reading]), hidden @ rest, reading.T @ A
    return ObservableSplit(seen, hidden, decisions)


def without_rounding(M: NDArray) -> Matrix:
    """Return a matrix of balanced numbers with zeros where rounding may be all that there is."""
    return above_rounding(M, 1.0, NEGLIGIBLE)


def _split(M: Matrix, tolerance: float) -> tuple[Matrix, Matrix, Matrix, Matrix, RankDecision]:
    """Return bases, as columns: the range of a matrix and its complement, the null space and its complement."""
    rows, columns = M.shape
    U, s, Vh = np.linalg.svd(M) if M.size else (np.eye(rows), np.zeros(0), np.eye(columns))
    U, Vh, k = without_rounding(U), without_rounding(Vh), int(np.count_nonzero(s > tolerance))
    return U[:, :k], U[:, k:], Vh[k:].T, Vh[:k].T, RankDecision(k, s, tolerance)


def explicit(
    A: Matrix, B: Matrix, C: Matrix, D: Matrix, E: Matrix
) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix, Matrix, Matrix]:
    r"""Write a balanced descriptor system as an ordinary one.

    With :math:`E = U \operatorname{diag}(S, 0) V^T` the states that ``E`` does not see are unknown inputs, first among
    the columns of ``B``, and the equations without derivatives are outputs that read zero, last in ``C``.

    Returns
    -------
    tuple
        ``A, B, C, D`` of the ordinary system, the map ``T`` of its states, :math:`\xi = T E x`, with
        :math:`\dot\xi = T (A x + \dots)`, the map back, :math:`x = V_1 \xi + V_2 v`, as ``[V_1, V_2]``, and the
        rows of the algebraic equations.
    """
    U, s, Vh = np.linalg.svd(E)
    k = int(np.count_nonzero(s > BALANCED_RANK))
    root = np.sqrt(s[:k])
    T, V1, V2, algebra = U[:, :k].T / root[:, None], Vh[:k].T / root, Vh[k:].T, U[:, k:].T
    return (
        T @ A @ V1,
        np.hstack([T @ A @ V2, T @ B]),
        np.vstack([C @ V1, algebra @ A @ V1]),
        np.vstack([np.hstack([C @ V2, D]), algebra @ np.hstack([A @ V2, B])]),
        T,
        np.hstack([V1, V2]),
        algebra,
    )
