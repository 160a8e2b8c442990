"""Figures as a table: for printing, as columns, or as a data frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from residua.errors import MissingExtraError, SettingError
from residua.shown import Bar, Shown, table
from residua.validate.intervals import Estimate
from residua.visible import echo
from residua.words import number


@dataclass(frozen=True, repr=False)
class FigureTable(Shown):
    """A table of figures. Prints with columns in line.

    Attributes
    ----------
    header : tuple of str
    rows : tuple of tuple
        Texts, numbers and :class:`Estimate`.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def columns(self) -> dict[str, list[Any]]:
        """Return the columns by name; an estimate has three: its value, ``low`` and ``high``."""
        out: dict[str, list[Any]] = {}
        for k, name in enumerate(self.header):
            values = [row[k] for row in self.rows]
            if not any(isinstance(value, Estimate) for value in values):
                out[name] = values
                continue
            for part, suffix in (("value", ""), ("low", " low"), ("high", " high")):
                out[name + suffix] = [getattr(value, part, value) for value in values]
        return out

    def to_frame(self, backend: str = "pandas") -> Any:
        """Return the columns as a data frame.

        Parameters
        ----------
        backend : {"pandas", "polars"}

        Raises
        ------
        MissingExtraError
            If that package is not installed.
        """
        if backend not in ("pandas", "polars"):
            raise SettingError(f"backend must be 'pandas' or 'polars', got {echo(backend)}")
        try:
            module = __import__(backend)
        except ImportError as error:
            raise MissingExtraError(f"this needs the package {echo(backend)}: pip install {backend}") from error
        return module.DataFrame(self.columns())

    def cells(self) -> list[list[str]]:
        """Return the rows as text."""
        return [[_text(value) for value in row] for row in self.rows]

    def _headline(self) -> str:
        return f"{len(self.rows)} rows of {', '.join(self.header)}"

    def _parts(self) -> list[str]:
        rows = [[_cell(name, value) for name, value in zip(self.header, row, strict=True)] for row in self.rows]
        return [table(self.header, rows)]

    def __str__(self) -> str:
        lines: Sequence[Sequence[str]] = [self.header, *self.cells()]
        width = [max(len(line[c]) for line in lines) for c in range(len(self.header))]
        joined = ("  ".join(cell.ljust(w) for cell, w in zip(line, width, strict=True)) for line in lines)
        return "\n".join(line.rstrip() for line in joined)


def _cell(name: str, value: Any) -> Any:
    """Return a cell for a notebook: shares with a bar."""
    is_share = isinstance(value, Estimate) and not name.endswith("]") and 0 <= value.value <= 1
    return Bar(value.value, str(value)) if is_share else value


def _text(value: Any) -> str:
    return number(value) if isinstance(value, float) else str(value)
