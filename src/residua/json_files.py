"""JSON files of the package: one table, no repeated entries, and a checksum of the content.

A single changed digit can make a monitor blind and still be a number like any other. So what is written carries a
checksum of its content; reading compares it. Who edits a file on purpose writes ``"checksum": null``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, NoReturn

from residua.errors import FileFormatError
from residua.visible import echo

#: The entry with the checksum.
CHECKSUM = "checksum"


def loads(content: bytes, source: str) -> dict[str, Any]:
    """Return the table in a JSON file, empty if the file holds something else.

    NaN and infinity, which are not JSON, are refused, and so is an entry that occurs twice.
    """

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"it holds {constant}, which JSON does not have")

    try:
        found = json.loads(content.decode("utf-8"), parse_constant=refuse, object_pairs_hook=_table)
    except RecursionError as error:
        raise FileFormatError(f"{source} is not JSON: nested too deeply") from error
    except ValueError as error:  # also text that is not UTF-8, and integers without end
        is_cut = isinstance(error, json.JSONDecodeError) and (
            error.pos >= len(error.doc) or "Unterminated" in error.msg
        )
        advice = "; it ends there: it is cut short, copy it again or take another one" if is_cut else ""
        raise FileFormatError(f"{source} is not JSON: {error}{advice}") from error
    return found if isinstance(found, dict) else {}


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the entry {echo(next(name for name in names if names.count(name) > 1))} occurs twice")
    return out


def dumps(content: Mapping[str, Any]) -> str:
    """Return the text of a JSON file with the checksum of its content as last entry."""
    return json.dumps({**content, CHECKSUM: checksum(content)}, allow_nan=False) + "\n"


def checksum(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a content, without its own entry; the order of entries counts, their layout does not."""
    rest = {name: value for name, value in content.items() if name != CHECKSUM}
    text = json.dumps(rest, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def check_checksum(content: Mapping[str, Any], source: str) -> bool:
    """Return whether the checksum matches, or ``False`` if the file says that it was edited.

    Raises
    ------
    FileFormatError
        If the checksum is another one.
    """
    recorded = content.get(CHECKSUM)
    if recorded is None and CHECKSUM in content:
        return False
    try:
        same = recorded == checksum(content)
    except (ValueError, RecursionError):  # a number beyond all numbers, which dumps never wrote
        same = False
    if not same:
        raise FileFormatError(
            f"{source}: its content is not what was saved (the entry {CHECKSUM!r} does not fit): the file is damaged, "
            f'or was edited. Take a copy that is whole; if it was edited on purpose, write "{CHECKSUM}": null in it, '
            "and what it does will say so"
        )
    return True
