"""Tolerances shared by several files, each with its reason; any other is beside its use.

Each is relative, and compared in units that do not depend on those of the user: to the terms that a number is the sum
of, or to the largest entry of a row in comparable units.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Nothing is divided by less, so that a size of zero is not an error: its comparand is then zero as well.
TINY = 1e-300

#: An entry this far below the largest of its row, in comparable units, is rounding of a factorisation.
RESIDUE = 64 * float(np.finfo(float).eps)

#: A sum this far below its terms is rounding of them: some hundred operations, each of half a unit in the last place.
ROUNDING = 1e-13

#: A response this far below the terms that it is made of is rounding: it has a solved system in it, so ten times more.
RESPONSE_ROUNDING = 1e-12

#: Rounding of a zero after a design, whose gain is less accurate than its responses.
DESIGN_ROUNDING = 1e-9

#: Residuals whose fault-free part is this far below the signals that they are differences of hold no noise.
SIGNAL_ROUNDING = 1e-12

#: Recorded values this far below the largest of their signal are rounding of it: a signal that stands still.
DATA_ROUNDING = 1e-9

#: Singular values below this are zero in balanced units, whose entries are near one. Between 1e-7 and 1e-13 no rank of
#: 10,000 generated plants was wrong; below, rounding of staircases comes near.
BALANCED_RANK = 1e-11

#: A pole or a mode is stable if it is farther than this inside of the boundary, in units of the rate of the plant.
BALANCED_STABLE = 1e-11

#: A balanced response to a fault of size one in a quotient counts as zero below this.
BALANCED_ANSWER = 1e-8

#: Decisions within this factor of their tolerance are near.
NEAR = 1e3

#: Singular values this far below the largest are zero where a rank of a model is decided, in comparable units.
RANK = 1e-10

#: Two numbers that a user wrote, such as steps of time, are the same to this.
SAME = 1e-9

#: An identity that defines a design, such as ``T E = 0``, holds to this, relative to its terms.
IDENTITY = 1e-8

#: Known inputs reach a residual or an estimate by less: peak over peak of the cancelling terms.
LEAK = 1e-6

#: Decoupled signals reach a residual by less, relative to the terms that cancel there.
LEAKAGE = 1e-7

#: Poles are where they were asked for to this, relative to their size.
POLE = 1e-6


def above_rounding(M: NDArray, size: NDArray | float, rtol: float = ROUNDING) -> NDArray:
    """Return an array with zeros for entries within the rounding of the terms of their sums."""
    return np.where(np.abs(M) > rtol * size, M, 0.0)
