"""Which design function to call for a plant: it tries them and says what came of it."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from residua.analysis.diagnosability import Diagnosability, diagnosability
from residua.analysis.unknown_input import is_singular
from residua.design.banks.bank import Bank
from residua.design.banks.matched_filters import MatchedFilters
from residua.design.catalogue import methods
from residua.design.core.brought import PartialDesign, as_generator, brings_a_generator, for_monitor
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import Chosen, Method, Noise, TimeCourse, check_design, defect
from residua.design.estimation.fault_estimator import FaultEstimator
from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.plant import Identification, InputOutputModel, Plant
from residua.robust.sets.uncertain_plant import UncertainPlant
from residua.words import counted, listing

WANTS = ("name", "size", "state")
#: Larger plants are tried with the single observers only, and the largest not at all.
LARGE, LARGEST, MOST_FAULTS = 60, 200, 16
#: Seconds for the choice of a coding set; the search then takes the best one so far.
_CHOICE_TIME = 5.0


@dataclass(frozen=True, eq=False)
class Entry:
    """One call that was considered.

    Attributes
    ----------
    call : str
        The line of code, for a plant called ``plant``.
    method : Method
        The record of the function.
    works : bool or None
        ``None`` when it was not tried.
    reason : str
        The result; or why the method was refused, or not tried.
    names : tuple of str
        The faults that it tells from all others.
    estimates : tuple of str
        The faults whose size it estimates.
    order : int
        Number of its states.
    made : object
        What the call returned; ``None`` when it did not work.
    """

    call: str
    method: Method
    works: bool | None
    reason: str
    names: tuple[str, ...] = ()
    estimates: tuple[str, ...] = ()
    order: int = 0
    made: Any = field(default=None, repr=False)

    def __str__(self) -> str:
        mark = {True: "works", False: "refused", None: "not tried"}[self.works]
        return f"{self.call}: {mark}: {self.reason}"


@dataclass(frozen=True, eq=False)
class Suggestion:
    """What to call for a plant, the best first. Prints as a table.

    Attributes
    ----------
    plant : Plant
    want : {"name", "size", "state"}
        What they are ranked by.
    entries : tuple of Entry
        All that was considered: what works, from the best down, then what was refused, then what was not tried.
    notes : tuple of str
        What can be said about the plant at all, and what to mind.
    """

    plant: Plant
    want: str
    entries: tuple[Entry, ...]
    notes: tuple[str, ...]

    @property
    def best(self) -> Entry | None:
        """The first entry that gives what is wanted; ``None`` when none does."""
        return next((entry for entry in self.entries if entry.works and _gives(entry, self.want)), None)

    def __str__(self) -> str:
        wanted = {"name": "the name of the fault", "size": "the size of the fault", "state": "the state"}[self.want]
        lines = [f"{self.plant.name}: what to call for {wanted}"]
        lines.append(f"  {self.best.call}" if self.best else "  nothing that was tried gives it")
        lines += [f"note: {note}" for note in self.notes]
        for title, works in (("works", True), ("refused", False), ("not tried", None)):
            group = [entry for entry in self.entries if entry.works is works]
            if group:
                lines.append(f"{title}:")
                width = min(max(len(entry.call) for entry in group), 78)
                lines += [f"  {entry.call:<{width}}  {_shortened(entry.reason)}" for entry in group]
        return "\n".join(lines)


def suggest(plant: Plant, *, want: str | None = None, seconds: float = 30.0) -> Suggestion:
    """Tell which design functions apply to a plant and which to prefer, by trying them.

    Guaranteed: what is said to work has been designed and has passed its own checks (``entry.made``); what is said to
    be refused has been refused, for the reason that stands beside it.

    Parameters
    ----------
    plant : Plant
        With everything that is known of it: faults, disturbances, noise.
    want : {"name", "size", "state"}, optional
        What to rank by: which fault it is, how large it is, or the state. When omitted, the name if the plant has
        faults, else the state.
    seconds : float
        After that much time nothing more is tried. A design that has begun is not interrupted; plants of more than
        60 states are tried with single observers only, those of more than 200 not at all.

    Returns
    -------
    Suggestion

    Raises
    ------
    SettingError
        If ``want`` is none of these, or the plant has no faults to name.
    ModelError
        If it is no :class:`residua.Plant`; for an uncertain one with what serves a set.

    Notes
    -----
    Assumes: each call is tried with its own choice of poles. Ranked by how many faults are named (or sized), those
    that disturbances do not reach first; among equals by what is assumed of the time course of the fault, then one
    filter before a bank, then by the number of states. Whether faults may come together is left to the reader: the
    notes say what then serves. For the state, what filters noise comes before what does not, and what converges before
    what differentiates.

    Examples
    --------
    >>> import residua as rs
    >>> rs.suggest(rs.library.gertler()).best.call
    'rs.design.detection_filter(plant)'
    >>> rs.suggest(rs.library.gertler(), want="state").best.call
    'rs.design.luenberger_observer(plant)'
    """
    if not isinstance(plant, Plant):
        raise ModelError(_no_plant(plant))
    want = _checked(plant, want)
    if not (np.isfinite(seconds) and seconds >= 0):
        raise SettingError(f"seconds must be a number of at least zero, got {seconds}")
    known = diagnosability(plant) if plant.faults and plant.n_states <= LARGEST else None
    end = time.monotonic() + seconds
    entries = [_tried(candidate, plant, want, end) for candidate in candidates(plant, known)]
    position = {entry.call: k for k, entry in enumerate(entries)}
    entries.sort(key=lambda entry: (*_rank(entry, plant, want), position[entry.call]))
    return Suggestion(plant, want, tuple(entries), tuple(_notes(plant, known, entries)))


def _no_plant(value: object) -> str:
    """Return what to do with what is no plant."""
    if isinstance(value, InputOutputModel):
        return "suggest looks at a plant: suggest(model.to_plant())"
    if not isinstance(value, UncertainPlant):
        return f"suggest looks at a residua.Plant, got {type(value).__name__}"
    if value.nominal.inputs:
        serves = (
            "with its controller, loop = plant.in_closed_loop(controller) and rs.design.robust_l1_bank(loop), whose "
            "thresholds hold for all of the set; without one, rs.design.multi_model_parity([plant.member(v) for v in "
            "plant.sample_values(0, 20)], order=...), or rs.design.insensitive_parity of a function of the parameters"
        )
    else:
        sampled = (
            "" if value.nominal.is_discrete else " (sampled first, plant.discretize(dt), before the loop is closed)"
        )
        serves = f"rs.design.robust_l1_bank(plant){sampled}, whose thresholds hold for all of the set"
    return (
        "suggest looks at one plant, and this is a set of them. For the set: "
        f"{serves}. For its nominal plant alone: suggest(plant.nominal)"
    )


def _checked(plant: Plant, want: str | None) -> str:
    if want is None:
        return "name" if plant.faults else "state"
    if want not in WANTS:
        raise SettingError(f"want must be one of {', '.join(WANTS)}, got {want!r}")
    if want != "state" and not plant.faults:
        raise SettingError(
            "the plant has no faults: name what may fail with with_sensor_faults, with_actuator_faults or with_faults"
        )
    return want


# -------------------------------------------------------------------------- trying


@dataclass(frozen=True)
class Candidate:
    """A call, and why it makes no sense here, where it makes none.

    Attributes
    ----------
    method : Method
    options : mapping of str to value
        The options of the call.
    pointless : str
        Why it makes no sense; empty if it does.
    defect : str
        What the method raised when it was asked for its calls; empty if nothing.
    made : dict
        Arguments that were made from the plant already, which candidates share.
    """

    method: Method
    options: Mapping[str, Any] = field(default_factory=dict)
    pointless: str = ""
    defect: str = ""
    made: dict[Chosen, Any] = field(default_factory=dict, repr=False)

    @property
    def call(self) -> str:
        """The line of code."""
        arguments = [one.code for one in self.method.chosen.values()]
        arguments += [f"{name}={_typed(value)}" for name, value in self.options.items()]
        return f"{self.method.called}({', '.join(['plant', *arguments])})"

    def run(self, plant: Plant) -> Any:
        """Make the call."""
        return self.method.function(plant, **self.method.with_chosen(plant, self.options, self.made, _CHOICE_TIME))


def candidates(plant: Plant, known: Diagnosability | None) -> Iterator[Candidate]:
    """Yield what could serve, the more usual first.

    Parameters
    ----------
    plant : Plant
    known : Diagnosability or None
        Of this plant; ``None`` if it was not examined.
    """
    made: dict[Chosen, Any] = {}
    for one in methods():
        asked = {option.name for option in one.options if option.required} - set(one.chosen)
        if one.takes_a_plant and not asked:
            yield from _calls_of(one, plant, known, made)


def _calls_of(
    one: Method, plant: Plant, known: Diagnosability | None, made: dict[Chosen, Any]
) -> tuple[Candidate, ...]:
    """Return the calls of a method for a plant, or the one that says what it raised when it was asked for them."""
    try:
        why = one.missing(plant, known)
        calls = tuple(dict(options) for options in one.calls(plant, known)) or ({},)
    except Exception as error:  # a method of anybody's: it must not take the others with it
        return (Candidate(one, defect=defect(one, error), made=made),)
    return tuple(Candidate(one, options, why, made=made) for options in calls)


def _typed(value: Any) -> str:
    """Return a value as it is typed."""
    if isinstance(value, str):
        return f'"{value}"'
    return repr(list(value)) if isinstance(value, tuple) else repr(value)


def _tried(one: Candidate, plant: Plant, want: str, end: float) -> Entry:
    record = one.method
    if one.defect:
        return Entry(one.call, record, False, one.defect)
    why = one.pointless or _too_much(record, plant, end)
    if why:
        return Entry(one.call, record, None, why)
    try:
        made = one.run(plant)
        check_design(record, made)
        return _told(one, made, plant)
    except (DesignError, AccuracyError, ModelError) as error:
        return Entry(one.call, record, False, str(error))
    except Exception as error:  # a method of anybody's: it must not take the others with it
        return Entry(one.call, record, False, defect(record, error))


def _too_much(record: Method, plant: Plant, end: float) -> str:
    n = plant.n_states
    if n > LARGEST:
        return f"{n} states are more than the {LARGEST} that are tried here; call it, it may take minutes"
    if record.many and n > LARGE:
        return f"{n} states are more than the {LARGE} for which banks and estimators are tried here"
    if record.many and (record.faults or record.size) and len(plant.faults) > MOST_FAULTS:
        return f"{len(plant.faults)} faults are more than the {MOST_FAULTS} for which banks are tried here"
    return "the time for trying is used up: suggest(plant, seconds=...)" if time.monotonic() > end else ""


def _told(one: Candidate, made: Any, plant: Plant) -> Entry:
    """Return the entry of a design that works, with what it tells about faults."""
    record = one.method
    if isinstance(made, FaultEstimator):
        late = ", ".join(f"{name} {lag:.3g} s late" for name, lag in made.lag.items() if lag)
        reason = f"estimates {_listed(made.faults)}, and the state" + (f"; {late}" if late else "")
        return Entry(one.call, record, True, reason, made.faults, made.faults, made.system.n_states, made)
    if isinstance(made, MatchedFilters):
        names = tuple(group[0] for group in made.groups if len(group) == 1)
        seen = tuple(name for name in made.faults if name not in made.unseen)
        reason = f"arrival, up to {made.window} samples ago, and size of a step; " + (
            f"names {_listed(names)}" if names else "names no fault"
        )
        exposed = "; disturbances reach it" if plant.disturbances else ""
        return Entry(one.call, record, True, reason + exposed, names, seen, made.generator.system.n_states, made)
    if isinstance(made, Mapping):
        left_out = made.failures if isinstance(made, PartialDesign) else ()
        missing = f"; none for {_listed(tuple(left_out))}" if left_out else ""
        reason = f"{record.state}: {_listed(tuple(made)) if made else 'none'}{missing}"
        return Entry(one.call, record, True, reason, order=sum(_order(part) for part in made.values()), made=made)
    generator, blind = _generator_of(made)
    order = _order(generator or made)
    if isinstance(made, Bank):
        names = tuple(group[0] for group in made.groups if len(group) == 1)
        reason = f"{counted(len(made.members), 'member')}; " + (
            f"names {_listed(names)}" if names else "its codes name no fault"
        )
        return Entry(one.call, record, True, reason, names, (), order, made)
    names = _named_by_direction(generator, settled=record.time_course == "constant") if generator else ()
    parts = [f"order {order}"]
    if record.state:
        parts.insert(0, record.state)
    if generator is not None and plant.faults:
        seen = [name for name, basis in generator.subspaces.items() if basis.shape[1]]
        parts.append(f"names {_listed(names)}" if names else f"detects {_listed(tuple(seen)) if seen else 'no fault'}")
    if blind:
        parts.append("no residual: it uses all measurements" if brings_a_generator(type(made)) else "no residual")
    if plant.disturbances and not record.decouples:
        parts.append("disturbances reach it")
    return Entry(one.call, record, True, "; ".join(parts), names, (), order, made)


def _order(made: Any) -> int:
    """Return the number of states of what was made, or of the observer in it."""
    return (made if hasattr(made, "system") else made.observer).system.n_states


def _generator_of(made: Any) -> tuple[ResidualGenerator | None, str]:
    """Return what a monitor would run, or why there is nothing."""
    try:
        return as_generator(for_monitor(made)), ""
    except (DesignError, AccuracyError, ModelError) as error:
        return None, str(error)


def _named_by_direction(generator: ResidualGenerator, *, settled: bool) -> tuple[str, ...]:
    """Return the faults whose residual stays out of every other fault's subspace, and every other out of its own."""
    if settled:
        steady = generator.steady_directions
        bases = {name: v[:, None] / np.linalg.norm(v) if np.any(v) else v[:, None][:, :0] for name, v in steady.items()}
    else:
        bases = dict(generator.subspaces)
    present = {name: basis for name, basis in bases.items() if basis.shape[1]}
    rank = generator.residual_rank
    if len(present) == 1 and len(generator.faults) == 1:
        return tuple(present)
    return tuple(
        name
        for name, basis in present.items()
        if basis.shape[1] < rank and all(_apart(basis, other) for key, other in present.items() if key != name)
    )


