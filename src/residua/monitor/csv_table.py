"""Reading tables of text: comma, semicolon or tab between the cells, one header line."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, FileFormatError
from residua.visible import echo

DELIMITERS = (",", ";", "\t")

#: What spreadsheets and loggers write where a value is missing, in lower case.
MISSING = frozenset(
    ["", "nan", "na", "n/a", "null", "none", "-nan", "#n/a", "#value!", "#div/0!", "#ref!", "#num!", "#name?", "#null!"]
)


@dataclass(frozen=True)
class CsvTable:
    """The lines of a table, with its header read."""

    source: str
    names: tuple[str, ...]
    delimiter: str
    lines: list[str]
    quoted: bool

    def numbers(self, wanted: Sequence[str]) -> dict[str, NDArray[np.float64]]:
        """Return columns of numbers; missing cells are NaN."""
        places = [self.names.index(name) for name in wanted]
        block = None if self.quoted else self._fast(places)
        if block is not None:
            return {name: block[:, i] for i, name in enumerate(wanted)}
        cells, rows = self._cells(places)
        comma = self.delimiter != ","
        return {name: _parsed(column, rows, self._at(name), comma) for name, column in zip(wanted, cells, strict=True)}

    def texts(self, name: str) -> tuple[list[str], list[int]]:
        """Return one column as text, with the line of the file that each cell is from."""
        cells, rows = self._cells([self.names.index(name)])
        return cells[0], rows

    def first(self, name: str) -> str:
        """Return the first cell of a column."""
        row = next(csv.reader(self.lines[:1], delimiter=self.delimiter))
        place = self.names.index(name)
        return row[place].strip() if place < len(row) else ""

    def _at(self, name: str) -> str:
        return f"{self.source}: column {echo(name)}"

    def _fast(self, places: list[int]) -> NDArray[np.float64] | None:
        """Let NumPy read the whole table; ``None`` where it is not plain numbers."""
        separators = len(self.names) - 1
        lines = [line for line in self.lines if line]
        if not lines or any(line.count(self.delimiter) != separators for line in lines):
            return None
        if self.delimiter != "," and any("," in line for line in lines[:100]):
            lines = [line.replace(",", ".") for line in lines]  # decimal commas
        try:
            return np.loadtxt(lines, delimiter=self.delimiter, comments=None, usecols=places, ndmin=2)
        except ValueError:
            return None

    def _cells(self, places: list[int]) -> tuple[list[list[str]], list[int]]:
        columns: list[list[str]] = [[] for _ in places]
        numbers = []
        reader = csv.reader(self.lines, delimiter=self.delimiter)
        try:
            for row in reader:
                if not any(cell.strip() for cell in row) and len(row) <= 1:
                    continue
                line = reader.line_num + 1
                if len(row) != len(self.names):
                    raise DataError(
                        f"{self.source}: line {line} has {len(row)} cells, the header has {len(self.names)}"
                    )
                numbers.append(line)
                for column, place in zip(columns, places, strict=True):
                    column.append(row[place])
        except csv.Error as error:
            raise FileFormatError(f"{self.source}: line {reader.line_num + 1}: {error}") from error
        return columns, numbers


def open_csv(content: bytes, source: str) -> CsvTable:
    """Find the separator and the header of a table of text.

    Parameters
    ----------
    content : bytes
    source : str
        What to call the file in messages.

    Raises
    ------
    DataError
        If there is nothing in it, or the first line is no header.
    FileFormatError
        If it is not text.
    """
    text = _decoded(content, source).replace("\r\n", "\n").replace("\r", "\n")
    if not text.strip():
        raise DataError(f"{source}: the file is empty")
    lines = text.split("\n")
    header = max((next(csv.reader(lines[:1], delimiter=d), []) for d in DELIMITERS), key=len)
    delimiter = next(d for d in DELIMITERS if next(csv.reader(lines[:1], delimiter=d), []) == header)
    names = tuple(name.strip() for name in header)
    if not names or all(_is_number(name) for name in names):
        raise DataError(f"{source}: the first line must name the columns, it holds {echo(lines[0], 60)}")
    while lines and not lines[-1].strip():
        lines.pop()
    if len(lines) < 2:
        raise DataError(f"{source}: there is a header but no data")
    return CsvTable(source, names, delimiter, lines[1:], '"' in text)


def _decoded(content: bytes, source: str) -> str:
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    else:
        encoding = "utf-8-sig"
        if b"\x00" in content[:4096]:
            raise FileFormatError(f"{source}: not a table of text (it holds binary data)")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError:
        return content.decode("latin-1")  # never fails; Windows programs write cm³ this way


def _parsed(cells: list[str], rows: list[int], what: str, comma: bool) -> NDArray[np.float64]:
    out = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            out[i] = float(cell)
        except ValueError:
            text = cell.strip().lower()
            if text in MISSING:
                out[i] = np.nan
            elif comma and _is_number(text.replace(",", ".")):
                out[i] = float(text.replace(",", "."))
            else:
                raise DataError(f"{what}, line {rows[i]}: expected a number, got {echo(cell)}") from None
    return out


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
