"""Detection filters: each fault moves the residual in its own direction or plane, and no disturbance does."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from residua.analysis.existence import unknown_input_observer_existence
from residua.arrays import index_of
from residua.design.banks.bank import largest_leaks, maps_of
from residua.design.core.decoupling import Approximate
from residua.design.core.evidence import Evidence
from residua.design.core.generator import Member, ResidualGenerator, make_generator
from residua.design.core.method import FAULTS, disturbances, method
from residua.design.detection_filters.directional_gain import (
    FaultEvent,
    Poles,
    block_gain,
    entrances,
    fault_events,
    hidden_modes,
    partition,
    with_poles_of_whole,
)
from residua.design.observers.observer_gain import balanced_options, require_detectable
from residua.design.observers.unknown_input_observer import REFERENCE, ErrorPair, error_pair
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.observer_gain import ObserverGain
from residua.linear.poles.spectrum import balanced_rate, describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.quotient import observable_split
from residua.linear.systems.state_space import stack_systems
from residua.plant import Plant
from residua.tolerances import BALANCED_RANK, above_rounding
from residua.words import counted, used_up

#: The units in which a pseudoinverse is the smallest.
Scaling = Literal["plant", "even"]
REFERENCES = (
    "Chen, Patton and Zhang (1996), Int. J. Control 63(1), eqs. (14) to (18), Definitions 2 to 4",
    "Gertler (1991), Automatica 27(4), section 5.1, eqs. (5-1) to (5-8), after White and Speyer (1987)",
)


@method(
    needs=[FAULTS],
    exists_when="a stable filter keeps each fault to its direction or plane",
    order="n per filter",
    source="Chen, Patton and Zhang (1996), eqs. (14) to (18); Gertler (1991), section 5.1",
    faults="by direction, whatever its time course",
)
def detection_filter(
    plant: Plant,
    *,
    poles: Poles = None,
    margin: float | None = None,
    faults: Iterable[str] | None = None,
    scaling: Scaling = "plant",
) -> ResidualGenerator:
    r"""Design Beard's detection filter: a Luenberger observer whose residual tells faults apart by direction.

    .. math:: \dot{\hat x} = A \hat x + B u + K (y - C \hat x), \qquad r = y - C \hat x

    The gain confines the response to each fault to a space of its own, so that, whatever its time course,
    the residual of an actuator or component fault stays on the line :math:`C A^\mu l_i` (the first nonzero of
    :math:`C l_i, C A l_i, \dots`) and that of a sensor fault on the line of its output. With as many independent
    measurements as states and all poles alike, :math:`K = (A - \lambda I) C^+`, and sensor faults stay in planes.
    Otherwise each fault gets its detection space, whose poles are free: for an actuator fault one, and one more for
    each invariant zero of :math:`(A, l_i, C)`; for a sensor fault one for each state that the other sensors do not
    see. Invariant zeros of all faults together that belong to no single fault are poles that no gain moves. Faults
    that one filter cannot keep apart, or only by a large gain, are split over as few filters as needed, which run as
    one. For one fault a filter exists wherever the pair (C, A) is detectable and an output answers to the fault.

    Parameters
    ----------
    plant : Plant
        Its disturbances are not decoupled; see :func:`robust_detection_filter`.
    poles : sequence of complex, or mapping of fault name to sequence, optional
        Dealt out in the order of the faults, conjugate pairs kept together; or one sequence for each fault
        (``"rest"`` for the poles that belong to no fault). With several filters, a list is used for each.
        The others are placed beyond ``margin``.
    margin : float, optional
        Stability margin in 1/s for the poles that ``poles`` leaves open. When omitted, they are those of least squares
        with equal noise in all states and outputs of the balanced plant; with as many independent measurements as
        states all are alike, at the geometric mean of the sizes of the poles of the error equation without feedback.
    faults : iterable of str, optional
        The faults to be kept apart; all faults of the plant when omitted.
    scaling : {"plant", "even"}
        The units of the outputs in which a pseudoinverse is the smallest: those of the plant, as in the paper, or
        balanced ones, so that the filter does not depend on the units of the plant.

    Returns
    -------
    ResidualGenerator
        ``directions`` and ``subspaces`` hold the signatures, ``observer.K`` the gain (of the first filter).

    Raises
    ------
    DesignError
        If the pair (C, A) is not detectable, or a fault cannot be kept to a direction by a stable filter.

    See Also
    --------
    robust_detection_filter : No disturbance reaches it.
    directional_parity : Directions of one's choice.
    structured_bank : Names by code where directions do not suffice.
    kalman_filter : The least noise, for settled faults.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant, there are no disturbances (or none that matter),
    and one fault is there at a time: with two, the residual lies in the sum of their spaces. Faults may have
    any time course.

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (14) to (18) and (25); Gertler (1991), eqs. (5-1) to (5-8).

    Examples
    --------
    >>> import residua as rs
    >>> flt = rs.design.detection_filter(rs.library.gertler(), poles=[0.25, 0.3, 0.6])
    >>> flt.observer.K.round(6) + 0.0
    array([[ 0.1 , -0.05],
           [ 0.1 ,  0.05],
           [-0.2 ,  0.4 ]])
    """
    model = plant.explicit().balanced
    require_detectable(model)
    pair = error_pair(model, None, 0, scaling)
    return _directional_filters(pair, poles, margin, faults, Evidence(method="detection filter", references=REFERENCES))


@method(
    needs=[FAULTS, disturbances("disturbances", "detection_filter is the same")],
    exists_when="as unknown_input_observer and detection_filter",
    order="n per filter",
    source="Chen, Patton and Zhang (1996), eqs. (19) to (25)",
    faults="by direction, whatever its time course",
    decouples=True,
)
def robust_detection_filter(
    plant: Plant,
    *,
    poles: Poles = None,
    margin: float | None = None,
    faults: Iterable[str] | None = None,
    H0: ArrayLike | None = None,
    scaling: Scaling = "plant",
) -> ResidualGenerator:
    r"""Design a filter that no disturbance reaches and that tells faults apart by direction.

    An unknown input observer, :math:`r = (I - CH) y - C z`, whose gain :math:`K_1` is that of a detection
    filter for the pair :math:`(C, A_1)` and the fault directions :math:`T l_i`:

    (a) ``H`` and ``T`` from the disturbances, (b) :math:`A_1 = T A`, (c) ``K1`` so that every fault keeps to
    its own line (:math:`C T l_i`) or plane, (d) :math:`K = K_1 + F H`. The residual of a sensor fault ``j``
    stays in :math:`R_j = \operatorname{span}\{I_j, C k_{1j}, C h_j\}`; ``subspaces`` holds the part of it
    that the residual can reach.

    Parameters
    ----------
    plant : Plant
        With at least one disturbance and one fault.
    poles : sequence of complex, or mapping of fault name to sequence, optional
        As for :func:`detection_filter`.
    margin : float, optional
        Stability margin in 1/s for the poles that ``poles`` leaves open.
    faults : iterable of str, optional
        The faults to be kept apart; all faults of the plant when omitted.
    H0 : array_like, shape (n, outputs), optional
        The free matrix of the general decoupling gain, in the units of the plant; zero when omitted.
    scaling : {"plant", "even"}
        The units of the outputs in which a pseudoinverse is the smallest: those of the plant, as in the paper, or
        balanced ones, so that the filter does not depend on the units of the plant.

    Returns
    -------
    ResidualGenerator
        ``observer`` holds ``F, T, K, H, K1, K2, A1``.

    Raises
    ------
    DesignError
        If no unknown input observer exists, the disturbances use up all measurements, they hide every
        fault, or no stable directional filter exists.

    See Also
    --------
    detection_filter : Without disturbances.
    structured_bank : Names by code, whenever any method does.
    directional_parity : Directions of one's choice, with disturbances decoupled.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant; disturbances enter where the model says, and may be
    any signals; one fault is there at a time. Costs: as many independent measurements as disturbances are
    used up, so fewer faults can be kept apart than by the plain filter.

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (19) to (25), Definitions 5 and 6.

    Examples
    --------
    >>> import residua as rs
    >>> flt = rs.design.robust_detection_filter(rs.library.jet_engine(), poles=[-3, -3, -3])
    >>> {name: basis.shape[1] for name, basis in flt.subspaces.items() if name.startswith("n_")}
    {'n_low sensor': 2, 'n_high sensor': 2}
    """
    plant = plant.explicit()
    existence = unknown_input_observer_existence(plant)
    if not existence:
        raise DesignError("; ".join(existence.reasons))
    if not existence.useful:
        raise DesignError(
            f"{used_up(plant.n_outputs)} to decouple {counted(len(plant.disturbances), 'disturbance')}: "
            "nothing is left to see faults with; add a sensor or decouple fewer disturbances"
        )
    model = plant.balanced
    pair = error_pair(model, model.disturbances, existence.rank_E.rank, scaling, H0)
    base = Evidence(
        method="robust detection filter",
        ranks={"rank(CE)": existence.rank_CE, "rank(E)": existence.rank_E} if pair.decoupled else {},
        conditions={"|T E|": float(np.linalg.norm(pair.T @ (model.disturbances[0] - pair.G @ model.disturbances[1])))},
        notes=pair.notes,
        references=(REFERENCE, *REFERENCES),
    )
    return _directional_filters(pair, poles, margin, faults, base)


def _directional_filters(
    pair: ErrorPair, poles: Poles, margin: float | None, faults: Iterable[str] | None, base: Evidence
) -> ResidualGenerator:
    """Design directional filters for an error pair: of the plant, or of the plant without its disturbances."""
    plant = pair.model.plant
    poles, margin = balanced_options(plant, poles, margin)
    wanted = plant.faults if faults is None else (faults,) if isinstance(faults, str) else tuple(faults)
    chosen = tuple(plant.faults[index_of(name, plant.faults, "fault")] for name in wanted)
    if not chosen:
        raise DesignError("the plant has no faults to tell apart: add some with with_sensor_faults, with_faults")
    pair = pair.white()
    hidden = hidden_modes(pair.A, pair.C)
    if hidden.size:
        pair = pair.seen(observable_split(pair.A, pair.C).seen)
    events, unseen = fault_events(pair.A, pair.C, entrances(pair, chosen))
    notes = [
        f"{', '.join(event.faults)} share one signature: this filter cannot tell them apart"
        for event in events
        if len(event.faults) > 1
    ]
    if unseen:
        why = "hidden by the decoupled disturbances" if pair.decoupled else "seen by no output"
        notes.append(f"{', '.join(unseen)}: {why}")
    if not events:
        raise DesignError(f"none of the faults reaches the residual ({'; '.join(notes)})")
    names = {name for event in events for name in event.faults} | {"rest"}
    for name in poles if isinstance(poles, Mapping) else ():
        if name not in names:
            raise DesignError(f"poles: unknown fault {name!r}; known: {', '.join(sorted(names))}")
    ideal = _scalar_gain(pair, poles, margin)
    groups, gains = partition(pair, events, hidden) if ideal is None else ([events], [ideal])
    for k, group in enumerate(groups if ideal is None and (poles is not None or margin is not None) else ()):
        names = {name for event in group for name in event.faults} | {"rest"}
        share = {name: poles[name] for name in poles if name in names} if isinstance(poles, Mapping) else poles
        gains[k] = block_gain(pair, group, hidden, share, margin)
    if len(groups) > 1:
        notes.append(f"{len(groups)} filters: one cannot keep all faults apart")
    near = [one for event in events for one in event.space.decisions if not one.is_clear]
    notes += [f"near: {one}; double precision hardly decides this rank" for one in near[:1]]
    base = base.extended(notes=tuple(notes))
    parts = [pair.observer(gain.K, with_poles_of_whole(base, pair, gain)).residual_generator() for gain in gains]
    return _stacked(parts, groups, ideal is not None)


def _scalar_gain(pair: ErrorPair, poles: Poles, margin: float | None) -> ObserverGain | None:
    r"""Return the gain of eq. (25), :math:`A - KC = \lambda I`, or nothing unless rank C = n and poles are alike."""
    n, sampled, rate = len(pair.M), pair.model.plant.is_discrete, pair.model.units.rate
    if isinstance(poles, Mapping) or np.count_nonzero(np.linalg.svd(pair.C, compute_uv=False) > BALANCED_RANK) < n:
        return None
    wanted = np.asarray([] if poles is None else poles, dtype=complex)
    if poles is None:
        distance = balanced_rate(pair.A, sampled) if margin is None else margin
        pole = float(np.exp(-distance)) if sampled else -float(distance)
    elif len(wanted) != n or np.any(wanted != wanted[0]) or np.any(np.imag(wanted)):
        return None
    else:
        pole = float(np.real(wanted[0]))
    if not is_stable_mode(pole, float(sampled)):
        kind = "a sampled" if sampled else "a continuous"
        raise DesignError(f"the pole {describe_modes([rate * pole])} is not stable for {kind} plant")
    A, C = pair.T @ pair.A0, pair.C0
    inverse = np.linalg.pinv(C)
    off = above_rounding(A - pole * np.eye(n), np.abs(A) + abs(pole) * np.eye(n))
    K = above_rounding(off @ inverse, np.abs(off) @ np.abs(inverse))
    error = float(np.abs(np.linalg.eigvals(A - K @ C) - pole).max(initial=0.0))
    note = "as many independent measurements as states: every fault keeps its direction or plane"
    return ObserverGain(K, wanted, wanted, np.zeros(0, complex), error, note)


def _stacked(parts: list[ResidualGenerator], groups: list[list[FaultEvent]], ideal: bool) -> ResidualGenerator:
    """Return the filters as one generator, or raise where a fault leaves the line or plane that the design gave it."""
    members, start = [], 0
    for k, (part, group) in enumerate(zip(parts, groups, strict=True), 1):
        rows = tuple(range(start, start + part.n_residuals))
        start += part.n_residuals
        members.append(Member(f"filter {k}", rows, tuple(name for event in group for name in event.faults)))
        for name, space in ((name, event.space) for event in group for name in event.faults):
            direct = np.any(part.plant.Df[:, part.faults.index(name)])
            promised = 1 + bool(direct) if ideal else space.outputs.shape[1]
            if part.subspaces[name].shape[1] > promised:
                raise AccuracyError(
                    f"the residual of {name!r} leaves its direction (dimension {part.subspaces[name].shape[1]} instead "
                    f"of {promised}): the plant is too badly conditioned for a directional filter with these "
                    "poles; ask for slower ones, or add a sensor"
                )
    first = parts[0]
    if len(parts) == 1:
        return replace(first, members=tuple(members))
    system = stack_systems([part.system for part in parts])
    leaks = largest_leaks(parts, first.plant)
    evidence = first.evidence.extended(
        decoupling=leaks,
        poles=system.poles(),
        requested_poles=np.concatenate([part.evidence.requested_poles for part in parts]),
        fixed_poles=np.concatenate([part.evidence.fixed_poles for part in parts]),
    )
    return make_generator(
        system,
        first.plant,
        first.method,
        evidence,
        decouples=Approximate(next(iter(leaks), "")),
        **maps_of(parts, system.outputs),
        observer=first.observer,
        members=tuple(members),
    )
