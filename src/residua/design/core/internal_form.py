"""A residual generator seen from faults, disturbances and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError
from residua.linear import StateSpace
from residua.linear.poles.zeros import invariant_zeros
from residua.linear.subspaces.reachability import without_unobservable
from residua.linear.systems.array_cache import Latest, entries
from residua.linear.systems.balancing import descriptor_units, state_units
from residua.linear.systems.response_terms import (
    EvenUnits,
    ResponseTerms,
    accurate_response,
    in_even_units,
    response_terms,
)
from residua.linear.systems.units import system_units
from residua.plant import Plant
from residua.tolerances import DESIGN_ROUNDING, IDENTITY, RESPONSE_ROUNDING, ROUNDING, TINY, above_rounding
from residua.words import unit_of_rates

#: Frequencies of a grid, if nothing else is asked for.
POINTS = 60
#: The logarithm of the span of a grid is rounded as if it were larger by this: poles are often round numbers.
_OFF_ROUND = 0.01371
#: Rounding in a response, relative to its terms; measured: below 2e-16 for up to 30 states.
_MEASURED = 1e-15
#: Rounding of the responses that could hide or feign a leak of this size is taken out by more digits.
_UNSURE = 1e-10
#: The same rounding with twice the digits.
_MEASURED_TWICE = _MEASURED**2
#: Poles and zeros this far below what they are made of are at 0: half the digits.
_SMALL = float(np.sqrt(np.finfo(float).eps))
#: Of the slowest zero, the part at which its response is the asymptote to a thousandth: ``sqrt(1 + 1 / 25**2)``.
_BELOW_ZEROS = 25
#: Where a response is looked at for a zero, as multiples of it: next to it, and beside it. Off round numbers, where
#: models have poles; a hidden mode is a zero and a pole.
_AT_AND_BESIDE = np.array([1.0 + 0.01j, 2.031 + 0.07j, 0.487 + 0.03j, 1.0 + 0.53j], dtype=complex)
#: How far smaller it is at a zero than beside it.
_FAR_SMALLER = 0.1
#: Of the slowest pole, the part from which frequencies begin.
_BELOW_POLES = 100
#: Rad per sample from which leaks of a sampled plant are measured at least: a period of 6,000 samples.
_SLOW = 1e-3


def internal_form(
    generator: StateSpace,
    plant: Plant,
    state_map: NDArray | None = None,
    static_map: NDArray | None = None,
    *,
    with_controls: bool = False,
) -> StateSpace:
    r"""Return the system from faults, disturbances and noise (and controls) of ``plant`` to the residual.

    With a state map ``T``, the state that the fault-free plant gives the generator, :math:`\xi = T E x`, the error
    :math:`e = T E x - \xi` obeys :math:`\dot e = A_g e + (T B - G_y D) v`,
    :math:`r = -C_g e + (H_y D + V B) v`, where ``V``, with ``V E = 0``, reads the algebraic equations of a
    singular plant: exact, of the order of the generator, whatever the plant. Without a state map the
    generator is driven by the plant, and the states that the residual does not see are removed.

    Parameters
    ----------
    generator : StateSpace
        From control inputs and outputs of the plant to residuals.
    plant : Plant
    state_map : ndarray, shape (states of the generator, states of the plant), optional
    static_map : ndarray, shape (residuals, states of the plant), optional
        Zero when omitted.
    with_controls : bool
        Whether the control inputs are further columns, at the end.

    Returns
    -------
    StateSpace

    References
    ----------
    Gertler (1991), eqs. (4-15) to (4-20).
    """
    n_u = len(plant.inputs)
    if state_map is None:
        whole = _driven(generator, plant)
        order = list(range(n_u, whole.n_inputs)) + (list(range(n_u)) if with_controls else [])
        return without_unobservable(whole.select(inputs=order))
    p = plant.system(("fault", "disturbance", "noise", *(("control",) if with_controls else ())))
    Gy, Hy = generator.B[:, n_u:], generator.D[:, n_u:]
    B, D = state_map @ p.B - Gy @ p.D, Hy @ p.D
    B_terms = np.abs(state_map) @ np.abs(p.B) + np.abs(Gy) @ np.abs(p.D)
    D_terms = np.abs(Hy) @ np.abs(p.D)
    if static_map is not None:
        D, D_terms = D + static_map @ p.B, D_terms + np.abs(static_map) @ np.abs(p.B)
    if with_controls:
        first = p.n_inputs - n_u
        B[:, first:] -= generator.B[:, :n_u]
        D[:, first:] += generator.D[:, :n_u]
        B_terms[:, first:] += np.abs(generator.B[:, :n_u])
        D_terms[:, first:] += np.abs(generator.D[:, :n_u])
    # what rounding leaves of nothing would be a coupling, by which units are chosen
    B, D = above_rounding(B, B_terms), above_rounding(D, D_terms)
    return StateSpace(generator.A, B, -generator.C, D, dt=plant.dt, inputs=p.inputs, outputs=generator.outputs)


def with_silent_inputs(form: StateSpace, names: tuple[str, ...]) -> StateSpace:
    """Return an internal form with further inputs that do nothing."""
    if not names:
        return form
    clash = set(names) & set(form.inputs)
    return form.replaced(
        B=np.hstack([form.B, np.zeros((form.n_states, len(names)))]),
        D=np.hstack([form.D, np.zeros((form.n_outputs, len(names)))]),
        inputs=(*form.inputs, *(f"control {name}" if name in clash else name for name in names)),
    )


def check_state_map(
    generator: StateSpace, plant: Plant, T: NDArray, V: NDArray | None = None, *, limit: float = IDENTITY
) -> float:
    r"""Return how far the identities of a generator are missed, or raise.

    :math:`T A - G_y C = A_g T E`, :math:`C_g T E + H_y C + V A = 0` and :math:`V E = 0`, in balanced units,
    relative to the terms that have to cancel; the second also for each residual by its own terms.
    """
    n_u = len(plant.inputs)
    p = plant.system(("control", "disturbance", "fault"))
    if p.E is None:
        units = state_units(p.A, p.B, p.C, p.D)
        rate = _largest(p.A, units / units[:, None])
    else:
        u = descriptor_units(p.A, p.E, p.B, p.C, p.D)
        units, rate = u.states, 1 / u.unit
    V = np.zeros((generator.n_outputs, plant.n_states)) if V is None else V
    TE, VE = (T, 0.0 * V) if p.E is None else (T @ p.E, V @ p.E)
    absolute_TE, absolute_VE = (
        (np.abs(T), 0.0 * V) if p.E is None else (np.abs(T) @ np.abs(p.E), np.abs(V) @ np.abs(p.E))
    )
    Gy, Hy = generator.B[:, n_u:], generator.D[:, n_u:]
    terms = np.abs(T) @ np.abs(p.A) + np.abs(Gy) @ np.abs(p.C) + np.abs(generator.A) @ absolute_TE
    own_rate = float(np.abs(generator.poles()).max(initial=0.0))
    if len(T) % max(p.n_states, 1) == 0:
        rows = np.resize(units, len(T))  # stacked observers repeat the states of the plant
    else:
        heights = (absolute_TE * units).max(axis=1, initial=0.0)
        others = (terms * units).max(axis=1, initial=0.0)
        # a row of T that is zero has the size of the other terms, which have a rate in them, of the plant or else of
        # the filter; residuals, and so rows, have units of their own
        per_time = rate or own_rate or 1.0
        instead = np.where(others > 0, others / per_time, 1.0)
        rows = np.where(per_time * heights > RESPONSE_ROUNDING * others, heights, instead)
        rows = np.where(rows > 0, rows, 1.0)
    first = _largest(T @ p.A - Gy @ p.C - generator.A @ TE, units / rows[:, None])
    own = max(rate if p.E is None else 0.0, 1e-3 * own_rate)  # where T = 0, terms are rounding of what poles are of
    first /= max(_largest(terms, units / rows[:, None]), own, TINY)
    terms = np.abs(generator.C) @ absolute_TE + np.abs(Hy) @ np.abs(p.C) + np.abs(V) @ np.abs(p.A)
    heights = np.abs(p.C) @ units
    scale = units / np.where(heights > 0, heights, 1.0)[:, None] if len(Hy) == len(p.C) else units[None, :]
    per_row = (
        np.abs(generator.C) * rows / (np.where(heights > 0, heights, 1.0)[:, None] if len(Hy) == len(p.C) else 1.0)
    )
    floor = max(1e-6 * float(per_row.max(initial=0.0)), TINY)
    missed = generator.C @ TE + Hy @ p.C + V @ p.A
    second = _largest(missed, scale) / max(_largest(terms, scale), floor)
    # no residual hides behind another in larger units
    own_terms = np.maximum((terms * scale).max(axis=1, initial=0.0), 1e-6 * per_row.max(axis=1, initial=0.0))
    each = (np.abs(missed) * scale).max(axis=1, initial=0.0) / np.maximum(own_terms, TINY)
    third = 0.0
    if np.any(V) and p.E is not None:  # what V reads may stand where E is zero, and meet it by rounding only
        beside = np.abs(V).max(axis=1, initial=0.0)[:, None] * np.abs(p.E).max(axis=0, initial=0.0)
        third = _largest(VE, scale) / max(_largest(absolute_VE, scale), 1e-3 * _largest(beside, scale), TINY)
    worst = max(first, second, third)
    _accepted(max(worst, float(each.max(initial=0.0))), limit)
    return worst


def check_known_form(generator: StateSpace, plant: Plant, form: StateSpace, *, limit: float = 1e-7) -> float:
    """Return how far an internal form is from the generator driven by the plant, over frequency, or raise."""
    w = frequency_grid(generator, plant.system(()))
    n_u = len(plant.inputs)
    points = np.asarray(np.exp(1j * w * generator.dt) if generator.is_discrete else 1j * w, dtype=np.complex128)
    systems = generator, plant.system(("fault", "disturbance", "noise")), form
    # values are exactly zero where no chain of couplings leads: in some units rounding there is large
    of_filter, of_plant, of_form = (response_terms(_with_even_states(system), points) for system in systems)
    Q, P, known = of_filter.values[..., n_u:], of_plant.values, of_form.values
    if known.shape != (len(w), Q.shape[1], P.shape[2]):
        raise ModelError(f"the internal form is {form.n_outputs} x {form.n_inputs}, not residuals x (f, d, w)")
    terms = (np.abs(Q) @ np.abs(P)).max(axis=0)
    # a path that is itself what rounding left of nothing, beside the others of its residual, cannot be missed
    units = in_even_units(systems[1]).outputs
    largest = (np.abs(Q) / units).max(axis=(0, 2))[:, None] * (np.abs(P) * units[:, None]).max(axis=(0, 1))
    terms = np.maximum(terms, ROUNDING / limit * largest)
    made_of = of_filter.terms[..., n_u:] @ np.abs(P) + np.abs(Q) @ of_plant.terms + of_form.terms
    terms = np.maximum(terms, ROUNDING / limit * made_of.max(axis=0))
    missed = np.abs(Q @ P - known).max(axis=0)
    return _accepted(float(np.max(missed / np.where(terms > 0, terms, 1.0), initial=0.0)), limit)


def _accepted(worst: float, limit: float) -> float:
    if not worst <= limit:
        raise AccuracyError(
            f"the identities of the residual generator are missed by {worst:.2g} > {limit:.0e}: the plant is too "
            "badly conditioned for this design; ask for other poles, or use decoupled_residual"
        )
    return worst


def _largest(M: NDArray, units: NDArray) -> float:
    """Return the largest entry of a matrix in given units."""
    return float(np.max(np.abs(M * units), initial=0.0))


def _driven(generator: StateSpace, plant: Plant) -> StateSpace:
    """Return the generator driven by the plant, with all inputs of the plant: controls, f, d, w."""
    n_u, n_y = len(plant.inputs), plant.n_outputs
    if generator.n_inputs != n_u + n_y:
        raise ModelError(
            f"this generator takes {generator.n_inputs} signals, the plant has {n_u} inputs and {n_y} outputs"
        )
    if generator.dt != plant.dt:
        raise ModelError(
            f"the generator has dt={generator.dt:g}, the plant dt={plant.dt:g}: sample both with the same step"
        )
    p = plant.system(("control", "fault", "disturbance", "noise")).explicit()
    Gu, Gy = generator.B[:, :n_u], generator.B[:, n_u:]
    Hu, Hy = generator.D[:, :n_u], generator.D[:, n_u:]
    n_rest = p.n_inputs - n_u
    A = np.block(
        [[p.A, np.zeros((p.n_states, generator.n_states))], [Gy @ p.C, generator.A]],
    )
    B = np.vstack([p.B, Gy @ p.D + np.hstack([Gu, np.zeros((generator.n_states, n_rest))])])
    D = Hy @ p.D + np.hstack([Hu, np.zeros((generator.n_outputs, n_rest))])
    return StateSpace(
        A,
        B,
        np.hstack([Hy @ p.C, generator.C]),
        D,
        dt=plant.dt,
        inputs=p.inputs,
        outputs=generator.outputs,
    )


def frequency_grid(*systems: StateSpace, points: int = POINTS) -> NDArray[np.float64]:
    """Return frequencies in rad/s that span the dynamics of the systems, from far below to far above.

    They begin below the slowest pole, which often is one of the plant, and end at a power of two times that number: the
    filters of one plant then often have the same ones, and what the plant does there is computed once.
    """
    dt = max(system.dt for system in systems)
    if dt:  # not at the ends of the circle, where models have poles
        return np.concatenate([np.pi / dt * np.logspace(-5, np.log10(0.97), points - 1), [0.37 * np.pi / dt]])
    sizes = np.concatenate([np.zeros(0), *(_pole_sizes(system) for system in systems)])
    low, high = (sizes.min(), sizes.max()) if sizes.size else (1.0, 1.0)
    span = np.exp2(np.ceil(np.log2(high / low) + _OFF_ROUND))
    # the factor keeps round numbers, where models have their poles, off the grid
    return 1.0371 * low * np.geomspace(0.01, 100 * span, points)


def _pole_sizes(system: StateSpace) -> NDArray[np.float64]:
    """Return the sizes of the poles that are not rounding, whatever the units of the states."""
    poles = np.abs(system.poles())
    return poles[poles > _SMALL * _size(system)]


def _size(system: StateSpace) -> float:
    """Return the size of what the poles of a system are made of."""
    if system.E is None and system.n_states:
        n = system.n_states
        T = system_units(system.A, np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0))).states
        return float(np.linalg.norm(system.A / T[:, None] * T))
    return float(np.abs(system.poles()).max(initial=0.0))


def leak_frequencies(
    generator: StateSpace,
    plant: Plant,
    roles: tuple[str, ...] = ("control", "disturbance"),
    *,
    points: int = POINTS,
) -> NDArray[np.float64]:
    """Return the frequencies in rad/s at which leaks are measured: those of the dynamics of filter and plant.

    A plant that integrates goes on to change below its slowest pole: where the response of an output to an input goes
    from one power of 1/s to another, it has a zero. Below a part of the slowest of these a response is the power of
    1/s alone to a thousandth, and what is added there is what rounding left of the filter. Of a sampled plant the same
    holds of ``z - 1`` to two thousandths, as ``exp(jw dt) - 1`` turns from ``jw dt`` by half of that angle; it is
    measured down to periods of some thousand samples in any case.
    """
    w, system = frequency_grid(generator, plant.system(()), points=points), plant.system(roles)
    form = _in_differences(system)
    integrators = int(np.count_nonzero(form.poles() == 0))
    if not form.n_inputs or not integrators:
        return w
    low = 1.0371 * _slowest_zero(form) / _BELOW_ZEROS
    if system.is_discrete:
        own = _in_differences(generator)
        slowest = float(np.concatenate([_pole_sizes(form), _pole_sizes(own)]).min(initial=np.inf))
        low = (
            min(low, 1.0371 * _slowest_zero(own, integrators) / _BELOW_ZEROS, 1.0371 * slowest / _BELOW_POLES, _SLOW)
            / system.dt
        )
        w = w[w > low]
    if w[0] <= low:
        return w
    more = int(np.ceil(np.log(w[0] / low) / np.log(w[1] / w[0])))  # as near to one another as the others
    return np.concatenate([np.geomspace(low, w[0], more + 1)[:-1], w])


def _in_differences(system: StateSpace) -> StateSpace:
    """Return a sampled system as one of ``z - 1``, which is to it what ``s`` is to a continuous one."""
    if not system.is_discrete:
        return system
    return system.replaced(A=system.A - (np.eye(system.n_states) if system.E is None else system.E), dt=0.0)


_slowest: Latest[float] = Latest()


def _slowest_zero(system: StateSpace, multiplicity: int = 2) -> float:
    """Return the size of the smallest zero of the response of an output to an input that is not at 0.

    Rounding scatters one at 0 of some multiplicity, as a filter has where its plant integrates, by that root: none of a
    cluster about 0 counts. In a pencil it moves the zeros of a response that is weak beside others, too: a zero counts
    where its own response is far smaller than beside it.
    """
    A, B, C, D, E = system.A, system.B, system.C, system.D, system.E

    def found() -> float:
        least = float(np.finfo(float).eps) ** (1 / max(multiplicity, 2)) * _size(system)
        zeros = []
        for i, j in np.ndindex(system.D.shape):
            known = invariant_zeros(A, B[:, [j]], C[[i]], D[[i]][:, [j]], E)
            scattered = max((2 * c.radius for c in known.clusters if abs(c.center) <= c.radius), default=0.0)
            zeros += [(z, (i, j)) for z in known.zeros if abs(z) > max(least, scattered) and z.imag >= 0]
        even = in_even_units(system).system
        for zero, (i, j) in sorted(zeros, key=lambda one: float(np.abs(one[0]))):
            there, *beside = np.abs(response_terms(even, zero * _AT_AND_BESIDE).values[:, i, j])
            if there < _FAR_SMALLER * np.median(beside):
                return float(np.abs(zero))
        return float(np.inf)

    return _slowest.of((entries(A, B, C, D, E), multiplicity), found)


def leakage(generator: StateSpace, plant: Plant, w: NDArray | None = None) -> dict[str, float]:
    r"""Return the response of the residual to controls and to disturbances, relative to the terms that cancel there.

    For each residual, each input and each frequency

    .. math:: \frac{|Q_{u,ij} + \sum_k Q_{y,ik} P_{kj}|}{|Q_{u,ij}| + \sum_k |Q_{y,ik}| |P_{kj}|}

    with the responses ``Q`` of the filter and ``P`` of the plant; of these the largest. 1e-16 is exact, 1 is no
    decoupling. No number of it has a unit. A response that is rounding at all frequencies, of the terms it is itself
    made of, is no term: where there are only such, nothing can leak. Where the responses cancel so far inside filter
    or plant that rounding would hide a leak, they are computed with twice the digits. Far below the frequencies of the
    default even these tell nothing of a plant that integrates many times.

    Parameters
    ----------
    generator : StateSpace
        From control inputs and outputs of the plant to residuals.
    plant : Plant
    w : ndarray, optional
        Frequencies in rad/s; a grid over the dynamics of both when omitted.

    Returns
    -------
    dict of str to float
        ``"control"`` and ``"disturbance"``, as far as the plant has any.

    Raises
    ------
    AccuracyError
        If a leak cannot be told from rounding at a frequency.
    """
    found, n_u = leakage_of_inputs(generator, plant, w), len(plant.inputs)
    groups = {"control": found[:n_u], "disturbance": found[n_u:]}
    return {name: float(part.max()) for name, part in groups.items() if len(part)}


@dataclass(frozen=True, eq=False)
class JointResponses:
    """What a filter and its plant do at the frequencies of leaks, each evaluated once, with what faults do to them.

    Attributes
    ----------
    plant : Plant
    w : ndarray, shape (k,)
        In rad/s.
    filter, driven : ResponseTerms
        Of the filter and of the plant, as leaks take them.
    faults, of_faults : ResponseTerms
        The responses to the faults of the internal form, and those of the plant.
    residuals, outputs : ndarray
        The factors of the residuals and of the outputs in all of these.
    """

    plant: Plant
    w: NDArray[np.float64]
    filter: ResponseTerms
    driven: ResponseTerms
    faults: ResponseTerms
    of_faults: ResponseTerms
    residuals: NDArray[np.float64]
    outputs: NDArray[np.float64]


def joint_responses(
    generator: StateSpace, plant: Plant, form: StateSpace, B_terms: NDArray, D_terms: NDArray
) -> JointResponses:
    """Return the responses by which a filter with a state map is checked.

    Parameters
    ----------
    generator : StateSpace
    plant : Plant
    form : StateSpace
        The internal form of the filter from the faults: with its own ``A``, and ``C`` but for the sign.
    B_terms, D_terms : ndarray
        The sums of sizes of which the ``B`` and ``D`` of the internal form are made.
    """
    w, n_u = leak_frequencies(generator, plant), len(plant.inputs)
    points = np.asarray(np.exp(1j * w * generator.dt) if generator.is_discrete else 1j * w, dtype=np.complex128)
    p, f = in_even_units(plant.system(("control", "disturbance"))), plant.system("fault")
    R, Y = p.equations[:, None], p.outputs[:, None]
    P = _with_columns(p.system, R * f.B, Y * f.D)
    even = _with_even_rows(generator, np.concatenate([p.inputs[:n_u], 1 / p.outputs]))
    R, Y = even.equations[:, None], even.outputs[:, None]
    Q = _with_columns(even.system, -R * form.B, Y * form.D)
    sizes = np.abs(even.system.B), np.abs(even.system.D)
    terms = np.hstack([sizes[0], R * B_terms]), np.hstack([sizes[1], Y * D_terms])
    parts = (
        *_divided(response_terms(Q, points, *terms), form.n_inputs),
        *_divided(response_terms(P, points), f.n_inputs),
    )
    return JointResponses(plant, w, parts[0], parts[2], parts[1], parts[3], even.outputs, p.outputs)


def _with_columns(system: StateSpace, B: NDArray, D: NDArray) -> StateSpace:
    return system.replaced(B=np.hstack([system.B, B]), D=np.hstack([system.D, D]), inputs=None)


def _divided(found: ResponseTerms, last: int) -> tuple[ResponseTerms, ResponseTerms]:
    """Return the responses to all inputs but the last ones, and to those."""
    k = found.values.shape[2] - last
    return (
        ResponseTerms(found.values[:, :, :k], found.terms[:, :, :k]),
        ResponseTerms(found.values[:, :, k:], found.terms[:, :, k:]),
    )


def leakage_of_inputs(
    generator: StateSpace, plant: Plant, w: NDArray | None = None, known: JointResponses | None = None
) -> NDArray[np.float64]:
    """Return the leakage of each control, then of each disturbance; see :func:`leakage`.

    With the responses that are ``known`` of a generator, as far as they are those of this plant.
    """
    n_u = len(plant.inputs)
    if not n_u and not plant.disturbances:
        return np.zeros(0)
    if known is not None and known.plant is plant:
        w = known.w
    else:
        known, w = None, leak_frequencies(generator, plant) if w is None else w
    points = np.exp(1j * w * generator.dt) if generator.is_discrete else 1j * w
    driven = in_even_units(plant.system(("control", "disturbance")))
    system = _with_even_rows(generator, np.concatenate([driven.inputs[:n_u], 1 / driven.outputs])).system
    Q = response_terms(system, points) if known is None else known.filter
    P = response_terms(driven.system, points) if known is None else known.driven
    total, parts = _cancelling(Q.values, P.values, n_u)
    rounding = _MEASURED * (_products(Q.terms, np.abs(P.values), n_u) + _products(np.abs(Q.values), P.terms, n_u))
    unsure = np.flatnonzero((rounding > _UNSURE * parts).any(axis=(1, 2)))
    if unsure.size:
        measured = accurate_response(driven.system, points[unsure])
        signals = np.zeros((len(unsure), n_u + measured.shape[1], measured.shape[2]), dtype=np.complex128)
        signals[:, :n_u], signals[:, n_u:] = np.eye(n_u, measured.shape[2]), measured
        total[unsure] = accurate_response(system, points[unsure], signals)
    alive = _live_terms(Q)
    parts = _cancelling(
        np.where(alive, Q.values, 0.0), np.where(_alive(np.abs(P.values), P.terms), P.values, 0.0), n_u
    )[1]
    # where the terms that are alive are the smaller ones, what gets through is of the others: all of it
    ratio = np.where(parts > 0, np.abs(total) / np.where(parts > 0, np.maximum(parts, np.abs(total)), 1.0), 0.0)
    _check_digits(w, unsure, (ratio > _UNSURE) & (np.abs(total) <= _MEASURED_TWICE / _MEASURED * rounding))
    return ratio.max(axis=(0, 1), initial=0.0)


def _check_digits(w: NDArray[np.float64], unsure: NDArray[np.int_], lost: NDArray[np.bool_]) -> None:
    """Raise where twice the digits do not tell a leak from their own rounding, as far below all rates of integrators.

    Of ten integrators a response cancels by so many digits there that of the filter's own zeros nothing is left.
    """
    where = unsure[lost[unsure].any(axis=(1, 2))]
    if where.size:
        raise AccuracyError(
            f"leaks at {w[where].max() * unit_of_rates():.3g} rad/s and below cannot be told from rounding with twice "
            "the digits: the plant integrates too often for inputs as slow as these"
        )


def _with_even_states(system: StateSpace) -> StateSpace:
    """Return a system with its channels as they are, and its states in units in which elimination rounds least."""
    even = in_even_units(system)
    B, C = even.system.B / even.inputs, even.system.C / even.outputs[:, None]
    return even.system.replaced(B=B, C=C, D=system.D)


def _with_even_rows(generator: StateSpace, inputs: NDArray) -> EvenUnits:
    """Return a filter in given units of its inputs, states and residuals in those that it has of itself."""
    scaled = generator.replaced(B=generator.B * inputs, D=generator.D * inputs)
    even = in_even_units(scaled)
    system = even.system.replaced(B=even.system.B / even.inputs, D=even.system.D / even.inputs)
    return EvenUnits(system, inputs, even.outputs, even.equations)


def _cancelling(Q: NDArray, P: NDArray, n_u: int) -> tuple[NDArray, NDArray[np.float64]]:
    """Return what controls and disturbances do to the residual, and the sum of the sizes of its terms."""
    total = Q[..., n_u:] @ P
    total[..., :n_u] += Q[..., :n_u]
    return total, _products(np.abs(Q), np.abs(P), n_u)


def _products(Q: NDArray, P: NDArray, n_u: int) -> NDArray[np.float64]:
    """Return the sums of the sizes of the terms of controls and disturbances in the residual."""
    parts = Q[..., n_u:] @ P
    parts[..., :n_u] += Q[..., :n_u]
    return parts


def _live_terms(Q: ResponseTerms) -> NDArray[np.bool_]:
    """Tell which responses of each residual are more than rounding.

    In the units of the signals that the plant has of itself, the rounding of one term of a residual is that of all. Of
    a residual that is nothing beside that, but more than a design leaves of nothing, each term has its own.
    """
    sizes = np.abs(Q.values)
    alive = _alive(sizes, Q.terms + Q.terms.max(axis=2, keepdims=True, initial=0.0))
    small = ~alive.any(axis=1, keepdims=True) & np.any(sizes > DESIGN_ROUNDING * Q.terms, axis=(0, 2))[:, None]
    return alive | (small & _alive(sizes, Q.terms))


def _alive(sizes: NDArray, terms: NDArray) -> NDArray[np.bool_]:
    """Tell which responses are more than the rounding of their terms, at some frequency."""
    return np.any(sizes > ROUNDING * terms, axis=0)
