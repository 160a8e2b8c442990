"""How faults are read off a plant whose state is known: from its equations, and from one derivative of its outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, DesignError
from residua.linear.subspaces.rank import RankDecision, decide_rank, left_null_basis, null_basis
from residua.linear.systems.balancing import descriptor_units, without_rounding
from residua.plant import Plant
from residua.tolerances import RESIDUE, RESPONSE_ROUNDING, above_rounding


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


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The plant with its unknown inputs in units in which its entries are of one size."""

    A: NDArray
    E: NDArray
    B: NDArray
    C: NDArray
    D: NDArray
    equations: NDArray
    outputs: NDArray
    units: NDArray


def read_faults(plant: Plant, faults: tuple[str, ...], *, rtol: float) -> FaultReading:
    r"""Return how to read faults off a plant in which they are the last disturbances.

    What the faults and disturbances ``v`` do at once, :math:`D v = y - D u - C x` and :math:`N B v = -N (A x + B u)`
    with :math:`N E = 0`, is used first; only what that leaves open is taken from derivatives of outputs that ``v``
    does not enter, :math:`W D = 0`, :math:`W C = R E`: :math:`R B v = W (\dot y - D \dot u) - R (A x + B u)`.
    The solution with the smallest derivative part is taken.

    Parameters
    ----------
    plant : Plant
        With an unknown input observer: then ``v`` is known up to what has no effect at all.
    faults : tuple of str
    rtol : float

    Raises
    ------
    DesignError
        If the faults are not determined: they have the effect of disturbances or of one another.
    """
    s = _scaled(plant)
    ranks = _determined(s, plant, faults, rtol)
    n_f, p = len(faults), plant.n_outputs
    whole = np.eye(s.B.shape[1])[-n_f:]
    N = left_null_basis(s.E, rtol=rtol, scale=1.0)[0].T
    Z = null_basis(s.E, rtol=rtol, scale=1.0)[0]
    W = left_null_basis(np.hstack([s.D, s.C @ Z]), rtol=rtol, scale=1.0)[0].T
    R = W @ s.C @ np.linalg.pinv(s.E, rcond=rtol)
    at_once, late = np.vstack([s.D, N @ s.B]), R @ s.B
    U, sizes, Vh = np.linalg.svd(at_once)
    r = int(np.count_nonzero(sizes > rtol))
    rest = whole @ Vh[r:].T
    rest[np.abs(rest).max(axis=1, initial=0.0) <= RESPONSE_ROUNDING] = 0.0
    L_d = rest @ _inverse(late @ Vh[r:].T, rtol * max(1.0, float(np.linalg.norm(R))))
    left = whole - L_d @ late
    L_s = _reading_what_it_needs(left @ (Vh[:r].T / sizes[:r]) @ U[:, :r].T, at_once, left, rtol)
    missed = float(np.abs(L_s @ at_once + L_d @ late - whole).max(initial=0.0))
    if not missed < 1e-7:
        raise AccuracyError(
            f"the faults are read off with a relative error of {missed:.2g}: the outputs see them too weakly for "
            "this scaling; rescale the channels"
        )
    L_W = _without_residue(L_d @ W)
    L_R = _without_residue(L_d @ R)
    P = _without_residue(without_rounding(L_s[:, p:], N) + L_R)
    f = s.units[-n_f:, None]
    return FaultReading(
        f * L_s[:, :p] * s.outputs,
        f * L_W * s.outputs,
        f * P * s.equations,
        np.any(L_d, axis=1),
        f[:, 0],
        ranks,
    )


def _without_residue(M: NDArray) -> NDArray[np.float64]:
    """Return a matrix without the entries that are what rounding leaves beside the largest of their row."""
    return above_rounding(M, np.abs(M).max(axis=1, keepdims=True, initial=0.0), RESIDUE)


def _reading_what_it_needs(X: NDArray, M: NDArray, wanted: NDArray, rtol: float) -> NDArray:
    """Return ``X`` with ``X M = wanted``, solved again without the columns that are rounding in a row.

    What rounding leaves there would read outputs that the row leaves out, in the units of those however small.
    """
    for i, row in enumerate(X):
        kept = np.abs(row) > RESIDUE * np.abs(row).max(initial=0.0)
        if not kept.all():
            fewer = np.zeros(len(row))
            fewer[kept] = wanted[i] @ _inverse(M[kept], rtol)
            if np.abs(fewer @ M - wanted[i]).max() <= max(2 * np.abs(row @ M - wanted[i]).max(), RESIDUE):
                X[i] = fewer
    return X


def _scaled(plant: Plant) -> _Scaled:
    u = descriptor_units(plant.A, plant.E, np.hstack([plant.B, plant.Bd]), plant.C, np.hstack([plant.D, plant.Dd]))
    R, S, Y = u.equations[:, None], u.states, u.outputs[:, None]
    E = np.eye(plant.n_states) if plant.E is None else R * plant.E * S
    B, D = R * plant.Bd, Y * plant.Dd
    size = np.abs(np.vstack([B, D])).max(axis=0, initial=0.0)
    units = 1.0 / np.where(size > 0, size, 1.0)
    return _Scaled(R * plant.A * S, E, B * units, Y * plant.C * S, D * units, u.equations, u.outputs, units)


def _determined(s: _Scaled, plant: Plant, faults: tuple[str, ...], rtol: float) -> dict[str, RankDecision]:
    """Return the ranks that show that the faults have effects of their own, or raise."""
    n_f = len(faults)
    columns = np.vstack([s.B, s.D])
    all_of_them = decide_rank(columns, rtol=rtol, scale=1.0)
    without = decide_rank(columns[:, : columns.shape[1] - n_f], rtol=rtol, scale=1.0)
    if all_of_them.rank < without.rank + n_f:
        others = plant.disturbances[: len(plant.disturbances) - n_f]
        against = f"from the disturbances {', '.join(others)} or " if others else ""
        raise DesignError(
            f"the faults {', '.join(faults)} cannot be told {against}from one another: rank [Bd Bf; Dd Df] = "
            f"{all_of_them.rank} < rank [Bd; Dd] + {n_f} = {without.rank + n_f}; estimate fewer of them at once"
        )
    return {"rank [Bd Bf; Dd Df]": all_of_them, "rank [Bd; Dd]": without}


def _inverse(M: NDArray, tolerance: float) -> NDArray:
    """Return the pseudoinverse with an absolute tolerance: ``M`` may be nothing but rounding."""
    if not M.size:
        return M.T
    U, sizes, Vh = np.linalg.svd(M, full_matrices=False)
    r = int(np.count_nonzero(sizes > tolerance))
    return Vh[:r].T / sizes[:r] @ U[:, :r].T