def _apart(a: NDArray, b: NDArray, sine: float = 1e-3) -> bool:
    """Whether neither of two subspaces holds the other."""
    small, large = (a, b) if a.shape[1] <= b.shape[1] else (b, a)
    return bool(np.linalg.norm(small - large @ (large.T @ small), 2) > sine)


# ------------------------------------------------------------------- ranking, telling

#: Among equals, what holds for any time course comes before what is for steps, and that before settled faults; for the
#: state, what filters noise comes before what does not, and what converges before what differentiates.
_ASSUMES, _LOUDER = get_args(TimeCourse), get_args(Noise)


def _gives(entry: Entry, want: str) -> bool:
    if want == "state":
        return bool(entry.method.state) and not isinstance(entry.made, (Bank, Mapping))
    return bool(entry.estimates if want == "size" else entry.names)


def _rank(entry: Entry, plant: Plant, want: str) -> tuple[float, ...]:
    """Return what to sort by, the best first."""
    if entry.works is not True:
        return (1 if entry.works is False else 2,)
    gives = _gives(entry, want)
    exposed = bool(plant.disturbances) and not entry.method.decouples
    noise = _LOUDER.index(entry.method.noise)
    if want == "state":
        return (0, not gives, exposed, entry.method.size, noise, len(entry.estimates), entry.order)
    count = len(entry.estimates if want == "size" else entry.names)
    assumes = _ASSUMES.index(entry.method.time_course)
    moving_average = entry.method.noise == "moving average"
    return (0, not gives, exposed, -count, assumes, moving_average, isinstance(entry.made, Bank), entry.order)


