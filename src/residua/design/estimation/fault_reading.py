"""How faults are read off a plant whose state is known: from its equations, and from one derivative of its outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import AccuracyError, DesignError
from residua.linear.subspaces.rank import RankDecision, decide_rank, left_null_basis
from residua.plant import Plant
from residua.tolerances import BALANCED_RANK, IDENTITY, RESIDUE, RESPONSE_ROUNDING, above_rounding

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FaultReading:
    r"""Faults as functions of a known state.

    .. math:: f = L_s (y - D u - C x) + L_d (\dot y - D \dot u) - P (A x + B u)

    for any disturbance. Rows of :math:`L_d` that are zero need no derivative; :math:`L_d` reads only what neither
    faults nor disturbances enter directly. In sampled time the derivative is the next sample, and the fault the one
    before it.

    Attributes
    ----------
    static, derivative : ndarray, shape (faults, outputs)
        ``L_s`` and ``L_d``.
    dynamics : ndarray, shape (faults, n)
        ``P``; ``L_d C`` is its part that is not zero on the algebraic equations: ``P E = L_d C``.
    needs_derivative : ndarray of bool, shape (faults,)
    units : ndarray, shape (faults,)
        Size of each fault that moves states and outputs by about one of their own units.
    ranks : mapping of str to RankDecision
    """

    static: NDArray[np.float64]
    derivative: NDArray[np.float64]
    dynamics: NDArray[np.float64]
    needs_derivative: NDArray[np.bool_]
    units: NDArray[np.float64]
    ranks: dict[str, RankDecision]


def read_faults(plant: Plant, faults: tuple[str, ...]) -> FaultReading:
    r"""Return how to read faults off a plant in which they are the last disturbances.

    What the faults and disturbances ``v`` do at once, :math:`D v = y - D u - C x` and :math:`N B v = -N (A x + B u)`
    with :math:`N E = 0`, is used first; only what that leaves open is taken from derivatives of outputs that ``v``
    does not enter, :math:`W D = 0`, :math:`W C = R E`: :math:`R B v = W (\dot y - D \dot u) - R (A x + B u)`.
    The solution with the smallest derivative part is taken, with equal weights of all outputs in balanced units.

    Parameters
    ----------
    plant : Plant
        With an unknown input observer: then ``v`` is known up to what has no effect at all.
    faults : tuple of str

    Raises
    ------
    DesignError
        If the faults are not determined: they have the effect of disturbances or of one another.
    """
    model, p, n_f = plant.balanced, plant.n_outputs, len(faults)
    units, algebra = model.units, model.algebra
    weight = 1 / np.sqrt(units.measurement_weight)[:, None]
    B, D = model.disturbances  # of the states without algebraic equations, and of outputs, these among them
    C, D, free = (weight * M[:p] for M in (model.C, D, model.free[1]))
    at_once = np.vstack([D, model.disturbances[1][p:]])
    columns = np.vstack([B, at_once])
    all_of_them, without = (decide_rank(M, rtol=BALANCED_RANK, scale=1.0) for M in (columns, columns[:, :-n_f]))
    if all_of_them.rank < without.rank + n_f:
        others = plant.disturbances[: len(plant.disturbances) - n_f]
        against = f"from the disturbances {', '.join(others)} or " if others else ""
        raise DesignError(
            f"the faults {', '.join(faults)} cannot be told {against}from one another: rank [Bd Bf; Dd Df] = "
            f"{all_of_them.rank} < rank [Bd; Dd] + {n_f} = {without.rank + n_f}; estimate fewer of them at once"
        )
    W = left_null_basis(np.hstack([D, free]), rtol=BALANCED_RANK, scale=1.0)[0].T
    late, whole = W @ C @ B, np.eye(B.shape[1])[-n_f:]
    U, sizes, Vh = np.linalg.svd(at_once)
    r = int(np.count_nonzero(sizes > BALANCED_RANK))
    rest = whole @ Vh[r:].T
    rest[np.abs(rest).max(axis=1, initial=0.0) <= RESPONSE_ROUNDING] = 0.0
    L_d = rest @ _inverse(late @ Vh[r:].T)
    L_s = _without_residue((whole - L_d @ late) @ (Vh[:r].T / sizes[:r]) @ U[:, :r].T)
    missed = float(np.abs(L_s @ at_once + L_d @ late - whole).max(initial=0.0))
    if not missed <= IDENTITY:
        raise AccuracyError(
            f"the faults are read off with a relative error of {missed:.2g} > {IDENTITY:.0e}: the outputs see them too "
            "weakly; add a sensor"
        )
    P = L_s[:, p:] @ algebra + L_d @ W @ C @ model.derivative
    first = len(plant.inputs) + len(plant.disturbances) - n_f
    f, Y = units.inputs[first : first + n_f, None], weight[:, 0] * units.outputs
    return FaultReading(
        f * L_s[:, :p] * Y,
        f * _without_residue(L_d @ W) * Y / units.rate,
        f * _without_residue(P) * units.equations / units.rate,
        np.any(L_d, axis=1),
        f[:, 0],
        {"rank [Bd Bf; Dd Df]": all_of_them, "rank [Bd; Dd]": without},
    )


def _without_residue(M: Matrix) -> Matrix:
    """Return a matrix without the entries that are what rounding leaves beside the largest of their row."""
    return above_rounding(M, np.abs(M).max(axis=1, keepdims=True, initial=0.0), RESIDUE)


def _inverse(M: Matrix) -> Matrix:
    """Return the pseudoinverse of a balanced matrix, which may be nothing but rounding."""
    return np.asarray(scipy.linalg.pinv(M, atol=BALANCED_RANK, rtol=0.0)) if M.size else M.T
