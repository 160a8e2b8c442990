"""Text from files and names for messages: short, with every control character shown instead of sent."""

from __future__ import annotations

import re

#: Characters of a file that a message repeats at most.
MAX_ECHO = 200

#: Control characters (a terminal obeys them), line separators, and marks that turn the direction of writing.
_CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufeff]")


def visible(text: str) -> str:
    r"""Return a text with control characters as escapes, such as ``\x1b``; line ends stay.

    Examples
    --------
    >>> from residua.visible import visible
    >>> print(visible("\x1b[2Jname"))
    \x1b[2Jname
    """
    return _CONTROL.sub(_escape, text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def shortened(text: str, most: int = MAX_ECHO) -> str:
    """Return a text of at most that many characters: its beginning, and three dots if it was longer."""
    return text if len(text) <= most else text[: max(most - 3, 0)] + "..."


def echo(value: object, most: int = MAX_ECHO) -> str:
    """Return a value from a file for a message: as Python writes it, short, on one line."""
    if isinstance(value, str):  # of a text of a gigabyte only the shown part is formatted
        value = value[: most + 1]
    return shortened(visible(repr(value)), most)


def listed(names: object, most: int = MAX_ECHO) -> str:
    """Return names separated by commas, of limited total length; ``none`` without any."""
    out = ""
    for name in names if isinstance(names, (list, tuple, dict, set, frozenset)) else ():
        out += (", " if out else "") + visible(str(name)[: most + 1])
        if len(out) > most:
            break
    return shortened(out, most) or "none"
