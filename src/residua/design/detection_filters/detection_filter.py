"""Beard's detection filter: each fault moves the residual in its own direction or plane."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from residua.analysis.output_free_form import OutputFreeForm, output_free_form
from residua.arrays import index_of
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import Member, ResidualGenerator, make_generator
from residua.design.core.method import method
from residua.design.core.needs import FAULTS
from residua.design.core.own_time import in_own_time
from residua.design.detection_filters.directional_gain import (
    DirectionalGain,
    FaultEvent,
    Poles,
    block_gain,
    checked_options,
    fault_events,
    partition,
    scalar_gain,
    scalar_pole,
)
from residua.design.observers.even_units import POLE_ERROR, gain_size, in_units_of_the_plant
from residua.design.observers.observer import Observer
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.matrix_poles import explicit_poles
from residua.linear.poles.placement import default_margin
from residua.linear.poles.spectrum import describe_modes, spectrum_error
from residua.linear.subspaces.detection_space import inverse_without_rounding
from residua.linear.subspaces.far_gain import refuse_far_gain
from residua.linear.subspaces.observability import detectability
from residua.linear.subspaces.rank import DEFAULT_RTOL, decide_rank
from residua.linear.systems.balancing import balance_system, without_rounding
from residua.linear.systems.state_space import stack_systems
from residua.plant import Plant
from residua.plant.comparable_units import EvenPlant, even_plant
from residua.tolerances import RESIDUE, above_rounding

#: The units in which a pseudoinverse is the smallest.
Scaling = Literal["plant", "even"]
#: What a fault does to the error, relative to the terms that it is the sum of, is rounding below this.
_NO_EVENT = 1e-11

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
@in_own_time()
def detection_filter(
    plant: Plant,
    *,
    poles: Poles = None,
    margin: float | None = None,
    faults: Iterable[str] | None = None,
    scaling: Scaling = "plant",
    rtol: float = DEFAULT_RTOL,
) -> ResidualGenerator:
    r"""Design Beard's detection filter: a Luenberger observer whose residual tells faults apart by direction.

    .. math:: \dot{\hat x} = A \hat x + B u + K (y - C \hat x), \qquad r = y - C \hat x

    The gain confines the response to each fault to a space of its own, so that, whatever its time course,
    the residual of an actuator or component fault stays on the line :math:`C A^\mu l_i` (the first nonzero of
    :math:`C l_i, C A l_i, \dots`) and that of a sensor fault in a plane. With as many independent
    measurements as states and all poles alike, :math:`K = (A - \lambda I) C^+`. Otherwise each fault gets
    its detection space, whose poles are free, one more for each invariant zero of
    :math:`(A, l_i, C)`; invariant zeros of all faults together that belong to no single fault are poles
    that no gain moves. Faults that one filter cannot keep apart are split over as few filters as needed,
    which run as one.

    Parameters
    ----------
    plant : Plant
        Its disturbances are not decoupled; see :func:`robust_detection_filter`.
    poles : sequence of complex, or mapping of fault name to sequence, optional
        Dealt out in the order of the faults, conjugate pairs kept together; or one sequence for each fault
        (``"rest"`` for the poles that belong to no fault). With several filters, a list is used for each.
        The others are placed beyond ``margin``.
    margin : float, optional
        Stability margin in 1/s for the poles that ``poles`` leaves open; when omitted, the geometric mean of the
        sizes of the poles of the error equation without feedback, or less where that proves too much.
    faults : iterable of str, optional
        The faults to be kept apart; all faults of the plant when omitted.
    scaling : {"plant", "even"}
        The units of the outputs in which a pseudoinverse is the smallest: those of the plant, as in the paper, or
        balanced ones, so that the filter does not depend on the units of the plant.
    rtol : float
        Relative tolerance of the rank decisions.

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
    plant, even = plant.explicit(), even_plant(plant, explicit=True)
    return directional_filters(
        plant,
        even,
        even.plant.A,
        even.plant.C,
        T=np.eye(plant.n_states),
        H=np.zeros((plant.n_states, plant.n_outputs)),
        W=np.eye(plant.n_outputs),
        offset=np.zeros((plant.n_states, plant.n_outputs)),
        poles=poles,
        margin=margin,
        faults=faults,
        base=Evidence(method="detection filter", references=REFERENCES),
        decouples=False,
        scaling=scaling,
        rtol=rtol,
    )


