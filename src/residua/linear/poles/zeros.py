"""Invariant zeros and normal rank of any linear system: non-square, descriptor, with hidden modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua.linear.subspaces.quotient import explicit, quotient
from residua.linear.subspaces.rank import RankDecision, decide_rank
from residua.linear.systems.scaling import scaling
from residua.linear.systems.state_space import StateSpace
from residua.tolerances import BALANCED_RANK

Matrix = NDArray[np.float64]
#: Rounding of a balanced matrix, by whose ``m``-th root ``m`` equal eigenvalues are scattered.
_SCATTER = 1e-14


class Cluster(NamedTuple):
    """Zeros that rounding may have scattered from one place.

    Attributes
    ----------
    center : complex
        Their mean, which rounding moves far less.
    count : int
    radius : float
        The distance of the farthest one from the mean.
    """

    center: complex
    count: int
    radius: float

    def __str__(self) -> str:
        return f"{self.count} zeros near {self.center:.4g}, radius {self.radius:.1g}"


@dataclass(frozen=True, eq=False)
class InvariantZeros:
    """The finite invariant zeros of a system and the rank of its transfer matrix.

    Attributes
    ----------
    zeros : ndarray of complex
        With multiplicity, sorted by real part.
    normal_rank : int
        Rank of the transfer matrix at almost every ``s``: that of the pencil less ``n``.
    decisions : tuple of RankDecision
        Every rank decision on the way, in balanced units.
    clusters : tuple of Cluster
        Zeros that may be equal: each is known to the radius of its cluster only.
    """

    zeros: NDArray[np.complex128]
    normal_rank: int
    decisions: tuple[RankDecision, ...]
    clusters: tuple[Cluster, ...] = ()


def invariant_zeros(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None, E: ArrayLike | None = None
) -> InvariantZeros:
    r"""Return the numbers ``s`` at which the pencil of a system loses rank.

    .. math:: \begin{bmatrix} A - sE & B \\ C & D \end{bmatrix}

    The system is divided by what its inputs reach unseen, and the transposed rest by what its outputs do not
    distinguish; the zeros are the eigenvalues of what is left.

    Parameters
    ----------
    A, B, C : array_like, shapes (n, n), (n, m), (p, n)
    D : array_like, shape (p, m), optional
        Zero when omitted.
    E : array_like, shape (n, n), optional
        Identity when omitted; may be singular.

    Returns
    -------
    InvariantZeros

    Raises
    ------
    ModelError
        If a matrix is malformed.

    References
    ----------
    Emami-Naeini and Van Dooren, Computation of zeros of linear multivariable systems, Automatica 18 (1982) 415-430.

    Examples
    --------
    >>> invariant_zeros([[0, 1], [-2, -3]], [[0], [1]], [[4, 1]]).zeros.real.round(12)
    array([-4.])
    """
    system = StateSpace(A, B, C, D, E=E)
    A, B, C, D, E = system.A, system.B, system.C, system.D, system.E
    units = scaling(A, B, C, D, E, sampled=False)
    R, X, Y = units.equations[:, None], units.states, units.outputs[:, None]
    A, B, C, D = R * A * X / units.rate, R * B * units.inputs / units.rate, Y * C * X, Y * D * units.inputs
    algebraic = 0
    if E is not None:
        n = len(A)
        A, B, C, D, *_ = explicit(A, B, C, D, R * E * X)
        algebraic = n - len(A)
    right = quotient(A, B, C, D)
    left = quotient(right.A.T, right.C.T, right.B.T, right.D.T)
    zeros = _zeros_of_square(left.A.T, left.C.T, left.B.T, left.D.T)
    zeros = zeros[np.lexsort((zeros.imag, zeros.real))]
    clusters = tuple(Cluster(units.rate * c.center, c.count, units.rate * c.radius) for c in clusters_of(zeros))
    return InvariantZeros(
        units.rate * zeros, left.D.shape[1] - algebraic, (*right.decisions, *left.decisions), clusters
    )


def _zeros_of_square(A: Matrix, B: Matrix, C: Matrix, D: Matrix) -> NDArray[np.complex128]:
    """Return the zeros of a system with a square and regular ``D``, without inverting it."""
    k, r = len(A), len(D)
    if not k:
        return np.zeros(0, dtype=complex)
    if not r:
        return np.asarray(np.linalg.eigvals(A), dtype=complex)
    W = np.linalg.qr(np.hstack([C, D]).T, mode="complete")[0][:, r:]  # what the outputs do not see
    return np.asarray(scipy.linalg.eigvals(np.hstack([A, B]) @ W, W[:k]), dtype=complex)


def clusters_of(zeros: NDArray[np.complex128], unit: float = 1.0) -> list[Cluster]:
    """Return the groups of numbers that rounding of a matrix of size ``unit`` may have scattered from one place."""
    left = list(range(len(zeros)))
    found = []
    for count in range(len(zeros), 1, -1):
        reach = 2 * unit * _SCATTER ** (1 / count)
        for i in list(left):
            if i not in left:
                continue
            near = sorted(left, key=lambda j: abs(zeros[j] - zeros[i]))[:count]
            mean = complex(zeros[near].mean()) if near else 0j
            radius = float(np.abs(zeros[near] - mean).max(initial=0.0))
            if len(near) == count and 0 < radius <= reach:
                found.append(Cluster(mean, count, radius))
                left = [j for j in left if j not in near]
    return found


def normal_rank(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None, E: ArrayLike | None = None
) -> int:
    """Return the rank of the transfer matrix at almost every ``s``.

    Parameters are those of `invariant_zeros`.

    Examples
    --------
    >>> normal_rank([[-1.0]], [[1.0, 2.0]], [[1.0], [1.0]])
    1
    """
    return invariant_zeros(A, B, C, D, E).normal_rank


def pencil_rank_at(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike | None = None,
    E: ArrayLike | None = None,
    s: complex = 0.0,
    *,
    rtol: float = BALANCED_RANK,
) -> RankDecision:
    """Decide the rank of the system pencil at one ``s``, in balanced units.

    Parameters
    ----------
    A, B, C, D, E : array_like
        See `invariant_zeros`.
    s : complex
        Finite.
    rtol : float
        Singular values below this count as zero; wider where ``s`` is known to fewer digits.

    Returns
    -------
    RankDecision
        Full column rank is ``n + m``, full row rank ``n + p``.

    Examples
    --------
    >>> print(pencil_rank_at([[0, 1], [-2, -3]], [[0], [1]], [[4, 1]], s=-4).rank)
    2
    """
    system = StateSpace(A, B, C, D, E=E)
    A, B, C, D, E = system.A, system.B, system.C, system.D, system.E
    units = scaling(A, B, C, D, E, sampled=False)
    R, X, U, Y = units.equations[:, None], units.states, units.inputs, units.outputs[:, None]
    dynamic = R * (A - s * (np.eye(len(A)) if E is None else E)) * X / units.rate
    far = max(1.0, float(np.abs(dynamic).max(initial=0.0)))  # of an s far beyond the rates of the system
    pencil = np.block([[dynamic / far, R * B * U / units.rate / far], [Y * C * X, Y * D * U]])
    largest = max(1.0, float(np.abs(pencil).max(initial=0.0)))
    return decide_rank(pencil, rtol=rtol, scale=largest)
