"""Files of earlier versions as files of today."""

from __future__ import annotations

from typing import Any

import numpy as np

from residua.monitor.encoding import array_in, array_out, table_in
from residua.monitor.judging import empty_fields

#: Versions before today's that are read.
OLDER = (3, 4)


def renewed(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a file of version 3 or 4 as one of version 5.

    In a file of version 3 nothing was matched with responses; before version 5 every test was of the norm, and when a
    standing alarm began was not known: it stays so until it ends. ``bounds`` are an entry of version 5 only where there
    are any.
    """
    content = {"bounds": {}} | content
    if content["version"] == 3:
        _with_matched(content)
    if content["version"] in OLDER:
        _with_kinds(content)
    _with_promise(content)
    return content


def _with_matched(content: dict[str, Any]) -> None:
    if content.get("running") is not None:
        content["running"] = table_in(content["running"], "running") | {"matched": None}
    if content.get("state") is not None:
        state = table_in(content["state"], "state")
        plants = len(array_in(state["resets"], "state.resets")) if "resets" in state else 0
        nothing = empty_fields(None, plants)
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
            alarm = array_in(state["alarm"], "state.alarm")
            content["state"] = state | {"since": array_out(np.zeros(alarm.shape, dtype=np.int64))}


__all__ = ["OLDER", "renewed"]