def directional_filters(
    plant: Plant,
    even: EvenPlant,
    A: NDArray,
    C: NDArray,
    *,
    T: NDArray,
    H: NDArray,
    W: NDArray,
    offset: NDArray,
    poles: Poles,
    margin: float | None,
    faults: Iterable[str] | None,
    base: Evidence,
    decouples: bool,
    scaling: Scaling,
    rtol: float,
    form: OutputFreeForm | None = None,
) -> ResidualGenerator:
    """Design directional filters for the error pair ``(C, A)``: ``F = A - K C``, ``K1 = K W + offset``.

    Shared by the plain filter (``T = I``, ``H = 0``) and the robust one, whose pair is that of the unknown
    input observer. All matrices are those of the plant in even units, so that the filter does not depend on its own.
    """
    original, plant = plant, even.plant
    poles, margin = checked_options(poles, margin)
    wanted = plant.faults if faults is None else (faults,) if isinstance(faults, str) else tuple(faults)
    chosen = tuple(plant.faults[index_of(name, plant.faults, "fault")] for name in wanted)
    if not chosen:
        raise DesignError("the plant has no faults to tell apart: add some with with_sensor_faults, with_faults")
    answer = detectability(A, C, dt=plant.dt)
    if not answer.detectable:
        bad = describe_modes(answer.unstable_modes)
        raise DesignError(f"no stable filter exists: no measurement sees the mode {bad}; add a sensor")
    weights = even.output_weights(A, np.zeros((len(A), 0)), C)
    units = _Units.of(A, C, event_matrices(plant, T, chosen, form, weights), weights)
    events, unseen = fault_events(units.A, units.C, units.events, rtol=rtol)
    directly = [name for name in chosen if _seen_directly(plant, H, W, name)]
    notes = [note for event in events for note in _shared(event.faults, directly)]
    unseen = [name for name in unseen if not _seen_directly(plant, H, W, name)]
    if unseen:
        why = "hidden by the decoupled disturbances" if decouples and plant.disturbances else "seen by no output"
        notes.append(f"{', '.join(unseen)}: {why}")
    if not events and not directly:
        raise DesignError(f"none of the faults reaches the residual ({'; '.join(notes)})")
    pole = scalar_pole(A, C, poles, margin, plant.dt)
    if pole is not None:
        groups = [events]
    else:
        groups = partition(units.A, units.C, events, plant.dt) if events else [[]]
    if isinstance(poles, Mapping):
        _check_names(poles, events)
    notes += [f"{len(groups)} filters: one cannot keep all faults apart"] if len(groups) > 1 else []
    frame = _Frame(original, even, T, H, W, offset, base, decouples)
    failure, lowered = AccuracyError("no design was tried"), ()
    for distance in _margins(A, plant.dt, poles, margin):
        try:
            if pole is not None:
                in_gain = weights if units.independent else weights_of(even, scaling, A, np.zeros((len(A), 0)), C, W)
                gains = [scalar_gain(A, C, pole, in_gain, asked=poles is not None)]
            else:
                gains = [
                    units.plain(
                        block_gain(units.A, units.C, group, _poles_for(poles, group), distance, plant.dt, rtol=rtol)
                    )
                    for group in groups
                ]
            for gain in gains:  # as a whole too: the blocks have units of their own
                refuse_far_gain(A, C, gain.gain, _farthest(gain.requested, pole, distance, plant))
            observers = [frame.observer(gain, (*notes, *lowered)) for gain in gains]
            return _stacked(original, observers, groups, pole is not None)
        except AccuracyError as error:
            failure = error
            lowered = (f"the default margin was lowered: {str(error).split(':')[0]}",)
    raise failure