def _notes(plant: Plant, known: Diagnosability | None, entries: list[Entry]) -> Iterator[str]:
    if is_singular(plant):
        yield "E is singular: functions that need state equations refuse this plant"
    if known is not None:
        for name, why in known.reasons().items():
            yield f"{name}: {why}"
    elif plant.faults:
        yield f"whether the faults can be isolated was not examined: {plant.n_states} states"
    if plant.disturbances:
        yield from _about_disturbances(plant, entries)
    if plant.identification is not None:
        yield from _about_identification(plant, plant.identification)
    if plant.noises:
        yield "the plant has noise: a Kalman filter is the quietest observer; perfect observers are the loudest"
    yield from _about_sizes(plant, entries)
    yield from _about_many_residuals(entries)
    banks = [entry.made for entry in entries if isinstance(entry.made, Bank)]
    if any(bank.strongly_isolating for bank in banks):
        yield "faults that come together: a dedicated bank or a fault_estimator; a generalized bank names one at a time"


#: Residuals from which on groups of them are advised.
_MANY = 10


def _about_many_residuals(entries: list[Entry]) -> Iterator[str]:
    single = [entry.made for entry in entries if isinstance(entry.made, ResidualGenerator)]
    most = max((made.n_residuals for made in single), default=0)
    if most >= _MANY:
        yield (
            f"one norm over {most} residuals hides a fault that few of them show: test them by themselves, with "
            "rs.Monitor(..., test=rs.decide.NormThreshold(groups='each')), or in groups that belong together"
        )


