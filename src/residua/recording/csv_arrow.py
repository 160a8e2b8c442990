"""Reading large tables of text by pyarrow, if it gives the same values as the package's own reader, sooner.

What pyarrow might read otherwise is not left to it: text that is not plain ASCII, quotation marks that do not surround
whole cells, very long lines. A cell that it takes for no number ends the attempt: the other reader then says which
cell and line, or reads it after all (``1_000``, `` NA ``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.recording.missing import EMPTY, Marks, Tally

#: Characters from which on pyarrow is worth the time that its import takes.
LARGE = 4_000_000
#: Characters of a valid text: printable ASCII, tabs and line ends.
_PLAIN = bytes([9, 10, *range(32, 127)])
#: Within so many characters there must be a line end: the csv module of Python refuses cells of more than 131,072.
_LINE = 65_536
_QUOTE, _LINE_END = ord('"'), ord("\n")


@dataclass(frozen=True, eq=False)
class Body:
    """Data lines of a table that pyarrow reads like the package.

    Attributes
    ----------
    content : bytes
    columns : int
    delimiter, decimal : str
    """

    content: bytes
    columns: int
    delimiter: str
    decimal: str

    def numbers(self, places: Sequence[int], marks: Marks) -> list[NDArray[np.float64]] | None:
        """Return columns of numbers, NaN for missing ones; ``None`` if there is anything but numbers and marks."""
        import pyarrow

        table = self._table(dict.fromkeys(places, pyarrow.float64()), marks)
        return None if table is None else [table[str(place)].to_numpy() for place in places]

    def count_marks(self, place: int, marks: Marks, name: str, tally: Tally) -> None:
        """Count the marks of missing values in a column."""
        import pyarrow
        from pyarrow import compute

        cells = self._table({place: pyarrow.string()}, marks)[str(place)]
        found = cells.filter(compute.is_in(cells, value_set=pyarrow.array(marks.written)))
        for one in compute.value_counts(found).to_pylist():
            tally.add(one["values"], name, one["counts"])

    def texts(self, place: int) -> list[str] | None:
        """Return one column as text; ``None`` if the line number of a cell is unknown."""
        import pyarrow

        if self.content.startswith(b"\n") or b"\n\n" in self.content:
            return None
        table = self._table({place: pyarrow.string()}, Marks())
        return None if table is None else table[str(place)].to_pylist()

    def _table(self, types: dict[int, Any], marks: Marks) -> Any:
        import pyarrow
        from pyarrow import csv

        try:
            return csv.read_csv(
                pyarrow.BufferReader(self.content),
                csv.ReadOptions(column_names=[str(i) for i in range(self.columns)]),
                csv.ParseOptions(delimiter=self.delimiter),
                csv.ConvertOptions(
                    column_types={str(place): kind for place, kind in types.items()},
                    include_columns=[str(place) for place in types],
                    null_values=[*EMPTY, *marks.written],
                    decimal_point=self.decimal,
                ),
            )
        except pyarrow.ArrowException:
            return None


def served(text: str, columns: int, delimiter: str, decimal: str) -> Body | None:
    """Return the lines of a table for pyarrow; ``None`` if it is absent, not worthwhile, or might read otherwise.

    Parameters
    ----------
    text : str
        Lines of data, ended by line feeds.
    columns : int
    delimiter, decimal : str
    """
    if len(text) < LARGE or not text.isascii():
        return None
    return body_of(text.encode("ascii"), columns, delimiter, decimal)


def body_of(content: bytes, columns: int, delimiter: str, decimal: str) -> Body | None:
    """Return lines of data for pyarrow, however few; ``None`` if it is absent, or might read them otherwise."""
    try:
        import pyarrow.csv  # noqa: F401 (whether it is there)
    except ImportError:
        return None
    return Body(content, columns, delimiter, decimal) if same_to_both(content, columns, delimiter) else None


def same_to_both(content: bytes, columns: int, delimiter: str) -> bool:
    """Tell whether pyarrow splits lines into the same cells as Python's csv module.

    Parameters
    ----------
    content : bytes
    columns : int
    delimiter : str
    """
    if columns < 1 or content.translate(None, _PLAIN):
        return False
    if b"(" in content and b"nan(" in content.lower():  # a number to pyarrow
        return False
    if columns == 1 and any(mark in content for mark in (b'"', b" ", b"\t")):
        return False  # of a line that is blank but for these, the other reader makes no row
    if any(content.find(b"\n", at, at + _LINE) < 0 for at in range(0, len(content) - _LINE, _LINE)):
        return False
    return b'"' not in content or _quoted_whole(np.frombuffer(content, dtype=np.uint8), ord(delimiter))


def _quoted_whole(letters: NDArray[np.uint8], delimiter: int) -> bool:
    """Tell whether quotation marks surround whole cells within a line, with doubled ones inside such a cell.

    The first mark of each pair then follows a delimiter, a line end or the mark before it (a doubled one), the second
    is followed by one of these: so both readers are inside a quoted cell between them, and nowhere else.
    """
    marks = np.flatnonzero(letters == _QUOTE)
    if len(marks) % 2:
        return False
    first, second = marks[::2], marks[1::2]
    around = np.concatenate([[_LINE_END], letters, [_LINE_END]]).astype(np.uint8)
    borders = np.array([delimiter, _LINE_END, _QUOTE], dtype=np.uint8)
    if not (np.isin(around[first], borders).all() and np.isin(around[second + 2], borders).all()):
        return False
    ends = np.flatnonzero(letters == _LINE_END)
    return bool((np.searchsorted(ends, first) == np.searchsorted(ends, second)).all())
