"""Damage to files, seeded: to their bytes, to their numbers and words, and to what they hold as tables."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable
from typing import Any

#: A text that no message may repeat as a whole, and one that a terminal would obey.
LONG, ESCAPE = "Z" * 5000, "\x1b[2J\x1b]0;title\x07"

_WORDS = r"""
nan inf -inf NaN Infinity -Infinity 1e308 -1e308 1.8e308 1e309 1e400 1e300 1e154 5e-324 1e-300 -1 0 -0.0 1 2 0.5 1e9
1e18 9223372036854775807 9223372036854775808 18446744073709551616 -9223372036854775809 1000000000 4294967296 null true
false "nan" "inf" "text" "" [] {} [[]] [1,2] {"a":1} 0x7f 1_000 1. .5 +1 1e 2026-11-22 "\u0000" "\ud800" 'a' # , : "
"""
#: What stands in place of a number or another entry, as it is written in a file.
WORDS = [
    *_WORDS.split(),
    *("9" * 400, "9" * 5000, f'"{LONG}"', f'"{ESCAPE}"', "[" * 3000, "[" * 200 + "]" * 200, '{"a":' * 500, LONG),
]

#: The same as values of a table of JSON.
VALUES: list[Any] = [
    *("nan", "inf", "-inf", "text", "", "0x1p+2000", "0x1.8p+0", LONG, ESCAPE, "\ud800", "\x00"),
    *(
        1e308,
        -1e308,
        1e300,
        1e154,
        1e100,
        5e-324,
        -1,
        0,
        -0.0,
        1,
        2,
        0.5,
        3.7,
        10**6,
        10**9,
        10**18,
        2**63,
        -(2**63) - 1,
    ),
    *(10**400, None, True, False, [], {}, [[]], [1, 2], [[1.0]], {"a": 1}, {"shape": [1], "float": [1.0]}),
]

_NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def damaged_bytes(rng: random.Random, content: bytes) -> bytes:
    """Return a content with one to five places damaged: cut, flipped, swapped, filled, doubled, left out."""
    out = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        if not out:
            break
        i, n = rng.randrange(len(out)), rng.choice((1, 2, 4, 8, 64))
        how = rng.randrange(10)
        if how <= 2:
            out[i] ^= 1 << rng.randrange(8)
        elif how == 3:
            out[i] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
        elif how == 4:
            j = rng.randrange(len(out))
            out[i], out[j] = out[j], out[i]
        elif how == 5:
            out[i:i] = rng.randbytes(n)
        elif how == 6:
            del out[i : i + n]
        elif how == 7:
            out[i : i + n] = out[i : i + n][::-1]
        elif how == 8:
            out[i : i + n] = rng.choice((b"\0", b"\xff", b"\x7f")) * n
        elif rng.random() < 0.5:
            del out[i:]
        else:
            out[i:i] = out[rng.randrange(len(out)) :][: 4 * n]
    return bytes(out)


def damaged_text(rng: random.Random, content: bytes) -> bytes:
    """Return a text with one number or word replaced, or a line doubled, left out or moved."""
    text = content.decode("utf-8")
    how = rng.randrange(6)
    if how <= 3:
        places = list(_NUMBER.finditer(text)) if how <= 2 else list(re.finditer(r'"[^"]*"|[A-Za-z_]+', text))
        if places:
            place = rng.choice(places)
            text = text[: place.start()] + rng.choice(WORDS) + text[place.end() :]
    else:
        lines = text.split("\n")
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        if how == 4:
            lines.insert(j, lines[i])
        elif rng.random() < 0.5:
            del lines[i]
        else:
            lines[i], lines[j] = lines[j], lines[i]
        text = "\n".join(lines)
    return text.encode("utf-8", "surrogatepass")


def damaged_table(rng: random.Random, content: bytes, keep: Callable[[dict[str, Any]], None] | None = None) -> bytes:
    """Return a JSON file with one entry replaced, changed in size, left out, renamed, moved or written twice.

    ``keep`` sets what is not to be damaged.
    """
    table = json.loads(content)
    place, key = _entry(rng, table)
    how, twice = rng.randrange(13), ""
    if how >= 10 and type(place[key]) in (int, float):  # a number like any other
        place[key] *= rng.choice((-1, 2, 10, 1000, 10**6, 10**12, 1.01, 0.5, 1e-3, 1e-12))
    elif how <= 5 or how >= 10:
        place[key] = rng.choice(VALUES)
    elif how == 6:
        del place[key]
    elif how == 7:
        other, there = _entry(rng, table)
        place[key], other[there] = other[there], place[key]
    elif how == 8 and isinstance(place, dict):
        place[rng.choice((LONG, ESCAPE, "", key + " "))] = place.pop(key)
    elif isinstance(place, list):
        place.insert(key, rng.choice(VALUES))
    else:
        twice = str(key)
    if keep is not None:
        keep(table)
    try:
        text = json.dumps(table)
    except (ValueError, RecursionError):  # a table that was moved into itself
        return content[: rng.randrange(len(content))]
    if twice:
        text = text.replace(f'"{twice}":', f'"{twice}": {json.dumps(rng.choice(VALUES[:20]))}, "{twice}":', 1)
    return text.encode()


def _entry(rng: random.Random, table: Any) -> tuple[Any, Any]:
    """Return a table or list somewhere, and the name or number of one of its entries."""
    place = table
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = rng.choice(keys)
        inner = place[key]
        if not isinstance(inner, (dict, list)) or not inner or rng.random() < 0.1:
            return place, key
        place = inner
