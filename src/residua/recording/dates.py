"""Times written as dates: ISO 8601, with day or month first, or in a given format."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.recording.time_axis import seconds_from_dates
from residua.visible import echo

#: Day, month and year as numbers, with the time of day behind them: 3/11/2017 0:00, 20.11.2026 08:00:01,5,
#: 1-2-2026 1:30 PM.
_NUMBERS = re.compile(
    r"(?P<first>\d{1,2})(?P<mark>[/.\-])(?P<second>\d{1,2})(?P=mark)(?P<year>\d{4})"
    r"(?:,?[ T]+(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<after>\d{2}(?:[.,]\d{1,9})?))?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?)?"
)
#: The same with the year first, where it is not ISO 8601 already: 2026/11/20, 2026.11.20.
_YEAR_FIRST = re.compile(r"(\d{4})([/.])(\d{1,2})\2(\d{1,2})(?=$|[ T])")
_SHORT_YEAR = re.compile(r"\d{1,2}[/.\-]\d{1,2}[/.\-]\d{2}(?!\d)")


def seconds_from_text(
    cells: Sequence[str],
    rows: Sequence[int],
    what: str,
    *,
    dayfirst: bool | None = None,
    time_format: str | None = None,
) -> tuple[NDArray[np.float64], str]:
    """Return times written as text as seconds since the first one, and that one as text.

    Parameters
    ----------
    cells : sequence of str
    rows : sequence of int
        The line of the file that each is from.
    what : str
        Name of the column in messages.
    dayfirst : bool, optional
        Of dates such as 3/4/2026. When omitted, ambiguous dates are an error, except for dots
        (20.11.2026), which are written with the day first.
    time_format : str, optional
        As of :meth:`datetime.datetime.strptime`; nothing else is then tried.
    """
    stripped = [cell.strip() for cell in cells]
    if time_format is not None:
        how = f" as {echo(time_format)}"
        return _one_by_one(stripped, rows, what, lambda cell: datetime.strptime(cell, time_format), how)
    number = _NUMBERS.match(stripped[0]) if stripped else None
    if number:
        return seconds_from_dates(_numbers(stripped, rows, what, dayfirst))
    stripped = [_YEAR_FIRST.sub(lambda m: f"{m[1]}-{int(m[3]):02d}-{int(m[4]):02d}", cell) for cell in stripped]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if all(cell[:1].isdigit() for cell in stripped):  # NumPy also takes "now", and "" for no time
                return seconds_from_dates(np.array(stripped, dtype="datetime64[ns]"))
    except (ValueError, UserWarning, DeprecationWarning):
        pass  # a time zone, or a cell that is not a time: the slow way finds which
    return _one_by_one(stripped, rows, what, datetime.fromisoformat, "")


def _one_by_one(
    cells: list[str], rows: Sequence[int], what: str, read: Callable[[str], datetime], how: str
) -> tuple[NDArray[np.float64], str]:
    """Read cell by cell; times without a zone are taken as one clock."""
    out = np.empty(len(cells))
    start, origin = None, ""
    for i, cell in enumerate(cells):
        try:
            moment = read(cell)
        except (ValueError, re.error) as error:
            raise DataError(
                f"{what}, line {rows[i]}: expected a time{how}, got {echo(cell)}{_advice(cell, how)}"
            ) from error
        origin = origin or (moment.isoformat() if how else cell)
        moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        start = start or moment
        out[i] = (moment - start).total_seconds()
    return out, origin


def _advice(cell: str, how: str) -> str:
    if how:
        return ""
    if _SHORT_YEAR.match(cell):
        return "; a year of two digits can be any of its three numbers: set time_format=, such as '%d.%m.%y %H:%M'"
    if any(letter.isdigit() for letter in cell):
        return (
            "; known are ISO 8601 and dates of three numbers, anything else by time_format=, such as '%d-%b-%Y %H:%M'"
        )
    return ""


def _numbers(cells: list[str], rows: Sequence[int], what: str, dayfirst: bool | None) -> NDArray:
    """Return dates of three numbers, the year last, as ``datetime64``."""
    matches: list[re.Match[str]] = []
    for i, cell in enumerate(cells):
        match = _NUMBERS.fullmatch(cell)
        if not match or (matches and match["mark"] != matches[0]["mark"]):
            raise DataError(f"{what}, line {rows[i]}: expected a time like {echo(cells[0])}, got {echo(cell)}")
        matches.append(match)
    first, second = (np.array([int(match[part]) for match in matches]) for part in ("first", "second"))
    by_day = _day_first(first, second, rows, what, cells, dayfirst)
    days, months = (first, second) if by_day else (second, first)

    def moment(i: int) -> str:
        """Return a date in ISO 8601; ``ValueError`` for a time of day that is none."""
        match = matches[i]
        hour, after = int(match["hour"] or 0), (match["after"] or "00").replace(",", ".")
        if match["half"]:
            if not 1 <= hour <= 12:
                raise ValueError(hour)
            hour = hour % 12 + 12 * (match["half"].upper() == "P")
        return f"{match['year']}-{months[i]:02d}-{days[i]:02d}T{hour:02d}:{match['minute'] or '00'}:{after}"

    try:
        return np.array([moment(i) for i in range(len(cells))], dtype="datetime64[ns]")
    except ValueError:
        for i, cell in enumerate(cells):
            try:
                np.datetime64(moment(i), "ns")
            except ValueError:
                order = "day/month/year" if by_day else "month/day/year"
                raise DataError(f"{what}, line {rows[i]}: {echo(cell)}, read as {order}, is not a time") from None
        raise


def _day_first(
    first: NDArray, second: NDArray, rows: Sequence[int], what: str, cells: list[str], dayfirst: bool | None
) -> bool:
    """Tell whether the day comes first: as requested, by numbers over 12, or by the dots."""
    over = [np.flatnonzero(part > 12) for part in (first, second)]
    decisive = len(over[0]) > 0, len(over[1]) > 0
    if dayfirst is None:
        if all(decisive):
            one, other = over[0][0], over[1][0]
            raise DataError(
                f"{what}: no order of day and month fits both {echo(cells[one])} (line {rows[one]}) and "
                f"{echo(cells[other])} (line {rows[other]})"
            )
        if any(decisive) or "." in cells[0][:3]:
            return not decisive[1]
        k = int(np.argmax(first != second))
        if first[k] == second[k]:
            return True  # the same day either way
        raise DataError(
            f"{what}: {echo(cells[k])} (line {rows[k]}) may be day {first[k]} of month {second[k]}, or day "
            f"{second[k]} of month {first[k]}, and no date in this column decides: set dayfirst=True or dayfirst=False"
        )
    if decisive[1] if dayfirst else decisive[0]:
        k = int(over[1][0] if dayfirst else over[0][0])
        raise DataError(
            f"{what}, line {rows[k]}: {echo(cells[k])} would be of month {max(first[k], second[k])}: with "
            f"dayfirst={dayfirst} the {'second' if dayfirst else 'first'} number is the month"
        )
    return dayfirst
