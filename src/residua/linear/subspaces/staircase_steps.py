"""The steps of an observability staircase, with ranks decided beside what rounding of the steps before has made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.rank import spectral_norm
from residua.linear.subspaces.weak_couplings import UnclearRankError, WeakCouplings, copies_of

_EPS = float(np.finfo(float).eps)

Pair = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Steps:
    """What the steps of a staircase found.

    Attributes
    ----------
    Q : ndarray, shape (n, n)
        An orthogonal basis, the observable states first.
    n_observable, n_seen : int
        States that outputs see in the end, and those that they see directly.
    dropped : float
        The largest coupling that was called zero; one with outputs as if these were as large as ``A``.
    decided : WeakCouplings
        How ranks were, step by step.
    """

    Q: NDArray[np.float64]
    n_observable: int
    n_seen: int
    dropped: float
    decided: WeakCouplings


def states_with_a_path(A: NDArray, C: NDArray) -> NDArray[np.bool_]:
    """Return which states have a path to any output: the others are hidden whatever the entries are."""
    couples = A != 0
    seen = np.any(C != 0, axis=0)
    fresh = seen
    while fresh.any():
        fresh = couples[fresh].any(axis=0) & ~seen
        seen = seen | fresh
    return seen


def staircase_steps(A: NDArray[np.float64], C: NDArray[np.float64], rtol: float, *, compare: bool = True) -> Steps:
    """Take the steps of a staircase of a pair in comparable units.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    C : ndarray, shape (p, n)
    rtol : float
        Relative to the norm of ``A`` (without its multiple of the identity) or of ``C``.
    compare : bool
        Whether weak couplings are compared with those of copies.

    Returns
    -------
    Steps
    """
    path = states_with_a_path(A, C)
    if path.all():
        return _steps(A, C, rtol, compare)
    order = np.r_[np.flatnonzero(path), np.flatnonzero(~path)]
    k = int(path.sum())
    found = _steps(A[np.ix_(order[:k], order[:k])], C[:, order[:k]], rtol, compare)
    Q = np.zeros_like(A)
    Q[np.ix_(order[:k], np.arange(k))] = found.Q
    Q[order[k:], np.arange(k, len(A))] = 1.0
    return Steps(Q, found.n_observable, found.n_seen, found.dropped, found.decided)


def _steps(A: NDArray[np.float64], C: NDArray[np.float64], rtol: float, compare: bool) -> Steps:
    """Take the steps where every state has a path; with copies where a weak coupling may be rounding."""
    if not len(A):
        return Steps(np.eye(0), 0, 0, 0.0, WeakCouplings(rtol))
    sizes = _Sizes.of(A, C, rtol)
    try:
        return _taken([(A, C)], sizes, rtol, compare)
    except UnclearRankError:
        return _taken([(A, C), *copies_of((A, C))], sizes, rtol, compare)


@dataclass(frozen=True, eq=False)
class _Sizes:
    """Spectral norms of a pair, of ``A`` without its multiple of the identity, and what its couplings are beside."""

    C: float
    A: float
    shifted: float
    couplings: float

    @staticmethod
    def of(A: NDArray[np.float64], C: NDArray[np.float64], rtol: float) -> _Sizes:
        n = len(A)
        size = spectral_norm(A)
        # Observability does not change with A - mu I; a plant sampled fast (A near I) shows its couplings only then.
        shifted = spectral_norm(A - np.trace(A) / n * np.eye(n))
        floor = 100 * n * _EPS * size / max(rtol, _EPS)
        return _Sizes(spectral_norm(C), size, shifted, max(shifted, min(size, floor)))


def _taken(pairs: list[Pair], sizes: _Sizes, rtol: float, compare: bool) -> Steps:
    """Take the steps of a pair, with its copies if there are any."""
    n = len(pairs[0][0])
    runs = [_Run(A, C, np.eye(n)) for A, C in pairs]
    one, decided = runs[0], WeakCouplings(rtol)

    def couplings() -> list[NDArray[np.float64]]:
        return [run.couplings() for run in runs] if len(runs) > 1 else []

    first, dropped = 0, 0.0
    while one.seen < n:
        size, of = (sizes.couplings, sizes.A) if one.seen else (sizes.C, sizes.C)
        rank = decided.rank(one.s, size, of=of, turning=sizes.shifted, couplings=couplings if compare else None)
        if one.s.size > rank and size:
            dropped = max(dropped, float(one.s[rank]) / size)
        if rank == 0:
            break
        first = first or rank
        for run in runs:
            run.take(rank)
    return Steps(one.Q, one.seen, first, dropped * sizes.couplings, decided)


class _Run:
    """A pair on its way through the steps."""

    def __init__(self, A: NDArray[np.float64], C: NDArray[np.float64], Q: NDArray[np.float64]) -> None:
        self.A, self.Q, self.seen = A, Q, 0
        self._couple(None, C)

    def _couple(self, left: NDArray[np.float64] | None, block: NDArray[np.float64]) -> None:
        """Note the couplings of the states seen last, or of the outputs, with all that are not seen yet."""
        self._left, self._block = left, block
        nothing = np.zeros((0, 0)), np.zeros(0), np.eye(block.shape[1])
        _, self.s, self._directions = np.linalg.svd(block) if block.size else nothing

    def couplings(self) -> NDArray[np.float64]:
        """Return these couplings in the coordinates of the pair, which have no choice of a basis in them."""
        M = self._block @ self.Q[:, self.seen :].T
        return M if self._left is None else self._left @ M

    def take(self, rank: int) -> None:
        """Go on to what is coupled most."""
        self.Q[:, self.seen :] = self.Q[:, self.seen :] @ self._directions.T
        before, self.seen = self.seen, self.seen + rank
        left = self.Q[:, before : self.seen]
        self._couple(left, left.T @ self.A @ self.Q[:, self.seen :])
