"""Files of earlier versions as files of today."""

from __future__ import annotations

from typing import Any

import numpy as np

from residua.errors import FileFormatError
from residua.json_files import CHECKSUM
from residua.monitor.partial_update import empty_partial
from residua.monitor.plausible import TIMES
from residua.number_kinds import ENTRY, FLAG, INDEX
from residua.records import array_in, array_out, joined, record, table_in, whole_in

#: Versions before today's that are read.
OLDER = (3, 4, 5, 6, 7, 8)


def renewed(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a file of an earlier version as one of today.

    In a file of version 3 nothing was matched with responses; before version 5 every test was of the norm, and when a
    standing alarm began was not known: it stays so until it ends. ``bounds``, ``fit_check``, ``normal`` and ``learnt``
    are entries of a file only where there are any. A file from before version 6 has no checksum, and in its signatures
    rounding where there are zeros now: in the rows of residuals that a fault does not reach. Its starts were from rest,
    and its Kalman filters held the values of missing outputs, which both stay so; and every finite number was a
    measurement: without the recording that was fitted, only what would overflow is missing. Before version 7 what ran
    and its state were one flat table of every kind of test and isolation. Before version 8 all plants of a monitor had
    seen equally many samples, and a moving sum kept what it had read. Before version 9 a Kalman filter that goes on
    without missing outputs held the last values of these too, a test whose alarm is ended by a level counted the
    samples below its threshold, and CUSUM kept its alarm behind its sums too.
    """
    version, content = content["version"], {"bounds": {}, "fit_check": None, "normal": None, "learnt": []} | content
    if version == 3:
        _with_matched(content)
    if version in (3, 4):
        _with_kinds(content)
    if version in (3, 4, 5):
        if CHECKSUM in content:
            raise FileFormatError(f"the entry {CHECKSUM!r} is unknown in version {version}")
        content[CHECKSUM] = None
        for name in ("design", "sampled"):
            if content.get(name) is not None:
                content[name] = _with_silent_rows(table_in(content[name], name), name)
        _with_promise(content)
        _with_plausible(content)
    if version in (3, 4, 5, 6):
        _nested(content)
    if version in OLDER[:-1] and content.get("state") is not None:
        _with_counts(content)
    if version in OLDER and content.get("state") is not None:
        _with_less(content)
    if content["fit_check"] is not None:  # channels, what contradicts the plant and the rate were not kept at first
        absent = {"mean": [], "spread": [], "units": [], "doubts": [], "rows": 0, "aimed": None, "promised": None}
        content["fit_check"] = absent | table_in(content["fit_check"], "fit_check")
    return content


# ----------------------------------------------------------------------------- version 8 to 9


def _with_less(content: dict[str, Any]) -> None:
    """Leave out of a state what is no longer remembered."""
    state = table_in(content["state"], "state")
    partial = table_in(content.get("running"), "running").get("partial")
    if partial is not None:
        filtered = table_in(state.get("filter"), "state.filter")
        settled = table_in(partial, "running.partial").get("settled")
        outputs = len(array_in(settled, "running.partial.settled", ENTRY, 2))
        held = array_in(filtered.get("held"), "state.filter.held", ndim=2)
        if held.shape[1] < outputs:
            raise FileFormatError(f"state.filter.held must have a column for each channel, got {held.shape[1]}")
        state["filter"] = filtered | {"held": array_out(held[:, : held.shape[1] - outputs])}
    test = table_in(state.get("test"), "state.test")
    if set(test) == {"past", "sums", "runs"}:
        runs = table_in(test["runs"], "state.test.runs")
        down = array_in(runs.get("down"), "state.test.runs.down", INDEX)
        test |= {"runs": runs | {"down": array_out(np.zeros_like(down))}}
        if table_in(content["test"], "test").get("kind") == "cusum":
            test["sums"] = array_out(array_in(test["sums"], "state.test.sums", ndim=2)[:, :-1])
        state["test"] = test
    content["state"] = state


# ----------------------------------------------------------------------------- version 7 to 8


def _with_counts(content: dict[str, Any]) -> None:
    """Count the samples of every plant by itself, and keep of moving sums only what is read again."""
    state = table_in(content["state"], "state")
    plants = len(array_in(table_in(state.get("filter"), "state.filter").get("gap"), "state.filter.gap", INDEX, 1))
    count = array_out(np.full(plants, whole_in(state.get("count"), "state.count"), dtype=np.int64))
    content["state"] = _with_counted_windows(state, "state", plants) | {"count": count}


def _with_counted_windows(value: Any, where: str, plants: int) -> Any:
    if not isinstance(value, dict):
        return value
    if not set(_WINDOW) <= set(value):
        return {name: _with_counted_windows(entry, joined(where, name), plants) for name, entry in value.items()}
    content = record(value, where, _WINDOW)
    ends, block = (array_in(content[name], joined(where, name), ndim=3) for name in ("ends", "block"))
    filled = whole_in(content["filled"], joined(where, "filled"))
    if ends.shape != block.shape or filled >= max(ends.shape[1], 2):
        raise FileFormatError(f"{where}: ends and block must be of one shape, and filled below its window")
    kept = np.where(np.arange(ends.shape[1])[:, None] < filled, block, ends)
    counted = array_out(np.full(plants, filled, dtype=np.int64))
    return {"values": array_out(kept), "begun": content["begun"], "filled": counted}


# ----------------------------------------------------------------------------- version 6 to 7

_FILTER = (
    *("x", "held", "gap", "running", "age", "resets", "broken", "starting", "start_sums", "moved", "apart"),
    *("spread", "bent"),
)
_WINDOW, _RUNS = ("ends", "block", "begun", "filled"), ("up", "down", "alarm")
_STATE_6 = (
    *_FILTER, *_RUNS, "since", *_WINDOW, *(f"test_{name}" for name in _WINDOW), "count",
    *(f"match_{name}" for name in ("sums", "weights", "held", "extra")),
)  # fmt: skip
_RUNNING_6 = ("start", "settle", "plausible", "first", "partial", "direction", "codes", "matched")


def _nested(content: dict[str, Any]) -> None:
    """Bring test and isolation, and their states, together: each in a table of its own."""
    isolate = content.get("isolate")
    kind = "" if isolate is None else table_in(isolate, "isolate").get("kind")
    if content.get("running") is None or content.get("fitted") is None:
        if content.get("state") is not None:
            raise FileFormatError("state must not be there without running")
        return
    running = record(content["running"], "running", _RUNNING_6)
    fitted = table_in(content["fitted"], "fitted")
    parts = {name: running.pop(name) for name in ("direction", "codes", "matched")}
    wanted = {"direction": "direction", "code": "codes", "matched": "matched"}.get(str(kind))
    for name, part in parts.items():
        if (part is None) != (name != wanted):
            raise FileFormatError(f"running.{name} must be there if and only if isolate asks for it")
    if kind == "code":
        codes = table_in(parts["codes"], "running.codes")
        fitted = fitted | {"names": codes.get("members")}
        running["isolation"] = codes | {"at_once": fitted.get("kind") == "peak"}
    elif kind == "matched":
        fitted = fitted | {"matched": parts["matched"]}
        running["isolation"] = {}
    else:
        running["isolation"] = parts["direction"] or {"groups": [], "unjudged": []}
    content |= {"running": running, "fitted": fitted}
    if content.get("state") is not None:
        content["state"] = _nested_state(record(content["state"], "state", _STATE_6), str(kind), parts)


def _nested_state(state: dict[str, Any], kind: str, parts: dict[str, Any]) -> dict[str, Any]:
    """Return a state with tables for filter, test and isolation."""
    window, runs = {name: state[name] for name in _WINDOW}, {name: state[name] for name in _RUNS}
    test: dict[str, Any] = {"window": {name: state[f"test_{name}"] for name in _WINDOW}, "runs": runs}
    isolation: Any = None
    if kind == "direction":
        isolation = window if table_in(parts["direction"], "running.direction").get("bases") else _narrow(window)
    elif kind == "code":
        isolation = {"window": window, "since": state["since"], "fired": state["alarm"]}
    elif kind == "matched":
        match = {name: state[f"match_{name}"] for name in ("sums", "weights", "extra")}
        length = array_in(window["ends"], "state.ends").shape[1]
        extra = array_in(match["extra"], "state.match_extra", ndim=3)
        if not extra.shape[1]:
            match["extra"] = array_out(np.zeros((extra.shape[0], length, extra.shape[2])))
        test = {"window": window, "match": match, "runs": runs}
        isolation = {"held": state["match_held"], "on": state["alarm"]}
    filtered = {name: state[name] for name in _FILTER}
    return {"filter": filtered, "test": test, "isolation": isolation, "count": state["count"]}


def _narrow(window: dict[str, Any]) -> dict[str, Any]:
    """Return a moving sum of nothing: where there is no signature, nothing is compared with one."""
    none = {name: array_in(window[name], f"state.{name}")[..., :0] for name in ("ends", "block", "begun")}
    return {name: array_out(value) for name, value in none.items()} | {"filled": window["filled"]}


# ----------------------------------------------------------------------------- before version 6


def _with_silent_rows(design: dict[str, Any], where: str) -> dict[str, Any]:
    """Return a design with zeros for what was rounding beside the largest entry of its residual in any signature."""
    if "subspaces" not in design:
        return design
    bases = {name: array_in(M, f"{where}.subspaces.{name}") for name, M in table_in(design["subspaces"], where).items()}
    if not bases or any(M.ndim != 2 for M in bases.values()) or len({len(M) for M in bases.values()}) > 1:
        return design  # what reads the signatures says what is wrong
    reach = np.array([np.abs(M).max(axis=1, initial=0.0) for M in bases.values()])
    seen = (reach > 1e-7 * reach.max(axis=0)) & (reach > 0)
    kept = {name: array_out(np.where(row[:, None], M, 0.0)) for row, (name, M) in zip(seen, bases.items(), strict=True)}
    return design | {"subspaces": kept}


def _with_plausible(content: dict[str, Any]) -> None:
    content |= {"plausible": TIMES, "start": "rest"}
    if content.get("running") is not None:
        content["running"] = table_in(content["running"], "running") | {
            "plausible": None,
            "first": None,
            "partial": None,
        }
    if content.get("state") is not None:
        state = table_in(content["state"], "state")
        plants = _plants(state)
        whole, flag = np.zeros(plants, dtype=np.int64), np.zeros(plants, dtype=bool)
        nothing = empty_partial(None, plants) | {"match_extra": np.zeros((plants, 0, 0))}
        if "match_sums" in state:  # of matched filters one column for each fault
            nothing["match_extra"] = np.zeros((plants, 0, 2 * array_in(state["match_sums"], "state").shape[-1]))
        new = {"broken": whole, "starting": flag, "start_sums": np.zeros((plants, 0)), "moved": np.zeros(plants)}
        content["state"] = state | {name: array_out(x) for name, x in (new | {"apart": flag} | nothing).items()}


def _plants(state: dict[str, Any]) -> int:
    return len(array_in(state["resets"], "state.resets", INDEX, 1)) if "resets" in state else 0


def _with_matched(content: dict[str, Any]) -> None:
    if content.get("running") is not None:
        content["running"] = table_in(content["running"], "running") | {"matched": None}
    if content.get("state") is not None:
        state = table_in(content["state"], "state")
        none = np.zeros((_plants(state), 0, 0))
        nothing = {
            "match_sums": none,
            "match_weights": none,
            "match_held": np.zeros((len(none), 0)),
            "match_extra": none,
        }
        content["state"] = state | {name: array_out(value) for name, value in nothing.items()}


def _with_promise(content: dict[str, Any]) -> None:
    """Fill in that nothing is promised by a test of a file of version 5 that was written before promises were."""
    if content.get("fitted") is not None:
        fitted = table_in(content["fitted"], "fitted")
        if "promised" not in fitted and "shrinkage" not in fitted:
            content["fitted"] = fitted | {"promised": None, "shrinkage": None}


def _with_kinds(content: dict[str, Any]) -> None:
    content["certified"] = {}
    for name in ("test", "fitted"):
        if content.get(name) is not None:
            content[name] = table_in(content[name], name) | {"kind": "norm"}
    if content.get("state") is not None:
        state = table_in(content["state"], "state")
        if "alarm" in state:
            alarm = array_in(state["alarm"], "state.alarm", FLAG)
            content["state"] = state | {"since": array_out(np.zeros(alarm.shape, dtype=np.int64))}


__all__ = ["OLDER", "renewed"]
