"""The choice of a design function for a plant: by the faults that each design sees in the noise of the plant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from residua.analysis.diagnosability import Diagnosability, diagnosability
from residua.design.banks.bank import Bank
from residua.design.banks.matched_filters import MatchedFilters
from residua.design.catalogue import methods
from residua.design.core.decoupling import reached_inputs
from residua.design.core.generator import PartialDesign, ResidualGenerator, as_generator, for_monitor
from residua.design.core.method import Chosen, Method, check_design
from residua.design.estimation.fault_estimator import FaultEstimator
from residua.design.lasting_faults import LastingFaults, lasting_faults
from residua.design.ranking import FIRST, UNSEEN, Entry, by_faults, by_state, few, gives, never_first, typed
from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.plant import Identification, InputOutputModel, Plant
from residua.plant.assumed_noise import MEASUREMENT, PROCESS, lasting_gains, sensible_step
from residua.plant.balanced import is_singular
from residua.progress import TimeUsedUpError, check_time, time_limit
from residua.robust.sets.uncertain_plant import UncertainPlant
from residua.shown import Bar, Shown, notes, table
from residua.tolerances import LEAK
from residua.words import counted, listing

WANTS = ("name", "size", "state")
#: Larger plants are tried with single filters only, and the largest not at all.
LARGE, LARGEST, MOST_FAULTS = 60, 200, 16
#: Residuals from which on groups of them are advised.
_MANY = 10
#: Seconds for the choice of a coding set; the search then takes the best one so far.
_CHOICE_TIME = 5.0


@dataclass(frozen=True, eq=False, repr=False)
class Suggestion(Shown):
    """Design functions for a plant, the best first. Prints as a table.

    Attributes
    ----------
    plant : Plant
    want : {"name", "size", "state"}
        What they are ranked by.
    entries : tuple of Entry
        All that was considered: what works, from the best down, what is left out last; then what was refused, then
        what was not tried.
    notes : tuple of str
        What can be said about the plant at all, and what to mind.
    deviations : mapping of str to float
        For each fault the size that moves an output by one deviation of its noise in the end.
    """

    plant: Plant
    want: str
    entries: tuple[Entry, ...]
    notes: tuple[str, ...]
    deviations: Mapping[str, float] = field(default_factory=dict, repr=False)

    @property
    def best(self) -> Entry | None:
        """The first entry that gives what is wanted; ``None`` when none does."""
        return next((one for one in self.entries if one.works and not one.left_out and gives(one, self.want)), None)

    def _headline(self) -> str:
        best, works = self.best, sum(one.works is True for one in self.entries)
        first = best.call if best else "nothing that was tried"
        return f"{self.plant.name}: first for the {self.want}: {first}; {works} of {len(self.entries)} designs work"

    def _parts(self) -> list[str]:
        best, states = self.best, {True: "works", False: "refused", None: "not tried"}
        sizes = dict(best.sizes) if best else {}
        scaled = {name: size / self.deviations.get(name, np.nan) for name, size in sizes.items()}
        largest = max((one for one in scaled.values() if one < UNSEEN), default=1.0)
        bars = [(name, Bar(one / largest, self._size(name, sizes[name]))) for name, one in scaled.items()]
        rows = [
            (one.label, "left out" if one.left_out else states[one.works], self._numbers(one))
            + (one.left_out or one.reason,)
            for one in self.entries
        ]
        return [
            table(["fault", "smallest size that the first sees (in deviations of the noise)"], bars),
            table(["design", "", "sizes seen, in deviations", "remark"], rows),
            notes(self.notes),
        ]

    def __str__(self) -> str:
        wanted = {"name": "the name of the fault", "size": "the size of the fault", "state": "the state"}[self.want]
        best, lines = self.best, [f"{self.plant.name}: what to call for {wanted}"]
        lines.append(f"  first: {best.call}" if best else "  nothing that was tried gives it")
        if best and best.sizes:
            lines.append(f"  seen as long as it lasts (in brackets, by deviations of the noise): {self.seen_by(best)}")
        lines += [f"note: {note}" for note in self.notes]
        groups = {
            "works": [one for one in self.entries if one.works and not one.left_out],
            "left out": [one for one in self.entries if one.works and one.left_out],
            "refused": [one for one in self.entries if one.works is False],
            "not tried": [one for one in self.entries if one.works is None],
        }
        for title, group in groups.items():
            if group:
                lines.append(f"{title}:")
                width = min(max(len(one.label) for one in group), 48)
                for one in group:
                    remarks = "; ".join(part for part in (one.left_out, self._numbers(one), one.reason) if part)
                    lines.append(f"  {one.label:<{width}}  {_shortened(remarks)}")
        return "\n".join(lines)

    def seen_by(self, entry: Entry) -> str:
        """Return the sizes that a design sees, each in the unit of its fault and in deviations of the noise."""
        sizes = [f"{name} {self._size(name, size)}" for name, size in entry.sizes.items()]
        more = f" and {len(sizes) - _LISTED} more" if len(sizes) > _LISTED else ""
        return f"{', '.join(sizes[:_LISTED])}{more}"

    def _size(self, fault: str, size: float) -> str:
        if not np.isfinite(size):
            return "not seen"
        one, deviation = self.plant.fault_list[self.plant.faults.index(fault)], self.deviations.get(fault, np.nan)
        unit = one.unit or ("" if one.kind == "component" else self.plant.units.get(one.component, ""))
        beside = f" ({size / deviation:.1f})" if np.isfinite(deviation) else ""
        return f"{size:.3g}{f' {unit}' if unit else ''}{beside}"

    def _numbers(self, entry: Entry) -> str:
        """Return the same sizes in deviations alone, in the order of the faults."""
        scaled = [size / self.deviations.get(name, np.nan) for name, size in entry.sizes.items()]
        more = f" and {len(scaled) - _LISTED} more" if len(scaled) > _LISTED else ""
        return ", ".join(f"{one:.1f}" if one < UNSEEN else "unseen" for one in scaled[:_LISTED]) + more


#: Faults whose sizes are printed.
_LISTED = 8


def suggest(plant: Plant, *, want: str | None = None, seconds: float = 30.0) -> Suggestion:
    r"""Suggest a design function for a plant, by the faults that each design sees in the noise of the plant.

    Guaranteed: what is said to work has been designed and has passed its own checks (``entry.made``); what is said to
    be refused has been refused, for the reason that stands beside it.

    For the name of a fault the innovations of a Kalman filter come first; where there are unknown disturbances, or no
    such filter, the residual that ignores them, with the gain of its own Kalman filter. Another design comes before
    them only where the faults that it sees are 1.25 times smaller (their geometric mean) and its names no worse.

    Parameters
    ----------
    plant : Plant
        With everything that is known of it: faults, disturbances, noise.
    want : {"name", "size", "state"}, optional
        What to rank by: which fault it is, how large it is, or the state. When omitted, the name if the plant has
        faults, else the state.
    seconds : float
        After that much time what is being tried is stopped, and nothing more is tried; what may come first is tried
        first. Plants of more than 60 states are tried with single filters only, those of more than 200 not at all.

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
    The sizes are foretold, not simulated: those of constant faults that put the whitened norm of sums of 127 samples
    over its threshold for 95 % of the time, with one false alarm in 1,000 samples, times 1.25, as simulations show.
    A continuous plant is taken to be sampled ten times in the time constant of its mean rate. One
    that has no noise gets what :meth:`residua.Plant.with_assumed_noise` assumes.

    Never first, though it works: what a disturbance reaches, what settles in more than 500 samples, what leaves a
    fault unseen that another design sees, and banks and moving averages, which miss faults that a Kalman filter sees.
    For sizes: matched filters, whose faults are steps, else an estimator that settles. For the state, what filters
    noise comes before what does not, and what converges before what differentiates.

    What a method raises that is no error of the package passes.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1)
    >>> answer = rs.suggest(plant)
    >>> answer.best.call
    'rs.design.kalman_filter(plant)'
    >>> print(answer.seen_by(answer.best))  # in brackets: by deviations of the noise of an output
    p1 0.0646 (0.7), p2 0.049 (1.9), y1 sensor 0.237 (0.8), y2 sensor 0.619 (2.0)
    >>> rs.suggest(plant, want="size").best.call
    'rs.design.matched_filters(plant)'
    """
    return _suggested(plant, want, seconds, everything=True)


def first_design(plant: Plant, *, seconds: float = 30.0) -> Suggestion:
    """Return the same answer from those designs alone that may come first, which takes less time.

    Parameters
    ----------
    plant : Plant
    seconds : float

    Returns
    -------
    Suggestion
    """
    return _suggested(plant, None, seconds, everything=False)


def _suggested(plant: Plant, want: str | None, seconds: float, *, everything: bool) -> Suggestion:
    if not isinstance(plant, Plant):
        raise ModelError(_no_plant(plant))
    want = ("name" if plant.faults else "state") if want is None else want
    if want not in WANTS:
        raise SettingError(f"want must be one of {', '.join(WANTS)}, got {want!r}")
    if want != "state" and not plant.faults:
        raise SettingError(
            "the plant has no faults: name what may fail with with_sensor_faults, with_actuator_faults or with_faults"
        )
    if not (np.isfinite(seconds) and seconds >= 0):
        raise SettingError(f"seconds must be a number of at least zero, got {seconds}")
    watched, assumed, known, deviations = plant, "", None, {}
    with time_limit(seconds):
        try:
            if want != "state" and plant.n_states <= LARGEST:
                watched, assumed = _with_noise(plant)
                deviations = _deviations(watched)
            known = diagnosability(plant) if plant.faults and plant.n_states <= LARGEST else None
        except TimeUsedUpError:
            pass
        chosen: dict[Chosen, Any] = {}
        tried = [
            _tried(one, watched, want, chosen)
            for one in sorted(
                _untried(watched, known, watched is not plant),
                key=lambda one: _rank_of_trial(one.method, want),  # as they come among equals
            )
            if (everything and want != "size") or not _rank_of_trial(one.method, want)[0]
        ]
    entries = by_state(tried, plant) if want == "state" else by_faults(tried, deviations, want)
    notes = [assumed] if assumed else []
    if any(one.sizes for one in entries):
        notes.append(
            "seen: in alarm for 95 % of the time, as foretold for sums of 127 samples with one false alarm in 1,000 "
            "samples; deviations: how far it moves an output in the end, in standard deviations of its noise"
        )
        if not plant.is_discrete:
            step = f"{sensible_step(plant):.3g} s"
            notes.append(f"sizes are for a sample each {step}; for another step: suggest(plant.discretize(dt))")
    return Suggestion(plant, want, tuple(entries), (*notes, *_notes(plant, known, entries)), deviations)


def _no_plant(value: object) -> str:
    """Return the advice for a value that is no plant."""
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


def _with_noise(plant: Plant) -> tuple[Plant, str]:
    """Return a plant with noise, and the assumption behind the noise of one without."""
    if plant.noises:
        return plant, ""
    try:
        noisy = plant.with_assumed_noise()
    except ModelError as error:
        return plant, f"no noise is given and none can be assumed ({error}), so that no sizes are foretold"
    return noisy, (
        f"no noise is given: sizes assume {100 * MEASUREMENT:g} % of the steady gain of each output in its measurement "
        f"and {100 * PROCESS:g} % of that of each state in a step; give what is known with plant.with_noise(...)"
    )


def _deviations(plant: Plant) -> dict[str, float]:
    """Return for each fault the size that moves an output by one deviation of its noise in the end."""
    dt = sensible_step(plant)
    spread = np.sqrt(np.diag(plant.measurement_noise) / (1.0 if plant.is_discrete else dt))
    noisy = spread > 0
    moved = (lasting_gains(plant, "fault")[1][noisy] / spread[noisy, None]).max(axis=0, initial=0.0)
    return {name: 1 / float(one) if one > 0 else np.nan for name, one in zip(plant.faults, moved, strict=True)}


# -------------------------------------------------------------------------- trying


def _untried(plant: Plant, known: Diagnosability | None, assumed: bool) -> Iterator[Entry]:
    """Yield the calls that could serve, the more usual first, with why they make no sense where they make none."""
    for one in methods():
        asked = {option.name for option in one.options if option.required} - set(one.chosen)
        if one.takes_a_plant and not asked:
            why = one.missing(plant, known) or _too_much(one, plant)
            for options in map(dict, tuple(one.calls(plant, known)) or ({},)):
                arguments = ["plant.with_assumed_noise()" if assumed else "plant"]
                arguments += [chosen.code for chosen in one.chosen.values()]
                arguments += [f"{name}={typed(value)}" for name, value in options.items()]
                yield Entry(f"{one.called}({', '.join(arguments)})", one, None, why, options=dict(options))


def _tried(entry: Entry, plant: Plant, want: str, chosen: dict[Chosen, Any]) -> Entry:
    """Return the entry of a call that was made; ``chosen`` keeps the arguments that calls share."""
    if entry.reason:
        return entry
    try:
        check_time()
        arguments = entry.method.with_chosen(plant, entry.options, chosen, _CHOICE_TIME)
        design = entry.method.function(plant, **arguments)
        check_design(entry.method, design)
        return _completed(entry, design, plant, want)
    except TimeUsedUpError:
        return replace(entry, reason="the time is used up: suggest(plant, seconds=...)")
    except (DesignError, AccuracyError, ModelError) as error:
        return replace(entry, works=False, reason=str(error))


def _too_much(record: Method, plant: Plant) -> str:
    n = plant.n_states
    if n > LARGEST:
        return f"{n} states are more than the {LARGEST} that are tried here; call it, it may take minutes"
    if record.many and n > LARGE:
        return f"{n} states are more than the {LARGE} for which banks and estimators are tried here"
    if record.many and (record.faults or record.size) and len(plant.faults) > MOST_FAULTS:
        return f"{len(plant.faults)} faults are more than the {MOST_FAULTS} for which banks are tried here"
    return ""


def _completed(entry: Entry, design: Any, plant: Plant, want: str) -> Entry:
    """Return the entry of a design that works: its names and sizes of faults, and the disturbances in it."""
    record = entry.method
    entry = replace(entry, works=True, made=design)
    if isinstance(design, Mapping):
        left_out = design.failures if isinstance(design, PartialDesign) else ()
        missing = f"; none for {few(tuple(left_out))}" if left_out else ""
        reason = f"{record.state}: {few(tuple(design)) if design else 'none'}{missing}"
        return replace(entry, reason=reason, order=sum(_order(part) for part in design.values()))
    blind = ""
    try:
        generator = as_generator(for_monitor(design))
    except (DesignError, AccuracyError, ModelError) as error:
        generator, blind = None, f"no residual: {error}"
    entry = replace(entry, order=_order(generator or design), blind=blind)
    if generator is not None:
        if plant.disturbances:
            maps = generator.state_map, generator.static_map
            leaks = reached_inputs(generator.system, generator.plant, *maps)[len(plant.inputs) :]
            reached = tuple(np.array(plant.disturbances)[leaks > LEAK].tolist())
            entry = replace(entry, reached_by=reached)
        if plant.noises and plant.faults and want != "state":
            try:
                entry = replace(entry, foretold=lasting_faults(generator, sensible_step(plant)))
            except (DesignError, AccuracyError, ModelError) as error:
                entry = replace(entry, reason=f"no sizes foretold: {error}")
    names, estimates, parts = _names(design, entry.foretold)
    if record.state and want == "state":
        parts.append(record.state)
    if names:
        parts.append(f"names {few(names)}")
    elif plant.faults and generator is not None and want != "state":
        parts.append("names no fault")
    if generator is None:
        parts.append(blind)
    parts.append(f"order {entry.order}")
    reason = "; ".join(part for part in (entry.reason, *parts) if part)
    return replace(entry, reason=reason, names=names, estimates=estimates)


def _names(design: Any, foretold: LastingFaults | None) -> tuple[tuple[str, ...], tuple[str, ...], list[str]]:
    """Return the faults that a design names, those whose size it estimates, and remarks."""
    if isinstance(design, FaultEstimator):
        late = ", ".join(f"{name} {lag:.3g} s late" for name, lag in design.lag.items() if lag)
        return design.faults, design.faults, [f"estimates {few(design.faults)}", late]
    if isinstance(design, MatchedFilters):
        seen = tuple(name for name in design.faults if name not in design.unseen)
        arrival = f"arrival, up to {design.window} samples ago, and size of a step"
        return _alone(design.groups), seen, [arrival]
    if isinstance(design, Bank):
        return _alone(design.groups), (), [counted(len(design.members), "member")]
    if foretold is None:
        return (), (), []
    return tuple(name for name, size in foretold.named.items() if np.isfinite(size)), (), []


def _alone(groups: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the faults that are in no group with another."""
    return tuple(group[0] for group in groups if len(group) == 1)