def weights_of(
    even: EvenPlant, scaling: Scaling, A: NDArray, B: NDArray, C: NDArray, W: NDArray
) -> NDArray[np.float64]:
    """Return the weights that least squares give the outputs ``W y`` of a plant in even units."""
    if scaling not in get_args(Scaling):
        raise DesignError(f"scaling must be 'plant' or 'even', got {scaling!r}")
    if scaling == "even":
        return even.output_weights(A, B, C)
    return 1 / np.linalg.norm(W * even.outputs, axis=1)


def _margins(A: NDArray, dt: float, poles: Poles, margin: float | None) -> list[float | None]:
    """Return the margins to try: the one asked for, or the default and smaller ones when it asks too much."""
    if margin is not None or (poles is not None and not isinstance(poles, Mapping)):
        return [margin]
    default = default_margin(A, dt)
    return [default, default / 4, default / 16]


def _farthest(requested: NDArray, pole: float | None, margin: float | None, plant: Plant) -> float:
    """Return the size of the farthest pole that a filter was asked for; one where the plant is sampled."""
    if plant.dt:
        return 1.0
    return float(max([margin or 0.0, abs(pole or 0.0), *np.abs(requested)]))


@dataclass(frozen=True, eq=False)
class _Frame:
    """What the filters of one design share: the decoupling, in even units, and the plant."""

    plant: Plant
    even: EvenPlant
    T: NDArray
    H: NDArray
    W: NDArray
    offset: NDArray
    base: Evidence
    decouples: bool

    def observer(self, design: DirectionalGain, notes: tuple[str, ...]) -> Observer:
        """Return the observer of a directional gain."""
        plant = self.even.plant
        K1 = self._read(design.gain @ self.W + self.offset)
        F = without_rounding(np.hstack([self.T, -K1]), np.vstack([plant.A, plant.C]))
        evidence = self.base.extended(
            poles=explicit_poles(F),
            requested_poles=design.requested,
            fixed_poles=design.fixed,
            conditions={"pole error": self._pole_error(design, F), "size of K1": gain_size(F, K1, plant.C)},
            notes=(*notes, design.note) if design.note else notes,
        )
        K, M = above_rounding(K1 + F @ self.H, np.abs(K1) + np.abs(F) @ np.abs(self.H)), np.eye(len(F))
        made = Observer(plant, F, self.T, K, M, self.H, self.W, self.base.method, self.decouples, evidence)
        return in_units_of_the_plant(made, self.plant, self.even)

    def _read(self, K1: NDArray) -> NDArray[np.float64]:
        """Return a gain without what changes the error equation by its rounding only, which would couple its states.

        Where decoupling has left a state no equation of its own, rounding is that of the equations of the others.
        """
        C, own = np.abs(self.even.plant.C), np.abs(self.T) @ np.abs(self.even.plant.A)
        rows = (own + np.abs(K1) @ C).max(axis=1, keepdims=True, initial=0.0)
        rows = np.where(own.any(axis=1, keepdims=True), rows, rows.max(initial=0.0))
        return np.where(np.abs(K1) * C.max(axis=1, initial=0.0) > RESIDUE * rows, K1, 0.0)

    def _pole_error(self, design: DirectionalGain, F: NDArray) -> float:
        """Return by how much the poles of the whole filter miss those that were asked for, or raise where it counts."""
        wanted = np.concatenate([design.requested, design.fixed])
        if not design.requested.size or len(wanted) != len(F):
            return design.error
        error = max(design.error, spectrum_error(F, wanted, self.plant.dt, POLE_ERROR)[0])
        if error > POLE_ERROR:
            raise AccuracyError(
                f"a pole is off by {error:.2g} > {POLE_ERROR:.0e} of the requested pole: so ill-conditioned that "
                "rounding moves it; ask for poles nearer to those of the plant or further apart, for a margin, or add "
                "a sensor"
            )
        return error


