"""The algebra of observers of order n - p, for plants with and without singular E and with unknown inputs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.analysis.unknown_input import with_needed_equations
from residua.design.core.evidence import Evidence
from residua.design.observers.estimate_check import check_estimate
from residua.design.observers.observer import (
    Observer,
    in_units_of_the_plant,
    kept_observer_for,
    without_measured_equations,
)
from residua.design.observers.observer_gain import margin_from, place, pole_evidence
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.matrix_poles import explicit_poles
from residua.linear.poles.placement import Placement
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.far_gain import refuse_far_gain
from residua.linear.subspaces.parts import rows_by_parts
from residua.linear.subspaces.rank import (
    RankDecision,
    decide_rank,
    left_null_basis,
    without_noise,
    without_slight_mixing,
)
from residua.linear.systems.array_cache import cached_by_contents
from residua.linear.systems.balancing import descriptor_units, sum_without_rounding, without_rounding
from residua.plant import Plant
from residua.plant.comparable_units import even_plant
from residua.tolerances import IDENTITY, RESIDUE, ROUNDING, TINY, above_rounding


def reduced_observer(
    plant: Plant,
    method: str,
    reference: str,
    *,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    outputs: Iterable[str | int] | str | None,
    rtol: float,
) -> Observer:
    r"""Return the observer of order n - p.

    With :math:`x = C^+ y + Q w`, ``Q`` a basis of the null space of ``C``, only ``w`` is to be estimated. Any
    ``X`` with :math:`X [E Q, E_d] = [I, 0]` gives :math:`z = X E x` and :math:`F = X A Q`; all of them are
    :math:`X = X_0 - L N`, where the rows of ``N`` annihilate :math:`[E Q, E_d]`, so that ``F`` is that of an
    ordinary observer for the pair :math:`(N A Q, X_0 A Q)`.
    """
    chosen = arrays.different_positions(outputs, plant.outputs, "output")
    return kept_observer_for(plant, lambda own: _designed(own, method, reference, chosen, poles, margin, rtol))


@cached_by_contents
def _designed(
    plant: Plant,
    method: str,
    reference: str,
    chosen: list[int],
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    rtol: float,
) -> Observer:
    """Return the observer of a plant in its own units that uses the numbered outputs."""
    even = even_plant(plant)
    if plant.E is not None:
        measured, N = with_needed_equations(even.plant, used=chosen, rtol=rtol)
        chosen = [*chosen, *range(plant.n_outputs, measured.n_outputs)]
        made = _reduced(measured, method, reference, chosen, poles, margin, rtol)
        made = without_measured_equations(made, even.plant, N)
    else:
        made = _reduced(even.plant, method, reference, chosen, poles, margin, rtol)
    return in_units_of_the_plant(made, plant, even)


def _reduced(
    plant: Plant,
    method: str,
    reference: str,
    used: list[int],
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    rtol: float,
) -> Observer:
    """Return the observer that uses the numbered outputs."""
    n, p = plant.n_states, plant.n_outputs
    read = [i for i in used if np.any(plant.C[i]) or np.any(plant.Dd[i])]  # a dead output gets no gain
    # combinations of the outputs that no disturbance enters
    free = _embedded(left_null_basis(plant.Dd[read])[0], read, p) if np.any(plant.Dd) else np.eye(p)[:, read]
    G = _through_outputs(plant, used)
    # an equation, or an output, that a measured disturbance leaves nothing of would be evened up from its rounding
    A, C = sum_without_rounding((np.eye(n), plant.A), (-G, plant.C)), without_rounding(free.T, plant.C)
    drive = np.hstack([plant.B, plant.Bd])
    u = descriptor_units(A, plant.E, drive, C, np.zeros((free.shape[1], drive.shape[1])))
    R, S = u.equations[:, None], u.states
    As, Es = R * A * S, R * (np.eye(n) if plant.E is None else plant.E) * S
    Cs = u.outputs[:, None] * C * S
    Ds = R * (plant.Bd - G @ plant.Dd)
    U, s, Vh = np.linalg.svd(Cs) if Cs.size else (np.eye(len(Cs)), np.zeros(0), np.eye(n))
    U, Vh = without_noise(U), without_noise(Vh)
    k = decide_rank(Cs, rtol=rtol).rank
    inverse, Q = without_rounding(Vh[:k].T / s[:k], U[:, :k].T), Vh[k:].T
    unknown = _full_rank_columns(Ds, R * (np.abs(plant.Bd) + np.abs(G) @ np.abs(plant.Dd)), rtol)
    X0, N = _particular(without_rounding(Es, Q), unknown, n - k, plant, rtol)
    placed = _placed(without_rounding(N, As, Q), without_rounding(X0, As, Q), poles, margin, plant, rtol)
    Xs = _without_noise(X0 - placed.gain @ N)
    F = without_rounding(Xs, As, Q)
    # back to the units of the plant: x = S xs, equations R
    T = Xs * u.equations
    reading = u.outputs * inverse
    lift = S[:, None] * without_rounding(reading, free.T)  # x = lift y + S Q w
    L = without_rounding(Xs, Es, reading, free.T)  # w = z - L y
    M = S[:, None] * Q
    H = sum_without_rounding((np.eye(n), lift), (-M, L))
    K = sum_without_rounding((without_rounding(T, A), lift), (-F, L), (T, G))
    _check(plant, T, F, K, M, H, u.states, rtol)
    evidence = Evidence(
        method=method,
        **pole_evidence(placed, F),
        ranks={"independent measurements": RankDecision(k, s, rtol * float(s[0]) if s.size else 0.0)},
        conditions={
            "pole error": placed.error,
            "condition of [T E; C]": float(np.linalg.cond(np.vstack([Xs @ Es, Vh[:k]]))) if n else 1.0,
        },
        notes=(f"uses {', '.join(plant.outputs[i] for i in used)}",) if len(used) < p else (),
        references=(reference,),
    )
    made = Observer(plant, F, T, K, M, H, _unused(plant, used), method, True, evidence)
    return replace(made, evidence=evidence.extended(conditions={"estimate off the state": check_estimate(made)}))


def _particular(EQ: NDArray, D: NDArray, order: int, plant: Plant, rtol: float) -> tuple[NDArray, NDArray]:
    """Return the smallest ``X`` with ``X [E Q, D] = [I, 0]`` and a basis of the rows that annihilate both."""
    level = float(np.linalg.norm(EQ, 2)) if EQ.size else 1.0  # it has the unit of time
    whole = np.hstack([EQ / (level or 1.0), D])
    decision = decide_rank(whole, rtol=rtol, scale=1.0)
    if decision.rank < whole.shape[1]:
        got = f"rank [E D; C 0] = {plant.n_states - order + decision.rank} < n + rank D = {plant.n_states + D.shape[1]}"
        raise DesignError(
            f"{got}: the measurements do not determine what the equations leave open; "
            + (
                f"add a sensor or decouple fewer disturbances than {', '.join(plant.disturbances)}"
                if D.shape[1]
                else "add a sensor that sees the states without equations of their own"
            )
        )
    X = _without_noise(np.linalg.pinv(whole)[:order]) / (level or 1.0)
    return X, left_null_basis(whole)[0].T


def _without_noise(M: NDArray) -> NDArray[np.float64]:
    """Return a matrix without the entries that are the rounding of the largest of their row."""
    return above_rounding(M, np.abs(M).max(axis=1, keepdims=True, initial=0.0), RESIDUE)


def _placed(C: NDArray, A: NDArray, poles: object, margin: float | None, plant: Plant, rtol: float) -> Placement:
    if len(A):
        if poles is None and margin is None:
            margin = margin_from(A, plant)
        placed = place(A, C, poles, margin, plant.dt, rtol)  # pyright: ignore[reportArgumentType]
        farthest = float(np.abs(placed.requested).max(initial=margin or 0.0))
        refuse_far_gain(A, C, placed.gain, 1.0 if plant.dt else farthest)
        return placed
    if poles is not None and np.size(np.asarray(poles)):
        raise DesignError("there is nothing to place: the measurements determine all states, the order is 0")
    none = np.zeros(0, dtype=complex)
    return Placement(np.zeros((0, len(C))), none, none, none, 0.0, np.zeros((0, 0)), 0.0)


def _full_rank_columns(D: NDArray, terms: NDArray, rtol: float) -> NDArray:
    """Return an orthonormal basis of the range of the disturbances, each first brought to unit size.

    Rounding of the terms of a column is no disturbance.
    """
    size = np.linalg.norm(D, axis=0)
    real = size > ROUNDING * np.linalg.norm(terms, axis=0)
    D = D[:, real] / size[real]
    U, s, _ = np.linalg.svd(D, full_matrices=False)
    return U[:, s > rtol]


def _through_outputs(plant: Plant, used: list[int]) -> NDArray:
    """Return ``G`` with ``d = ... (y - C x)`` put into the state equation for disturbances that enter used outputs."""
    Dd = plant.Dd[used]
    if not np.any(Dd):
        return np.zeros((plant.n_states, plant.n_outputs))
    rows, columns = np.abs(Dd).max(axis=1), np.abs(Dd).max(axis=0)
    rows, columns = np.where(rows > 0, rows, 1.0), np.where(columns > 0, columns, 1.0)
    inverse = np.linalg.pinv(Dd / rows[:, None] / columns, rcond=1e-10)
    # an output that rounding reads would bring in the disturbances in it
    inverse = above_rounding(inverse, np.abs(inverse).max(initial=0.0), RESIDUE) / rows / columns[:, None]
    return _embedded(without_rounding(plant.Bd, inverse).T, used, plant.n_outputs).T


def _embedded(rows: NDArray, used: list[int], p: int) -> NDArray:
    out = np.zeros((p, rows.shape[1]))
    out[used] = rows
    return out


def _unused(plant: Plant, used: list[int]) -> NDArray:
    """Return the combinations of unused outputs that no disturbance enters: their errors are the residual."""
    p = plant.n_outputs
    rest = [i for i in range(p) if i not in set(used)]
    rest = rest or list(range(p))  # of more outputs than states some are redundant
    # Outputs that no disturbance has in common do not mix, and what rounding leaves of an output in a combination would
    # bring in the disturbance that it leaves out.
    rows = rows_by_parts(
        plant.Dd[rest], lambda part: without_slight_mixing(without_noise(scipy.linalg.null_space(part.T)))
    )
    return _embedded(rows.T, rest, p).T


def _check(
    plant: Plant, T: NDArray, F: NDArray, K: NDArray, M: NDArray, H: NDArray, units: NDArray, rtol: float
) -> None:
    """Raise when a pole of ``F`` is not stable, or ``M T E + H C = I`` or ``T E_d = K D_d`` is missed.

    Relative to the largest terms of the row.
    """
    poles = explicit_poles(F)
    if not is_stable_mode(poles, plant.dt).all():
        raise AccuracyError(
            f"the observer is not stable, with poles {describe_modes(poles)}: rounding moved them from where they were "
            "placed; ask for poles nearer to those of the plant, or use unknown_input_observer"
        )
    TE = T if plant.E is None else T @ plant.E
    missed = (M @ TE + H @ plant.C - np.eye(plant.n_states)) * units / units[:, None]
    terms = (np.abs(M) @ np.abs(TE) + np.abs(H) @ np.abs(plant.C)) * units / units[:, None]
    first = np.abs(missed).max(initial=0.0) / max(np.abs(terms).max(initial=0.0), TINY)
    unknown = np.abs(T @ plant.Bd - K @ plant.Dd)
    terms = _outer(T, plant.Bd) + _outer(K, plant.Dd)
    second = float(np.max(unknown / np.where(terms > 0, terms, 1.0), initial=0.0))
    if not max(first, second) < IDENTITY:
        raise AccuracyError(
            f"M T E + H C = I is missed by {first:.2g} and T E_d = K D_d by {second:.2g} (relative): the plant is too "
            "badly conditioned for an observer of reduced order; use unknown_input_observer"
        )


def _outer(rows: NDArray, columns: NDArray) -> NDArray[np.float64]:
    """Return the largest entry of each row times the largest of each column."""
    return np.abs(rows).max(axis=1, initial=0.0)[:, None] * np.abs(columns).max(axis=0, initial=0.0)
