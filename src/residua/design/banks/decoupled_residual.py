"""The residual that ignores chosen faults and all disturbances, whenever one exists."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from residua import arrays
from residua.analysis.fault_space import fault_space
from residua.design.banks.unknown_input_quotient import (
    ExplicitParts,
    Quotient,
    explicit_parts,
    quotient_filter,
    unknown_input_quotient,
)
from residua.design.core.canonical_design import designed_in_own_units
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.internal_form import frequency_grid, leak_frequencies
from residua.design.core.method import method
from residua.design.core.needs import FAULTS
from residua.design.core.own_time import in_own_time
from residua.design.observers.observer_gain import margin_from, place, pole_evidence
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.placement import Placement
from residua.linear.poles.riccati import filter_riccati
from residua.linear.subspaces.observable_part import UndetectableError
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.linear.systems.resolvent import solutions, solver
from residua.plant import Plant
from residua.plant.comparable_units import even_plant
from residua.words import unit_of_rates, used_up

_EPS = float(np.finfo(float).eps)

_ROUNDING = "rounding over a fault"
#: A default margin that lets rounding grow to more than this of what a fault leaves is lowered.
_LITTLE = 1e-8
#: The same beside noise, which hides more than that, so that a slower filter would gain nothing.
_LITTLE_BESIDE_NOISE = 1e-4


@method(
    needs=[FAULTS],
    exists_when="more independent outputs than unknown inputs reach; no condition on zeros",
    order="least that sees all it can",
    source="Massoumnia, Verghese and Willsky (1989)",
    decouples=True,
    singular=True,
)
@in_own_time()
def decoupled_residual(
    plant: Plant,
    *,
    insensitive_to: Iterable[str | int] | str = (),
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    gain: str | None = None,
    rtol: float = DEFAULT_RTOL,
) -> ResidualGenerator:
    r"""Design a residual that neither the disturbances nor the named faults reach, whatever their time course.

    The smallest unobservability subspace ``S`` that holds everything to be ignored is divided out; what is left
    of the plant, :math:`z = P^T x` with :math:`P^T S = 0`, is observed through the outputs that do not see ``S``:

    .. math:: \dot z = (A_0 - G_0 C_0) z + K y + G u, \qquad r = H W y - C_0 z

    Guaranteed: zero for the fault-free plant and for the ignored faults; every other residual that ignores them
    is a filtered version of this one, so that a fault it does not see is seen by none of them. All poles are
    free; nothing need be detectable or stable.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled; ``E`` may be singular: then the algebraic equations count as measurements, and what
        they leave undetermined as unknown inputs.
    insensitive_to : sequence of str
        Faults to ignore, besides all disturbances of the plant.
    poles : sequence of complex, optional
        One for each state of the filter, closed under conjugation; their number is in the message when it
        does not fit.
    margin : float, optional
        Stability margin in 1/s, used without ``poles``. When omitted: the rate of what is left of the plant, or a
        fraction of it where that leaves rounding smaller beside a fault (the evidence says which).
    gain : {"kalman", "placement"}, optional
        ``"kalman"`` takes the gain of the Kalman filter of what is left of the plant, so that the residual of a sampled
        plant is white; ``"placement"`` the poles or the margin. When omitted: ``"kalman"`` for a plant with noise, if
        there are neither ``poles`` nor ``margin`` and that filter exists (the evidence says which).
    rtol : float
        Relative tolerance of every rank decision, in balanced units.

    Returns
    -------
    ResidualGenerator
        Of the smallest order with which all residuals of this kind are had at once.

    Raises
    ------
    DesignError
        If no such residual exists: all measurements are used up; or if poles, margin and gain do not go together.
    AccuracyError
        If the poles or the decoupling missed their tolerance.

    See Also
    --------
    structured_bank : One for each row of a structure.
    eigenstructure_assignment : As an observer of the whole state.
    parity_relations : A moving average of the last samples.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant.

    References
    ----------
    Massoumnia, Verghese and Willsky (1989), IEEE TAC 34(3) (fundamental problem of residual generation);
    Gertler (1991), section 4.

    Examples
    --------
    >>> import residua as rs
    >>> flt = rs.design.decoupled_residual(rs.library.gertler(), insensitive_to="p1")
    >>> flt.structure.any(axis=0)
    array([False,  True])
    """
    ignored = [plant.faults[i] for i in arrays.positions(insensitive_to, plant.faults, "fault")]
    # of poles and margins that a user chooses nothing is kept: they may be arrays, or wrong
    asked = (tuple(ignored), gain, rtol) if poles is None and margin is None and isinstance(rtol, float) else None
    return designed_in_own_units(plant, lambda own: _designed(own, ignored, poles, margin, gain, rtol), asked)


def _designed(
    plant: Plant,
    ignored: list[str],
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    gain: str | None,
    rtol: float,
) -> ResidualGenerator:
    """Return the residual of a plant in its own units."""
    parts = explicit_parts(plant.faults_as_disturbances(ignored))
    quotient = unknown_input_quotient(parts, rtol)
    if not quotient.read.shape[0]:
        names = ", ".join(f"'{name}'" for name in (*plant.disturbances, *ignored))
        raise DesignError(
            f"no residual ignores {names or 'nothing'}: the {used_up(plant.n_outputs)}; add a sensor or ignore less"
        )
    failure: AccuracyError | None = None
    best: tuple[int, float, ResidualGenerator] | None = None
    free = poles is None and margin is None
    visible = _visible(plant, ignored, rtol)
    for attempt, note in _attempts(quotient, poles, margin, gain, even_plant(plant).plant, rtol):
        try:
            made = _assembled(plant, parts, quotient, attempt(), ignored, note())
        except AccuracyError as error:
            failure = failure or error
            continue
        except UndetectableError as error:
            failure = failure or AccuracyError(f"what is left of the plant is seen by construction, but {error}")
            continue
        rounding = rounding_share(made)
        made = replace(made, evidence=made.evidence.extended(conditions={_ROUNDING: rounding}))
        unseen = sum(1 for name in visible if not made.structure[:, made.faults.index(name)].any())
        if not unseen and (not free or rounding <= _limit(plant)):
            return _told(made, rounding)
        if best is None or (unseen, rounding) < best[:2]:
            best = unseen, rounding, made
    if best is not None and not best[0]:
        return _told(best[2], best[1])
    if best is not None:
        raise AccuracyError(
            f"the response to {best[0]} of the faults {', '.join(visible)}, which a residual can see that ignores "
            f"{', '.join((*plant.disturbances, *ignored)) or 'nothing'}, is lost in rounding: the plant is too badly "
            f"conditioned{'; reduce its order, or give a margin' if free else ' for these poles; ask for slower ones'}"
        )
    assert failure is not None  # there is at least one attempt
    raise failure


def _visible(plant: Plant, ignored: list[str], rtol: float) -> list[str]:
    """Return the faults that a residual sees which ignores some, by the ranks of the pencil."""
    left = plant.faults_as_disturbances(ignored)
    if not left.faults:
        return []
    return [name for name, seen in zip(left.faults, fault_space(left, rtol=rtol).visible, strict=True) if seen]


def _limit(plant: Plant) -> float:
    return _LITTLE_BESIDE_NOISE if plant.Bw.shape[1] else _LITTLE


def _told(made: ResidualGenerator, rounding: float) -> ResidualGenerator:
    """Return a residual with a note where rounding is more than a little."""
    if rounding <= _limit(made.plant):
        return made
    note = (
        f"rounding of numbers of 16 digits makes the residual {rounding:.0e} of what a fault leaves, that of "
        "measurements more; a smaller margin leaves less"
    )
    return replace(made, evidence=made.evidence.extended(notes=(note,)))


def _assembled(
    plant: Plant, parts: ExplicitParts, quotient: Quotient, placed: Placement, ignored: list[str], note: str
) -> ResidualGenerator:
    """Return the generator of a gain on the quotient, in the units of the plant."""
    whole = quotient_filter(plant, parts, quotient, placed.gain)
    system = whole.system
    evidence = Evidence(
        method="decoupled residual",
        **pole_evidence(placed, system.A),
        ranks={"unknown inputs in the outputs": quotient.direct},
        conditions={"pole error": placed.error, "norm of the gain": placed.norm},
        notes=((f"ignores {', '.join(ignored)}",) if ignored else ()) + ((note,) if note else ()),
        references=("Massoumnia, Verghese and Willsky (1989), IEEE TAC 34(3)", "Gertler (1991), section 4"),
    )
    maps = {"state_map": whole.state_map, "static_map": whole.static_map}
    decouples = Decoupled(faults=tuple(ignored))
    return make_generator(system, plant, "decoupled residual", evidence, decouples=decouples, **maps)


def _attempts(
    quotient: Quotient,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    kind: str | None,
    plant: Plant,
    rtol: float,
) -> list[tuple[Callable[[], Placement], Callable[[], str]]]:
    """Return the gains to try, each with what to say about it: what was asked for, or defaults of falling demands."""
    if kind not in (None, "kalman", "placement"):
        raise DesignError(f"gain must be 'kalman' or 'placement', got {kind!r}")
    free = poles is None and margin is None
    if kind == "kalman" and not free:
        raise DesignError("the gain of a Kalman filter has no poles or margin to choose: leave them out")
    if kind == "kalman" and not plant.Bw.shape[1]:
        raise DesignError("a Kalman filter needs the noise of the plant: with_noise(process=..., measurement=...)")
    if not free:
        return [(lambda: place(quotient.A, quotient.C, poles, margin, plant.dt, rtol), str)]
    default = margin_from(quotient.A, plant)
    placed = [
        (
            lambda part=part: place(quotient.A, quotient.C, None, default / part, plant.dt, rtol),
            partial(_lowered, default, part),
        )
        for part in (1, 4, 16, 64)
    ]
    if kind == "placement" or not plant.Bw.shape[1]:
        return placed
    try:
        best = _kalman_gain(quotient, plant)
    except (DesignError, AccuracyError) as error:
        if kind == "kalman":
            raise
        note = f"poles placed, for there is no Kalman filter: {error}"
        return [(attempt, lambda: note) for attempt, _ in placed]
    return [(lambda: best, lambda: "gain of the Kalman filter"), *([] if kind == "kalman" else placed)]


def _lowered(default: float, part: int) -> str:
    """Return what to say of a part of the default margin; of all of it nothing, so that no text has a rate in it."""
    if part == 1:
        return ""
    return f"the default margin was lowered to {unit_of_rates() * default / part:.3g} per second, for less rounding"


def _kalman_gain(quotient: Quotient, plant: Plant) -> Placement:
    """Return the gain of the Kalman filter of the quotient."""
    G, J = quotient.process_noise, quotient.measurement_noise
    riccati = filter_riccati(quotient.A, quotient.C, G @ G.T, J @ J.T, G @ J.T, dt=plant.dt)
    none, K = np.zeros(0, dtype=complex), np.asarray(riccati.gain)
    block, poles = quotient.A - K @ quotient.C, np.asarray(riccati.poles, dtype=complex)
    return Placement(K, none, poles, none, 0.0, block, float(np.linalg.norm(K)))


def rounding_share(generator: ResidualGenerator) -> float:
    r"""Return how large rounding is over the response to the fault that is weakest against it.

    For the signals of a slow fault: the terms :math:`|F| |x| + |K| |y|` of each step are rounded and pass through
    :math:`C (zI - F)^{-1}` on to the residual, whose own terms are :math:`|C| |x| + |D| |y|`. Zero without faults.
    """
    system, plant = generator.system, generator.plant
    # of a sampled plant with several poles at one nothing is known of slower signals than those of leaks
    sampled = plant.is_discrete
    w = leak_frequencies(system, plant, ("fault",)) if sampled else frequency_grid(system, plant.system(()))
    w = w[: max(len(w) // 3, 1)]
    moved = plant.system("fault").frequency_response(w)
    n_u, n, y = len(plant.inputs), system.n_states, np.abs(moved)
    K, H = np.abs(system.B[:, n_u:]), np.abs(system.D[:, n_u:])
    response = np.abs(generator.internal_form().select(inputs=range(len(plant.faults))).frequency_response(w))
    left = H @ y
    if n:
        z = np.asarray(np.exp(1j * w * plant.dt) if plant.is_discrete else 1j * w, dtype=np.complex128)
        x = np.abs(solver(system.A, None, z)(system.B[:, n_u:] @ moved))
        steps = np.abs(system.A) @ x + K @ y
        through = np.abs(solutions(system.A, None, z, np.zeros((n, 0)), system.C)[1])
        left = left + np.abs(system.C) @ x + through @ steps
    # A response below the rounding of its terms is lost as a whole, however small it is: a share of one.
    lost = response < _EPS * left
    share = np.median(np.where(lost, 1.0, _EPS * left / np.where(lost | (response == 0), 1.0, response)), axis=0)
    best = np.where(generator.structure, share, np.inf).min(axis=0, initial=np.inf)  # of the residuals that see it
    return float(np.max(best, initial=0.0, where=np.isfinite(best)))
