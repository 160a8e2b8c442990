"""User names as identifiers and comments of other languages."""

from __future__ import annotations

import re

from residua.errors import SettingError
from residua.visible import echo

_LONGEST = 60
#: Words that no language here takes as a name.
_RESERVED = frozenset(
    """
    auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main and or
    xor not mod program function var real lreal array of to by exit repeat until type end
    """.split()  # noqa: SIM905 - a list of so many words is no easier to read
)


def identifier(name: str, fallback: str = "monitor") -> str:
    """Return an identifier valid in every target: letters, digits and single underscores, a letter first."""
    made = re.sub(r"_+", "_", re.sub(r"[^0-9a-zA-Z]", "_", name)).strip("_").lower()[:_LONGEST].rstrip("_")
    made = made if made and made[0].isalpha() else f"{fallback}_{made}".rstrip("_")
    return f"{made}_1" if made in _RESERVED else made


def checked_identifier(name: object) -> str:
    """Return a requested prefix, if it is an identifier already."""
    if not isinstance(name, str) or identifier(name) != name.lower() or not name.isidentifier():
        wanted = identifier(str(name))
        raise SettingError(
            f"name must be letters, digits and single underscores, a letter first, and no word of a language, got "
            f"{echo(name)}: {wanted!r} would do"
        )
    return name


def comment_text(text: str) -> str:
    """Return a text that cannot end a comment and is one line of plain characters."""
    plain = re.sub(r"[^ -~]", "?", text.encode("ascii", "replace").decode("ascii"))
    for mark in ("*/", "/*", "(*", "*)", "??"):  # of comments, and of characters that C makes of three
        plain = plain.replace(mark, " ".join(mark))
    return plain.replace("\\", "/")


__all__ = ["checked_identifier", "comment_text", "identifier"]
