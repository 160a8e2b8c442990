"""Files of monitors as earlier versions wrote them."""

from __future__ import annotations

from typing import Any

#: What came with version 6, by table; the empty name is that of the file.
_SIX = {
    "": ("plausible", "start"),
    "running": ("plausible", "first", "partial"),
    "state": ("broken", "starting", "start_sums", "moved", "apart", "spread", "bent", "match_extra"),
}


def _read_windows(state: Any) -> Any:
    """Keep of every moving sum what it has read, and count all plants together, as before version 8."""
    if not isinstance(state, dict) or "shape" in state:
        return state
    if set(state) == {"values", "begun", "filled"}:
        counts = state["filled"]["int"]
        return {"ends": state["values"], "block": state["values"], "begun": state["begun"], "filled": counts[0]}
    return {name: _read_windows(entry) for name, entry in state.items()}


def _hold_outputs(content: dict[str, Any]) -> None:
    """Hold the last values of the outputs of a Kalman filter, and an alarm behind sums, as before version 9."""
    test = content["state"]["test"]
    if content["test"]["kind"] == "cusum":
        (plants, count), sums, alarm = test["sums"]["shape"], test["sums"]["float"], test["runs"]["alarm"]["bool"]
        rows = [sums[k * count : (k + 1) * count] + [float(alarm[k])] for k in range(plants)]
        test["sums"] = {"shape": [plants, count + 1], "float": [value for row in rows for value in row]}
    partial = content["running"]["partial"]
    if partial is None:
        return
    held, outputs = content["state"]["filter"]["held"], partial["settled"]["shape"][0]
    (plants, inputs), values = held["shape"], held["float"]
    rows = [values[k * inputs : (k + 1) * inputs] + [0.5] * outputs for k in range(plants)]
    held |= {"shape": [plants, inputs + outputs], "float": [value for row in rows for value in row]}


_WINDOW, _RUNS = ("ends", "block", "begun", "filled"), ("up", "down", "alarm")


def _flat(content: dict[str, Any]) -> None:
    """Put what runs and its state into one flat table each, as before version 7."""
    fitted, running, state = content["fitted"], content["running"], content["state"]
    kind = "" if content["isolate"] is None else content["isolate"]["kind"]
    if running is not None:
        isolation = running.pop("isolation")
        running |= dict.fromkeys(("direction", "codes", "matched"))
        if kind == "matched":
            running["matched"] = fitted.pop("matched")
        elif kind == "code":
            del isolation["at_once"], fitted["names"]
            running["codes"] = isolation
        elif kind:
            running["direction"] = isolation
    if state is None:
        return
    test, isolation, empty = state["test"], state["isolation"], {"shape": [1, 0, 0], "float": []}
    flat = state["filter"] | test["runs"] | {"count": state["count"], "since": test["runs"]["up"]}
    flat |= {f"match_{name}": empty for name in ("sums", "weights", "held", "extra")}
    flat |= {f"test_{name}": test["window"][name] for name in _WINDOW}
    judged = isolation
    if kind == "code":
        judged, flat["since"] = isolation["window"], isolation["since"]
    elif kind == "matched":
        judged, flat["match_held"] = test["window"], isolation["held"]
        flat |= {f"match_{name}": entry for name, entry in test["match"].items()}
    flat |= {name: judged[name] for name in _WINDOW}
    content["state"] = flat


def as_version(version: int, content: dict[str, Any]) -> dict[str, Any]:
    """Take out of a file of today what came later than a version; it must hold nothing that only today has."""
    content["version"] = version
    if content["state"] is not None:
        _hold_outputs(content)
    if version == 8:
        content["checksum"] = None
        return content
    if content["state"] is not None:
        content["state"] = _read_windows(content["state"]) | {"count": content["state"]["count"]["int"][0]}
    if version == 7:
        content["checksum"] = None
        return content
    _flat(content)
    if version == 6:
        content["checksum"] = None
        return content
    del content["checksum"]
    for table, names in _SIX.items():
        entries = content[table] if table else content
        if entries is not None:
            for name in names:
                del entries[name]
    if version == 5:
        return content
    del content["certified"], content["test"]["kind"]
    if content["fitted"] is not None:
        del content["fitted"]["kind"]
    if content["state"] is not None:
        del content["state"]["since"]
    if version == 3:
        if content["running"] is not None:
            del content["running"]["matched"]
        for name in ("match_sums", "match_weights", "match_held") if content["state"] is not None else ():
            del content["state"][name]
    return content