@dataclass(frozen=True, eq=False)
class _Units:
    """The error pair in balanced units, so that directions do not depend on the units of the model.

    Outputs have weights that do not depend on their units when there are more of them than independent rows of ``C``:
    what the gain ignores, and so the plane of a sensor fault, changes with them.
    """

    A: NDArray
    C: NDArray
    events: dict[str, NDArray]
    states: NDArray
    outputs: NDArray
    independent: bool

    @staticmethod
    def of(A: NDArray, C: NDArray, events: dict[str, NDArray], weights: NDArray) -> _Units:
        B = np.hstack([np.zeros((len(A), 0)), *events.values()])
        balanced = balance_system(A, B, C, np.zeros((len(C), B.shape[1])))
        T = balanced.states
        scaled = balanced.outputs[:, None] * C * T
        independent = decide_rank(scaled).rank == len(C)
        outputs = balanced.outputs if independent else weights
        unit = {name: _unit_columns(L / T[:, None]) for name, L in events.items()}
        return _Units(A / T[:, None] * T, outputs[:, None] * C * T, unit, T, outputs, independent)

    def plain(self, design: DirectionalGain) -> DirectionalGain:
        """Return the design in the units of the plant."""
        return replace(design, gain=self.states[:, None] * design.gain * self.outputs)


def _unit_columns(L: NDArray) -> NDArray:
    size = np.linalg.norm(L, axis=0)
    return L / np.where(size > 0, size, 1.0)


def event_matrices(
    plant: Plant,
    T: NDArray,
    faults: tuple[str, ...],
    form: OutputFreeForm | None = None,
    weights: NDArray | None = None,
) -> dict[str, NDArray]:
    r"""Return what each fault does to the error equation: ``T f``, or two columns for one in the outputs.

    A fault with output part ``d`` acts, after the shift :math:`e + T g \eta` with :math:`C g = d`, as the
    events :math:`T g` (with its derivative) and :math:`T (f - A g)`; ``A``, ``C`` and ``d`` here after
    disturbances have been removed from the outputs, where a ``form`` says how: a plain filter leaves them there.
    Where no ``g`` gives all of ``d``, the rest must not pass the gain: ``g`` is that of least squares with the weights
    that the outputs have for it.
    """
    out = {}
    form = output_free_form(plant.without_disturbances()) if form is None else form
    weights = np.ones(len(form.C)) if weights is None else weights
    inverse = inverse_without_rounding(weights[:, None] * form.C) * weights
    for name in faults:
        i = plant.faults.index(name)
        f, d = plant.Bf[:, [i]], plant.Df[:, [i]]
        effects, sizes = f, np.abs(f)
        if np.any(d):
            g, above = _product(inverse, *_product(form.W, d, np.abs(d)))
            parts = np.hstack([np.eye(len(f)), -form.G, -form.A])
            late = _product(parts, np.vstack([f, d, g]), np.abs(np.vstack([f, d, above])))
            effects, sizes = np.hstack([g, late[0]]), np.hstack([above, late[1]])
        L, terms = _product(T, effects, sizes)
        real = np.linalg.norm(L, axis=0) > _NO_EVENT * np.linalg.norm(terms, axis=0)
        out[name] = _unit_columns(np.where(real, L, 0.0))
    return out


def _product(M: NDArray, x: NDArray, sizes: NDArray) -> tuple[NDArray, NDArray]:
    """Return ``M x``, exactly zero where it is rounding of its terms, and their sizes; ``sizes`` are those of ``x``.

    An entry that rounding left in an event would be a coupling to what balances the error pair, and to every space.
    """
    terms = np.abs(M) @ sizes
    return above_rounding(M @ x, terms), terms


