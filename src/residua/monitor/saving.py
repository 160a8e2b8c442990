"""Monitors as JSON: every float to its last bit, a schema version, a checksum, nothing executed.

What runs is stored as it ran, the sampled filter, the threshold test and the signatures included, so that a
monitor goes on with the same bits on a machine whose linear algebra rounds differently.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import IsolationSettings
from residua.decide.kinds import read_isolation, read_test, settings_out
from residua.decide.learnt_faults import LearntFault
from residua.decide.member_bounds import bounds_in
from residua.decide.test import TestSettings
from residua.design import ResidualGenerator
from residua.errors import FileFormatError, ResiduaError
from residua.files import other_version, read_bytes, write_text
from residua.json_files import CHECKSUM, check_checksum, dumps, loads
from residua.monitor.design_records import generator_in, generator_out, sampled_in, sampled_out
from residua.monitor.fit_check import FitCheck
from residua.monitor.monitor import Monitor
from residua.monitor.plausible_values import Plausible
from residua.monitor.running import State, initial_state
from residua.monitor.specification import Specification
from residua.monitor.start_estimate import MOST_SAMPLES, StartFit
from residua.number_kinds import ANY, ENTRY, INDEX, POSITIVE
from residua.records import (
    RecordOf,
    array_in,
    array_out,
    float_in,
    float_out,
    joined,
    list_in,
    record,
    state_in,
    table_in,
    text_in,
    texts_in,
    values_in,
    values_out,
    whole_in,
)
from residua.visible import shortened

FORMAT, VERSION = "residua-monitor", 1
#: That of monitors by operating mode, of which each holds several.
REGIMES = "residua-regime-monitor"

#: Caution in every diagnosis of a monitor whose file was edited: only its author can know whether it still holds.
EDITED = "the file of this monitor was edited after it was saved: its numbers are not those of the design"

#: Relative accuracy of values computed from the design before the first sample.
_EXACT = 1e-6
#: What a damaged or invented file may raise where it is read.
_ERRORS = (TypeError, ValueError, AttributeError, LookupError, ArithmeticError, MemoryError, ResiduaError)

_ENTRIES = (
    *("format", "version", "design", "sampled", "test", "certified", "bounds", "isolate", "settle", "max_hold"),
    *("plausible", "start", "notes", "fitted", "fit_check", "normal", "learnt", "running", "state"),
    CHECKSUM,
)


def save_monitor(monitor: Monitor, path: str | Path) -> None:
    """Write a monitor with its thresholds and running state; the file appears whole or not at all."""
    write_text(path, dumps(monitor_out(monitor)))


def monitor_out(monitor: Monitor) -> dict[str, Any]:
    """Return a monitor as a record."""
    generator, test = monitor._generator, monitor._test
    spec = None if test is None or generator is None else monitor._plain_specification()
    return {
        "format": FORMAT,
        "version": VERSION,
        "design": generator_out(monitor.design),
        "sampled": None if generator is None or generator is monitor.design else sampled_out(generator),
        "test": settings_out(monitor.test),
        "certified": {name: float_out(value) for name, value in monitor._certified.items()},
        "bounds": {name: values_out(one) for name, one in monitor._bounds.items()},
        "isolate": None if monitor.isolate is None else settings_out(monitor.isolate),
        "settle": monitor.settle,
        "max_hold": monitor.max_hold,
        "plausible": _plausible_out(monitor.plausible),
        "start": monitor.start,
        "notes": list(monitor.notes),
        "fitted": None if test is None else test.to_record(),
        "fit_check": None if monitor._check is None else values_out(monitor._check),
        "normal": None if monitor._normal is None else array_out(monitor._normal),
        "learnt": [values_out(fault) for fault in monitor._learnt],
        "running": None if spec is None else values_out(_Running.of(spec)) | {"isolation": spec.isolation.to_record()},
        "state": None if monitor._state is None else values_out(monitor._state),
    }


def load_monitor(path: str | Path) -> Monitor:
    """Read a monitor; :class:`FileFormatError` names the wrong entry.

    Every number must be valid (:class:`residua.records.Record`), the parts must fit together, and the
    content must be what was saved, by its checksum. With ``"checksum": null`` in the file, which says that it was
    edited, the monitor is as the file says, and its notes say that.
    """
    path = Path(path)
    if path.suffix.lower() == ".toml":
        raise FileFormatError(f"{path.name} looks like a plant file: design a monitor from it first (residua design)")
    content = loads(read_bytes(path, "monitor"), path.name)
    monitor = monitor_from(content, path.name)
    if not check_checksum(content, path.name) and EDITED not in monitor.notes:
        monitor.notes = (*monitor.notes, EDITED)
    return monitor


def monitor_from(content: Mapping[str, Any], source: str) -> Monitor:
    """Return the monitor of a record; the caller checks the checksum."""
    if content.get("format") == REGIMES:
        raise FileFormatError(f"{source} is a monitor by operating mode: read it by residua.RegimeMonitor.load")
    if content.get("format") != FORMAT:
        raise FileFormatError(f'{source} is not a monitor of residua (no "format": {FORMAT!r} in it)')
    return read_content(content, source, VERSION, lambda: _monitor_in(record(content, "", _ENTRIES)))


def read_content(content: Mapping[str, Any], source: str, version: int, read: Callable[[], Any]) -> Any:
    """Read the content of a file of a version; whatever is wrong names the file."""
    if content.get("version") != version:
        raise FileFormatError(
            other_version(source, content.get("version"), version, "design and fit the monitor again")
        )
    try:
        with np.errstate(all="ignore"):  # overflow is refused later; a warning adds nothing
            return read()
    except _ERRORS as error:
        raise FileFormatError(f"{source}: {shortened(str(error), 1000)}") from error


def _monitor_in(content: Mapping[str, Any]) -> Monitor:
    design = generator_in(content["design"], "design")
    settle, isolate = content["settle"], content["isolate"]
    certified = {
        name: float_in(value, joined("certified", name), POSITIVE)
        for name, value in table_in(content["certified"], "certified").items()
    }
    test, isolate = read_test(content["test"], "test"), read_isolation(content["isolate"], "isolate")
    _check_parts(content, isolate.test_of(test), isolate)
    monitor = Monitor(
        _Saved(design, certified),
        test=test,
        isolate=isolate,
        settle=None if settle is None else whole_in(settle, "settle"),
        max_hold=whole_in(content["max_hold"], "max_hold"),
        plausible=_plausible_in(content["plausible"]),
        start=text_in(content["start"], "start"),
    )
    monitor.notes = texts_in(content["notes"], "notes")
    monitor._bounds = bounds_in(content["bounds"], "bounds", [member.name for member in design.members])
    if content["sampled"] is not None:
        monitor._generator = sampled_in(design, content["sampled"], "sampled")
    monitor._test = monitor._spec = monitor._state = None
    if content["fitted"] is not None:
        _read_fit(monitor, content)
    elif content["learnt"]:
        raise FileFormatError("learnt must be empty where fitted is null")
    if content["state"] is not None:
        monitor._state = _state_in(content["state"], monitor._specification())
    return monitor


def _check_parts(content: Mapping[str, Any], test: TestSettings, isolate: IsolationSettings) -> None:
    """Raise if the settings do not match the saved results, before anything is rebuilt.

    What takes the time of a window is in the file then, as long as its window says.
    """
    fitted, running = content["fitted"], content["running"]
    if (fitted is None) != (running is None):
        raise FileFormatError("running must be present if and only if fitted is")
    if fitted is not None:
        test.check_record(table_in(fitted, "fitted"), "fitted")
        named = table_in(running, "running").get("isolation")
        isolate.check_record(table_in(named, "running.isolation"), "running.isolation")


@dataclass(frozen=True, eq=False)
class _Saved:
    """A design from a file, with the thresholds that it was certified for."""

    generator: ResidualGenerator
    thresholds: Mapping[str, float]


def _read_fit(monitor: Monitor, content: Mapping[str, Any]) -> None:
    """Give a monitor the test, the specification, the check of its fit and the learnt faults of a file."""
    watched, k = monitor._watched(monitor.generator), monitor.generator.n_residuals
    monitor._test = monitor._settings.test_from_record(content["fitted"], "fitted", watched)
    spec = monitor._plain_specification()
    values = table_in(content["running"], "running")
    named = values.pop("isolation")
    isolation = monitor._isolation.isolation_from_record(named, "running.isolation", watched, spec.test)
    running: _Running = values_in(values, "running", _Running, others=_PARTS)
    monitor._spec = running.in_place_of(replace(spec, isolation=isolation))
    if content["fit_check"] is not None:
        monitor._check = values_in(content["fit_check"], "fit_check", FitCheck)
        for name in ("mean", "spread"):
            count, channels = len(getattr(monitor._check, name)), len(monitor.generator.system.inputs)
            if count not in (0, channels):
                raise FileFormatError(f"fit_check.{name} must have {channels} numbers, got {count}")
    if content["normal"] is not None:
        monitor._normal = array_in(content["normal"], "normal", ENTRY)
        _check_shape(monitor._normal, (k, k), "normal")
    coding, faults = isolation.coding, []
    for j, value in enumerate(list_in(content["learnt"], "learnt")):
        fault: LearntFault = values_in(value, f"learnt[{j}]", LearntFault)
        size, members = (k, 0) if coding is None else (0, len(coding.members))
        shapes = [fault.shift.shape, *(M.shape for M in (fault.error, fault.noise, fault.between)), fault.code.shape]
        if shapes != [(size,), *[(size, size)] * 3, (members,)]:
            raise FileFormatError(f"learnt[{j}] must be for {size} residuals and {members} members")
        if not (fault.shift.any() or fault.code.any()):
            raise FileFormatError(f"learnt[{j}] has neither a direction nor a code")
        faults.append(fault)
    if len({fault.name for fault in faults}) < len(faults):
        raise FileFormatError("learnt: every fault must have a name of its own")
    monitor._learnt = tuple(faults)


def _plausible_out(setting: Plausible) -> Any:
    if isinstance(setting, Mapping):
        return {name: [float_out(low), float_out(high)] for name, (low, high) in setting.items()}
    return None if setting is None else float_out(setting)


def _plausible_in(value: Any) -> Plausible:
    if not isinstance(value, Mapping):
        return None if value is None else float_in(value, "plausible")
    out = {}
    for name, limits in value.items():
        low, high = (float_in(x, joined("plausible", name), ANY) for x in list_in(limits, joined("plausible", name), 2))
        out[name] = (low, high)
    return out


# --------------------------------------------------------------------- the running state


@dataclass(frozen=True, eq=False)
class _First:
    """Values of the estimator of a start that are computed from the design."""

    samples: int
    weights: NDArray[np.float64]
    correction: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Partial:
    """Values of a Kalman filter with missing outputs that are computed from the design."""

    covariance: NDArray[np.float64]
    settled: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Running:
    """Values of a specification that are computed from the design before the first sample."""

    start: NDArray[np.float64]
    settle: int
    plausible: NDArray[np.float64]
    first: _First | None
    partial: _Partial | None

    @staticmethod
    def of(spec: Specification) -> _Running:
        """Return the values of a specification."""
        first, partial = spec.first, spec.partial
        return _Running(
            spec.start,
            spec.settle,
            spec.plausible,
            None if first is None else _First(first.samples, first.weights, first.correction),
            None if partial is None else _Partial(partial.covariance, partial.settled),
        )

    def in_place_of(self, spec: Specification) -> Specification:
        """Return a specification with these values in place of those computed now."""
        n = len(spec.A)
        _check_shape(self.start, spec.start.shape, "running.start")
        remains = np.eye(n) - spec.A
        size = np.abs(remains) @ np.abs(self.start) + np.abs(spec.B)
        if size.size and np.abs(remains @ self.start - spec.B).max() > _EXACT * size.max():
            raise FileFormatError("running.start must be the state that the filter settles to, (I - A)^-1 B")
        _check_shape(self.plausible, spec.plausible.shape, "running.plausible")
        if not (self.plausible[:, 0] < self.plausible[:, 1]).all():
            raise FileFormatError("running.plausible: the smallest value of a channel must be below its largest")
        first, partial = None, None
        if self.first is not None:
            where, samples = "running.first", self.first.samples
            if not 1 <= samples <= MOST_SAMPLES:
                raise FileFormatError(f"{where}.samples must be 1 to {MOST_SAMPLES}, got {samples}")
            weights, correction, p = self.first.weights, self.first.correction, len(spec.C)
            if weights.ndim != 2 or len(weights) != p:
                raise FileFormatError(f"{where}.weights must have {p} rows, got shape {weights.shape}")
            _check_shape(correction, (n, n), f"{where}.correction")
            first = StartFit(samples, spec.A, spec.C, weights, spec.test.per_threshold, correction)
        if self.partial is not None:
            where, partial = "running.partial", spec.partial
            if partial is None:
                raise FileFormatError(f"{where} is present, but the generator is not a stationary Kalman filter")
            _check_shape(self.partial.covariance, (n, n), f"{where}.covariance")
            _check_shape(self.partial.settled, partial.settled.shape, f"{where}.settled")
            if np.any(np.abs(self.partial.covariance - partial.covariance) > _EXACT * partial.spread):
                raise FileFormatError(f"{where}.covariance must be the stationary one of the Kalman filter")
            partial = replace(partial, covariance=self.partial.covariance, settled=self.partial.settled)
        values = {"start": self.start, "settle": self.settle, "plausible": self.plausible}
        return replace(spec, **values, first=first, partial=partial)


_PARTS = (RecordOf(_First), RecordOf(_Partial))


def _check_shape(array: NDArray, shape: tuple[int, ...], where: str) -> None:
    if array.shape != shape:
        raise FileFormatError(f"{where} must be finite numbers of shape {shape}, got {array.shape}")


def _state_in(value: Any, spec: Specification) -> State:
    """Return the state of a running monitor, checked against its specification."""
    filtered = table_in(table_in(value, "state").get("filter"), "state.filter")
    plants = len(array_in(filtered.get("gap"), "state.filter.gap", INDEX, 1))
    state: State = state_in(value, "state", initial_state(spec, plants))
    first = 0 if spec.first is None else spec.first.samples
    if (state.filter.age[state.filter.starting] >= first).any():
        raise FileFormatError(f"state.filter.age must be below {first} while a start is estimated")
    spec.test.check_state(state.test)
    spec.isolation.check_state(state.isolation, int(state.count.max(initial=0)))
    return state


__all__ = [
    "EDITED",
    "FORMAT",
    "REGIMES",
    "VERSION",
    "load_monitor",
    "monitor_from",
    "monitor_out",
    "read_content",
    "save_monitor",
]
