"""Files of monitors as earlier versions wrote them."""

from __future__ import annotations

from typing import Any


def as_version(version: int, content: dict[str, Any]) -> dict[str, Any]:
    """Take out of a file of today what came later than a version; it must hold nothing that only today has."""
    content["version"] = version
    del content["checksum"]
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
