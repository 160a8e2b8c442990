"""Sueur's unknown input observer: poles placed on the inverse of the state matrix."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import comb

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.analysis.existence import unknown_input_observer_existence
from residua.arrays import matrix
from residua.design.core.evidence import Evidence, format_pole
from residua.design.core.method import FAULTS, method
from residua.design.observers.observer import Observer, plant_observer, with_checked_estimate
from residua.design.observers.unknown_input_observer import unknown_input_observer
from residua.errors import AccuracyError, DesignError
from residua.linear import is_stable_mode
from residua.linear.poles.placement import place_observer_poles
from residua.linear.poles.spectrum import spectrum_error
from residua.linear.subspaces.quotient import without_rounding
from residua.linear.subspaces.rank import decide_rank, equilibrated
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant
from residua.tolerances import BALANCED_RANK, RANK, ROUNDING, TINY, above_rounding

#: No pole of a sampled observer is chosen nearer to zero: its inverse would be far from all others.
_LEAST = 0.01
_INSTEAD = "fault_estimator and unknown_input_observer do not need it"


@dataclass(frozen=True, eq=False)
class InverseFormObserver:
    r"""An unknown input observer with the matrices of Sueur.

    Its error obeys :math:`e = N_{BF} \dot e`, so that its poles are the inverses of the eigenvalues of ``N_BF``.

    Attributes
    ----------
    observer : Observer
        The same observer as any other unknown input observer: ``F = N_BF^-1``, ``H = -N_BF^-1 K``,
        ``T = I - H C``. No derivative is needed to run it.
    N_BO, N_BF : ndarray, shape (n, n)
        Eq. (10); ``N_BF = N_BO - K C``.
    K : ndarray, shape (n, outputs)
        The gain of eq. (7). (``observer.K`` is the gain of the observer's state equation.)
    first : tuple of str
        The outputs ``H1`` that express the unknown inputs.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, eqs. (3) to (11).
    """

    observer: Observer
    N_BO: NDArray[np.float64] = field(repr=False)
    N_BF: NDArray[np.float64] = field(repr=False)
    K: NDArray[np.float64] = field(repr=False)
    first: tuple[str, ...]

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the estimation error."""
        return self.observer.poles

    @property
    def evidence(self) -> Evidence:
        """The checks that the design has passed."""
        return self.observer.evidence


@method(
    needs=[FAULTS],
    exists_when="as fault_estimator, A and H A^-1 F invertible, no fault in the outputs",
    order="n",
    source="Sueur, eqs. (1) to (11)",
    state="estimate that the faults do not reach",
    faults="by size, several at once",
    size=True,
    decouples=True,
    many=True,
)
def inverse_form_observer(
    plant: Plant,
    *,
    faults: Iterable[str] | str | None = None,
    poles: Sequence[complex] | ArrayLike | None = None,
    K: ArrayLike | None = None,
    first: Iterable[str | int] | str | None = None,
) -> InverseFormObserver:
    r"""Design an unknown input observer in Sueur's parameters.

    .. math::

       \dot{\hat x} = A \hat x + B u + F \hat d - A K (\dot z - H \dot{\hat x}), \qquad
       \hat d = -(H_1 A^{-1} F)^{-1} [z_1 - H_1 A^{-1} \dot{\hat x} + H_1 A^{-1} B u]

    with :math:`N_{BO} = A^{-1} - A^{-1} F (H_1 A^{-1} F)^{-1} H_1 A^{-1}` and :math:`N_{BF} = N_{BO} - K H`. Solved
    for :math:`\hat x` this is :math:`\dot w = N_{BF}^{-1} (\hat x + N_{BO} B u - \Pi z_1)`,
    :math:`\hat x = w - N_{BF}^{-1} K z`, :math:`\Pi = A^{-1} F (H_1 A^{-1} F)^{-1}`: an unknown input observer as
    any other. Guaranteed: the error obeys :math:`e = N_{BF} \dot e` for any control and unknown input.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, with invertible ``A``; its disturbances and the chosen faults are the unknown
        inputs ``d``, which must not enter the outputs (:func:`residua.plant.augment_sensor_filter` for sensors).
    faults : sequence of str, optional
        All faults when omitted; empty for the disturbances alone.
    poles : sequence of complex, optional
        As many as states, or as many as are free; those that :func:`unknown_input_observer` chooses when omitted.
    K : array_like, shape (n, outputs), optional
        The gain itself, instead of poles.
    first : sequence of str or int, optional
        The outputs ``H1``, as many as unknown inputs; when omitted, those for which the smaller of the relative
        smallest singular values of ``H1 F`` and ``H1 A^-1 F`` is largest.

    Returns
    -------
    InverseFormObserver

    Raises
    ------
    DesignError
        If ``A`` or ``H1 A^-1 F`` is singular, unknown inputs enter the outputs or depend on one another, no
        unknown input observer exists, or ``K`` makes it unstable.
    AccuracyError
        If the poles or the identities missed their tolerance.

    See Also
    --------
    fault_estimator : Estimates the faults too, with fewer conditions.
    unknown_input_observer : The same observer from its state equation.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, eqs. (1) to (11) and properties 1 to 3.

    Examples
    --------
    >>> import residua as rs
    >>> observer = rs.design.inverse_form_observer(
    ...     rs.library.vtol(), faults=["collective actuator", "cyclic actuator"], poles=[-20, -25, -100 / 3, -50]
    ... )
    >>> observer.first
    ('v_horizontal', 'v_vertical')
    """
    if poles is not None and K is not None:
        raise DesignError("give poles or K, not both")
    chosen = [plant.faults[i] for i in arrays.positions(faults, plant.faults, "fault")]
    plant = (plant.faults_as_disturbances(chosen) if chosen else plant).explicit()
    _check_existence(plant)
    model, n, p = plant.balanced, plant.n_states, plant.n_outputs
    units, A, C, E = model.units, model.A, model.C, model.disturbances[0]
    X, Y, rate = units.states[:, None], units.outputs, units.rate
    AE = np.linalg.solve(A, E)
    rows = _first_rows(C @ E, C @ AE, plant, first)
    small = np.linalg.inv(C[rows] @ AE)
    Pi = above_rounding(AE @ small, np.abs(AE) @ np.abs(small) @ (np.abs(C[rows]) @ np.abs(AE)) @ np.abs(small))
    rest = above_rounding(np.eye(n) - Pi @ C[rows], np.eye(n) + np.abs(Pi) @ np.abs(C[rows]))
    inverse = without_rounding(np.linalg.inv(A))
    N_BO = above_rounding(rest @ inverse, np.abs(rest) @ np.abs(inverse))
    requested = np.zeros(0, dtype=complex)
    if K is not None:
        gain = rate * matrix(K, "K", (n, p), what="states x outputs") / X / Y
    elif poles is not None:
        gain, requested = _placed(N_BO, C, np.atleast_1d(np.asarray(poles, dtype=complex)), plant)
    else:
        wanted = unknown_input_observer(plant).poles
        near = np.flatnonzero(np.abs(wanted) < _LEAST) if plant.dt else []
        wanted[near] = _LEAST * np.linspace(1.0, 2.0, len(near))
        gain, _ = _placed(N_BO, C, wanted, plant)
    N_BF = N_BO - gain @ C
    observer = with_checked_estimate(_observer(model, N_BF, gain, Pi, rows, requested))
    N_BO, N_BF = (X * N / units.states / rate for N in (N_BO, N_BF))
    return InverseFormObserver(observer, N_BO, N_BF, X * gain * Y / rate, tuple(plant.outputs[i] for i in rows))


def _check_existence(plant: Plant) -> None:
    """Raise unless the assumptions of section 2.1 hold, and an unknown input observer exists."""
    q, model = len(plant.disturbances), plant.balanced
    if not q:
        raise DesignError("this plant has no unknown input: give it disturbances, or choose faults")
    seen = [name for name, column in zip(plant.disturbances, plant.Dd.T, strict=True) if np.any(column)]
    if seen:
        raise DesignError(
            f"{', '.join(seen)} enters the outputs; the inverse form asks for none: augment the plant, "
            f"residua.plant.augment_sensor_filter, or use fault_estimator, which does not need it"
        )
    directions, states = (decide_rank(M, rtol=BALANCED_RANK, scale=1.0) for M in (model.disturbances[0], model.A))
    if directions.rank < q:
        raise DesignError(f"the {q} unknown inputs have only {directions.rank} independent directions")
    if states.rank < plant.n_states:
        raise DesignError(
            f"A is singular, rank {states.rank} < {plant.n_states}, with a singular value of "
            f"{states.largest_dropped:.1g} in balanced units: the inverse form does not exist; {_INSTEAD}"
        )
    existence = unknown_input_observer_existence(plant)
    if not existence:
        raise DesignError("; ".join(existence.reasons))


def _first_rows(CE: NDArray, CAE: NDArray, plant: Plant, first: Iterable[str | int] | str | None) -> list[int]:
    """Return the outputs ``H1``: those of the user, or those that express the unknown inputs best."""
    q, p, names = CE.shape[1], len(CE), plant.outputs
    late, steady = equilibrated(CE), equilibrated(CAE)
    if first is not None:
        rows = arrays.positions(first, names, "output")
        if len(set(rows)) != q:
            raise DesignError(f"first: as many outputs as unknown inputs are needed, {q}, got {len(set(rows))}")
        candidates = np.array([rows])
    elif comb(p, q) <= 5000:
        candidates = np.array(list(combinations(range(p), q)))
    else:
        candidates = np.sort(scipy.linalg.qr(steady.T, pivoting=True, mode="r")[1][:q])[None]
    least = np.linalg.svd(steady[candidates], compute_uv=False)[:, -1]
    if not least.max() > RANK:
        which = f"with H1 = {', '.join(names[i] for i in candidates[0])}" if first is not None else "whatever outputs"
        raise DesignError(
            f"H1 A^-1 F is singular {which} (smallest singular value {least.max():.2g}): the unknown inputs have a "
            f"zero at the origin; choose other outputs, or another method: {_INSTEAD}"
        )
    both = np.minimum(least, np.linalg.svd(late[candidates], compute_uv=False)[:, -1])
    both[least <= RANK] = -1.0
    return [int(i) for i in candidates[np.lexsort((-least, -both))[0]]]


def _placed(N_BO: NDArray, C: NDArray, poles: NDArray, plant: Plant) -> tuple[NDArray, NDArray]:
    """Return the gain that places poles by their inverses, and those that were free, in 1/s."""
    bad = poles[~is_stable_mode(poles, plant.dt) | (poles == 0)]
    if bad.size:
        raise DesignError(f"pole {format_pole(bad[0])} is not stable, or zero, which the inverse form cannot have")
    rate, inverses, shift = plant.balanced.units.rate, 1 / poles, 0.0
    if plant.dt:  # the inverses lie outside of the unit disc: place them, shifted, in the left half plane
        shift = 1.5 * float(max(np.abs(inverses).max(), np.abs(np.linalg.eigvals(N_BO)).max()))
    placed = place_observer_poles(N_BO / rate - shift * np.eye(len(N_BO)), C, inverses - shift)
    return rate * placed.gain, 1 / (placed.requested + shift)


def _observer(
    model: BalancedPlant, N_BF: NDArray, K: NDArray, Pi: NDArray, rows: list[int], requested: NDArray
) -> Observer:
    """Return the unknown input observer of the inverse form of a balanced plant, in the units of the plant."""
    plant, C, E, n = model.plant, model.C, model.disturbances[0], len(N_BF)
    condition = float(np.linalg.cond(N_BF))
    if not condition < 1 / ROUNDING and len(requested):
        raise AccuracyError(
            f"with the poles {', '.join(map(format_pole, requested))} the inverse form is singular to working "
            "precision: ask for poles nearer to each other"
        )
    if not condition < 1 / ROUNDING:
        raise DesignError(f"N_BF is singular: K H F must have rank {len(plant.disturbances)}; choose another K")
    F = np.linalg.inv(N_BF)
    # what the inverse loses is taken out of the identities H C E = E and F = T A - K1 C
    H = -F @ K
    H = H + (E - H @ C @ E) @ np.linalg.pinv(C @ E)
    T, K1 = np.eye(n) - H @ C, np.zeros_like(H)
    K1[:, rows] = -F @ Pi
    F = T @ model.A - K1 @ C
    gain = K1 + F @ H
    poles = np.asarray(model.units.rate * np.linalg.eigvals(F), dtype=complex)
    listed = ", ".join(map(format_pole, poles))
    if not is_stable_mode(poles, plant.dt).all():
        raise DesignError(f"K gives the poles {listed}, which are not stable; give poles=[...] instead")
    all_asked = requested if len(requested) == n else requested[:0]
    error, _, reached = spectrum_error(model.units.rate * F, all_asked, plant.dt, 1e-5)
    if not reached:
        raise AccuracyError(
            f"the poles came out as {listed}, not as requested: the inverse form is too badly conditioned here; use "
            "fault_estimator"
        )
    off, terms = T @ model.A - gain @ C - F @ T, np.abs(T) @ np.abs(model.A) + np.abs(gain) @ np.abs(C)
    evidence = Evidence(
        method="inverse-form observer",
        poles=poles,
        requested_poles=requested,
        conditions={
            "|T F| / |F|": float(np.abs(T @ E).max()),
            "T A - K C = F T": float(np.abs(off).max() / max((terms + np.abs(F) @ np.abs(T)).max(), TINY)),
            "pole error": error,
            "condition of N_BF": condition,
        },
        references=("Sueur, Observer-based actuator and sensor fault estimation, eqs. (3) to (11)",),
    )
    return plant_observer(model, F, T, gain, np.eye(len(C)), evidence, H=H)
