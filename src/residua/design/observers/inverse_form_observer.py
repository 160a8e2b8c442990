"""Sueur's unknown input observer: poles placed on the inverse of the state matrix."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import comb

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.analysis.existence import UnknownInputExistence, unknown_input_observer_existence
from residua.arrays import matrix
from residua.design.core.evidence import Evidence, format_pole
from residua.design.core.method import method
from residua.design.core.needs import FAULTS
from residua.design.core.own_time import has_rates, in_own_time
from residua.design.observers.even_units import in_units_of_the_plant
from residua.design.observers.observer import Observer
from residua.design.observers.unknown_input_observer import unknown_input_observer
from residua.errors import AccuracyError, DesignError
from residua.linear import is_stable_mode
from residua.linear.poles.placement import place_observer_poles
from residua.linear.poles.spectrum import spectrum_error
from residua.linear.subspaces.rank import DEFAULT_RTOL, decide_rank, equilibrated
from residua.linear.systems.balancing import evened
from residua.plant import Plant
from residua.plant.comparable_units import even_plant
from residua.tolerances import IDENTITY, RESIDUE, TINY
from residua.words import rates_in, unit_of_rates

#: No pole of a sampled observer is chosen nearer to zero: its inverse would be far from all others.
_LEAST = 0.01
_INSTEAD = "fault_estimator and unknown_input_observer do not need it"


@has_rates(N_BO=-1, N_BF=-1, K=-1)
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
@in_own_time(K=-1)
def inverse_form_observer(
    plant: Plant,
    *,
    faults: Iterable[str] | str | None = None,
    poles: Sequence[complex] | ArrayLike | None = None,
    K: ArrayLike | None = None,
    first: Iterable[str | int] | str | None = None,
    rtol: float = DEFAULT_RTOL,
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
    rtol : float
        Relative tolerance of every rank decision.

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
    _existence(plant, rtol)
    even = even_plant(plant, explicit=True)
    S, Y = even.states[:, None], even.outputs
    if K is not None:
        K = matrix(K, "K", (plant.n_states, plant.n_outputs), what="states x outputs") / S / Y
    if K is None and poles is None:
        chosen_poles = _off_zero(unknown_input_observer(plant).poles, plant.dt)
    else:
        chosen_poles = None if poles is None else np.asarray(np.atleast_1d(poles), dtype=complex)
    made = _designed(even.plant, chosen_poles, K, first, rtol, asked=poles is not None)
    return replace(
        made,
        observer=in_units_of_the_plant(made.observer, plant, even),
        N_BO=S * made.N_BO / even.states,
        N_BF=S * made.N_BF / even.states,
        K=S * made.K * Y,
    )


def _designed(
    plant: Plant,
    poles: NDArray[np.complex128] | None,
    K: NDArray | None,
    first: Iterable[str | int] | str | None,
    rtol: float,
    *,
    asked: bool,
) -> InverseFormObserver:
    """Return the observer of a plant in even units, whose unknown inputs are its disturbances."""
    A, C, F = plant.A, plant.C, plant.Bd
    AF = np.linalg.solve(A, F)
    rows = _first_rows(C @ F, C @ AF, plant, first, rtol)
    Pi, N_BO = _without_inputs(_inverse(A), AF, C[rows])
    gain, free = K, np.zeros(0, dtype=complex)
    if gain is None:
        assert poles is not None
        gain, free = _placed(N_BO, plant, poles, rtol)
    N_BF = N_BO - gain @ C
    observer = _observer(plant, N_BF, gain, Pi, rows, free if asked else free[:0])
    return InverseFormObserver(observer, N_BO, N_BF, gain, tuple(plant.outputs[i] for i in rows))


def _off_zero(poles: NDArray[np.complex128], dt: float) -> NDArray[np.complex128]:
    """Return the poles of a sampled observer, those at zero, which have no inverse, a little apart from it instead."""
    size = np.abs(poles)
    near = size < _LEAST
    if not dt or not near.any():
        return poles
    moved = poles.copy()
    moved[near] = _LEAST * np.linspace(1.0, 2.0, int(near.sum()))
    return moved


def _existence(plant: Plant, rtol: float) -> UnknownInputExistence:
    """Return the existence of the unknown input observer, or raise unless the assumptions of section 2.1 hold."""
    q = plant.Bd.shape[1]
    if not q:
        raise DesignError("this plant has no unknown input: give it disturbances, or choose faults")
    if np.any(plant.Dd):
        seen = [name for name, column in zip(plant.disturbances, plant.Dd.T, strict=True) if np.any(column)]
        raise DesignError(
            f"{', '.join(seen)} enters the outputs; the inverse form asks for none: augment the plant, "
            f"residua.plant.augment_sensor_filter, or use fault_estimator, which does not need it"
        )
    equations, inputs = evened(plant.Bd)
    independent = decide_rank(equations[:, None] * plant.Bd * inputs, rtol=rtol)
    if independent.rank < q:
        raise DesignError(f"the {q} unknown inputs have only {independent.rank} independent directions")
    _refuse_singular(plant.A, rtol)
    existence = unknown_input_observer_existence(plant)
    if not existence:
        raise DesignError("; ".join(existence.reasons))
    return existence


def _refuse_singular(A: NDArray, rtol: float) -> None:
    """Raise unless ``A`` is invertible, block by block of its triangular form: rates far apart make no rank.

    Each state is matched to an equation; the blocks are the states that depend on one another. Within one, rows and
    columns have an even size, in whatever units; those of different blocks have none in common.
    """
    from scipy.sparse.csgraph import connected_components  # slow to import

    equation = _equation_of_each_state(A)
    matched = int(np.count_nonzero(equation >= 0))
    why = f"rank {matched} < {len(A)}, whatever the values of its entries that are not zero" if matched < len(A) else ""
    if not why:
        ordered, rates = A[equation], np.abs(A.diagonal())  # which no units of the states change
        count, block_of = connected_components(ordered != 0, connection="strong")
        for block in (np.flatnonzero(block_of == k) for k in range(count)):
            M = ordered[np.ix_(block, block)]
            if len(block) == 1 and equation[block[0]] == block[0] and abs(M[0, 0]) <= RESIDUE * rates.max():
                why = f"a state that no other leads back to has the rate {unit_of_rates() * M[0, 0]:.1g}, "
                why += "which beside those of the other states is what rounding leaves of zero"
                break
            rows, columns = evened(M)
            found = decide_rank(rows[:, None] * M * columns, rtol=rtol)
            if found.rank < len(block):
                relative = found.largest_dropped / found.singular_values[0]
                why = f"a block of {len(block)} states has rank {found.rank}: a singular value is {relative:.1g} of "
                why += f"the largest, with rows and columns of even size, not above {rtol:.0e}"
    if why:
        raise DesignError(f"A is singular, {why}: the inverse form does not exist; {_INSTEAD}")


def _first_rows(
    CF: NDArray, CAF: NDArray, plant: Plant, first: Iterable[str | int] | str | None, rtol: float
) -> list[int]:
    """Return the outputs ``H1``: those of the user, or those that express the unknown inputs best."""
    q, p = CF.shape[1], len(CF)
    names = plant.outputs
    late, steady = equilibrated(CF), equilibrated(CAF)
    if first is not None:
        rows = arrays.positions(first, names, "output")
        if len(set(rows)) != q:
            raise DesignError(f"first: as many outputs as unknown inputs are needed, {q}, got {len(set(rows))}")
        candidates = [tuple(rows)]
    elif comb(p, q) <= 5000:
        candidates = list(combinations(range(p), q))
    else:
        pivots = scipy.linalg.qr(steady.T, pivoting=True, mode="r")[1]
        candidates = [tuple(sorted(int(i) for i in pivots[:q]))]

    def smallest(M: NDArray, rows: tuple[int, ...]) -> float:
        return float(np.linalg.svd(M[list(rows)], compute_uv=False)[-1])

    def merit(rows: tuple[int, ...]) -> tuple[float, float]:
        both = smallest(steady, rows)
        return min(both, smallest(late, rows)), both

    usable = [rows for rows in candidates if smallest(steady, rows) > rtol]
    if not usable:
        value = max(smallest(steady, rows) for rows in candidates)
        which = f"with H1 = {', '.join(names[i] for i in candidates[0])}" if first is not None else "whatever outputs"
        raise DesignError(
            f"H1 A^-1 F is singular {which} (smallest singular value {value:.2g}): the unknown inputs have a zero "
            f"at the origin; choose other outputs, or another method: {_INSTEAD}"
        )
    return list(max(usable, key=merit))


def _without_inputs(inverse: NDArray, AF: NDArray, C1: NDArray) -> tuple[NDArray, NDArray]:
    """Return ``Pi`` and ``N_BO``, with what is nothing but rounding set to zero.

    Rows of ``N_BO`` are zero, as ``H1 N_BO = 0``; left as rounding, they would pass for states in small units.
    """
    small = np.linalg.inv(C1 @ AF)
    Pi = _rounded(AF @ small, np.abs(AF) @ np.abs(small) @ (np.abs(C1) @ np.abs(AF)) @ np.abs(small))
    whole = np.eye(len(AF))
    rest = _rounded(whole - Pi @ C1, whole + np.abs(Pi) @ np.abs(C1))
    return Pi, _rounded(rest @ inverse, np.abs(rest) @ np.abs(inverse))


def _inverse(A: NDArray) -> NDArray:
    """Return the inverse, exactly zero where the pattern of ``A`` makes it so, whatever the values.

    A state that is matched to an equation follows from the right-hand sides of those that it is reached from alone.
    """
    from scipy.sparse.csgraph import shortest_path  # slow to import

    inverse = np.linalg.inv(A)
    equation = _equation_of_each_state(A)
    if np.any(equation < 0):
        return inverse
    depends = A[equation] != 0  # row i: what the state i is computed from
    distance = shortest_path(depends.astype(float), unweighted=True)
    mask = np.zeros(A.shape, dtype=bool)
    mask[:, equation] = np.isfinite(distance)
    return np.where(mask, inverse, 0.0)


def _equation_of_each_state(A: NDArray) -> NDArray[np.int_]:
    """Return for each state an equation that holds it, no two the same; -1 where there is none left."""
    from scipy.sparse import csr_array  # slow to import
    from scipy.sparse.csgraph import maximum_bipartite_matching

    return maximum_bipartite_matching(csr_array(A.T != 0), perm_type="column")


def _rounded(M: NDArray, terms: NDArray) -> NDArray:
    return np.where(np.abs(M) > 64 * np.finfo(float).eps * terms, M, 0.0)


def _placed(N_BO: NDArray, plant: Plant, poles: NDArray, rtol: float) -> tuple[NDArray, NDArray]:
    """Return the gain that places the poles, by their inverses, and the poles that were free."""
    bad = poles[~is_stable_mode(poles, plant.dt) | (poles == 0)]
    if bad.size:
        raise DesignError(f"pole {format_pole(bad[0])} is not stable, or zero, which the inverse form cannot have")
    inverses = 1 / poles
    shift = 0.0
    if plant.dt:  # the inverses lie outside of the unit disc: place them, shifted, in the left half plane
        shift = 1.5 * float(max(np.abs(inverses).max(), np.abs(np.linalg.eigvals(N_BO)).max()))
    n = plant.n_states
    with rates_in(unit_of_rates() ** -2):  # they are times
        placed = place_observer_poles(N_BO - shift * np.eye(n), plant.C, inverses - shift)
    return placed.gain, 1 / (placed.requested + shift)


def _observer(plant: Plant, N_BF: NDArray, K: NDArray, Pi: NDArray, rows: list[int], asked: NDArray) -> Observer:
    """Return the unknown input observer of the inverse form, with its identities checked."""
    if decide_rank(equilibrated(N_BF), rtol=1e-13).rank < plant.n_states:
        raise DesignError(f"N_BF is singular: K H F must have rank {plant.Bd.shape[1]}; choose another K")
    n, C = plant.n_states, plant.C
    F = np.linalg.inv(N_BF)
    poles = np.linalg.eigvals(F).astype(complex)
    if not is_stable_mode(poles, plant.dt).all():
        listed = ", ".join(format_pole(pole) for pole in poles)
        raise DesignError(f"K gives the poles {listed}, which are not stable; give poles=[...] instead")
    H = -F @ K
    T = np.eye(n) - H @ C
    gain = F @ H
    gain[:, rows] -= F @ Pi
    error = 0.0
    if len(asked) == n:
        error, _, reached = spectrum_error(F, asked, plant.dt, 1e-5)
        if not reached:
            raise AccuracyError(
                f"the poles came out as {', '.join(map(format_pole, poles))}, not as requested: the inverse form is "
                "too badly conditioned here; use fault_estimator"
            )
    parts = {
        "|T F| / |F|": (T @ plant.Bd, (np.eye(n) + np.abs(H) @ np.abs(C)) @ np.abs(plant.Bd)),
        "T A - K C = F T": (
            T @ plant.A - gain @ C - F @ T,
            np.abs(T) @ np.abs(plant.A) + np.abs(gain) @ np.abs(C) + np.abs(F) @ np.abs(T),
        ),
    }
    missed = {name: float(np.abs(M).max() / max(terms.max(), TINY)) for name, (M, terms) in parts.items()}
    if not max(missed.values()) < IDENTITY:
        raise AccuracyError(
            f"the identities of the observer are missed by {max(missed.values()):.2g}: the inverse form is too badly "
            "conditioned here; use fault_estimator"
        )
    evidence = Evidence(
        method="inverse-form observer",
        poles=poles,
        requested_poles=asked,
        conditions={**missed, "pole error": error, "condition of N_BF": float(np.linalg.cond(N_BF))},
        references=("Sueur, Observer-based actuator and sensor fault estimation, eqs. (3) to (11)",),
    )
    return Observer(plant, F, T, gain, np.eye(n), H, np.eye(plant.n_outputs), "inverse-form observer", True, evidence)
