"""Full-order observers that disturbances cannot reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.analysis.unknown_input import (
    OrdinaryDecoupling,
    OutputFreeForm,
    SingularDecoupling,
    UnknownInputExistence,
    decomposed_existence,
    decoupling_map,
    error_pair,
    output_free_form,
)
from residua.arrays import matrix
from residua.design.core.evidence import Evidence
from residua.design.core.method import method
from residua.design.core.own_time import in_own_time
from residua.design.observers.estimate_check import check_estimate
from residua.design.observers.observer import (
    Observer,
    in_units_of_the_plant,
    kept_observer_for,
    without_measured_equations,
)
from residua.design.observers.observer_gain import gain_size, margin_from, place, pole_evidence
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.placement import Placement
from residua.linear.subspaces.far_gain import refuse_far_gain
from residua.linear.subspaces.observability import staircase
from residua.linear.subspaces.observable_part import UndetectableError
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision
from residua.linear.systems.array_cache import cached_by_contents
from residua.linear.systems.balancing import sum_without_rounding, without_rounding
from residua.plant import Plant
from residua.tolerances import IDENTITY, RESIDUE, TINY, above_rounding
from residua.words import counted

REFERENCE = "Chen, Patton and Zhang (1996), Int. J. Control 63(1), eqs. (2) to (13)"


@method(
    needs=["disturbances (or none)"],
    exists_when="rank [E Bd; C 0] = n + rank Bd; stable invariant zeros of (E, A, Bd, C)",
    order="n",
    source="Chen, Patton and Zhang (1996), eqs. (2) to (13)",
    state="estimate, converges whatever the disturbances do",
    decouples=True,
    singular=True,
)
@in_own_time()
def unknown_input_observer(
    plant: Plant,
    *,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    H0: ArrayLike | None = None,
    rtol: float = DEFAULT_RTOL,
) -> Observer:
    r"""Design a full-order observer whose error no disturbance reaches.

    .. math::

       \dot z = F z + T B u + K y, \qquad \hat x = z + H y

    with :math:`H = E(CE)^+` (in even units, so that the observer does not depend on those of the plant; with ``H0``
    it is :math:`E(CE)^+ + H_0 [I - CE(CE)^+]` in those of the plant), :math:`T = I - HC`, :math:`A_1 = T A`,
    :math:`F = A_1 - K_1 C` stable and :math:`K = K_1 + F H`. For a singular plant :math:`E_s \dot x = A x + \dots`,
    :math:`T E_s + H C = I` and :math:`T E = 0` take the place of the first two; the observer itself is an ordinary
    system. Guaranteed: the error obeys :math:`\dot e = F e` for any control input and any disturbance.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not; its disturbances are what is decoupled. A disturbance in
        the outputs is eliminated first.
    poles : sequence of complex, optional
        Poles of the error, closed under conjugation: as many as states, or as many as are free.
    margin : float, optional
        Stability margin in 1/s, used without ``poles``; when omitted, the geometric mean of the sizes of the
        poles of ``T A``.
    H0 : array_like, shape (n, outputs), optional
        The free matrix of the general solution, in the units of the plant: zeros give the smallest ``H`` in these
        units, as in the paper. Of ``H0 [I - CE(CE)^+]`` only what acts on the outputs left over by the decoupling
        matters.
    rtol : float
        Relative tolerance of every rank decision.

    Returns
    -------
    Observer
        With the matrices ``F, T, K, H, K1, K2, A1`` and its evidence.

    Raises
    ------
    DesignError
        If no such observer exists; the message says which condition failed, with its numbers.
    AccuracyError
        If the poles or the decoupling missed their tolerance.

    See Also
    --------
    decoupled_residual : A residual without the condition on zeros.
    reduced_order_observer : Of the order n - p.
    robust_detection_filter : Names the fault too.
    fault_estimator : Estimates faults as unknown inputs.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant; disturbances enter where the model says, and may
    be any signals. Costs: as many independent measurements as
    disturbances are used up, and the error's poles include the invariant zeros of (A, E, C).

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (2) to (13), Lemma 1 and Theorem 1; the general solution with
    ``H0`` is in the proof of Lemma 1.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.twardy()
    >>> observer = rs.design.unknown_input_observer(plant, poles=[-2, -2 + 1j, -2 - 1j])
    >>> observer.H
    array([[1., 0.],
           [0., 0.],
           [0., 0.]])
    """
    if H0 is not None:  # as the equations say, in the units of the plant
        return observer_of(plant, decomposed_existence(plant, rtol=rtol), poles, margin, H0, rtol)
    return kept_observer_for(plant, lambda own: _designed(own, poles, margin, rtol))


@cached_by_contents
def _designed(plant: Plant, poles: Sequence[complex] | ArrayLike | None, margin: float | None, rtol: float) -> Observer:
    """Return the observer of a plant in its own units."""
    return observer_of(plant, decomposed_existence(plant, rtol=rtol), poles, margin, None, rtol)


def observer_of(
    plant: Plant,
    existence: UnknownInputExistence,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    H0: ArrayLike | None,
    rtol: float,
) -> Observer:
    """Return the observer of an answer about its existence, by the decomposition that the answer was read from."""
    if not existence:
        raise DesignError("; ".join(existence.reasons))
    parts = existence.decomposition
    if isinstance(parts, SingularDecoupling):
        if H0 is not None:
            raise DesignError("H0 is the free matrix of an ordinary plant; for a singular one leave it out")
        return _of_singular_plant(plant, parts, poles, margin, existence, rtol)
    assert isinstance(parts, OrdinaryDecoupling)
    if H0 is not None:
        return _with_free_matrix(plant.explicit(), H0, poles, margin, existence, rtol)
    even = parts.even.plant
    if poles is None and margin is None:
        margin = margin_from(parts.A22, even)
    with _known_to_exist():
        placed = place(*parts.error_pair, poles, margin, plant.dt, rtol)
    farthest = float(np.abs(placed.requested).max(initial=margin or 0.0))
    refuse_far_gain(*parts.error_pair, placed.gain, 1.0 if plant.dt else farthest)
    placed = replace(placed, gain=without_rounding(parts.M, placed.gain, parts.outputs))
    made = assemble(even, parts.form, parts.T, parts.H, placed, existence)
    return in_units_of_the_plant(made, plant.explicit(), parts.even)


def _with_free_matrix(
    plant: Plant,
    H0: ArrayLike,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    existence: UnknownInputExistence,
    rtol: float,
) -> Observer:
    """Return the observer of one free matrix: as the equations say, in the units of the plant."""
    form = output_free_form(plant, rtol=rtol)
    H = decoupling_gain(form, H0)
    T = decoupling_map(H, plant.C)
    A1 = without_rounding(T, form.A)
    if poles is None and margin is None:
        margin = margin_from(A1, plant)
    with _known_to_exist():
        placed = place(A1, form.C, poles, margin, plant.dt, rtol)
    return assemble(plant, form, T, H, placed, existence, even=False)


@contextmanager
def _known_to_exist() -> Iterator[None]:
    """Placement for an error that is known to be detectable: from the plant, whose modes are known better."""
    try:
        yield
    except UndetectableError as error:
        raise AccuracyError(
            "an observer of this plant exists, but rounding in the matrices of its error moves fixed poles that are "
            f"near one another across the boundary of stability ({error}); use reduced_order_observer or "
            "decoupled_residual, or add a sensor"
        ) from error


def _of_singular_plant(
    plant: Plant,
    parts: SingularDecoupling,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    existence: UnknownInputExistence,
    rtol: float,
) -> Observer:
    """Return the observer of a singular plant: the free part of the decoupling is placed along with the gain."""
    even, form, free = parts.even.plant, parts.form, parts.decoupling
    A1, C1 = error_pair(free, form)
    if poles is None and margin is None:
        margin = margin_from(A1, even)
    p = len(form.C)
    seen = staircase(A1, form.C, rtol=rtol).n_observable
    needed = seen < staircase(A1, C1, rtol=rtol).n_observable  # or else the smallest T is the best
    with _known_to_exist():
        placed = place(A1, C1 if needed else form.C, poles, margin, plant.dt, rtol)
    K1, Z = placed.gain[:, :p], placed.gain[:, p:] if needed else np.zeros((len(A1), len(free.N)))
    T, H = free.T - Z @ free.N, without_rounding(free.H - Z @ free.M, form.W)
    made = assemble(parts.measured, form, T, H, replace(placed, gain=K1), existence)
    return in_units_of_the_plant(without_measured_equations(made, even, parts.equations), plant, parts.even)


def decoupling_gain(form: OutputFreeForm, H0: ArrayLike | None = None) -> NDArray[np.float64]:
    """Return ``H`` on the measured outputs, with ``(H C - I) E = 0`` (eq. 5; Lemma 1)."""
    CE = form.C @ form.E
    p = len(form.C)
    inverse = np.linalg.pinv(CE) if CE.size else np.zeros((CE.shape[1], p))
    inverse = np.where(np.any(form.C, axis=1), inverse, 0.0)  # rounding on a dead output is no gain
    H = form.E @ inverse
    for _ in range(2):  # channels in very different units make one pseudoinverse inexact
        H = H + (form.E - H @ CE) @ inverse
    # what rounding left of nothing would couple states that nothing couples, in some units strongly
    H = above_rounding(H, p * (np.abs(form.E) @ np.abs(inverse)))
    if H0 is not None:
        n = len(form.A)
        free = matrix(H0, "H0", (n, form.W.shape[1]), what="states x outputs") @ form.W.T
        H = H + free @ (np.eye(p) - CE @ inverse)
    return H @ form.W


def assemble(
    plant: Plant,
    form: OutputFreeForm,
    T: NDArray,
    H: NDArray,
    placed: Placement,
    existence: UnknownInputExistence,
    *,
    even: bool = True,
) -> Observer:
    """Return the observer of a decoupling and a placed gain, with its identities checked.

    In even units a gain is known to the rounding of the largest of its row, in others to that of its own terms only.
    """
    K1 = sum_without_rounding((placed.gain, form.W), (T, form.G))  # of nothing it would couple states
    F = without_rounding(np.hstack([T, -K1]), np.vstack([plant.A, plant.C]))
    made_of = np.abs(K1) + np.abs(F) @ np.abs(H)
    K = above_rounding(K1 + F @ H, made_of)  # nothing, where H leaves nothing of an output
    if even:
        K = above_rounding(K, made_of.max(axis=1, keepdims=True, initial=0.0), RESIDUE)
    # where nothing is left of T, or of a column, what counts is what it is the rounding of
    sizes = max(1.0, float(np.linalg.norm(T))), float(np.linalg.norm(K))
    terms = sizes[0] * np.linalg.norm(plant.Bd, axis=0) + sizes[1] * np.linalg.norm(plant.Dd, axis=0)
    identity = _relative(T @ plant.Bd - K @ plant.Dd, terms[None, :], by_column=True)
    if not identity < IDENTITY:
        raise AccuracyError(
            f"the disturbances are not decoupled: |T E| / |E| = {identity:.2g}; the outputs see them too weakly "
            "beside one another; add a sensor, or decouple fewer disturbances"
        )
    TE = T if plant.E is None else T @ plant.E
    whole = _relative(TE + H @ plant.C - np.eye(plant.n_states), np.abs(TE) + np.abs(H) @ np.abs(plant.C))
    if not whole < IDENTITY:
        raise AccuracyError(
            f"T E + H C = I is missed by {whole:.2g} (relative): the outputs see the disturbances too weakly beside "
            "one another; add a sensor, or decouple fewer disturbances"
        )
    q, p = form.E.shape[1], len(form.W)
    method, notes = "unknown input observer", ()
    if q and p > q and plant.E is None:
        notes = (
            f"{p - q} of the {p} residuals are independent: the others are filtered copies, the price of "
            f"decoupling {counted(q, 'disturbance')}",
        )
    evidence = Evidence(
        method=method,
        **pole_evidence(placed, F),
        ranks=_ranks(plant, existence),
        conditions={
            "|T E| / |E|": identity,
            "T E + H C = I": whole,
            "pole error": placed.error,
            "size of K1": gain_size(F, K1, plant.C),
        },
        notes=notes,
        references=(REFERENCE,),
    )
    made = Observer(plant, F, T, K, np.eye(plant.n_states), H, form.W, method, True, evidence)
    return replace(made, evidence=evidence.extended(conditions={"estimate off the state": check_estimate(made)}))


def _relative(missed: NDArray, terms: NDArray, *, by_column: bool = False) -> float:
    """Return what an identity is missed by, relative to the largest of its terms, or of those of each column."""
    size = terms.max(axis=0 if by_column else None, keepdims=True, initial=0.0)
    return float(np.max(np.abs(missed) / np.maximum(size, TINY), initial=0.0))


def _ranks(plant: Plant, existence: UnknownInputExistence) -> dict[str, RankDecision]:
    if plant.E is not None:
        return {"rank [E D; C 0]": existence.rank_CE, "rank D": existence.rank_E}
    return {"rank(CE)": existence.rank_CE, "rank(E)": existence.rank_E} if existence.rank_E.rank else {}
