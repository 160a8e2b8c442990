"""Existence of an observer that ignores the disturbances, and the reasons against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.rank import RankDecision, decide_rank
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant, is_inside
from residua.tolerances import BALANCED_RANK, TINY


@dataclass(frozen=True, eq=False)
class UnknownInputExistence:
    r"""Existence of an unknown input observer, with the numbers behind each condition.

    Attributes
    ----------
    exists : bool
    reasons : tuple of str
        Why not, in words and numbers; empty when it exists.
    rank_CE, rank_E : RankDecision
        Condition (i): they must be equal.
    fixed_poles : ndarray
        Invariant zeros of ``(A, E, C)``, which are poles of every such observer; condition (ii): stable.
    useful : bool
        Whether measurements are left over to see faults with (more measurements than disturbances).
    near : tuple of RankDecision
        Rank decisions that double precision hardly allows; empty where all are clear.

    References
    ----------
    Chen, Patton and Zhang (1996), Lemma 1, Theorem 1 and the zero test in section 2.
    """

    exists: bool
    reasons: tuple[str, ...]
    rank_CE: RankDecision
    rank_E: RankDecision
    fixed_poles: NDArray[np.complex128]
    useful: bool
    near: tuple[RankDecision, ...] = ()

    def __bool__(self) -> bool:
        return self.exists

    def __str__(self) -> str:
        if not self.exists:
            return "no unknown input observer: " + "; ".join(self.reasons)
        if not self.useful:
            return "an unknown input observer exists, but its residual is zero whatever fails"
        return f"an unknown input observer exists (rank(CE) = rank(E) = {self.rank_E.rank})"


def unknown_input_observer_existence(plant: Plant) -> UnknownInputExistence:
    r"""Tell whether an observer exists whose error no disturbance reaches.

    Exactly when (i) :math:`\operatorname{rank}(CE) = \operatorname{rank}(E)` and (ii) the pair
    :math:`(C, A_1)`, :math:`A_1 = A - E(CE)^+CA`, is detectable, that is, the invariant zeros of
    :math:`(A, E, C)` are stable.

    Parameters
    ----------
    plant : Plant
        Disturbances in the outputs are eliminated first. For a singular ``E`` the conditions are
        :math:`\operatorname{rank}[E\ E_d; C\ 0] = n + \operatorname{rank} E_d`, where the algebraic equations count
        as measurements, and stable finite invariant zeros of :math:`(E, A, E_d, C)`.

    Returns
    -------
    UnknownInputExistence

    References
    ----------
    Chen, Patton and Zhang (1996), Theorem 1.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[-1, 1], [0, -2]], [[0], [1]], [[1, 0]])
    >>> print(rs.analysis.unknown_input_observer_existence(plant.with_disturbances({"gust": [0, 1]})))
    no unknown input observer: rank(CE)=0 < rank(E)=1: no exact unknown input observer; ...
    """
    model = plant.balanced
    q = model.quotient()
    rank_CE, rank_E, hidden = _conditions(model)
    modes = np.asarray(q.hidden_modes if q.proper else (), dtype=np.complex128)
    unstable = model.units.rate * modes[~is_inside(modes, plant.is_discrete)]
    reasons: tuple[str, ...] = (_unstable(plant, unstable),) if unstable.size else ()
    if not q.proper:
        reasons = (_improper(plant, rank_CE, rank_E, hidden),)
    fixed, useful = model.units.rate * modes, bool(len(q.H))
    return UnknownInputExistence(not reasons, reasons, rank_CE, rank_E, fixed, useful, q.near)


def _conditions(model: BalancedPlant) -> tuple[RankDecision, RankDecision, NDArray[np.float64]]:
    """Return the two ranks of condition (i), and the combinations of disturbances that outputs do not see at once."""
    plant, units = model.plant, model.units
    d = slice(len(plant.inputs), len(plant.inputs) + len(plant.disturbances))
    R, U, Y, (A, C, E) = units.equations[:, None], units.inputs[d], units.outputs[:, None], model.written
    B, D = R * plant.Bd * U / units.rate, Y * plant.Dd * U
    if plant.E is not None:  # the algebraic equations count as measurements
        C = np.vstack([C, model.algebra @ A])
        D = np.vstack([D, model.algebra @ B])
    left, right = _null_spaces(D)
    B, C = B @ right, left.T @ C
    rank_E = decide_rank(B, rtol=BALANCED_RANK, scale=1.0)
    if plant.E is None:
        rank_CE = decide_rank(C @ B, rtol=BALANCED_RANK, scale=1.0)
        return rank_CE, rank_E, right @ _null_spaces(C @ B)[1]
    whole = np.block([[E, B], [C, np.zeros((len(C), B.shape[1]))]])
    return decide_rank(whole, rtol=BALANCED_RANK, scale=1.0), rank_E, right


def _null_spaces(M: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return bases of the left null space and of the null space of a balanced matrix."""
    if not M.size:
        return np.eye(len(M)), np.eye(M.shape[1])
    U, s, Vh = np.linalg.svd(M)
    k = int(np.count_nonzero(s > BALANCED_RANK))
    return U[:, k:], Vh[k:].T


def _improper(plant: Plant, rank_CE: RankDecision, rank_E: RankDecision, hidden: NDArray[np.float64]) -> str:
    if plant.E is None:
        weight = np.abs(hidden).max(axis=1, initial=0.0)
        names = [name for name, w in zip(plant.disturbances, weight / max(weight.max(), TINY), strict=True) if w > 1e-6]
        return (
            f"rank(CE)={rank_CE.rank} < rank(E)={rank_E.rank}: no exact unknown input observer; add a sensor that sees "
            f"{' or '.join(map(repr, names)) or 'the disturbance'}, or decouple fewer disturbances"
        )
    return (
        f"rank [E D; C 0] = {rank_CE.rank} < n + rank D = {plant.n_states + rank_E.rank}, algebraic equations counted "
        "as measurements: no exact unknown input observer; add a sensor that sees the states without equations of "
        "their own"
        + (f", or decouple fewer disturbances than {', '.join(plant.disturbances)}" if plant.disturbances else "")
    )


def _unstable(plant: Plant, unstable: NDArray[np.complex128]) -> str:
    bad = describe_modes(unstable)
    if plant.E is not None:
        return (
            f"([C; N A], T A) is not detectable: the finite invariant zero {bad} of (E, A, D, C) is a fixed pole "
            "outside the stability region; add a sensor, or decouple other disturbances"
        )
    if not plant.disturbances:
        return f"(C, A) is not detectable: no measurement sees the mode {bad}; add a sensor"
    return (
        f"(C, A1) is not detectable: the invariant zero {bad} of (A, E, C) is a fixed pole outside "
        "the stability region; add a sensor, or decouple other disturbances"
    )
