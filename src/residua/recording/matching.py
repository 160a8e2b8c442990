"""Matching channels to columns by name: exactly, or without case, blanks and units if that is unique."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence

from residua.errors import DataError
from residua.recording.time_axis import TIME_NAME
from residua.visible import MAX_ECHO, echo, listed
from residua.words import listing

#: Columns that a message names at most, and among which a name is looked for that may be meant.
_LISTED, _COMPARED = 40, 1000
#: A unit behind a name: ``h1 [cm]``, ``h1 (cm)``; a number in brackets is none.
_UNIT = re.compile(r"(?<=\S)\s*[\[({](?P<unit>[^\[\](){}]*[^\[\](){}\d\s][^\[\](){}]*)[\])}]$")


def matched_names(
    channels: Sequence[str], columns: Sequence[str], *, renamed: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the column of each channel that has one.

    A channel takes the column of its own name. The others take a column that differs in case, in blanks, underscores
    and hyphens, or in a unit behind the name, where one column alone does, and for one channel alone. A column with a
    name of the time is never taken in this way.

    Parameters
    ----------
    channels, columns : sequence of str
    renamed : mapping of str to str, optional
        Columns that the caller has chosen; they are returned as they are.

    Examples
    --------
    >>> from residua.recording.matching import matched_names
    >>> matched_names(["h1", "h2", "valve 1"], ["time", "H1 [cm]", "h2", "Valve_1"])
    {'h1': 'H1 [cm]', 'h2': 'h2', 'valve 1': 'Valve_1'}
    """
    renamed, there = renamed or {}, set(columns)
    out = {name: renamed.get(name, name) for name in channels if name in renamed or name in there}
    candidates = _candidates([name for name in channels if name not in out], columns, set(out.values()))
    wanted = [found[0] for found in candidates.values() if len(found) == 1]
    out |= {name: found[0] for name, found in candidates.items() if len(found) == 1 and wanted.count(found[0]) == 1}
    return {name: out[name] for name in channels if name in out}


def required_columns(
    channels: Sequence[str], columns: Sequence[str], source: str, *, advice: str = ""
) -> dict[str, str]:
    """Return the column of each channel as :func:`matched_names` does, or raise if one has none.

    Parameters
    ----------
    channels, columns : sequence of str
    source, advice : str
        As for :func:`missing_columns`.
    """
    found = matched_names(channels, columns)
    absent = {name: name for name in channels if name not in found}
    if absent:
        raise missing_columns(absent, columns, source, matched=list(found.values()), advice=advice)
    return found


def _candidates(channels: Sequence[str], columns: Sequence[str], taken: set[str]) -> dict[str, list[str]]:
    """Return the candidate columns of each channel: those of the same name but for case, blanks and units."""
    free = [name for name in columns if name not in taken and name.strip() and not TIME_NAME.fullmatch(name.strip())]
    plain, bare = ([read(name) for name in free] for read in (_plain, _bare))
    out = {}
    for channel in channels:
        name, without = _plain(channel), _bare(channel)
        out[channel] = [
            column
            for column, one, part in zip(free, plain, bare, strict=True)
            if one in (name, without) or part == name
        ]
    return out


def _plain(name: str) -> str:
    """Return a name in lower case, with single blanks for blanks, underscores and hyphens."""
    return re.sub(r"[\s_-]+", " ", name).strip(" \"'").casefold()


def _bare(name: str) -> str:
    """Return the plain name without a unit."""
    return _plain(_UNIT.sub("", name.strip(" \"'")))


def _unit_of(name: str) -> str:
    """Return the unit behind the name of a column; empty without one."""
    found = _UNIT.search(name.strip(" \"'"))
    return found["unit"].strip() if found else ""


def spelling_notes(matched: Mapping[str, str], units: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Return a note on channels whose columns have another name.

    Parameters
    ----------
    matched : mapping of str to str
        The column of each channel.
    units : mapping of str to str, optional
        Of channels: a column that names another one is pointed out, for nothing is converted.
    """
    others = {name: column for name, column in matched.items() if column != name}
    if not others:
        return ()
    pairs = [f"{name!r} is {echo(column, 60)}" for name, column in others.items()]
    shown = [*pairs[:_LISTED], f"{len(pairs) - _LISTED} more"] if len(pairs) > _LISTED else pairs
    units = units or {}
    differ = [
        f"{echo(column, 60)}, where the plant has {units[name]}"
        for name, column in others.items()
        if _unit_of(column) and units.get(name) and _unit_of(column).casefold() != units[name].casefold()
    ]
    unlike = f"; the units differ, and nothing is converted: {listing(differ)}" if differ else ""
    return (f"matched by name but for case, blanks and units: {', '.join(shown)}{unlike}",)


def named_columns(names: Sequence[str]) -> str:
    """Return the names of columns as part of a message."""
    return listed([echo(name) for name in names[:_LISTED]])


def missing_columns(
    absent: Mapping[str, str], names: Sequence[str], source: str, *, matched: Sequence[str], advice: str = ""
) -> DataError:
    """Return the error about channels without a column, with a nearly right ``columns``.

    Parameters
    ----------
    absent : mapping of str to str
        Channels without a column, and the names that were looked for.
    names : sequence of str
        Of all columns.
    source : str
        Name of the recording.
    matched : sequence of str
        Columns that other channels have.
    advice : str
        Remedy, if there is no option ``columns``.
    """
    free = [name for name in names[:_COMPARED] if name and len(name) <= MAX_ECHO and name not in set(matched)]
    likely: dict[str, str] = {}
    parts = []
    for channel, name in absent.items():
        found = _candidates([name], free, set())[name]
        left = [one for one in found or _similar(name, free) if one not in likely.values()]
        if len(found) > 1:
            parts.append(f"{echo(name)} (may be {listing(map(echo, found[:_LISTED]), 'or')})")
        else:
            parts.append(echo(name) + (f" (did you mean {echo(left[0])}?)" if left else ""))
        likely |= {channel: left[0]} if left else {}
    given = {channel: likely.get(channel, "...") for channel in list(absent)[:_LISTED]}
    advice = advice or f"{'choose by' if likely else 'where names differ, give'} columns={given}"
    return DataError(
        f"{source}: missing column{'s' * (len(absent) > 1)} {', '.join(parts)}; there are: {named_columns(names)}; "
        f"{advice}"
    )


def _similar(channel: str, columns: Sequence[str]) -> list[str]:
    """Return columns that contain the name of a channel as a word, or else have a similar name; the nearest first."""
    bare, name = {column: _bare(column) for column in columns}, _plain(channel)
    holding = [column for column in columns if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", bare[column])]
    near = difflib.get_close_matches(name, dict.fromkeys(bare.values()), n=3)
    return list(dict.fromkeys([*holding, *(column for one in near for column in columns if bare[column] == one)]))