def _shared(faults: Sequence[str], directly: Sequence[str]) -> list[str]:
    """Return what is to be said of faults that move the error along one signature; ``directly``: seen without it."""
    if len(faults) < 2:
        return []
    alike = [name for name in faults if name not in directly]
    notes = [f"{', '.join(alike)} share one signature: this filter cannot tell them apart"] if len(alike) > 1 else []
    if len(alike) < len(faults):
        notes.append(
            f"{', '.join(faults)} move the error of the observer along one signature: what tells them apart is how "
            "they enter the outputs"
        )
    return notes


def _seen_directly(plant: Plant, H: NDArray, W: NDArray, name: str) -> bool:
    """Tell whether a fault in the outputs reaches the residual without the help of the state."""
    d = plant.Df[:, plant.faults.index(name)]
    direct = W @ (d - plant.C @ (H @ d))
    terms = np.abs(W) @ (np.abs(d) + np.abs(plant.C) @ (np.abs(H) @ np.abs(d)))
    return bool(np.any(np.abs(direct) > 1e-9 * terms))


def _poles_for(poles: Poles, group: list[FaultEvent]) -> Poles:
    """Return the part of named poles that concerns this group of faults."""
    if not isinstance(poles, Mapping):
        return poles
    mine = {name for event in group for name in event.faults} | {"rest"}
    return {name: values for name, values in poles.items() if name in mine}


def _check_names(poles: Mapping, events: list[FaultEvent]) -> None:
    known = [name for event in events for name in event.faults] + ["rest"]
    for name in poles:
        if name not in known:
            raise DesignError(f"poles: unknown fault {name!r}; known: {', '.join(known)}")


def _stacked(
    plant: Plant,
    observers: list[Observer],
    groups: list[list[FaultEvent]],
    ideal: bool,
) -> ResidualGenerator:
    """Return the filters as one generator, after checking the directions that they promise."""
    parts = [observer.residual_generator() for observer in observers]
    members, start = [], 0
    for k, (part, group) in enumerate(zip(parts, groups, strict=True), 1):
        rows = tuple(range(start, start + part.n_residuals))
        start += part.n_residuals
        names = tuple(name for event in group for name in event.faults)
        members.append(Member(f"filter {k}", rows, names))
        _check_directions(part, group, ideal)
    if len(parts) == 1:
        first = parts[0]
        return replace(first, members=tuple(members))
    system = stack_systems([part.system for part in parts])
    evidence = parts[0].evidence.extended(
        poles=system.poles(),
        requested_poles=np.concatenate([part.evidence.requested_poles for part in parts]),
        fixed_poles=np.concatenate([part.evidence.fixed_poles for part in parts]),
    )
    return make_generator(
        system,
        plant,
        parts[0].method,
        evidence,
        decouples=Decoupled(disturbances=observers[0].decouples),
        state_map=np.vstack([observer.T for observer in observers]),
        observer=observers[0],
        members=tuple(members),
    )


def _check_directions(generator: ResidualGenerator, group: list[FaultEvent], ideal: bool) -> None:
    """Raise when a fault leaves the line or plane that the design gave it."""
    plant = generator.plant
    for event in group:
        for name in event.faults:
            d = plant.Df[:, plant.faults.index(name)]
            basis = generator.subspaces[name]
            promised = 1 if ideal else event.space.outputs.shape[1]
            if np.any(d):  # what enters the outputs adds its own direction
                promised = 2 if ideal else promised + 1
            if basis.shape[1] > promised:
                raise AccuracyError(
                    f"the residual of {name!r} leaves its direction (dimension {basis.shape[1]} instead of "
                    f"{promised}): the plant is too badly conditioned for a directional filter with these "
                    "poles; ask for slower ones, or add a sensor"
                )
