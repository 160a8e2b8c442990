"""Monitors as JSON: every float to its last bit, a schema version, a checksum, nothing executed.

What runs is stored as it ran, the sampled filter, the threshold test and the signatures included, so that a
monitor goes on with the same bits on a machine whose linear algebra rounds differently.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.directional import Directional, DirectionTest
from residua.decide.matched import Matched, MatchedTest
from residua.decide.member_thresholds import BankTest
from residua.decide.norm_threshold import NormTest, NormThreshold
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.residual_groups import GroupTest, rows_of_groups
from residua.decide.structured import CodeTest, Structured
from residua.errors import FileFormatError, ResiduaError
from residua.files import read_bytes, write_text
from residua.json_files import CHECKSUM, check_checksum
from residua.monitor.cautions import bounds_in, bounds_out
from residua.monitor.design_records import generator_in, generator_out, sampled_in, sampled_out
from residua.monitor.encoding import (
    array_in,
    array_out,
    dumps,
    field_names,
    float_in,
    float_out,
    joined,
    list_in,
    loads,
    record,
    table_in,
    text_in,
    texts_in,
    values_in,
    values_out,
    whole_in,
)
from residua.monitor.judging import empty_fields
from residua.monitor.monitor import Monitor
from residua.monitor.older_files import OLDER, renewed
from residua.monitor.partial_update import PartialUpdate, empty_partial
from residua.monitor.plausible import Plausible
from residua.monitor.preparing import Isolation
from residua.monitor.running import Specification, State
from residua.monitor.starting import MOST_SAMPLES, StartFit, start_from
from residua.monitor.threshold_records import threshold_in, threshold_out
from residua.number_kinds import ANY, ENTRY, FINITE, FLAG, POSITIVE, SHARE, WINDOW
from residua.plant import Plant
from residua.visible import echo, shortened

FORMAT = "residua-monitor"
VERSION = 6

#: What a monitor says in every diagnosis whose file was edited: nobody but its author can know whether it still holds.
EDITED = "the file of this monitor was edited after it was saved: its numbers are not those of the design"

#: Columns of a whitening matrix this near to being dependent, in units of their own rows, see some residuals no more;
#: what is fitted stays above 1e-5.
_DEPENDENT = 1e-10
#: Bases are orthonormal to that, and what is computed from the design before the first sample is right to that.
_EXACT = 1e-6

#: How faults are named, by the entry ``kind`` of ``isolate``.
_ISOLATION: dict[str, type[Any]] = {"direction": Directional, "code": Structured, "matched": Matched}

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


def save_monitor(monitor: Monitor, path: str | Path) -> None:
    """Write a monitor with its thresholds and running state; the file appears whole or not at all."""
    generator, test = monitor._generator, monitor._norm_test
    resampled = generator is not None and generator is not monitor.design
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "design": generator_out(monitor.design),
        "sampled": sampled_out(generator) if generator is not None and resampled else None,
        "test": threshold_out(monitor.test),
        "certified": {name: float_out(value) for name, value in monitor._certified.items()},
        "isolate": _isolation_out(monitor.isolate),
        "settle": monitor.settle,
        "max_hold": monitor.max_hold,
        "plausible": _plausible_out(monitor.plausible),
        "start": monitor.start,
        "notes": list(monitor.notes),
        "fitted": None if test is None else values_out(test),
        "running": None if test is None or generator is None else _running_out(monitor._specification()),
        "state": None if monitor._state is None else values_out(monitor._state),
    }
    if monitor._bounds:  # an entry of its own where there is something to tell: any other file stays as it was
        content["bounds"] = bounds_out(monitor._bounds)
    write_text(path, dumps(content))


def load_monitor(path: str | Path) -> Monitor:
    """Read a monitor; raises :class:`FileFormatError` that says which entry is wrong.

    Every number must be what it may be (:mod:`residua.monitor.field_kinds`), the parts must fit together, and the
    content must be what was saved, by its checksum. With ``"checksum": null`` in the file, which says that it was
    edited, the monitor is as the file says, and its notes say that.
    """
    path = Path(path)
    if path.suffix.lower() == ".toml":
        raise FileFormatError(f"{path.name} looks like a plant file: design a monitor from it first (residua design)")
    content = loads(read_bytes(path, "a monitor"), path.name)
    if content.get("format") != FORMAT:
        raise FileFormatError(f'{path.name} is not a monitor of residua (no "format": {FORMAT!r} in it)')
    if content.get("version") not in (*OLDER, VERSION):
        raise FileFormatError(
            f"{path.name} has schema version {echo(content.get('version'))}, this residua reads version {VERSION} (and "
            f"{' and '.join(map(str, OLDER))}): make the monitor anew with this version"
        )
    try:
        with np.errstate(all="ignore"):  # what overflows is refused; that it did is no news
            monitor = _monitor_in(record(renewed(content), "", (*_ENTRIES, "bounds", CHECKSUM)))
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError, MemoryError, ResiduaError) as error:
        raise FileFormatError(f"{path.name}: {shortened(str(error), 1000)}") from error
    if content["version"] == VERSION and not check_checksum(content, path.name) and EDITED not in monitor.notes:
        monitor.notes = (*monitor.notes, EDITED)
    return monitor


def _monitor_in(content: Mapping[str, Any]) -> Monitor:
    design = generator_in(content["design"], "design")
    settle, isolate = content["settle"], content["isolate"]
    certified = {
        name: float_in(value, joined("certified", name), POSITIVE)
        for name, value in table_in(content["certified"], "certified").items()
    }
    test, named = threshold_in(content["test"]), None if isolate is None else _isolation_in(isolate)
    _check_windows(content["fitted"], content["running"], test, named)
    monitor = Monitor(
        SimpleNamespace(generator=design, thresholds=certified),
        test=test,
        isolate=named,
        settle=None if settle is None else whole_in(settle, "settle"),
        max_hold=whole_in(content["max_hold"], "max_hold"),
        plausible=_plausible_in(content["plausible"]),
        start=text_in(content["start"], "start"),
    )
    monitor.notes = texts_in(content["notes"], "notes")
    monitor._bounds = bounds_in(content["bounds"], "bounds", [member.name for member in design.members])
    if content["sampled"] is not None:
        monitor._generator = sampled_in(design, content["sampled"], "sampled")
    monitor._norm_test = monitor._spec = monitor._state = None
    if content["fitted"] is not None:
        monitor._norm_test = values_in(content["fitted"], "fitted", _kind_of_test(monitor))
        _check_fitted(monitor)
    if content["running"] is not None:
        monitor._spec = _running_in(monitor._specification(), content["running"], monitor.design.plant)
    if content["state"] is not None:
        monitor._state = values_in(content["state"], "state", State)
        _check_state(monitor)
    return monitor


def _kind_of_test(monitor: Monitor) -> type[NormTest] | type[BankTest]:
    """Return what a threshold test is, with every number filled in."""
    if isinstance(monitor.isolate, Structured):
        return BankTest
    return NormTest if getattr(monitor.test, "groups", None) is None else GroupTest


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


def _isolation_out(isolate: Isolation) -> dict[str, Any] | None:
    if isolate is None:
        return None
    kind = next(kind for kind, cls in _ISOLATION.items() if isinstance(isolate, cls))
    return {"kind": kind} | values_out(isolate)


def _isolation_in(value: Any) -> Directional | Structured | Matched:
    content = table_in(value, "isolate")
    if "kind" not in content:
        raise FileFormatError("the entry 'isolate.kind' is missing")
    kind = text_in(content.pop("kind"), "isolate.kind")
    if kind not in _ISOLATION:
        raise FileFormatError(f"isolate.kind: expected one of {', '.join(_ISOLATION)}, got {echo(kind)}")
    return values_in(content, "isolate", _ISOLATION[kind])


# --------------------------------------------------------------------- what runs


def _running_out(spec: Specification) -> dict[str, Any]:
    """Return what was computed from the design before the first sample."""
    test, codes = spec.direction, spec.codes
    return {
        "start": array_out(spec.start),
        "settle": int(spec.settle),
        "plausible": array_out(spec.plausible),
        "first": None
        if spec.first is None
        else {"samples": int(spec.first.samples), "correction": array_out(spec.first.correction)},
        "partial": None
        if spec.partial is None
        else {"covariance": array_out(spec.partial.covariance), "settled": array_out(spec.partial.settled)},
        "direction": None
        if test is None
        else {
            "window": int(test.window),
            "groups": [list(group) for group in test.groups],
            "bases": [array_out(basis) for basis in test.bases],
            "unjudged": list(test.unjudged),
        },
        "codes": None
        if codes is None
        else {
            "window": int(codes.window),
            "share": float_out(codes.share),
            "distance": int(codes.distance),
            "members": list(codes.members),
            "groups": [list(group) for group in codes.groups],
            "codes": array_out(codes.codes),
            "unjudged": list(codes.unjudged),
            "settled": [list(group) for group in codes.settled],
        },
        "matched": None if spec.matched is None else _matched_out(spec.matched),
    }


def _matched_out(test: MatchedTest) -> dict[str, Any]:
    return {
        "window": int(test.window),
        "faults": list(test.faults),
        "groups": [list(group) for group in test.groups],
        "responses": array_out(test.responses),
        "settled": array_out(test.settled),
        "unjudged": list(test.unjudged),
    }


def _matched_in(value: Any, where: str, plant: Plant, residuals: int, steady: bool) -> MatchedTest:
    content = record(value, where, field_names(MatchedTest))
    groups = tuple(texts_in(group, joined(where, "groups")) for group in list_in(content["groups"], where))
    unjudged, faults = (texts_in(content[name], joined(where, name)) for name in ("unjudged", "faults"))
    window = whole_in(content["window"], joined(where, "window"), WINDOW)
    responses, settled = (array_in(content[name], joined(where, name), ENTRY) for name in ("responses", "settled"))
    _check_groups(groups, unjudged, where, plant)
    if faults != plant.faults:
        raise FileFormatError(f"{where}: faults must be those of the plant")
    wanted = (0 if steady else window + 1, residuals, len(faults))
    for name, array, shape in (("responses", responses, wanted), ("settled", settled, wanted[1:])):
        if array.shape != shape:
            raise FileFormatError(f"{where}.{name} must be finite numbers of shape {shape}")
    for group in groups:  # of what leaves no trace there is nothing to look for
        columns = [faults.index(name) for name in group]
        if not (responses[..., columns].any() or settled[:, columns].any()):
            raise FileFormatError(f"{where}.responses: those of {echo(group[0])} must not all be zero")
    return MatchedTest(window, faults, groups, responses, settled, unjudged)


_RUNNING = ("start", "settle", "plausible", "first", "partial", "direction", "codes", "matched")


def _running_in(spec: Specification, value: Any, plant: Plant) -> Specification:
    """Return the specification with what was computed when it was saved in place of what is computed now."""
    content = record(value, "running", _RUNNING)
    start = array_in(content["start"], "running.start", ENTRY)
    if start.shape != spec.start.shape:
        raise FileFormatError(f"running.start must have shape {spec.start.shape}, got {start.shape}")
    _check_start(spec, start)
    plausible = spec.plausible if content["plausible"] is None else _limits_in(content["plausible"], spec)
    for name in ("direction", "codes", "matched"):
        if (content[name] is None) != (getattr(spec, name) is None):
            raise FileFormatError(f"running.{name} must be there if and only if isolate asks for it")
    direction = codes = matched = None
    if content["direction"] is not None:
        direction = _direction_in(content["direction"], "running.direction", plant, len(spec.C))
    if content["codes"] is not None and spec.codes is not None:
        codes = _codes_in(content["codes"], "running.codes", plant, len(spec.codes.members))
    if content["matched"] is not None and spec.matched is not None:
        steady = not len(spec.matched.responses)
        matched = _matched_in(content["matched"], "running.matched", plant, len(spec.C), steady)
    settle = whole_in(content["settle"], "running.settle")
    spec = replace(spec, start=start, settle=settle, plausible=plausible)
    first, partial = _first_in(content["first"], spec), _partial_in(content["partial"], spec)
    return replace(spec, first=first, partial=partial, direction=direction, codes=codes, matched=matched)


def _first_in(value: Any, spec: Specification) -> StartFit | None:
    """Return what estimates a start, with the correction that was saved."""
    if value is None:
        return None
    content = record(value, "running.first", ("samples", "correction"))
    samples = whole_in(content["samples"], "running.first.samples")
    correction = _square_in(content["correction"], "running.first.correction", len(spec.A))
    if not 1 <= samples <= MOST_SAMPLES:
        raise FileFormatError(f"running.first.samples must be 1 to {MOST_SAMPLES}, got {samples}")
    return start_from(spec.A, spec.C, spec.test, samples, correction)


def _partial_in(value: Any, spec: Specification) -> PartialUpdate | None:
    """Return what a Kalman filter without some outputs needs, with the covariance that was saved."""
    if value is None:
        return None
    content = record(value, "running.partial", ("covariance", "settled"))
    if spec.partial is None:
        raise FileFormatError("running.partial is there, and the generator is no stationary Kalman filter")
    covariance = _square_in(content["covariance"], "running.partial.covariance", len(spec.A))
    settled, shape = array_in(content["settled"], "running.partial.settled", ENTRY), spec.partial.settled.shape
    if settled.shape != shape:
        raise FileFormatError(f"running.partial.settled must be finite numbers of shape {shape}")
    if np.any(np.abs(covariance - spec.partial.covariance) > _EXACT * spec.partial.spread):
        raise FileFormatError("running.partial.covariance must be the stationary one of the Kalman filter")
    return replace(spec.partial, covariance=covariance, settled=settled)


def _square_in(value: Any, where: str, n: int) -> NDArray[np.float64]:
    found = array_in(value, where, ENTRY)
    if found.shape != (n, n):
        raise FileFormatError(f"{where} must be finite numbers of shape {(n, n)}")
    return found


def _limits_in(value: Any, spec: Specification) -> NDArray[np.float64]:
    limits, shape = array_in(value, "running.plausible"), spec.plausible.shape
    if limits.shape != shape:
        raise FileFormatError(f"running.plausible must be finite numbers of shape {shape}")
    if not (limits[:, 0] < limits[:, 1]).all():
        raise FileFormatError("running.plausible: the smallest value of a channel must be below its largest")
    return limits


def _codes_in(value: Any, where: str, plant: Plant, count: int) -> CodeTest:
    content = record(value, where, field_names(CodeTest))
    groups = tuple(texts_in(group, joined(where, "groups")) for group in list_in(content["groups"], where))
    members, unjudged = (texts_in(content[name], joined(where, name)) for name in ("members", "unjudged"))
    settled = tuple(texts_in(group, joined(where, "settled")) for group in list_in(content["settled"], where))
    codes = array_in(content["codes"], joined(where, "codes"), FLAG, 2)
    share = float_in(content["share"], joined(where, "share"), SHARE)
    window = whole_in(content["window"], joined(where, "window"), WINDOW)
    distance = whole_in(content["distance"], joined(where, "distance"))
    if len(settled) != len(groups) or any(set(s) - set(g) for s, g in zip(settled, groups, strict=True)):
        raise FileFormatError(f"{where}: settled must name faults of each of the {len(groups)} groups")
    own = tuple(tuple(x for x in g if x not in s) for g, s in zip(groups, settled, strict=True))
    _check_groups(own, unjudged, where, plant)
    if len(members) != count or codes.shape != (count, len(groups)):
        raise FileFormatError(f"{where}: codes must be true or false, {count} members x {len(groups)} groups")
    return CodeTest(window, share, distance, members, groups, codes, unjudged, settled)


def _check_groups(groups: tuple[tuple[str, ...], ...], unjudged: tuple[str, ...], where: str, plant: Plant) -> None:
    if sorted([*unjudged, *(name for group in groups for name in group)]) != sorted(plant.faults):
        raise FileFormatError(f"{where}: groups and unjudged must be the faults of the plant, each once")


def _direction_in(value: Any, where: str, plant: Plant, residuals: int) -> DirectionTest:
    content = record(value, where, field_names(DirectionTest))
    groups = tuple(texts_in(group, joined(where, "groups")) for group in list_in(content["groups"], where))
    bases = tuple(
        array_in(basis, joined(where, "bases"), FINITE, 2)
        for basis in list_in(content["bases"], joined(where, "bases"), len(groups))
    )
    unjudged = texts_in(content["unjudged"], joined(where, "unjudged"))
    window = whole_in(content["window"], joined(where, "window"), WINDOW)
    _check_groups(groups, unjudged, where, plant)
    if any(len(basis) != residuals for basis in bases):
        raise FileFormatError(f"{where}: every basis must have {residuals} rows")
    for k, basis in enumerate(bases):
        if not basis.size or not np.abs(basis.T @ basis - np.eye(basis.shape[1])).max() <= _EXACT:
            raise FileFormatError(f"{where}.bases[{k}]: its columns must be orthonormal")
    return DirectionTest(window, groups, bases, unjudged)


def _check_fitted(monitor: Monitor) -> None:
    k, test = monitor.generator.n_residuals, monitor.norm_test
    if test.kind != ("peak" if isinstance(monitor.test, PeakThreshold) else "norm"):
        raise FileFormatError(f"fitted.kind must be that of the test, got {echo(test.kind)}")
    columns = k
    if isinstance(test, BankTest):
        members = [len(member.residuals) for member in monitor.generator.members]
        if isinstance(test, GroupTest):
            assert isinstance(monitor.test, NormThreshold)
            groups = rows_of_groups(monitor.test.groups, monitor.generator.residuals)
            members = [len(part) for part in groups.values()]
            if test.names != tuple(groups) or test.whole.shape != (k, k):
                raise FileFormatError(f"fitted: names must be those of the groups, and whole be for {k} residuals")
        columns = sum(members)
        if test.sizes.tolist() != members or test.thresholds.shape != (len(members),):
            raise FileFormatError(f"fitted: sizes and thresholds must be for {len(members)} members")
    if test.center.shape != (k,) or test.whitening.shape != (k, columns):
        raise FileFormatError(f"fitted: center and whitening must be for {k} residuals")
    _check_whitening(test)


def _check_windows(fitted: Any, running: Any, test: Any, isolate: Isolation) -> None:
    """Raise where the settings have other windows than what was made of them, before anything is made of them again.

    What takes the time of a window is in the file then, as long as its window says.
    """
    if (fitted is None) != (running is None):
        raise FileFormatError("running must be there if and only if fitted is")
    if fitted is None or running is None:
        return
    if isinstance(test, NormThreshold) and table_in(fitted, "fitted").get("window") != test.window:
        raise FileFormatError(f"fitted.window must be that of the test, {test.window}")
    for name, cls in (("direction", Directional), ("codes", Structured), ("matched", Matched)):
        if isinstance(isolate, cls):
            where = f"running.{name}"
            judge = table_in(table_in(running, "running").get(name), where)
            if judge.get("window") != isolate.window:
                raise FileFormatError(f"{where}.window must be that of isolate, {isolate.window}")
            if isinstance(isolate, Matched):
                shape = table_in(judge.get("responses"), f"{where}.responses").get("shape")
                rows = shape[0] if isinstance(shape, list) and shape else None
                if rows != (0 if isolate.steady else isolate.window + 1):
                    raise FileFormatError(f"{where}.responses must be those of {isolate.window + 1} samples")


def _check_start(spec: Specification, start: NDArray[np.float64]) -> None:
    """Raise unless the filter would stay where it starts: what was computed elsewhere differs by rounding alone."""
    remains = np.eye(len(spec.A)) - spec.A
    size = np.abs(remains) @ np.abs(start) + np.abs(spec.B)
    if start.size and np.abs(remains @ start - spec.B).max() > _EXACT * size.max():
        raise FileFormatError("running.start must be the state that the filter settles to, (I - A)^-1 B")


def _check_whitening(test: NormTest | BankTest) -> None:
    """Raise where a whitening matrix leaves out a residual, or a combination of them."""
    parts = test.columns if isinstance(test, BankTest) else [(0, test.whitening.shape[1])]
    for start, stop in parts:
        part = test.whitening[:, start:stop]
        rows = np.abs(part).max(axis=1, initial=0.0)
        part = part[rows > 0] / rows[rows > 0, None]
        columns = np.sqrt(np.sum(part**2, axis=0))
        sizes = np.linalg.svd(part / np.where(columns > 0, columns, 1.0), compute_uv=False)
        whole = len(part) >= stop - start if isinstance(test, BankTest) else len(part) == len(rows)
        if stop > start and not (whole and sizes[-1] > _DEPENDENT):
            raise FileFormatError(
                "fitted.whitening must be invertible, for each member: some residuals count for nothing"
            )


def _check_state(monitor: Monitor) -> None:
    state, spec = monitor._state, monitor._specification()
    assert state is not None
    plants, columns = len(state.x), spec.test.whitening.shape[1]
    wanted = {
        "x": (plants, len(spec.A)),
        "held": (plants, spec.B.shape[1]),
        **dict.fromkeys(("up", "down", "alarm", "since"), (plants, *spec.alarms)),
    }
    partial = empty_partial(spec.partial, plants)
    for name, empty in (empty_fields(spec.matched, plants, spec.partial is not None) | partial).items():
        wanted[name] = empty.shape
    wanted["start_sums"] = (plants, 0 if spec.first is None else len(spec.A))
    for prefix, length, k in (("", spec.window, spec.judged), ("test_", spec.test.window, columns)):
        wanted |= {prefix + "ends": (plants, length, k), prefix + "block": (plants, length, k)}
        wanted[prefix + "begun"] = (plants, k)
        if not 0 <= getattr(state, prefix + "filled") < max(length, 2):
            raise FileFormatError(f"state.{prefix}filled must be below the window of {length}")
    if (state.since > state.count).any():
        raise FileFormatError("state.since must not be later than state.count")
    for name in field_names(State):
        value = getattr(state, name)
        shape = wanted.get(name, (plants,))
        if isinstance(value, np.ndarray) and value.shape != shape:
            raise FileFormatError(f"state.{name} must have shape {shape}, got {value.shape}")


__all__ = ["FORMAT", "VERSION", "load_monitor", "save_monitor"]
