"""What a perfect observer is checked for: whether it can exist, and whether its estimate is the state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.design.core.evidence import Evidence
from residua.design.observers.perfect_gain import PerfectGain
from residua.errors import AccuracyError, DesignError
from residua.linear import StateSpace, decide_rank, invariant_zeros
from residua.linear.norms.system_norms import h2_norm, hinf_norm
from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.rank import left_null_basis
from residua.linear.systems.balancing import descriptor_units
from residua.linear.systems.descriptor import scaled_pencil
from residua.linear.systems.response_terms import response_terms
from residua.plant import Plant

if TYPE_CHECKING:
    from residua.design.observers.perfect_observer import PerfectObserver

REFERENCE = "Twardy and Kaczorek, part I, eqs. (30) to (33), Theorem 4, Procedure 2"

#: States of a filter beyond which its peak gain is not computed.
MOST_STATES = 300
#: A response this far below its terms is rounding of nothing.
_NOTHING = 1e-12


def check_singular(plant: Plant, rtol: float) -> None:
    """Raise when ``E`` is invertible and nothing else makes the plant singular."""
    if plant.disturbances or (
        plant.E is not None and decide_rank(scaled_pencil(plant.A, plant.E).E, rtol=rtol).rank < plant.n_states
    ):
        return
    raise DesignError(
        "E is invertible and there are no disturbances: det(sE - A - KC) has degree n for every K, so no perfect "
        "observer of this form exists; least_order=True differentiates the measurements instead, and a Luenberger "
        "observer or kalman_filter estimates the state without derivatives"
    )


def check_existence(plant: Plant, rows: list[int], rtol: float) -> None:
    """Raise unless the pencil has full column rank at every finite ``s``, with the ``s`` where it has not."""
    q = len(plant.disturbances)
    if len(rows) < q:
        raise DesignError(
            f"no perfect observer: {len(rows)} outputs cannot tell {q} disturbances apart; add sensors, or decouple "
            "fewer disturbances"
        )
    found = invariant_zeros(plant.A, plant.Bd, plant.C[rows], plant.Dd[rows], plant.E, rtol=rtol)
    if found.normal_rank < q:
        raise DesignError(
            f"no perfect observer: the {q} disturbances reach the outputs with rank {found.normal_rank} only (the "
            "pencil [sE-A -Bd; C Dd] lacks column rank at every s); add a sensor, or merge disturbances that act alike"
        )
    if found.zeros.size:
        what = "of (A, Bd, C, Dd), where a disturbance stays unseen," if q else "where a mode stays unseen,"
        raise DesignError(
            f"no perfect observer: the pencil [sE-A -Bd; C Dd] loses column rank at the finite zero(s) s = "
            f"{describe_modes(found.zeros)} {what} and no gain removes them; add a sensor"
            + (
                ", decouple other disturbances, or take unknown_input_observer if they are stable"
                if q
                else ", or take an observer with dynamics if they are stable"
            )
        )


def output_error_rows(gain: PerfectGain, outputs: int) -> NDArray[np.float64]:
    """Return ``W`` that leaves as many rows as the output error has independent ones: ``I`` without disturbances."""
    Q = gain.Y[-outputs:]
    if Q.shape[1] == outputs:
        return np.eye(outputs)
    units = np.abs(Q).max(axis=1, keepdims=True, initial=0.0)
    units = np.where(units > 0, units, 1.0)
    return np.linalg.svd(Q / units)[0][:, : Q.shape[1]].T / units.T


def reduced_rows(o: PerfectObserver) -> NDArray[np.float64]:
    """Return the rows that the residual reads, combined so that as many as can be take few derivatives.

    Those without derivatives come first; each is scaled so that its largest coefficient of a measurement, derivatives
    counted at the bandwidth, is one.
    """
    p = o.plant
    found = o.residual_polynomial(p.Bu, p.Du, own=True)
    P = np.array([o.bandwidth**i * M[:, len(p.inputs) :] for i, M in enumerate(found)])
    units = np.abs(P).max(axis=(0, 1), initial=0.0)
    units = np.where(units > 0, units, 1.0)
    P = P / units
    # Orthonormal rows first: rows of the caller's choice may be nearly parallel, or far apart in size.
    U, s, _ = np.linalg.svd(np.hstack(list(P)), full_matrices=False)
    left, P = (U / s).T @ o.left, (U / s).T @ P
    rows = np.zeros((0, len(left)))
    for degree in range(len(P)):
        higher = np.hstack([np.zeros((len(left), 0)), *P[degree + 1 :]])
        free = left_null_basis(np.hstack([higher, rows.T]), rtol=1e-9, scale=1.0)[0]
        rows = np.vstack([rows, free.T])
    size = np.abs(rows @ P * units).max(axis=(0, 2), initial=0.0)
    return rows @ left / size[:, None]


def perfect_evidence(o: PerfectObserver, R: NDArray, rtol: float) -> Evidence:
    """Return the evidence of a finished observer, or raise when its estimate is not the state."""
    p, gain = o.plant, o.gain
    system = o.system
    off = _estimate_off(o, system)
    from_outputs = system.select(inputs=range(len(p.inputs), system.n_inputs))
    conditions = {
        "nilpotency index": float(o.index),
        "derivatives" if not p.dt else "steps of delay": float(o.derivatives),
        "relative variation of det(sN - I)": gain.variation,
        "T [A Bd] + L [C Dd] - I": gain.missed,
        "dropped from N": gain.dropped,
        "estimate off the state": off,
        "sum of |C N^i L|": _noise_sum(o),
    }
    if o.complete:
        conditions["condition of T"] = gain.condition
    notes: tuple[str, ...] = ()
    M = (from_outputs.A, from_outputs.B, from_outputs.C, from_outputs.D)
    if p.dt:
        conditions["noise gain, outputs to estimate (H2)"] = h2_norm(*M, p.dt)
    else:
        conditions["bandwidth, rad/s"] = o.bandwidth
        try:
            if system.n_states > MOST_STATES:  # it would take minutes
                raise AccuracyError(f"the filter has {system.n_states} states, more than {MOST_STATES}")
            conditions["noise gain, outputs to estimate (peak)"] = hinf_norm(*M).value
        except AccuracyError as error:
            notes = (f"the peak gain from the outputs to the estimate was not found: {error}",)
    scaled = scaled_pencil(R, np.zeros_like(R), unit=1.0).A
    method = "perfect observer" if o.complete else "perfect observer of least order"
    return Evidence(
        method=method + (", disturbances estimated" if p.disturbances else ""),
        poles=system.poles(),
        ranks={"rank[A Bd; C Dd]": decide_rank(scaled, rtol=rtol)},
        conditions=conditions,
        notes=notes,
        references=(REFERENCE,),
    )


def _estimate_off(o: PerfectObserver, system: StateSpace, limit: float = 1e-6) -> float:
    """Return how far the filter driven by the plant is from the filtered state, over frequency, or raise.

    State by state, relative to its response to each control input and disturbance; where one hardly reaches a state, to
    what others do to it, in even units; where none does, to the terms that its estimate is the sum of.
    """
    p = o.plant
    driven = p.system(("control", "disturbance"))
    n, m, n_u = p.n_states, driven.n_inputs, len(p.inputs)
    if not m:
        return 0.0
    units = descriptor_units(driven.A, driven.E, driven.B, driven.C, driven.D).inputs
    points = np.exp(1j * np.array([0.2, 0.9, 2.3])) if p.dt else 1j * o.bandwidth * np.array([0.043, 0.21, 0.93])
    reached = response_terms(driven.replaced(C=np.eye(n), D=np.zeros((n, m)), outputs=None), points)
    X = np.where(np.abs(reached.values) > _NOTHING * reached.terms, reached.values, 0.0)
    Q, P = system.evaluate(points), driven.evaluate(points)
    found = Q[..., n_u:] @ P
    found[..., :n_u] += Q[..., :n_u]
    late = (1 / points if p.dt else 1 / (points / o.bandwidth + 1)) ** o.derivatives
    wanted = late[:, None, None] * X
    terms = np.abs(Q[..., n_u:]) @ np.abs(P)
    terms[..., :n_u] += np.abs(Q[..., :n_u])
    missed, size, terms = ((np.abs(M) * units).max(axis=0) for M in (found - wanted, wanted, terms))
    size = np.maximum(size, 1e-6 * size.max(axis=1, keepdims=True, initial=0.0))
    size = np.where(size.max(axis=1, keepdims=True, initial=0.0) > 0, size, terms)
    worst = float(np.max(missed / np.where(size > 0, size, 1.0), initial=0.0))
    if not worst <= limit:
        raise AccuracyError(
            f"the estimate is off the state by {worst:.2g} > {limit:.0e}: the plant is too badly scaled or conditioned "
            "for a perfect observer; rescale it, choose another bandwidth, or take unknown_input_observer"
        )
    return worst


def _noise_sum(o: PerfectObserver) -> float:
    """Return ``sum_i |C N^i L|``, the size of the coefficients that the measurements have in their own estimate."""
    whole = np.hstack([o.plant.C[o.rows], o.plant.Dd[o.rows]])
    return sum(float(np.linalg.norm(P, 2)) for P in o.series(o.L, whole, []))
