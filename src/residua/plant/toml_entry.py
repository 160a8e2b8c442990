"""Checked access to the entries of a TOML file, with errors that point at the entry."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.arrays import LARGEST
from residua.errors import FileFormatError
from residua.number_kinds import kind_of
from residua.visible import MAX_ECHO, echo, listed, shortened


class Entry:
    """One table of the file: its values, its place, and its allowed keys.

    Parameters
    ----------
    data : dict
        As ``tomllib`` returns it.
    source : str
        Name of the file, for messages.
    path : str
        Where the table stands, such as ``"faults[2]"``; empty for the file itself.
    keys : sequence of str
        The keys that are allowed.
    """

    def __init__(self, data: Any, source: str, path: str, keys: Sequence[str]) -> None:
        self.data, self.source, self.path = data, source, path
        if not isinstance(data, dict):
            raise FileFormatError(f"{source}: {path}: expected a table, got {kind_of(data)}")
        for key in data:
            if key not in keys:
                raise self.error(key, f"unknown entry{suggestion(key, keys)}; known here: {listed(keys)}")

    def where(self, key: str = "") -> str:
        """Return the full name of an entry."""
        return ".".join(part for part in (self.path, key) if part)

    def error(self, key: str, message: str) -> FileFormatError:
        """Return the error that points at an entry of this table."""
        name = self.data.get("name")
        named = f" (in {echo(name)})" if self.path and isinstance(name, str) and key != "name" else ""
        return FileFormatError(f"{self.source}: {shortened(self.where(key))}: {message}{named}")

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def table(self, key: str, keys: Sequence[str]) -> Entry:
        """Return a table, empty if it is absent."""
        return Entry(self.data.get(key, {}), self.source, self.where(key), keys)

    def tables(self, key: str, keys: Sequence[str]) -> list[Entry]:
        """Return an array of tables, empty if it is absent."""
        items = self.data.get(key, [])
        if not isinstance(items, list):
            raise self.error(key, f"expected tables under [[{key}]], got {kind_of(items)}")
        return [Entry(item, self.source, f"{self.where(key)}[{i}]", keys) for i, item in enumerate(items)]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string; required without a default."""
        value = self._get(key, default)
        if not isinstance(value, str):
            raise self.error(key, f"expected text in quotes, got {kind_of(value)}")
        return value

    def choice(self, key: str, known: Sequence[str], default: str | None = None) -> str:
        """Return one of several words."""
        value = self.text(key, default)
        if value not in known:
            raise self.error(key, f"expected one of {', '.join(map(repr, known))}; got {echo(value)}")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number of at most ``LARGEST`` in size."""
        return self._number(self._get(key, default), key)

    def texts(self, key: str, count: int | None, each: str) -> tuple[str, ...] | None:
        """Return a list of strings (any number of them for a count of ``None``), ``None`` if it is absent."""
        if key not in self:
            return None
        items = self.data[key]
        if not isinstance(items, list) or not all(isinstance(item, str) for item in items):
            raise self.error(key, f"expected a list of texts, got {kind_of(items)}")
        if count is not None and len(items) != count:
            raise self.error(key, f"expected {count} texts ({each}), got {len(items)}")
        return tuple(items)

    def pairs(self, key: str) -> list[tuple[str, str]]:
        """Return a list of pairs of strings, empty if it is absent."""
        items = self.data.get(key, [])
        if not isinstance(items, list) or not all(isinstance(item, list) and len(item) == 2 for item in items):
            raise self.error(key, f'expected pairs of texts, [["...", "..."]], got {kind_of(items)}')
        if not all(isinstance(text, str) for item in items for text in item):
            raise self.error(key, "expected pairs of texts")
        return [(item[0], item[1]) for item in items]

    def by_channel(self, key: str, channels: tuple[str, ...], each: str) -> NDArray[np.float64] | None:
        """Return one number per channel from a list or a table by name, ``None`` if it is absent."""
        if key not in self:
            return None
        value = self.data[key]
        if isinstance(value, dict):
            out = np.zeros(len(channels))
            for name, entry in value.items():
                where = f"{key}.{name}"
                if name not in channels:
                    raise self.error(where, f"unknown name{suggestion(name, channels)}; known: {listed(channels)}")
                out[channels.index(name)] = self._number(entry, where)
            return out
        if not isinstance(value, list):
            raise self.error(key, f"expected a list of numbers ({each}) or a table by name, got {kind_of(value)}")
        if len(value) != len(channels):
            raise self.error(key, f"expected {len(channels)} numbers ({each}), got {len(value)}")
        return np.array([self._number(item, f"{key}[{i}]") for i, item in enumerate(value)], dtype=float)

    def matrix(self, key: str, rows: int | None, columns: int | None, each: str) -> NDArray[np.float64] | None:
        """Return a matrix written as a list of rows, ``None`` if it is absent."""
        if key not in self:
            return None
        value = self.data[key]
        if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
            raise self.error(key, f"expected a matrix as a list of rows, [[...], [...]], got {kind_of(value)}")
        if rows is not None and len(value) != rows:
            raise self.error(key, f"expected {rows} rows ({each}), got {len(value)}")
        width = columns if columns is not None else len(value[0]) if value else 0
        for i, row in enumerate(value):
            if len(row) != width:
                why = each if columns is not None else f"as many as in {key}[0]"
                raise self.error(f"{key}[{i}]", f"expected {width} numbers ({why}), got {len(row)}")
        numbers = [[self._number(x, f"{key}[{i}][{j}]") for j, x in enumerate(r)] for i, r in enumerate(value)]
        return np.array(numbers, dtype=float).reshape(len(value), width)

    def _get(self, key: str, default: Any) -> Any:
        value = self.data.get(key, default)
        if value is None:
            raise self.error(key, "this entry is required")
        return value

    def _number(self, value: Any, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(where, f"expected a number, got {kind_of(value)}")
        try:
            out = float(value)
        except OverflowError:
            out = math.inf
        if not math.isfinite(out):
            raise self.error(where, f"every number must be finite, got {out}")
        if abs(out) > LARGEST:
            raise self.error(where, f"every number must be at most {LARGEST:g} in size, got {out:g}")
        return out


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return ``" 'x' (did you mean 'y'?)"``, or the name alone without a near one."""
    lowered = {k.lower(): k for k in known}
    near = difflib.get_close_matches(name.lower(), lowered, n=1) if len(name) <= MAX_ECHO else []
    return f" {echo(name)} (did you mean {echo(lowered[near[0]])}?)" if near else f" {echo(name)}"