def _order(design: Any) -> int:
    """Return the number of states of a design, or of the observer in it."""
    return (design if hasattr(design, "system") else design.observer).system.n_states


# ------------------------------------------------------------------------- ranking


def _rank_of_trial(record: Method, want: str) -> tuple[bool, ...]:
    """Return the key for the order of trials: candidates for the first place first, then the fast ones."""
    if want == "state":
        return not record.state, record.many
    if want == "size":
        return not record.size, record.many
    return never_first(record), record.name not in FIRST, record.many, record.noise == "moving average"


# ------------------------------------------------------------------------- telling


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
    most = max((entry.made.n_residuals for entry in entries if isinstance(entry.made, ResidualGenerator)), default=0)
    if most >= _MANY:
        yield (
            f"one norm over {most} residuals hides a fault that few of them show: test them by themselves, with "
            "rs.Monitor(..., test=rs.decide.NormThreshold(groups='each')), or in groups that belong together"
        )
    banks = [entry.made for entry in entries if isinstance(entry.made, Bank)]
    if any(bank.strongly_isolating for bank in banks):
        yield "faults that come together: a dedicated bank or a fault_estimator; a generalized bank names one at a time"


def _about_identification(plant: Plant, found: Identification) -> Iterator[str]:
    """Yield the open questions of a plant from recordings, and remedies for errors of the model."""
    yield f"the plant was {found}, not given: fit the monitor on recordings, which shows what its errors let through"
    if found.coloured:
        order = max(2, -(-plant.n_states // plant.n_outputs))
        yield (
            f"the prediction errors of {listing(found.coloured)} are correlated in time: the plant misses dynamics "
            "there, and tests that take the residual as white are wrong. Try a higher order first; else prefer what "
            "is insensitive to errors of the model: uncertain = model.uncertain_plant(plant); "
            f"rs.design.multi_model_parity([plant, *uncertain.sample(0, 20)], order={order}, noise=True)"
        )
    driven = {
        fault.name
        for fault in plant.fault_list
        if fault.kind == "actuator"
        and (
            fault.component in found.weak_inputs or any(fault.component == given for _, given in found.uncertain_gains)
        )
    }
    if driven:
        yield (
            f"the recordings hardly say how {listing(sorted(driven))} would act: their names and sizes rest on gains "
            "that the data leave open. Move their inputs in a recording, or fit the equations: rs.identify.grey_box"
        )


def _about_disturbances(plant: Plant, entries: list[Entry]) -> Iterator[str]:
    names = ", ".join(plant.disturbances)
    decoupling = [entry for entry in entries if entry.method.decouples and not entry.estimates]
    silent = [entry for entry in decoupling if entry.works is False or (plant.faults and entry.blind)]
    working = {entry.method.name for entry in decoupling if entry.works and not entry.reached_by} - {
        entry.method.name for entry in silent
    }
    if working == {"perfect_observer"}:
        yield f"disturbances ({names}): only perfect_observer decouples them, by differentiating the measurements"
    if silent and not working:
        why = _shortened(silent[0].blind or silent[0].reason, 200)
        yield (
            f"the disturbances ({names}) cannot be decoupled: {why}; what is left is to give them as process noise: "
            "plant.without_disturbances().with_noise(...)"
        )


def _shortened(text: str, most: int = 150) -> str:
    return text if len(text) <= most else text[: most - 3].rsplit(" ", 1)[0] + " ..."
