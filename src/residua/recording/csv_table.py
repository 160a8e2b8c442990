"""Reading tables of text: comma, semicolon, tab or blanks between the cells, with or without a header line."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, FileFormatError
from residua.recording import csv_arrow
from residua.recording.missing import Marks, Tally
from residua.visible import echo

DELIMITERS = (",", ";", "\t")
BLANKS = " "
_DATE = re.compile(r"\d{1,4}([/.\-])\d{1,2}\1\d{1,4}(?!\d)")
#: Declaration of the separator by spreadsheets, in a first line of its own.
_SEPARATOR = re.compile(r"sep=([,;\t])", re.IGNORECASE)
#: Characters in which the header is looked for before all lines are.
_BEGINNING = 1 << 16


@dataclass(frozen=True)
class CsvTable:
    """The lines of a table, with its header read.

    Attributes
    ----------
    source : str
    names : tuple of str
        Of the columns; numbers from 1 on where there is no header.
    delimiter : str
    body : str
        The lines with data.
    above : int
        Lines of the file before them.
    decimal : {".", ","}
    headed : bool
        Whether the file names its columns.
    blanks : bool
        Whether blanks stood between the cells, which are tabs in ``body``.
    """

    source: str
    names: tuple[str, ...]
    delimiter: str
    body: str
    above: int
    decimal: str
    headed: bool
    blanks: bool = False

    @cached_property
    def lines(self) -> list[str]:
        """The lines with data, one by one."""
        return self.body.split("\n")

    @cached_property
    def _bytes(self) -> csv_arrow.Body | None:
        """Data lines as pyarrow reads them; ``None`` if it does not, or not the same."""
        return csv_arrow.served(self.body, len(self.names), self.delimiter, self.decimal)

    def numbers(
        self, wanted: Sequence[str], marks: Marks, tally: Tally, *, optional: bool = False
    ) -> dict[str, NDArray[np.float64]]:
        """Return columns of numbers; missing cells are NaN, and marks of them are counted.

        Columns that hold nothing but text are left out where they are ``optional``.
        """
        places = [self.names.index(name) for name in wanted]
        block = self._bytes.numbers(places, marks) if self._bytes is not None else None
        if block is not None and self._bytes is not None:
            for name, place, values in zip(wanted, places, block, strict=True):
                if np.isnan(values).any():
                    self._bytes.count_marks(place, marks, name, tally)
            return dict(zip(wanted, block, strict=True))
        block = None if '"' in self.body else self._fast(places)
        if block is not None:
            return {name: block[:, i] for i, name in enumerate(wanted)}
        cells, rows = self._cells(places)
        out = {}
        for name, column in zip(wanted, cells, strict=True):
            parsed = _parsed(column, rows, f"{self.source}: column {echo(name)}", self.decimal, marks)
            if isinstance(parsed, DataError):
                if not optional or not is_text(column, marks):
                    raise parsed
                continue
            out[name] = parsed[0]
            for cell, count in parsed[1].items():
                tally.add(cell, name, count)
        return out

    @property
    def first_line(self) -> str:
        """The first line with data."""
        end = self.body.find("\n")
        return self.body[:end] if end >= 0 else self.body

    def texts(self, name: str) -> tuple[list[str], Sequence[int]]:
        """Return one column as text, with the line number of each cell in the file."""
        cells = self._bytes.texts(self.names.index(name)) if self._bytes is not None else None
        if cells is not None:
            return cells, range(self.above + 1, self.above + 1 + len(cells))
        columns, rows = self._cells([self.names.index(name)])
        return columns[0], rows

    def first(self, name: str) -> str:
        """Return the first cell of a column."""
        row = next(csv.reader([self.first_line], delimiter=self.delimiter))
        place = self.names.index(name)
        return row[place].strip() if place < len(row) else ""

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
        Name of the file in messages.
    decimal : {".", ","}

    Raises
    ------
    DataError
        If there is nothing in it.
    FileFormatError
        If it is not text.
    """
    encoding = "utf-16" if content.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
    if encoding != "utf-16" and b"\x00" in content[:4096]:
        raise FileFormatError(f"{source}: not a table of text (it holds binary data): export it as CSV in UTF-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # never fails; Windows programs write cm³ this way
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not text or text.isspace():
        raise DataError(f"{source}: the file is empty")
    names, delimiter, above, end = _head(text, decimal)
    body = _without_blank_end(text, end)
    blanks = delimiter == BLANKS
    if blanks:
        body, delimiter = "\n".join("\t".join(line.split()) for line in body.split("\n")), "\t"
    numbers = [_is_number(name.replace(",", ".")) for name in names]
    headed = not any(numbers) or not all(
        number or (name and name in Marks()) for name, number in zip(names, numbers, strict=True)
    )
    if headed:
        if not body or body.isspace():
            raise DataError(f"{source}: there is a header but no data")
        return CsvTable(source, names, delimiter, body, above + 1, decimal, True, blanks)
    numbered = tuple(str(i + 1) for i in range(len(names)))
    first = delimiter.join(names)
    body = first if not body or body.isspace() else f"{first}\n{body}"
    return CsvTable(source, numbered, delimiter, body, above, decimal, False, blanks)


def _without_blank_end(text: str, start: int) -> str:
    """Return the text from a place on without the blank lines at its end."""
    last = len(text)
    while last > start and text[max(start, last - _BEGINNING) : last].isspace():
        last = max(start, last - _BEGINNING)
    tail = text[max(start, last - _BEGINNING) : last]
    end = text.find("\n", last - len(tail) + len(tail.rstrip()))
    return text[start:end] if end >= 0 else text[start:]


def _head(text: str, decimal: str) -> tuple[tuple[str, ...], str, int, int]:
    """Return the cells of the line that names the columns, or holds the first data, and their separator.

    Then the number of lines above it, and where the text below it begins. The line is looked for at the beginning of
    the text, then in all of it. The separator is the one that makes the most cells; blanks only where nothing else
    separates any, and as many in the line that follows. A decimal comma separates no numbers.
    """
    lines = text[:_BEGINNING].split("\n")
    if len(text) > _BEGINNING:
        lines.pop()  # it may go on
        above = _first_line(lines)[0] if any(line.strip() for line in lines) else len(lines)
        if not any(line.strip() for line in lines[above + 1 :]):
            lines = text.split("\n")
    above, declared = _first_line(lines)
    head = lines[above].lstrip()[1:].strip() if _is_comment(lines[above]) else lines[above]
    end = sum(len(line) + 1 for line in lines[: above + 1])
    separators = [declared] if declared else [d for d in DELIMITERS if not (d == "," and decimal == ",")]
    rows = {d: next(csv.reader([head], delimiter=d), []) for d in separators}
    if not declared and decimal == "," and max(map(len, rows.values())) < 2:
        quoted = next(csv.reader([head]), [])
        if not all(_is_number(cell) for cell in quoted):
            rows[","] = quoted
    delimiter = max(rows, key=lambda d: len(rows[d]))
    following = next((line for line in lines[above + 1 :] if line.strip()), head)
    if not declared and len(rows[delimiter]) < 2 and 1 < len(head.split()) == len(following.split()):
        return tuple(head.split()), BLANKS, above, end
    return tuple(name.strip() for name in rows[delimiter]), delimiter, above, end


def _first_line(lines: list[str]) -> tuple[int, str]:
    """Return the number of the line with the names, or with the first data, and a separator that a line declares."""
    above = next(i for i, line in enumerate(lines) if line.strip())
    declaration = _SEPARATOR.fullmatch(lines[above].strip(" "))
    if declaration:
        above = next((i for i, line in enumerate(lines) if i > above and line.strip()), above)
    while above + 1 < len(lines) and _is_comment(lines[above]) and _is_comment(lines[above + 1]):
        above += 1  # of several lines of comment the last one may name the columns
    return above, declaration[1] if declaration else ""


def _is_comment(line: str) -> bool:
    return line.lstrip()[:1] in ("#", "%")


def _parsed(
    cells: list[str], rows: list[int], what: str, decimal: str, marks: Marks
) -> tuple[NDArray[np.float64], Counter[str]] | DataError:
    """Return the numbers of a column and its other cells, or the error about a cell that is not a mark either."""
    out, others = np.full(len(cells), np.nan), Counter[str]()
    for i, cell in enumerate(cells):
        text = cell.strip()
        try:
            # with a decimal comma a point is invalid
            out[i] = float(text if decimal == "." else "" if "." in text else text.replace(",", "."))
        except ValueError:
            if text not in others and text not in marks:
                return DataError(
                    f"{what}, line {rows[i]}: expected a number, got {echo(cell)}{_advice(cells, i, decimal, marks)}"
                )
            others[text] += 1
    return out, others


def is_text(cells: Iterable[str], marks: Marks) -> bool:
    """Return whether no cell is a number in any notation, and some are not marks of a missing value either."""
    kinds = {cell.strip() for cell in cells}
    return not any(map(_is_digits, kinds)) and any(cell not in marks for cell in kinds)


def _is_digits(text: str) -> bool:
    """Return whether a cell is a number, or would be one without its commas and points."""
    return _is_number(text) or _is_number(text.replace(".", "").replace(",", ""))


def _advice(cells: list[str], place: int, decimal: str, marks: Marks) -> str:
    """Return advice on a cell that is not a number: a date, one with commas and points, a unit, a mark."""
    text = cells[place].strip()
    if _DATE.match(text):
        return "; if these are the times, name the column by time="
    if not _is_digits(text):
        if is_text(cells, marks):
            return "; no cell of this column is a number: choose another by columns={channel: column}"
        if place == 0:
            return "; if this line holds units, take it out"
        return f"; if that stands for a missing value, give missing=[{echo(text, 40)}]"
    if "," in text and "." in text:
        return "; of a comma and a point in one number the first separates thousands: write the numbers without it"
    if decimal == ",":
        return "; decimal=',' was given, so a point is not a decimal mark"
    return "; if its comma is a decimal comma, set decimal=','; if it separates thousands, write the numbers without it"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
