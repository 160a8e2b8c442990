"""The steps of an observability staircase, with ranks decided beside what rounding of the steps before has made.

Rounding turns the basis of the states seen so far by itself over the weakest coupling so far, which couples states that
nothing couples, and more so step after step. Where a weak coupling may be no more than that, copies of the pair whose
entries differ in their last digits go through the same steps: a coupling that differs by its own size is rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.rank import RankDecision, spectral_norm

_EPS = float(np.finfo(float).eps)
#: Couplings above this, relative to the size of all, are never rounding: steps that amplify it so much end in one that
#: is weak before.
WEAK = 2.0**-10
#: Copies of a pair, and by how many units in the last place their entries differ at most.
_COPIES, _LAST_PLACES = 2, 4
#: A coupling is real where it is as many times what copies differ by.
SURELY = 4.0

Pair = tuple[NDArray[np.float64], NDArray[np.float64]]
T = TypeVar("T", bound=tuple[NDArray[np.float64], ...])


@dataclass(frozen=True, eq=False)
class Steps:
    """What the steps of a staircase found.

    Attributes
    ----------
    Q : ndarray, shape (n, n)
        An orthogonal basis, the observable states first.
    n_observable, n_seen : int
        States that outputs see in the end, and those that they see directly.
    decisions : tuple of RankDecision
    dropped : float
        The largest coupling that was called zero; one with outputs as if these were as large as ``A``.
    """

    Q: NDArray[np.float64]
    n_observable: int
    n_seen: int
    decisions: tuple[RankDecision, ...]
    dropped: float


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
    return Steps(Q, found.n_observable, found.n_seen, found.decisions, found.dropped)


def _steps(A: NDArray[np.float64], C: NDArray[np.float64], rtol: float, compare: bool) -> Steps:
    """Take the steps where every state has a path; with copies where a weak coupling may be rounding."""
    if not len(A):
        return Steps(np.eye(0), 0, 0, (), 0.0)
    sizes = _Sizes.of(A, C, rtol)
    found = _taken([(A, C)], sizes, rtol, compare)
    if found is None:
        found = _taken([(A, C), *copies_of((A, C))], sizes, rtol, compare)
    assert found is not None
    return found


def copies_of(matrices: T) -> list[T]:
    """Return matrices a few times more, each time with other last digits, which are the same in every call."""
    rng = np.random.default_rng(0)

    def like(M: NDArray[np.float64]) -> NDArray[np.float64]:
        return M * (1 + _EPS * rng.integers(-_LAST_PLACES, _LAST_PLACES + 1, M.shape))

    return [cast("T", tuple(like(M) for M in matrices)) for _ in range(_COPIES)]


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


def _taken(pairs: list[Pair], sizes: _Sizes, rtol: float, compare: bool) -> Steps | None:
    """Take the steps of a pair and its copies; or of a pair alone, and return nothing where it needs copies."""
    n = len(pairs[0][0])
    runs = [_Run(A, C, np.eye(n)) for A, C in pairs]
    one, copies = runs[0], runs[1:]
    decisions: list[RankDecision] = []
    first, dropped, turned = 0, 0.0, 0.0
    while one.seen < n:
        size = sizes.couplings if one.seen else sizes.C
        s = one.s
        tolerance = rtol * size
        rank = int(np.count_nonzero(s > tolerance))
        rounding = 10 * _EPS * (sizes.A if one.seen else sizes.C) + turned * sizes.shifted
        if compare and rank and s[rank - 1] < min(WEAK * size, SURELY * rounding):
            if not copies:
                return None
            tolerance = max(tolerance, SURELY * max(one.distance(other) for other in copies))
            rank = int(np.count_nonzero(s > tolerance))
        decisions.append(RankDecision(rank, s, tolerance))
        if s.size > rank and size:
            dropped = max(dropped, float(s[rank]) / size)
        if rank == 0:
            break
        first = first or rank
        turned += rounding / s[rank - 1]
        for run in runs:
            run.take(rank)
    return Steps(one.Q, one.seen, first, tuple(decisions), dropped * sizes.couplings)


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

    def distance(self, other: _Run) -> float:
        """Return by how much the couplings of a copy differ."""
        return float(np.linalg.norm(self.couplings() - other.couplings()))

    def take(self, rank: int) -> None:
        """Go on to what is coupled most."""
        self.Q[:, self.seen :] = self.Q[:, self.seen :] @ self._directions.T
        before, self.seen = self.seen, self.seen + rank
        left = self.Q[:, before : self.seen]
        self._couple(left, left.T @ self.A @ self.Q[:, self.seen :])