def _about_identification(plant: Plant, made: Identification) -> Iterator[str]:
    """Yield what a plant from recordings leaves open, and what to do where its errors show that it is wrong."""
    yield f"the plant was {made}, not given: fit the monitor on recordings, which shows what its errors let through"
    if made.coloured:
        order = max(2, -(-plant.n_states // plant.n_outputs))
        yield (
            f"the prediction errors of {listing(made.coloured)} are correlated in time: the plant misses dynamics "
            "there, and tests that take the residual as white are wrong. Try a higher order first; else prefer what "
            "is insensitive to errors of the model: uncertain = model.uncertain_plant(plant); "
            f"rs.design.multi_model_parity([plant, *uncertain.sample(0, 20)], order={order}, noise=True)"
        )
    driven = {
        fault.name
        for fault in plant.fault_list
        if fault.kind == "actuator"
        and (fault.component in made.weak_inputs or any(fault.component == given for _, given in made.uncertain_gains))
    }
    if driven:
        yield (
            f"the recordings hardly say how {listing(sorted(driven))} would act: their names and sizes rest on gains "
            "that the data leave open. Move their inputs in a recording, or fit the equations: rs.identify.grey_box"
        )


def _about_sizes(plant: Plant, entries: list[Entry]) -> Iterator[str]:
    functions = {entry.method.name for entry in entries if entry.estimates}
    if plant.faults and not functions:
        yield "no size: fault_estimator was refused, or not tried, for every choice of faults"
    elif "matched_filters" in functions:
        more = "; fault_estimator follows any time course" if "fault_estimator" in functions else ""
        yield f"for faults that are steps matched_filters tells arrival and size, with the least noise{more}"
    elif plant.faults:
        yield "for the size of a fault only fault_estimator serves: suggest(plant, want='size')"


def _about_disturbances(plant: Plant, entries: list[Entry]) -> Iterator[str]:
    names = ", ".join(plant.disturbances)
    decoupling = [entry for entry in entries if entry.method.decouples and not entry.estimates]
    working = {entry.method.name for entry in decoupling if entry.works}
    if working == {"perfect_observer"}:
        yield f"disturbances ({names}): only perfect_observer decouples them, by differentiating the measurements"
    elif working:
        yield f"disturbances ({names}): prefer what decouples them; detection_filter and kalman_filter do not"
    tried = [entry for entry in decoupling if entry.works is False]
    if tried and not working:
        yield f"the disturbances ({names}) cannot be decoupled: {_shortened(tried[0].reason, 200)}"


def _listed(names: tuple[str, ...], most: int = 4) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _shortened(text: str, most: int = 150) -> str:
    return text if len(text) <= most else text[: most - 3].rsplit(" ", 1)[0] + " ..."
