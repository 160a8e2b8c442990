"""Reading tables of text: comma, semicolon, tab or blanks between the cells, with or without a header line."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, FileFormatError
from residua.visible import echo

DELIMITERS = (",", ";", "\t")
BLANKS = " "
_DATE = re.compile(r"\d{1,4}([/.\-])\d{1,2}\1\d{1,4}(?!\d)")
#: How spreadsheets say what stands between the cells, in a line of its own before all others.
_SEPARATOR = re.compile(r"sep=([,;\t])", re.IGNORECASE)

#: What spreadsheets and loggers write where a value is missing, in lower case.
MISSING = frozenset(
    ["", "nan", "na", "n/a", "null", "none", "-nan", "#n/a", "#value!", "#div/0!", "#ref!", "#num!", "#name?", "#null!"]
)


@dataclass(frozen=True)
class CsvTable:
    """The lines of a table, with its header read.

    Attributes
    ----------
    source : str
    names : tuple of str
        Of the columns; numbers from 1 on where there is no header.
    delimiter : str
    lines : list of str
        Those with data.
    quoted : bool
    above : int
        Lines of the file before them.
    decimal : {".", ","}
    headed : bool
        Whether the file names its columns.
    """

    source: str
    names: tuple[str, ...]
    delimiter: str
    lines: list[str]
    quoted: bool
    above: int
    decimal: str
    headed: bool

    def numbers(self, wanted: Sequence[str]) -> dict[str, NDArray[np.float64]]:
        """Return columns of numbers; missing cells are NaN."""
        places = [self.names.index(name) for name in wanted]
        block = None if self.quoted else self._fast(places)
        if block is not None:
            return {name: block[:, i] for i, name in enumerate(wanted)}
        cells, rows = self._cells(places)
        return {
            name: _parsed(column, rows, self._at(name), self.decimal)
            for name, column in zip(wanted, cells, strict=True)
        }

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
        """Let NumPy read the whole table; ``None`` if it is not plain numbers."""
        separators = len(self.names) - 1
        lines = [line for line in self.lines if line]
        if not lines or any(line.count(self.delimiter) != separators for line in lines):
            return None
        if self.decimal == ",":
            if self.delimiter == "," or any("." in line for line in lines):
                return None
            lines = [line.replace(",", ".") for line in lines]
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
                line = reader.line_num + self.above
                if len(row) != len(self.names):
                    raise DataError(
                        f"{self.source}: line {line} has {len(row)} cells, the "
                        f"{'header' if self.headed else 'first'} has {len(self.names)}"
                    )
                numbers.append(line)
                for column, place in zip(columns, places, strict=True):
                    column.append(row[place])
        except csv.Error as error:
            raise FileFormatError(f"{self.source}: line {reader.line_num + self.above}: {error}") from error
        return columns, numbers


def open_csv(content: bytes, source: str, *, decimal: str = ".") -> CsvTable:
    """Find the separator and the header of a table of text.

    Parameters
    ----------
    content : bytes
    source : str
        What to call the file in messages.
    decimal : {".", ","}

    Raises
    ------
    DataError
        If there is nothing in it.
    FileFormatError
        If it is not text.
    """
    text = _decoded(content, source).replace("\r\n", "\n").replace("\r", "\n")
    if not text.strip():
        raise DataError(f"{source}: the file is empty")
    lines = text.split("\n")
    above = next(i for i, line in enumerate(lines) if line.strip())
    said = _SEPARATOR.fullmatch(lines[above].strip(" "))
    if said:
        above = next((i for i, line in enumerate(lines) if i > above and line.strip()), above)
    while above + 1 < len(lines) and _is_comment(lines[above]) and _is_comment(lines[above + 1]):
        above += 1  # of several lines of comment the last one may name the columns
    head = lines[above].lstrip()[1:].strip() if _is_comment(lines[above]) else lines[above]
    following = next((line for line in lines[above + 1 :] if line.strip()), "")
    if said:
        delimiter, names = said[1], tuple(name.strip() for name in next(csv.reader([head], delimiter=said[1]), []))
    else:
        delimiter, names = _separated(head, following, decimal)
    if delimiter == BLANKS:
        lines, delimiter = [*lines[: above + 1], *("\t".join(line.split()) for line in lines[above + 1 :])], "\t"
    while lines and not lines[-1].strip():
        lines.pop()
    headed = not names or not all(_is_number(name.replace(",", ".")) for name in names)
    if headed:
        if len(lines) < above + 2:
            raise DataError(f"{source}: there is a header but no data")
        return CsvTable(source, names, delimiter, lines[above + 1 :], '"' in text, above + 1, decimal, True)
    numbered = tuple(str(i + 1) for i in range(len(names)))
    data = [delimiter.join(names), *lines[above + 1 :]]
    return CsvTable(source, numbered, delimiter, data, '"' in text, above, decimal, False)


def _is_comment(line: str) -> bool:
    return line.lstrip()[:1] in ("#", "%")


def _separated(head: str, following: str, decimal: str) -> tuple[str, tuple[str, ...]]:
    """Return what stands between the cells, and those of the first line.

    What makes the most of them; blanks only where nothing else separates any, and as many in the line that follows. A
    decimal comma separates no numbers.
    """
    rows = {d: next(csv.reader([head], delimiter=d), []) for d in DELIMITERS if not (d == "," and decimal == ",")}
    if decimal == "," and max(map(len, rows.values())) < 2:
        quoted = next(csv.reader([head]), [])
        if not all(_is_number(cell) for cell in quoted):
            rows[","] = quoted
    delimiter = max(rows, key=lambda d: len(rows[d]))
    if len(rows[delimiter]) < 2 and 1 < len(head.split()) == len(following.split() or head.split()):
        return BLANKS, tuple(head.split())
    return delimiter, tuple(name.strip() for name in rows[delimiter])


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


def _parsed(cells: list[str], rows: list[int], what: str, decimal: str) -> NDArray[np.float64]:
    out = np.empty(len(cells))
    for i, cell in enumerate(cells):
        text = cell.strip()
        if decimal == ",":
            number = "" if "." in text else text.replace(",", ".")
        else:
            number = text
        try:
            out[i] = float(number)
        except ValueError:
            if text.lower() not in MISSING:
                raise DataError(
                    f"{what}, line {rows[i]}: expected a number, got {echo(cell)}{_advice(text, decimal)}"
                ) from None
            out[i] = np.nan
    return out


def _advice(text: str, decimal: str) -> str:
    """Ask about commas and points in what would be a number without them, and about dates."""
    if _DATE.match(text):
        return "; if these are the times, name the column by time="
    if not ({",", "."} & set(text)) or not _is_number(text.replace(".", "").replace(",", "")):
        return ""
    if "," in text and "." in text:
        return "; of a comma and a point in one number the first separates thousands: write the numbers without it"
    if decimal == ",":
        return "; decimal=',' was asked for, and a point then is none"
    return "; if its comma is a decimal comma, say decimal=','; if it separates thousands, write the numbers without it"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
