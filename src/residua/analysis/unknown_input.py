"""Whether an observer exists that ignores the disturbances, and if not, why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.observability import detectability
from residua.linear.rank import DEFAULT_RTOL, RankDecision, decide_rank
from residua.plant import Plant
from residua.plant.disturbances import factor_disturbance


@dataclass(frozen=True, eq=False)
class OutputFreeForm:
    r"""The plant rewritten so that no disturbance enters the outputs that are used.

    With :math:`D_d = U_1 S V_1^T`, the part of ``d`` that reaches the outputs is expressed by them,
    :math:`V_1^T d = S^{-1} U_1^T (y - C x)`, and put into the state equation; the outputs :math:`W y`
    with :math:`W D_d = 0` remain.

    Attributes
    ----------
    A, C, E : ndarray
        Of :math:`\dot x = A x + G y + \dots + E d`, :math:`W y = C x`; ``E`` has full column rank.
    G : ndarray, shape (n, outputs)
    W : ndarray, shape (outputs left, outputs)
    rank_E : RankDecision
    """

    A: NDArray
    C: NDArray
    E: NDArray
    G: NDArray
    W: NDArray
    rank_E: RankDecision


def output_free_form(plant: Plant, *, rtol: float = DEFAULT_RTOL) -> OutputFreeForm:
    """Return the plant with the disturbances removed from its outputs; see :class:`OutputFreeForm`."""
    p, n = plant.n_outputs, plant.n_states
    if not np.any(plant.Dd):
        E1, decision = factor_disturbance(plant.Bd, rtol=rtol)
        E = plant.Bd if decision.rank == plant.Bd.shape[1] else E1
        return OutputFreeForm(plant.A, plant.C, E, np.zeros((n, p)), np.eye(p), decision)
    rows, columns = _units(np.vstack([plant.Bd, plant.Dd]), plant.n_states)
    Bd, Dd = plant.Bd * columns, rows[:, None] * plant.Dd * columns
    U, s, Vh = np.linalg.svd(Dd)
    r = int(np.count_nonzero(s > rtol * s[0]))
    G = Bd @ Vh[:r].T / s[:r] @ U[:, :r].T * rows
    W = np.linalg.qr((U[:, r:].T * rows).T)[0].T
    rest = Bd @ Vh[r:].T
    scale = float(np.linalg.norm(Bd, 2)) if Bd.size else 0.0
    E, decision = factor_disturbance(rest, rtol=rtol)
    if scale and decision.singular_values.size and decision.singular_values[0] <= rtol * scale:
        E, decision = rest[:, :0], RankDecision(0, decision.singular_values, rtol * scale)
    return OutputFreeForm(plant.A - G @ plant.C, W @ plant.C, E, G, W, decision)


def _units(F: NDArray, n_states: int) -> tuple[NDArray, NDArray]:
    """Return factors for the outputs and for the disturbances that make their entries comparable."""
    columns = 1.0 / np.maximum(np.abs(F).max(axis=0, initial=0.0), 1e-300)
    heights = np.abs(F[n_states:] * columns).max(axis=1, initial=0.0)
    rows = 1.0 / np.where(heights > 0, heights, 1.0)
    columns = 1.0 / np.maximum(np.abs(rows[:, None] * F[n_states:]).max(axis=0, initial=0.0), 1e-300)
    silent = ~np.any(F[n_states:], axis=0)
    return rows, np.where(silent, 1.0 / np.maximum(np.abs(F).max(axis=0, initial=0.0), 1e-300), columns)


@dataclass(frozen=True, eq=False)
class UnknownInputExistence:
    r"""Whether an unknown input observer exists, with the numbers behind each condition.

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

    def __bool__(self) -> bool:
        return self.exists

    def __str__(self) -> str:
        if not self.exists:
            return "no unknown input observer: " + "; ".join(self.reasons)
        if not self.useful:
            return "an unknown input observer exists, but its residual is zero whatever fails"
        return f"an unknown input observer exists (rank(CE) = rank(E) = {self.rank_E.rank})"


def unknown_input_observer_existence(plant: Plant, *, rtol: float = DEFAULT_RTOL) -> UnknownInputExistence:
    r"""Tell whether an observer exists whose error no disturbance reaches.

    Exactly when (i) :math:`\operatorname{rank}(CE) = \operatorname{rank}(E)` and (ii) the pair
    :math:`(C, A_1)`, :math:`A_1 = A - E(CE)^+CA`, is detectable, that is, the invariant zeros of
    :math:`(A, E, C)` are stable.

    Parameters
    ----------
    plant : Plant
        With invertible ``E`` matrix. Disturbances in the outputs are eliminated first.
    rtol : float
        Relative tolerance of every rank decision.

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
    plant = plant.explicit()
    form = output_free_form(plant, rtol=rtol)
    CE = form.C @ form.E
    rank_CE = _product_rank(form.C, form.E, rtol)
    q = form.E.shape[1]
    reasons: list[str] = []
    fixed = np.zeros(0, dtype=complex)
    if rank_CE.rank < q:
        reasons.append(
            f"rank(CE)={rank_CE.rank} < rank(E)={q}: no exact unknown input observer; add a sensor that sees "
            f"{_unseen(plant, form)}, or decouple fewer disturbances"
        )
    else:
        A1 = form.A - form.E @ np.linalg.pinv(CE) @ form.C @ form.A if q else form.A
        found = detectability(A1, form.C, dt=plant.dt, rtol=rtol)
        fixed = found.unobservable_modes
        if not found.detectable:
            bad = ", ".join(f"{z:.4g}" for z in np.atleast_1d(found.unstable_modes))
            reasons.append(
                f"(C, A1) is not detectable: the invariant zero {bad} of (A, E, C) is a fixed pole outside "
                "the stability region; add a sensor, or decouple other disturbances"
                if q
                else f"(C, A) is not detectable: no measurement sees the mode {bad}; add a sensor"
            )
    useful = len(form.W) > q
    return UnknownInputExistence(not reasons, tuple(reasons), rank_CE, form.rank_E, fixed, useful)


def _product_rank(C: NDArray, E: NDArray, rtol: float) -> RankDecision:
    """Return the rank of ``C E``, each entry judged against the terms that it is the sum of."""
    terms = np.abs(C) @ np.abs(E)
    if not terms.size:
        return RankDecision(0, np.zeros(0), 0.0)
    rows = terms.max(axis=1, keepdims=True)
    rows = np.where(rows > 0, rows, 1.0)
    columns = (terms / rows).max(axis=0)
    return decide_rank(C @ E / rows / np.where(columns > 0, columns, 1.0), rtol=rtol, scale=1.0)


def _unseen(plant: Plant, form: OutputFreeForm) -> str:
    """Return the names of the disturbances that the outputs do not see at once."""
    _, _, Vh = np.linalg.svd(form.C @ plant.Bd)
    hidden = Vh[decide_rank(form.C @ plant.Bd).rank :]
    weight = np.abs(hidden).max(axis=0, initial=0.0)
    names = [name for name, w in zip(plant.disturbances, weight, strict=True) if w > 1e-6]
    return " or ".join(f"'{name}'" for name in names) or "the disturbance"
