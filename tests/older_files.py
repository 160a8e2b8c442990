"""Files of monitors as earlier versions wrote them."""

from __future__ import annotations

from typing import Any

#: What came with version 6, by table; the empty name is that of the file.
_SIX = {
    "": ("plausible", "start"),
    "running": ("plausible", "first", "partial"),
    "state": ("broken", "starting", "start_sums", "moved", "apart", "spread", "bent", "match_extra"),
}


def as_version(version: int, content: dict[str, Any]) -> dict[str, Any]:
    """Take out of a file of today what came later than a version; it must hold nothing that only today has."""
    content["version"] = version
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
