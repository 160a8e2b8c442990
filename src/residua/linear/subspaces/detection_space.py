"""Detection spaces: where a fault can be confined by output injection, and gains that confine several at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.rank import (
    DEFAULT_RTOL,
    RankDecision,
    decide_rank,
    left_null_basis,
    null_basis,
    range_basis,
    spectral_norm,
    without_noise,
    without_rounded_gains,
)
from residua.linear.subspaces.reachability import reachable_basis
from residua.linear.systems.balancing import without_rounding
from residua.tolerances import RESIDUE, above_rounding


@dataclass(frozen=True, eq=False)
class DetectionSpace:
    r"""The smallest space to which output injection can confine a fault, with all its poles free.

    Attributes
    ----------
    basis : ndarray, shape (n, nu)
        Orthonormal basis of the space ``S``: the minimal unobservability subspace that contains the fault
        events. Its dimension is one plus the invariant zeros of ``(A, l, C)`` (plus the relative degree).
    outputs : ndarray, shape (p, q)
        Orthonormal basis of ``C S``, where the residual of the fault stays.
    """

    basis: NDArray[np.float64]
    outputs: NDArray[np.float64]

    @property
    def dimension(self) -> int:
        """Number of poles that the fault can have."""
        return self.basis.shape[1]


def detection_space(A: NDArray, C: NDArray, L: NDArray, *, rtol: float = DEFAULT_RTOL) -> DetectionSpace:
    r"""Return the detection space of fault events ``L`` for the pair ``(C, A)``.

    First the minimal conditioned invariant space, :math:`W_{k+1} = L + A (W_k \cap \ker C)`. Any gain ``D``
    with :math:`(A - D C) W \subseteq W` then gives the wanted space as the unobservable space of
    :math:`(H C, A - D C)`, where ``H`` annihilates :math:`C W`.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    C : ndarray, shape (p, n)
    L : ndarray, shape (n, k)
    rtol : float

    Returns
    -------
    DetectionSpace

    References
    ----------
    Gertler (1991), section 5.1, eqs. (5-5) to (5-8), after White and Speyer (1987) and Massoumnia (1986).
    """
    W = conditioned_invariant_basis(A, C, L, rtol=rtol)
    scale = spectral_norm(C)
    outputs, _ = range_basis(C @ W, rtol=rtol, scale=scale)
    if W.shape[1] == 0:
        return DetectionSpace(W, outputs)
    D = confining_gain(A, C, W)
    H, _ = left_null_basis(outputs) if outputs.shape[1] else (np.eye(len(C)), None)
    # W is not seen, which rounding would hide in a long staircase: only what is left of the states is searched
    P, _ = left_null_basis(W)
    read, _ = range_basis(P.T @ (C.T @ H), rtol=rtol, scale=scale)  # against C: nothing left is not to be something
    # what rounding leaves where everything cancels couples no states, however large it is beside nothing
    rest = without_rounding(P.T, np.hstack([np.eye(len(A)), -D]), np.vstack([A, C]), P)
    seen = P @ reachable_basis(rest.T, read, rtol=rtol)
    basis, _ = left_null_basis(seen) if seen.shape[1] else (np.eye(len(A)), None)
    return DetectionSpace(basis, outputs)


def conditioned_invariant_basis(
    A: NDArray, C: NDArray, L: NDArray, *, rtol: float = DEFAULT_RTOL
) -> NDArray[np.float64]:
    """Return an orthonormal basis of the smallest ``W`` that contains ``L`` and ``A (W with C x = 0)``."""
    L0, _ = range_basis(L, rtol=rtol)
    scale_A = spectral_norm(A)
    scale_C = spectral_norm(C)
    W = L0
    while W.shape[1]:
        hidden, _ = null_basis(C @ W, rtol=rtol, scale=scale_C)
        candidate = A @ (W @ hidden)
        for _ in range(2):
            candidate = candidate - W @ (W.T @ candidate)
        fresh, _ = range_basis(candidate, rtol=rtol, scale=max(scale_A, np.finfo(float).tiny))
        if fresh.shape[1] == 0:
            break
        W = np.hstack([W, fresh])
    return W


def confining_gain(A: NDArray, C: NDArray, S: NDArray) -> NDArray[np.float64]:
    """Return the smallest gain ``D`` with ``(A - D C) S`` inside ``S`` and the range of ``D`` outside it."""
    outside = A @ S - S @ (S.T @ (A @ S))
    U, s, Vh = np.linalg.svd(C @ S, full_matrices=False)
    k = int(np.count_nonzero(s > 1e-12 * np.linalg.norm(C, 2))) if C.size else 0  # C S may be nothing but rounding
    # an output that the gain does not need would be read by what rounding leaves, and its fault be a coupling
    return without_rounded_gains(outside @ (Vh[:k].T / s[:k]) @ U[:, :k].T)


@dataclass(frozen=True, eq=False)
class Separation:
    """Whether a set of detection spaces can be kept apart by one gain.

    Attributes
    ----------
    separable : bool
        The spaces and their outputs are linearly independent.
    outputs, spaces : RankDecision
        Ranks of the stacked output bases and of the stacked spaces.
    wanted_outputs, wanted_spaces : int
        The ranks that independence asks for.
    """

    separable: bool
    outputs: RankDecision
    spaces: RankDecision
    wanted_outputs: int
    wanted_spaces: int


def separation(spaces: list[DetectionSpace], *, rtol: float = 1e-8) -> Separation:
    """Tell whether the outputs of the detection spaces are linearly independent (output separability)."""
    D = decide_rank(np.hstack([space.outputs for space in spaces]), rtol=rtol)
    S = decide_rank(np.hstack([space.basis for space in spaces]), rtol=rtol)
    want_D = sum(space.outputs.shape[1] for space in spaces)
    want_S = sum(space.dimension for space in spaces)
    return Separation(D.rank == want_D and S.rank == want_S, D, S, want_D, want_S)


@dataclass(frozen=True, eq=False)
class Blocks:
    r"""The pair ``(C, A)`` cut into one block per detection space and the rest.

    With any gains :math:`G_i` on the blocks and :math:`G_0` on the rest, :meth:`gain` gives ``K`` such that
    :math:`A - KC` is block triangular with :math:`A_i - G_i C_i` on its diagonal, so every fault stays in
    its own space.

    Attributes
    ----------
    pairs : list of (A_i, C_i)
        One per detection space; all poles free but for modes that no output sees, of which a space has its own.
    rest : (A_0, C_0)
        The rest; its unobservable modes are poles that no gain can move: invariant zeros of
        ``(A, F, C)`` that belong to no single fault, and unobservable modes of ``(C, A)``.
    """

    pairs: list[tuple[NDArray, NDArray]]
    rest: tuple[NDArray, NDArray]
    _spaces: list[DetectionSpace]
    _confining: list[NDArray]
    _R: NDArray
    _read: NDArray

    def gain(self, block_gains: list[NDArray], rest_gain: NDArray) -> NDArray[np.float64]:
        """Return ``K`` from the gains of the blocks and of the rest."""
        columns = [
            K0 + space.basis @ G for K0, space, G in zip(self._confining, self._spaces, block_gains, strict=True)
        ]
        return np.hstack([*columns, self._R @ rest_gain]) @ self._read


def split_blocks(A: NDArray, C: NDArray, spaces: list[DetectionSpace], *, rtol: float = DEFAULT_RTOL) -> Blocks:
    """Cut ``(C, A)`` into the blocks of separable detection spaces; see :class:`Blocks`."""
    n = len(A)
    range_C, _ = range_basis(C, rtol=rtol)
    D = np.hstack([np.zeros((len(C), 0)), *(space.outputs for space in spaces)])
    inside = range_C - D @ np.linalg.lstsq(D, range_C, rcond=None)[0] if D.shape[1] else range_C
    U, _, _ = np.linalg.svd(inside, full_matrices=False)
    rest_outputs = without_noise(U[:, : range_C.shape[1] - D.shape[1]])
    read = inverse_without_rounding(np.hstack([D, rest_outputs]))
    pairs, confining, row = [], [], 0
    for space in spaces:
        S, q = space.basis, space.outputs.shape[1]
        seen = without_rounding(space.outputs.T, C, S)
        confining.append(
            without_rounding(np.hstack([np.eye(n), -S]), np.vstack([A, S.T @ A]), S, inverse_without_rounding(seen))
        )
        pairs.append((without_rounding(S.T, A, S), seen))
        row += q
    S_all = np.hstack([np.zeros((n, 0)), *(space.basis for space in spaces)])
    R = left_null_basis(S_all)[0] if S_all.shape[1] else np.eye(n)
    K_given = np.hstack([np.zeros((n, 0)), *confining])
    # Sums that cancel leave exact zeros: what rounding leaves of them would be couplings that poles are placed through.
    A0 = without_rounding(np.hstack([R.T, -(R.T @ K_given) @ read[:row]]), np.vstack([A, C]), R)
    return Blocks(pairs, (A0, without_rounding(read[row:], C, R)), spaces, confining, R, read)


def inverse_without_rounding(M: NDArray) -> NDArray[np.float64]:
    """Return the pseudo-inverse of a matrix in even units, exactly zero where only rounding is left."""
    inverse = np.linalg.pinv(M, rcond=1e-12)
    return above_rounding(inverse, np.abs(inverse).max(initial=0.0), RESIDUE)
