"""Detection spaces: where a fault can be confined by output injection, and gains that confine several at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.linear.subspaces.quotient import quotient, without_rounding
from residua.linear.subspaces.rank import RankDecision
from residua.tolerances import BALANCED_ANSWER, BALANCED_RANK, RESIDUE, above_rounding

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DetectionSpace:
    r"""A space to which output injection can confine a fault.

    Attributes
    ----------
    basis : ndarray, shape (n, nu)
        Orthonormal basis of the space ``S``: the minimal unobservability subspace of the fault. Its dimension is one
        plus the invariant zeros of ``(A, l, C)`` (plus the relative degree) for a fault of the states, and the number
        of states that the other outputs do not see for one of an output.
    outputs : ndarray, shape (p, q)
        Orthonormal basis of where the residual of the fault stays.
    confining : ndarray, shape (n, q)
        The smallest gain on these outputs that confines it.
    decisions : tuple of RankDecision
    """

    basis: Matrix
    outputs: Matrix
    confining: Matrix
    decisions: tuple[RankDecision, ...] = ()

    @property
    def dimension(self) -> int:
        """Number of poles that the fault can have."""
        return self.basis.shape[1]


def detection_space(A: ArrayLike, C: ArrayLike, L: ArrayLike) -> DetectionSpace:
    """Return the smallest space to which output injection can confine events with all its poles free.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)
    L : array_like, shape (n, k)
        Fault events. Ranks are decided to 1e-11 of the norm of each matrix.

    Returns
    -------
    DetectionSpace

    References
    ----------
    Gertler (1991), section 5.1, eqs. (5-5) to (5-8), after White and Speyer (1987) and Massoumnia (1986).
    """
    A = arrays.matrix(A, "A", (None, None))
    C, L = arrays.matrix(C, "C", (None, len(A))), arrays.matrix(L, "L", (len(A), None))
    A, C, L = (M / (float(np.linalg.norm(M)) or 1.0) for M in (A, C, L))
    return confined_space(A, C, L)


def confined_space(A: Matrix, C: Matrix, L: Matrix, D: Matrix | None = None, *, zeros: bool = True) -> DetectionSpace:
    r"""Return the smallest space that a gain ``K`` makes invariant, and that holds :math:`L - K D`.

    The error of a fault :math:`L \nu` that enters the outputs as :math:`D \nu` stays in it.

    Parameters
    ----------
    A, C, L, D : ndarray
        Of a balanced pair.
    zeros : bool
        Whether the space holds its invariant zeros too, so that all of its poles are free.
    """
    D = np.zeros((len(C), L.shape[1])) if D is None else D
    q = quotient(A, L, C, D)
    S = complement((q.split.seen.T @ q.N if zeros else q.N).T)
    outputs = without_rounding(np.linalg.svd(q.D, full_matrices=False)[0])
    image, seen = np.hstack([A @ S, L]), outputs.T @ np.hstack([C @ S, D])
    confining = (image - S @ (S.T @ image)) @ np.linalg.pinv(seen)
    return DetectionSpace(S, outputs, without_rounding(confining), (*q.decisions, *q.split.decisions))


def complement(V: Matrix) -> Matrix:
    """Return an orthonormal basis of what is orthogonal to independent columns."""
    return without_rounding(np.linalg.svd(V)[0][:, V.shape[1] :])


def are_independent(bases: list[Matrix]) -> bool:
    """Tell whether orthonormal bases are linearly independent of one another."""
    whole = np.hstack(bases)
    sizes = np.linalg.svd(whole, compute_uv=False)
    return whole.shape[1] <= len(whole) and bool(np.all(sizes > BALANCED_ANSWER))


@dataclass(frozen=True, eq=False)
class Blocks:
    r"""A balanced pair ``(C, A)`` cut into one block per detection space and the rest.

    With any gains :math:`G_i` on the blocks and :math:`G_0` on the rest, :meth:`gain` gives ``K`` such that
    :math:`A - KC` is block triangular with :math:`A_i - G_i C_i` on its diagonal, so every fault stays in
    its own space.

    Attributes
    ----------
    pairs : list of (A_i, C_i)
        One for each space, then the rest. Modes of the rest that ``C_0`` does not see are poles that no gain moves:
        invariant zeros of ``(A, F, C)`` that belong to no single space, and unobservable modes of ``(C, A)``.
    reads : list of ndarray
        How the outputs of each are read from those of the pair.
    spaces : list of ndarray
        Bases of the spaces, then one of what is orthogonal to them all.
    confining : ndarray, shape (n, p)
        The part of the gain that makes the spaces invariant.
    """

    pairs: list[tuple[Matrix, Matrix]]
    reads: list[Matrix]
    spaces: list[Matrix]
    confining: Matrix

    def gain(self, gains: list[Matrix]) -> Matrix:
        """Return ``K`` from the gains of the blocks, that of the rest last."""
        parts = zip(self.spaces, gains, self.reads, strict=True)
        return self.confining + np.add.reduce([S @ G @ read for S, G, read in parts])


def split_blocks(A: Matrix, C: Matrix, spaces: list[DetectionSpace]) -> Blocks:
    """Cut a balanced pair into the blocks of spaces whose outputs are independent; see :class:`Blocks`."""
    n, p = len(A), len(C)
    D = np.hstack([np.zeros((p, 0)), *(space.outputs for space in spaces)])
    left = complement(D)
    U, s, _ = np.linalg.svd(left.T @ C, full_matrices=False)
    rest = left @ U[:, s > BALANCED_RANK]
    read = np.linalg.pinv(np.hstack([D, rest]))
    read = above_rounding(read, np.abs(read).max(axis=1, keepdims=True, initial=0.0), RESIDUE)
    reads = np.split(read, np.cumsum([space.outputs.shape[1] for space in spaces]).astype(int))
    confining = sum((space.confining @ part for space, part in zip(spaces, reads, strict=False)), np.zeros((n, p)))
    pairs = [(space.basis.T @ A @ space.basis, space.outputs.T @ C @ space.basis) for space in spaces]
    R = complement(np.hstack([np.zeros((n, 0)), *(space.basis for space in spaces)]))
    pairs.append((R.T @ (A - confining @ C) @ R, reads[-1] @ C @ R))
    pairs = [(without_rounding(F), without_rounding(G)) for F, G in pairs]
    return Blocks(pairs, reads, [*(space.basis for space in spaces), R], confining)
