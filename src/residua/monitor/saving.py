"""Monitors as JSON: every float to its last bit, a schema version, a checksum, nothing executed.

What runs is stored as it ran, the sampled filter, the threshold test and the signatures included, so that a
monitor goes on with the same bits on a machine whose linear algebra rounds differently.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import IsolationSettings
from residua.decide.kinds import read_isolation, read_test, settings_out
from residua.decide.learnt_faults import LearntFault
from residua.decide.member_bounds import bounds_in
from residua.decide.test import TestSettings, Watched
from residua.design import ResidualGenerator
from residua.errors import FileFormatError, ResiduaError
from residua.files import other_version, read_bytes, write_text
from residua.json_files import CHECKSUM, check_checksum, dumps, loads
from residua.monitor.design_records import generator_in, generator_out, sampled_in, sampled_out
from residua.monitor.fault_learning import whitens
from residua.monitor.fit_check import FitCheck
from residua.monitor.monitor import Monitor
from residua.monitor.partial_update import PartialUpdate
from residua.monitor.plausible import Plausible
from residua.monitor.running import State, initial_state
from residua.monitor.specification import Specification
from residua.monitor.starting import MOST_SAMPLES, StartFit, start_from
from residua.number_kinds import ANY, ENTRY, INDEX, POSITIVE
from residua.records import (
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

FORMAT = "residua-monitor"
#: That of monitors by operating mode (``regime_files``), of which each holds several.
REGIMES = "residua-regime-monitor"
VERSION = 12

#: Caution in every diagnosis of a monitor whose file was edited: only its author can know whether it still holds.
EDITED = "the file of this monitor was edited after it was saved: its numbers are not those of the design"

#: Relative accuracy of values computed from the design before the first sample.
_EXACT = 1e-6

_ENTRIES = (
    "format",
    "version",
    "design",
    "sampled",
    "test",
    "certified",
    "isolate",
    "settle",
    "max_hold",
    "plausible",
    "start",
    "notes",
    "fitted",
    "running",
    "state",
)
#: Optional entries of a file, and their defaults.
_ABSENT: dict[str, Any] = {"bounds": {}, "fit_check": None, "normal": None, "learnt": []}


def save_monitor(monitor: Monitor, path: str | Path) -> None:
    """Write a monitor with its thresholds and running state; the file appears whole or not at all."""
    write_text(path, dumps(monitor_out(monitor)))


def monitor_out(monitor: Monitor) -> dict[str, Any]:
    """Return a monitor as a record."""
    generator, test = monitor._generator, monitor._test
    resampled = generator is not None and generator is not monitor.design
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "design": generator_out(monitor.design),
        "sampled": sampled_out(generator) if generator is not None and resampled else None,
        "test": settings_out(monitor.test),
        "certified": {name: float_out(value) for name, value in monitor._certified.items()},
        "isolate": None if monitor.isolate is None else settings_out(monitor.isolate),
        "settle": monitor.settle,
        "max_hold": monitor.max_hold,
        "plausible": _plausible_out(monitor.plausible),
        "start": monitor.start,
        "notes": list(monitor.notes),
        "fitted": None if test is None else test.to_record(),
        "running": None if test is None or generator is None else _running_out(monitor._plain_specification()),
        "state": None if monitor._state is None else values_out(monitor._state),
    }
    if monitor._bounds:  # entries of their own where there is something to tell: any other file stays as it was
        content["bounds"] = {name: values_out(one) for name, one in monitor._bounds.items()}
    if monitor._check is not None:
        content["fit_check"] = values_out(monitor._check)
    if test is not None and monitor._normal is not None and not whitens(test):
        content["normal"] = array_out(monitor._normal)  # else the test has it
    if monitor._learnt:
        content["learnt"] = [values_out(fault) for fault in monitor._learnt]
    return content


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
    if content.get("version") != VERSION:
        raise FileFormatError(
            other_version(source, content.get("version"), VERSION, "design and fit the monitor again")
        )
    try:
        with np.errstate(all="ignore"):  # overflow is refused later; a warning adds nothing
            return _monitor_in(record(_ABSENT | dict(content), "", (*_ENTRIES, *_ABSENT, CHECKSUM)))
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError, MemoryError, ResiduaError) as error:
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
        watched = monitor._watched(monitor.generator)
        monitor._test = monitor._settings.test_from_record(content["fitted"], "fitted", watched)
        monitor._spec = _running_in(monitor._plain_specification(), content["running"], monitor, watched)
        if content["fit_check"] is not None:
            monitor._check = values_in(content["fit_check"], "fit_check", FitCheck)
            for name in ("mean", "spread"):
                count, channels = len(getattr(monitor._check, name)), len(monitor.generator.system.inputs)
                if count not in (0, channels):
                    raise FileFormatError(f"fit_check.{name} must have {channels} numbers, got {count}")
        monitor._normal, monitor._learnt = _learnt_in(content, monitor)
    elif content["learnt"]:
        raise FileFormatError("learnt must be empty where fitted is null")
    if content["state"] is not None:
        monitor._state = _state_in(content["state"], monitor._specification())
    return monitor


def _learnt_in(
    content: Mapping[str, Any], monitor: Monitor
) -> tuple[NDArray[np.float64] | None, tuple[LearntFault, ...]]:
    """Return the fault-free covariance, if it is not that of the test, and the learnt faults."""
    k, coding = monitor.generator.n_residuals, monitor._plain_specification().isolation.coding
    normal = None if content["normal"] is None else _square_in(content["normal"], "normal", k)
    faults = []
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
    return normal, tuple(faults)


@dataclass(frozen=True, eq=False)
class _Saved:
    """A design from a file, with the thresholds that it was certified for."""

    generator: ResidualGenerator
    thresholds: Mapping[str, float]


def _check_parts(content: Mapping[str, Any], test: TestSettings, isolate: IsolationSettings) -> None:
    """Raise if the settings do not match the saved results, before anything is rebuilt.

    What takes the time of a window is in the file then, as long as its window says.
    """
    fitted, running = content["fitted"], content["running"]
    if (fitted is None) != (running is None):
        raise FileFormatError("running must be present if and only if fitted is")
    if fitted is not None:
        test.check_record(table_in(fitted, "fitted"), "fitted")
        where = "running.isolation"
        isolate.check_record(table_in(table_in(running, "running").get("isolation"), where), where)


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


def _running_out(spec: Specification) -> dict[str, Any]:
    """Return the values computed from the design before the first sample."""
    return {
        "start": array_out(spec.start),
        "settle": int(spec.settle),
        "plausible": array_out(spec.plausible),
        "first": None if spec.first is None else _first_out(spec, spec.first),
        "partial": None
        if spec.partial is None
        else {"covariance": array_out(spec.partial.covariance), "settled": array_out(spec.partial.settled)},
        "isolation": spec.isolation.to_record(),
    }


_RUNNING = ("start", "settle", "plausible", "first", "partial", "isolation")


def _running_in(spec: Specification, value: Any, monitor: Monitor, watched: Watched) -> Specification:
    """Return the specification with the saved values in place of those computed now."""
    content = record(value, "running", _RUNNING)
    start = array_in(content["start"], "running.start", ENTRY)
    if start.shape != spec.start.shape:
        raise FileFormatError(f"running.start must have shape {spec.start.shape}, got {start.shape}")
    _check_start(spec, start)
    plausible = spec.plausible if content["plausible"] is None else _limits_in(content["plausible"], spec)
    isolation = monitor._isolation.isolation_from_record(content["isolation"], "running.isolation", watched, spec.test)
    settle = whole_in(content["settle"], "running.settle")
    spec = replace(spec, start=start, settle=settle, plausible=plausible, isolation=isolation)
    first, partial = _first_in(content["first"], spec), _partial_in(content["partial"], spec)
    return replace(spec, first=first, partial=partial)


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


def _first_out(spec: Specification, first: StartFit) -> dict[str, Any]:
    """Return the record of a start estimator; its weights only if they differ from the default."""
    out = {"samples": int(first.samples), "correction": array_out(first.correction)}
    without = start_from(spec.A, spec.C, spec.test, first.samples, first.correction, None)
    return out if np.array_equal(without.weights, first.weights) else {**out, "weights": array_out(first.weights)}


def _first_in(value: Any, spec: Specification) -> StartFit | None:
    """Return the estimator of a start, with the saved correction."""
    if value is None:
        return None
    content = {"weights": None} | table_in(value, "running.first")  # an entry only where it is needed
    content = record(content, "running.first", ("samples", "correction", "weights"))
    samples = whole_in(content["samples"], "running.first.samples")
    correction = _square_in(content["correction"], "running.first.correction", len(spec.A))
    if not 1 <= samples <= MOST_SAMPLES:
        raise FileFormatError(f"running.first.samples must be 1 to {MOST_SAMPLES}, got {samples}")
    weights = content["weights"]
    if weights is not None:
        weights = _square_in(weights, "running.first.weights", len(spec.C))
    return start_from(spec.A, spec.C, spec.test, samples, correction, weights)


def _partial_in(value: Any, spec: Specification) -> PartialUpdate | None:
    """Return the data for a Kalman filter with missing outputs, with the saved covariance."""
    if value is None:
        return None
    content = record(value, "running.partial", ("covariance", "settled"))
    if spec.partial is None:
        raise FileFormatError("running.partial is present, but the generator is not a stationary Kalman filter")
    covariance = _square_in(content["covariance"], "running.partial.covariance", len(spec.A))
    settled, shape = array_in(content["settled"], "running.partial.settled", ENTRY), spec.partial.settled.shape
    if settled.shape != shape:
        raise FileFormatError(f"running.partial.settled must be finite numbers of shape {shape}")
    if np.any(np.abs(covariance - spec.partial.covariance) > _EXACT * spec.partial.spread):
        raise FileFormatError("running.partial.covariance must be the stationary one of the Kalman filter")
    return replace(spec.partial, covariance=covariance, settled=settled)


def _square_in(value: Any, where: str, n: int) -> NDArray[np.float64]:
    array = array_in(value, where, ENTRY)
    if array.shape != (n, n):
        raise FileFormatError(f"{where} must be finite numbers of shape {(n, n)}")
    return array


def _limits_in(value: Any, spec: Specification) -> NDArray[np.float64]:
    limits, shape = array_in(value, "running.plausible"), spec.plausible.shape
    if limits.shape != shape:
        raise FileFormatError(f"running.plausible must be finite numbers of shape {shape}")
    if not (limits[:, 0] < limits[:, 1]).all():
        raise FileFormatError("running.plausible: the smallest value of a channel must be below its largest")
    return limits


def _check_start(spec: Specification, start: NDArray[np.float64]) -> None:
    """Raise unless the filter would stay where it starts, up to rounding."""
    remains = np.eye(len(spec.A)) - spec.A
    size = np.abs(remains) @ np.abs(start) + np.abs(spec.B)
    if start.size and np.abs(remains @ start - spec.B).max() > _EXACT * size.max():
        raise FileFormatError("running.start must be the state that the filter settles to, (I - A)^-1 B")


__all__ = ["FORMAT", "REGIMES", "VERSION", "load_monitor", "monitor_from", "monitor_out", "save_monitor"]
