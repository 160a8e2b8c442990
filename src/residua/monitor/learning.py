"""A monitor from fault-free recordings alone: a model, relations of channels, and a check on held-out rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.by_channel import ByChannel
from residua.decide.channel_relations import ChannelRelations, ChannelRelationsTest
from residua.decide.checks import check_rate
from residua.decide.held_out import HeldOut
from residua.decide.relations import FORMS
from residua.decide.test import Block
from residua.design import ResidualGenerator, kalman_filter
from residua.errors import DataError, ResiduaError, SettingError
from residua.identify.canonical_variates import canonical_variates
from residua.identify.channel_facts import exact_channels, guessed_inputs
from residua.identify.fit_report import FitReport
from residua.identify.identified_model import IdentifiedModel, with_channel_faults
from residua.identify.segments import Gathered, Names, gather
from residua.identify.subspace import subspace
from residua.monitor.monitor import Monitor
from residua.monitor.running import filter_block, initial_state
from residua.plant import Plant
from residua.progress import Progress
from residua.shown import Shown
from residua.visible import echo
from residua.words import listing, number

#: The innovation alone by the default test, and canonical variates by theirs: routes under the same check.
INNOVATION, VARIATES = "innovation", "variates"
#: In the order in which one is preferred to the next.
ROUTES = (*FORMS, INNOVATION, VARIATES)
#: Of each recording: where the model's part ends, and where the check begins.
_MODEL, _CHECK = 0.5, 0.75
#: Multiples of the rate asked on the check from which on a part's thresholds are raised, beyond which a form of
#: relations is left out, and beyond which the log does not hold all that is normal.
_RAISED_FROM, _LEFT_OUT_FROM, _NOT_NORMAL_FROM = 3.0, 5.0, 20.0
#: Share of the check in alarm from which on a log is refused as faulty.
_FAULTY_FROM = 0.5
#: By how much thresholds are raised above the largest statistic of the check.
_ABOVE = 1.05
#: Shares of the time in alarm that are as good as the best.
_AS_GOOD = 0.02
#: Complete rows below which a log is too short for a promise, and for anything; and the share of rows that is few.
_FEW, _TOO_FEW, _MOSTLY = 600, 300, 0.8
#: Faults that are put into the check, and how large in deviations of the channel.
_FAULTS = (
    ("offset", 1.0), ("offset", 3.0), ("offset", 5.0), ("stuck", 1.0), ("stuck", 3.0), ("frozen", 0.0), ("dead", 0.0),
    ("drift", 5.0), ("gain", 1.5),
)  # fmt: skip
#: Rows of the check that faults are put into, where in them these begin, and numbers that are held at once.
_ROWS, _BEGIN, _MOST = 3_000, 0.2, 4_000_000
#: Share of every output that a model explains one sample ahead below which it explains nothing.
_NOTHING = 1 / 10

Rows = NDArray[np.float64]


@dataclass(frozen=True)
class Tried:
    """Results of one route on the held-out rows.

    Attributes
    ----------
    form : str
        ``"static"``, ``"curve"``, ``"lags"``, ``"horizon"``, ``"innovation"`` or ``"variates"``.
    false_alarms : float
        Fraction of the rows held out that are in alarm, by channels where these are compared.
    seen : float
        Fraction of the time in alarm after a fault was put in, in the mean, with thresholds raised above all that these
        rows show without.
    failed : str
        Why it could not be made; empty as a rule.
    """

    form: str
    false_alarms: float = np.nan
    seen: float = np.nan
    failed: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Learnt(Shown):
    """A monitor learnt from fault-free recordings, and its check. Prints as a summary.

    Attributes
    ----------
    monitor : Monitor
    tried : tuple of Tried
    chosen : str
        The form of relations in use.
    report : FitReport or None
        Of the model; ``None`` where none could be made.
    inputs, outputs : tuple of str
    guessed : bool
        Whether inputs were guessed.
    notes : tuple of str
        Of the recordings.
    """

    monitor: Monitor
    tried: tuple[Tried, ...]
    chosen: str
    report: FitReport | None = field(repr=False)
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    guessed: bool
    notes: tuple[str, ...] = ()

    @property
    def cautions(self) -> tuple[str, ...]:
        """Reasons to doubt this monitor, repeated by every run."""
        check = self.monitor.fit_check
        return check.cautions if check else ()

    @property
    def lines(self) -> tuple[str, ...]:
        """The summary, line by line."""
        said = "guessed: they keep their values" if self.guessed and self.inputs else "guessed" * self.guessed
        out = [
            f"inputs: {', '.join(self.inputs) or 'none'}{f' ({said}; name them to be sure)' if said else ''}",
            f"outputs: {', '.join(self.outputs)}",
        ]
        for one in self.tried:
            mark = "  <- chosen" if one.form == self.chosen else ""
            alarms, seen = number(100 * one.false_alarms, 3), percent_of(one.seen)
            rated = f"{alarms} % of the rows held out in alarm, {seen} of them with a fault put in"
            out.append(f"{'relations, ' * (one.form in FORMS)}{one.form}: {one.failed or rated}{mark}")
        return tuple(out)

    def __str__(self) -> str:
        check = self.monitor.fit_check
        return "\n".join([*self.lines, *([str(check)] if check else []), *self.notes])


def percent_of(share: float) -> str:
    """Return a share in per cent."""
    return f"{100 * share:.0f} %"


def learn(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    dt: float | None = None,
    false_alarm_rate: float | None = None,
    form: str = "auto",
    sensor_faults: bool = True,
    actuator_faults: bool = True,
    force: bool = False,
    model: Mapping[str, Any] | None = None,
    progress: Progress | bool | None = None,
) -> Learnt:
    r"""Learn a monitor from fault-free recordings, without a model or an option.

    1. A plant is identified from the first half of each recording, and its Kalman filter designed.
    2. Relations between channels of four forms (:class:`residua.decide.ChannelRelations`) are fitted to the first three
       quarters, and judged by the last: by false alarms there, and by the share of the time in alarm after faults were
       put into those rows: offsets, stuck, frozen, dead and drifting sensors, gains. Two routes without relations go
       through the same check: the innovation alone by the default test, and
       :func:`residua.identify.canonical_variates`. Forms with more than five times the rate asked are left out, and
       these two with more than three times. Of the others the first in that order is taken that is within .02 of the
       best; relations also see the innovation, and come before it.
    3. All is fitted again to all rows. Thresholds that the check exceeds more than three times as often as requested
       are raised above all its values.

    Guaranteed: the answers are the same in all units. ``learnt.monitor.fit_check`` has the results of the check, and
    every diagnosis repeats the doubts.

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        Fault-free, as :func:`residua.identify.subspace` takes them.
    y : array_like, shape (time, outputs), optional
    inputs, outputs : sequence of str, optional
        Channels by name. Inputs drive the plant; when omitted, they are guessed: columns that hold their
        values over most rows, where others do not. ``[]`` for none.
    dt : float, optional
        Step in seconds of arrays.
    false_alarm_rate : float, optional
        Intended fraction of fault-free samples in alarm; one that the rows can support when omitted, 1e-3 at the
        rarest.
    form : {"auto", "static", "curve", "lags", "horizon", "innovation", "variates"}
    sensor_faults, actuator_faults : bool
        Whether faults of every output, and of every input that has an effect, can be named.
    force : bool
        Learn from a log that looks faulty, too, and return a monitor of which nothing can be expected.
    model : mapping of str to object, optional
        Options of :func:`residua.identify.subspace`. Where the order is not among them and the model has a pole of one
        or more, a stable one of a near order is taken if there is one.
    progress : callable, bool, optional
        Is called with (stage, done, total); a bar on a terminal when omitted.

    Returns
    -------
    Learnt

    Raises
    ------
    DataError
        If the rows are too few, the log looks faulty, or the monitor can see next to nothing, and ``force`` is not set.
    SettingError
        If an option has an invalid value.

    See Also
    --------
    residua.identify.subspace : the model alone.
    residua.RegimeMonitor : where operating modes differ.

    Notes
    -----
    Assumes: the recordings are fault-free and hold all that is normal: loads, seasons, modes. Nothing tells a state
    of the plant that they do not hold from a fault.

    References
    ----------
    Chiuso (2007), Automatica 43(6) (the model); Hoerl and Kennard (1970), Technometrics 12(1), 55-67 (relations).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> load = rng.standard_normal(4000)
    >>> for k in range(1, 4000):
    ...     load[k] = 0.95 * load[k - 1] + 0.3 * load[k]
    >>> log = np.column_stack([np.sin(load), 3 + 2 * load, load**2]) + 0.05 * rng.standard_normal((4000, 3))
    >>> learnt = rs.learn(log[:3000], inputs=[], outputs=["flow", "level", "power"])
    >>> learnt.chosen
    'curve'
    >>> new = log[3000:].copy()
    >>> new[500:, 2] += 1.5
    >>> learnt.monitor.run(None, new).named
    (('power sensor',),)
    """
    check_rate(false_alarm_rate)
    if form not in ("auto", *ROUTES):
        raise SettingError(f"form must be auto or one of {', '.join(ROUTES)}, got {echo(form)}")
    gathered, guessed = _with_inputs(recordings, y, inputs, outputs, dt)
    rows, m = gathered.whole(), len(gathered.inputs)
    complete = sum(int(np.isfinite(one).all(axis=1).sum()) for one in rows)
    first = [(one[: _at(one, _CHECK), :m], one[: _at(one, _CHECK), m:]) for one in rows]
    last = [one[_at(one, _CHECK) :] for one in rows]
    generator, report, cautions = _modelled(gathered, rows, first, model, progress, sensor_faults, actuator_faults)
    rate = ChannelRelations(false_alarm_rate=false_alarm_rate).asked(None, complete)  # pyright: ignore
    total = sum(map(len, rows))
    if complete < _MOSTLY * total:
        cautions.append(
            f"only {complete:,} of {total:,} rows are complete, and thresholds are from these: leave out channels that "
            "are rarely present"
        )
    if complete < _TOO_FEW and not force:
        raise DataError(
            f"{complete:,} complete rows are too few to learn from, {_TOO_FEW} at least: give longer recordings, or "
            "force=True"
        )
    if complete < _FEW:
        cautions.append(f"{complete:,} complete rows are few: {_FEW} at least for thresholds that hold")
    routes = _Routes(generator, gathered, rate)
    tried, factors = [], {}
    for one in ROUTES if form == "auto" else (form,):
        found, factors[one] = _try(one, routes, first, last)
        tried.append(found)
    chosen = _choose(tried, rate)
    raised, alarmed = factors[chosen]
    monitor = routes.monitor(chosen, [(one[:, :m], one[:, m:]) for one in rows], _MODEL, raised)
    picked = next(one for one in tried if one.form == chosen)
    if picked.false_alarms > _FAULTY_FROM and not force:
        raise DataError(
            f"this does not look like a fault-free log: its last quarter is {percent_of(picked.false_alarms)} in alarm "
            "by what came before; leave the faulty rows out; where all rows are normal, learn from a longer log, or "
            "from several, or give force=True"
        )
    if picked.false_alarms > _NOT_NORMAL_FROM * rate:
        cautions.insert(0, (
            f"the log does not cover normal operation: its last quarter is {percent_of(picked.false_alarms)} in alarm "
            "by what came before, and thresholds were raised above it; learn from a longer log, or from several"
        ))  # fmt: skip
    check = monitor.fit_check
    assert check is not None
    check = replace(check, held_out=alarmed, cautions=tuple(cautions))
    monitor._check = check
    blind = check.sees_nothing
    if blind and not force:
        raise DataError("; ".join([*cautions, blind, "use force=True to make the monitor anyway"]))
    return Learnt(
        monitor,
        tuple(tried),
        chosen,
        report,
        gathered.inputs,
        gathered.outputs,
        guessed,
        gathered.notes,
    )


def _at(rows: Rows, share: float) -> int:
    return int(np.ceil(share * len(rows)))


def _with_inputs(recordings: Any, y: Any, inputs: Names, outputs: Names, dt: float | None) -> tuple[Gathered, bool]:
    """Return the recordings with their inputs, and a flag for guessed ones."""
    gathered = gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt)
    if inputs is not None or gathered.inputs:
        return gathered, False
    rows = gathered.whole()
    found = guessed_inputs(rows, gathered.channels)
    if y is not None or not found:
        exact = exact_channels(rows, gathered.channels) if y is None else ()
        if exact:
            raise DataError(
                f"{listing(map(repr, exact))} follow from one another exactly, as the commands of a controller do from "
                "what it measures: name the columns that drive the plant, inputs=[...]"
            )
        return gathered, y is None
    rest = tuple(name for name in gathered.outputs if name not in found)
    return replace(gather(recordings, y, inputs=found, outputs=rest, dt=dt), notes=gathered.notes), True


def _stable_model(parts: Any, names: Mapping[str, Any], options: dict[str, Any]) -> IdentifiedModel:
    """Return a stable model of recordings, of a near order if the order chosen from the data is unstable."""
    try:
        made = subspace(parts, **names, **options)
        radius, order = float(np.abs(made.report.poles).max(initial=0.0)), len(made.report.poles)
        if radius < 1 or options.get("order", "auto") != "auto":
            return made
        for other in (order - 1, order - 2, order + 1):
            if other > 0:
                again = subspace(parts, **names, **(options | {"order": other, "max_order": None}))
                if np.abs(again.report.poles).max(initial=0.0) < 1:
                    return again
    except TypeError as error:
        raise SettingError(f"model: {error}; give options of residua.identify.subspace") from error
    return made


def _modelled(
    gathered: Gathered,
    rows: Sequence[Rows],
    parts: Sequence[tuple[Rows, Rows]],
    options: Mapping[str, Any] | None,
    progress: Progress | bool | None,
    sensors: bool,
    actuators: bool,
) -> tuple[ResidualGenerator, FitReport | None, list[str]]:
    """Return the Kalman filter of a model of the first half, its report, and cautions about it."""
    m, cautions = len(gathered.inputs), []
    names = {"inputs": gathered.inputs, "outputs": gathered.outputs, "dt": gathered.dt}
    made = _stable_model(parts, names | {"held_out": 1 - _MODEL / _CHECK, "progress": progress}, dict(options or {}))
    try:
        design = kalman_filter(with_channel_faults(made.plant, sensors=sensors, actuators=actuators))
    except ResiduaError as error:
        cautions.append(f"no model could be made ({error}): channels are compared only with each other")
        middle, spread = np.nanmean(np.vstack(rows), axis=0), np.nanvar(np.vstack(rows)[:, m:], axis=0)
        plant = Plant(
            np.zeros((0, 0)), np.zeros((0, m)), np.zeros((len(gathered.outputs), 0)), **names, name="no model"
        )  # fmt: skip
        plant = plant.with_operating_point(inputs=middle[:m], outputs=middle[m:])
        plant = plant.with_noise(measurement=np.where(spread > 0, spread, 1.0))
        return kalman_filter(with_channel_faults(plant, sensors=sensors, actuators=actuators)), None, cautions
    report = made.report
    radius = float(np.abs(report.poles).max(initial=0.0))
    if radius >= 1:
        cautions.append(
            f"the model has a pole of size {radius:.4g}: the plant drifts, was held by a controller, or the order is "
            "wrong; try another, order=..."
        )
    if np.nanmax(report.checked.fit) < _NOTHING:
        most = number(100 * max(0.0, float(np.nanmax(report.checked.fit))), 2)
        cautions.append(
            f"the model explains {most} % of its outputs at most, one sample ahead: only relations of channels tell "
            "anything"
        )
    return design, report, cautions


@dataclass(frozen=True, eq=False)
class _Routes:
    """Routes to a fitted monitor."""

    generator: ResidualGenerator
    gathered: Gathered
    rate: float

    @property
    def inputs(self) -> int:
        """Number of channels that are inputs: the first ones."""
        return len(self.gathered.inputs)

    def monitor(
        self, route: str, parts: Sequence[tuple[Rows, Rows]], unseen: float, raised: Mapping[str, float]
    ) -> Monitor:
        """Return a monitor of recordings, the first part of which the model was identified from."""
        fitting: dict[str, Any] = {"dt": self.gathered.dt, "false_alarm_rate": self.rate, "held_out": 0.0}
        if route in FORMS:
            test = ChannelRelations(route, self.rate, unseen, raised)  # pyright: ignore[reportArgumentType]
            return Monitor(self.generator, test=test, isolate=ByChannel() if self.generator.faults else None).fit(
                list(parts), **fitting
            )
        rest = [tuple(one[_at(one, unseen) :] for one in pair) for pair in parts]
        if route == INNOVATION:
            return Monitor(self.generator).fit(rest, **fitting)
        names = {"inputs": self.gathered.inputs, "outputs": self.gathered.outputs, "dt": self.gathered.dt}
        made = canonical_variates([tuple(one[: _at(one, unseen)] for one in pair) for pair in parts], **names)
        return Monitor(made).fit(rest, **fitting)

    def statistics(self, monitor: Monitor, data: Rows) -> Rows:
        """Return the statistic of each part in thresholds, (plants, time, parts), from a fresh start."""
        monitor.reset()
        decided = monitor.update(data[..., : self.inputs], data[..., self.inputs :])
        limits = monitor.norm_test.part_thresholds
        if len(limits):
            return decided.member_statistics / limits
        return decided.statistic[..., None] / monitor.threshold

    def by_channels(self, monitor: Monitor, data: Rows) -> Rows:
        """Return the statistics of the channels alone, if these are compared; the bank of means is slow."""
        test = monitor.norm_test
        if not isinstance(test, ChannelRelationsTest):
            return self.statistics(monitor, data)
        spec = monitor._specification()
        filtered = filter_block(spec, initial_state(spec, len(data)).filter, data)[1]
        block = Block(filtered.residuals, filtered.usable, signals=filtered.signals)
        return test.of_channels(test.start(len(data)), block)[1]


def _try(
    route: str, routes: _Routes, first: Sequence[tuple[Rows, Rows]], last: Sequence[Rows]
) -> tuple[Tried, tuple[dict[str, float], HeldOut]]:
    """Return the results of one route on the held-out rows, the factors that these require, and all alarms there."""
    rate = routes.rate
    try:
        monitor = routes.monitor(route, first, _MODEL / _CHECK, {})
    except DataError as error:
        return Tried(route, failed=str(error)), ({}, HeldOut(0, 0, 0.0, rate))
    names = monitor.norm_test.part_names
    every = np.concatenate([routes.statistics(monitor, one[None])[0] for one in last])
    known = np.isfinite(every)
    over = known & (np.where(known, every, 0.0) > 1)
    judged = max(1, int(known.any(axis=1).sum()))
    largest = np.where(known, every, 0.0).max(axis=0, initial=0.0)
    limits = np.where(largest > 1, _ABOVE * largest, 1.0)
    raised = {
        name: float(factor)
        for name, factor, often in zip(names, limits, over.sum(axis=0) / judged, strict=False)
        if factor > 1 and often > _RAISED_FROM * rate / 2
    }
    held = HeldOut(judged, int(over.any(axis=1).sum()), float(judged), rate)
    own = slice(1, None) if route in FORMS else slice(None)  # channels, without the model
    share = _seen(routes, monitor, max(last, key=len)[:_ROWS], limits[own])
    return Tried(route, float(over[:, own].any(axis=1).sum() / judged), share), (raised, held)


def _seen(routes: _Routes, monitor: Monitor, rows: Rows, limits: NDArray[np.float64]) -> float:
    """Return the mean share of the time in alarm after faults were injected into rows."""
    begin, spread = int(_BEGIN * len(rows)), np.nanstd(rows, axis=0)
    if len(rows) - begin < 2:
        return 0.0
    cases = [(j, *fault) for j in range(rows.shape[1]) if spread[j] > 0 for fault in _FAULTS]
    at_once = max(1, _MOST // rows.size)
    shares = []
    for start in range(0, len(cases), at_once):
        faulty = np.stack([with_channel_fault(rows, *case, begin) for case in cases[start : start + at_once]])
        every = routes.by_channels(monitor, faulty)[:, begin:]
        known = np.isfinite(every)
        over = (np.where(known, every, 0.0) > limits).any(axis=2)
        shares += (over.sum(axis=1) / np.maximum(known.any(axis=2).sum(axis=1), 1)).tolist()
    return float(np.mean(shares)) if shares else 0.0


def with_channel_fault(rows: Rows, column: int, kind: str, size: float, begin: int) -> Rows:
    """Return rows with one channel falsified from a row on.

    Parameters
    ----------
    rows : ndarray, shape (time, channels)
    column : int
    kind : {"offset", "stuck", "frozen", "dead", "drift", "gain"}
    size : float
        In deviations of the channel; of a gain the factor.
    begin : int
    """
    out, values = rows.copy(), rows[begin:, column]
    middle, spread = float(np.nanmean(rows[:, column])), float(np.nanstd(rows[:, column]))
    count = len(values)
    if kind == "offset":
        changed = values + size * spread
    elif kind == "stuck":
        changed = np.full(count, middle + size * spread)
    elif kind == "frozen":
        changed = np.full(count, values[np.isfinite(values)][0] if np.isfinite(values).any() else middle)
    elif kind == "dead":
        changed = middle + spread / 100 * np.random.default_rng(column).standard_normal(count)
    elif kind == "drift":
        changed = values + size * spread * np.arange(count) / max(count - 1, 1)
    else:
        changed = middle + size * (values - middle)
    out[begin:, column] = np.where(np.isfinite(values), changed, np.nan)
    return out


def _choose(tried: Sequence[Tried], rate: float) -> str:
    """Return the route to use: the first good one, or that with the fewest false alarms if none is good.

    A monitor with relations also sees the innovation.
    """
    made = [one for one in tried if not one.failed]
    if not made:
        raise DataError(f"nothing was learnt: {tried[0].failed}")
    forms = [one for one in made if one.form in FORMS and one.false_alarms <= _LEFT_OUT_FROM * rate]
    others = [one for one in made if one.form not in FORMS and one.false_alarms <= _RAISED_FROM * rate]
    if not forms and not others:
        raisable = [one for one in made if one.form in FORMS] or made
        return min(raisable, key=lambda one: one.false_alarms).form
    beside = max((one.seen for one in others if one.form == INNOVATION), default=0.0) if forms else 0.0
    best = max(one.seen for one in (*forms, *others))
    if forms and max(beside, *(one.seen for one in forms)) >= best - _AS_GOOD:
        others, best = [], max(one.seen for one in forms)
    return next(one.form for one in (*forms, *others) if one.seen >= best - _AS_GOOD)


__all__ = ["Learnt", "Tried", "learn"]
