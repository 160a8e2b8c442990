"""Marks of missing values, as written by spreadsheets, databases and historians in place of a number."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.errors import SettingError
from residua.visible import echo
from residua.words import counted, some

#: Cells without a value, which nobody counts.
EMPTY = ("", "nan", "-nan", "NaN", "NAN", "-NaN")
#: Marks as their programs write them; any other case will do.
MARKS = (
    # data bases, Python and R, AVEVA (Wonderware) Historian
    "null", "NULL", "(null)", "None", "none", "NA", "na", "N/A", "n/a", "n.a.", "<NA>", "NaT",
    # placeholders
    "-", "--", "---", "–", "—", "?", "??", "???", "????", "missing", "not available", "no value", "invalid",
    # spreadsheets
    "#N/A", "#VALUE!", "#DIV/0!", "#REF!", "#NUM!", "#NAME?", "#NULL!", "#CALC!", "#BUSY!", "#GETTING_DATA",
    # PI, its system digital states
    "No Data", "Bad", "Bad Input", "Bad Output", "Bad Data", "Bad Quality", "Bad Total", "Bad Value", "Set to Bad",
    "I/O Timeout", "Configure", "Comm Fail", "Comm Error", "Not Connect", "Pt Created", "Intf Shut", "Shutdown",
    "Scan Off", "Scan Timeout", "Arc Off-line", "Archive Offline", "Out of Serv", "Over Range", "Under Range",
    "Inp OutRange", "Calc Failed", "Calc Off", "Calc Crash", "Calc Timeout", "Calc Overflw", "Not Converge",
    "No Result", "No Sample", "No_Sample", "ISU Saw No Data", "Invalid Data", "Invalid Float", "Coercion Failed",
    "Wrong Type", "AccessDenied", "Access Denied", "Equip Fail", "Failed", "Error", "Tag not found",
    # Ignition and OPC
    "Bad_NotConnected", "Bad_Stale", "Bad_NotFound", "Bad_Disabled", "Bad_OutOfRange", "Bad_GatewayCommOff",
    "Bad_CommFailure", "Bad_DeviceFailure", "Bad_SensorFailure", "Error_Configuration", "Error_TimeoutExpired",
)  # fmt: skip
#: All quality codes of Ignition and OPC UA that stand for no value.
_CODES = re.compile(r"(bad|error)_\w+")
_EMPTY, _MARKS = (frozenset(text.lower() for text in texts) for texts in (EMPTY, MARKS))
#: Columns that a note names for a mark, and marks that it names.
_TOLD = 5


@dataclass(frozen=True)
class Marks:
    """Marks of missing values: the known ones, and those of a caller.

    Attributes
    ----------
    more : tuple of str
        Numbers among them stand for that value, however it is written.

    Examples
    --------
    >>> from residua.recording.missing import Marks
    >>> marks = Marks(("out", "-9999"))
    >>> [text in marks for text in ("I/O Timeout", " OUT ", "Bad_Stale", "", "Good")]
    [True, True, True, True, False]
    >>> marks.numbers
    (-9999.0,)
    """

    more: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not all(isinstance(mark, str) and mark.strip() for mark in self.more):
            raise SettingError(f"missing must be marks, such as ['out', '-9999'], got {echo(self.more)}")

    @cached_property
    def numbers(self) -> tuple[float, ...]:
        """Numbers among the marks of the caller."""
        return tuple(dict.fromkeys(value for mark in self.more if (value := _number(mark)) is not None))

    @cached_property
    def _own(self) -> frozenset[str]:
        return frozenset(mark.strip().lower() for mark in self.more if _number(mark) is None)

    @cached_property
    def written(self) -> tuple[str, ...]:
        """Exact spellings of the marks, for a reader that compares letter by letter; empty cells are none."""
        return (*MARKS, *(mark for mark in self.more if mark.strip().lower() in self._own))

    def __contains__(self, cell: str) -> bool:
        text = cell.strip().lower()
        return text in _EMPTY or text in _MARKS or text in self._own or _CODES.fullmatch(text) is not None

    def numbers_removed(self, values: NDArray[np.float64], column: str, tally: Tally) -> NDArray[np.float64]:
        """Return a column with NaN for numbers that stand for a missing value, which are counted."""
        for number in self.numbers:
            found = values == number
            if found.any():
                values = np.where(found, np.nan, values)
                tally.add(f"{number:.12g}", column, int(found.sum()))
        return values


class Tally:
    """Counter of marks of missing values, by mark and column; ``shown``: other names of columns, for the note."""

    def __init__(self, shown: Mapping[str, str] | None = None) -> None:
        self.counts: dict[str, Counter[str]] = {}
        self._shown = shown or {}

    def add(self, mark: str, column: str, count: int = 1) -> None:
        """Count marks in a column; empty cells are none."""
        mark = mark.strip()
        if mark.lower() not in _EMPTY:
            self.counts.setdefault(mark, Counter())[self._shown.get(column, column)] += count

    @property
    def notes(self) -> tuple[str, ...]:
        """One note on all marks; empty without any."""
        if not self.counts:
            return ()
        marks = sorted(self.counts.items(), key=lambda one: -one[1].total())
        parts = [
            f"{echo(mark, 40)} {some([f'{_times(n)} in {echo(name, 40)}' for name, n in found.most_common()], _TOLD)}"
            for mark, found in marks[:_TOLD]
        ]
        more = [counted(len(marks) - _TOLD, "other mark")] if len(marks) > _TOLD else []
        return (f"taken as missing values: {'; '.join([*parts, *more])}",)


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count:,} times"


def _number(text: str) -> float | None:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        return None
    return value if np.isfinite(value) else None
