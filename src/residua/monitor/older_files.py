"""Files of earlier versions as files of today."""

from __future__ import annotations

from typing import Any

import numpy as np

from residua.errors import FileFormatError
from residua.json_files import CHECKSUM
from residua.monitor.encoding import array_in, array_out, table_in
from residua.monitor.judging import empty_fields
from residua.number_kinds import FLAG, INDEX

#: Versions before today's that are read.
OLDER = (3, 4, 5)


def renewed(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a file of version 3 to 6 as one of version 6.

    In a file of version 3 nothing was matched with responses; before version 5 every test was of the norm, and when a
    standing alarm began was not known: it stays so until it ends. ``bounds`` are an entry of version 5 only where there
    are any. A file from before version 6 has no checksum, and in its signatures rounding where there are zeros now: in
    the rows of residuals that a fault does not reach.
    """
    content = {"bounds": {}} | content
    if content["version"] == 3:
        _with_matched(content)
    if content["version"] in (3, 4):
        _with_kinds(content)
    if content["version"] in OLDER:
        if CHECKSUM in content:
            raise FileFormatError(f"the entry {CHECKSUM!r} is unknown in version {content['version']}")
        content[CHECKSUM] = None
        for name in ("design", "sampled"):
            if content.get(name) is not None:
                content[name] = _with_silent_rows(table_in(content[name], name), name)
    _with_promise(content)
    return content


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


def _with_matched(content: dict[str, Any]) -> None:
    if content.get("running") is not None:
        content["running"] = table_in(content["running"], "running") | {"matched": None}
    if content.get("state") is not None:
        state = table_in(content["state"], "state")
        plants = len(array_in(state["resets"], "state.resets", INDEX, 1)) if "resets" in state else 0
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
            alarm = array_in(state["alarm"], "state.alarm", FLAG)
            content["state"] = state | {"since": array_out(np.zeros(alarm.shape, dtype=np.int64))}


__all__ = ["OLDER", "renewed"]
