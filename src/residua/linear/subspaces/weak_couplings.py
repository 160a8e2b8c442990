"""Which couplings are real, where steps one after the other turn the bases of those before by what rounding left.

Rounding turns the basis of a step over its weakest coupling, and makes couplings in the next where there are none, more
so step after step. Where a weak coupling may be no more than that, copies of the matrices whose entries differ in their
last digits go through the same steps: a coupling that differs by its own size is rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.rank import RankDecision
from residua.tolerances import RESIDUE

_EPS = float(np.finfo(float).eps)
#: Couplings above this, relative to the size of all, are never rounding: steps that amplify it so much end in one that
#: is weak before.
_WEAK = 2.0**-10
#: Copies, and by how many units in the last place their entries differ at most.
_COPIES, _LAST_PLACES = 2, 4
#: A coupling is real where it is as many times what copies differ by.
SURELY = 4.0

Matrix = NDArray[np.float64]
T = TypeVar("T", bound=tuple[Matrix, ...])


class UnclearRankError(Exception):
    """A weak coupling may be rounding, which copies tell."""


def copies_of(matrices: T) -> list[T]:
    """Return matrices a few times more, each time with other last digits, which are the same in every call."""
    rng = np.random.default_rng(0)

    def like(M: Matrix) -> Matrix:
        return M * (1 + _EPS * rng.integers(-_LAST_PLACES, _LAST_PLACES + 1, M.shape))

    return [cast("T", tuple(like(M) for M in matrices)) for _ in range(_COPIES)]


class WeakCouplings:
    """The decisions about couplings on the way through some steps, and how far rounding has turned the bases so far.

    Attributes
    ----------
    decisions : list of RankDecision
    in_doubt : bool
        Whether a coupling may be rounding, or one that was left out is more than plain rounding.
    turned : float
        How far rounding has turned the bases by now, at most: a coupling that was left out is known to no more.
    """

    def __init__(self, rtol: float) -> None:
        self.decisions: list[RankDecision] = []
        self.in_doubt = False
        self.turned = 0.0
        self._rtol = rtol

    def rank(
        self,
        values: Matrix,
        size: float,
        *,
        of: float,
        turning: float,
        couplings: Callable[[], list[Matrix]] | None,
    ) -> int:
        """Decide how many singular values are couplings.

        Parameters
        ----------
        values : ndarray
            Singular values of the couplings of this step, largest first.
        size : float
            What the relative tolerance is of.
        of, turning : float
            Norm of what the couplings were computed from, and of what bases that are turned make couplings of.
        couplings : callable or None
            Returns those of the system and of each of its copies in the coordinates that all began in; none where there
            are no copies. ``None`` where copies are not asked for.

        Raises
        ------
        UnclearRankError
            If a coupling may be rounding, and there are no copies.
        """
        tolerance, rounding = self._rtol * size, 10 * _EPS * of + self.turned * turning
        rank = int(np.count_nonzero(values > tolerance))
        if couplings is not None and rank and values[rank - 1] < min(_WEAK * size, SURELY * rounding):
            one, *copies = couplings() or (None,)
            if one is None:
                raise UnclearRankError
            tolerance = max(tolerance, SURELY * max(float(np.linalg.norm(one - other)) for other in copies))
            rank = int(np.count_nonzero(values > tolerance))
        self.decisions.append(RankDecision(rank, values, tolerance))
        if (rank and values[rank - 1] < SURELY * rounding) or (len(values) > rank and values[rank] > RESIDUE * size):
            self.in_doubt = True
        if rank:
            self.turned += rounding / float(values[rank - 1])
        return rank
