"""Text form of the options of design functions, by their annotated types."""

from __future__ import annotations

import re
import typing
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from numpy.typing import ArrayLike

from residua.analysis.coding_sets import CodingSet
from residua.design.core.method import Option, kinds_of

#: The argument that is a relative tolerance in every design function.
_TOLERANCE = "rtol"
_ARRAY = frozenset(kinds_of(ArrayLike))


@dataclass(frozen=True)
class Form:
    """Text form of an option.

    Attributes
    ----------
    metavar : str
        Placeholder of its value in the help.
    read : callable
        From text to a value; raises ``ValueError`` with the mistake. Of a flag, from true or false.
    is_flag : bool
        Whether it is either there or not.
    """

    metavar: str
    read: Callable[[Any], Any] = field(compare=False)
    is_flag: bool = False


def form_of(option: Option) -> Form | None:
    """Return the text form of an option; ``None`` for values without one, such as other plants."""
    kinds = option.kinds
    if CodingSet in kinds:
        return Form("LIST", parse_rows)
    mapped = next((typing.get_args(kind)[-1] for kind in kinds if typing.get_origin(kind) is Mapping), None)
    single = _single(option, kinds)
    if mapped is None:
        return single
    each = _single(option, kinds_of(mapped))
    if each is None:
        return single
    metavar = f"NAME={each.metavar};..."
    return Form(
        metavar if single is None else f"{single.metavar}|{metavar}",
        partial(_named_or_not, each, None if single is None else single.read),
    )


def _single(option: Option, kinds: tuple[Any, ...]) -> Form | None:
    """Return the text form of a value without names."""
    if Sequence[complex] in kinds:
        return Form("LIST", parse_poles)
    if set(kinds) >= _ARRAY:
        return Form("MATRIX", parse_matrix)
    if bool in kinds:
        return Form("", bool, is_flag=True)
    if any(typing.get_origin(kind) in (Iterable, Sequence) and str in _members(kind) for kind in kinds):
        return Form("LIST", parse_names)
    if float in kinds:
        if option.name == _TOLERANCE:
            return Form("NUMBER", parse_tolerance)
        rate = "1/s" in option.text or "rad/s" in option.text
        return Form("RATE", parse_rate) if rate else Form("NUMBER", parse_number)
    if int in kinds:
        return Form("N", parse_whole)
    if option.choices:
        return Form("|".join(dict.fromkeys(option.choices)), partial(_choice, option.choices))
    return Form("TEXT", str.strip) if str in kinds else None


def _members(kind: Any) -> tuple[Any, ...]:
    return kinds_of(typing.get_args(kind)[0])


def _named_or_not(each: Form, single: Callable[[str], Any] | None, text: str) -> Any:
    """Return values by name; one without names if that is allowed."""
    if "=" not in text:
        if single is not None:
            return single(text)
        raise ValueError(f"{text!r} has no names: give {each.metavar} by name, such as 'first=...; second=...'")
    entries = [entry.partition("=") for entry in text.split(";") if entry.strip()]
    bare = next((name for name, sign, _ in entries if not sign), None)
    if bare is not None:
        raise ValueError(f"{bare.strip()!r} has no '=': give 'first=...; second=...'")
    _check_different([name.strip() for name, _, _ in entries])
    return {name.strip(): each.read(value) for name, _, value in entries}


def _check_different(entries: Sequence[str]) -> None:
    """Raise if an entry occurs twice."""
    twice = next((one for one, count in Counter(entries).items() if count > 1), None)
    if twice is not None:
        raise ValueError(f"{twice!r} occurs twice")


def _choice(choices: tuple[str, ...], text: str) -> str:
    if text not in choices:
        raise ValueError(f"{text!r} is not one of {', '.join(choices)}")
    return text


def in_plain_words(text: str) -> str:
    """Return a description from a docstring without markup."""
    text = re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"\1", text)
    text = re.sub(r":math:`([^`]*)`", lambda found: _formula(found[1]), text).replace("``", "")
    return text.replace("[", "(").replace("]", ")")  # screens take brackets for markup


def _formula(latex: str) -> str:
    """Return a formula as typed: ``e^(-dt/tau)``."""
    return re.sub(r"\\(\w+)", r"\1", latex.replace(r"\dots", "...").replace("{", "(").replace("}", ")"))


def parse_names(text: str) -> tuple[str, ...]:
    """Return names from text separated by commas."""
    names = tuple(name.strip() for name in text.split(","))
    _check_different(names)
    return names


def parse_number(text: str) -> float:
    """Return a finite number from text."""
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not abs(number) < float("inf"):
        raise ValueError(f"{text!r} is not a number")
    return number


def parse_rate(text: str) -> float:
    """Return a positive number from text."""
    rate = parse_number(text)
    if rate <= 0:
        raise ValueError(f"must be positive, got {text}")
    return rate


def parse_tolerance(text: str) -> float:
    """Return a relative tolerance, which lies between 0 and 1, from text."""
    tolerance = parse_number(text)
    if not 0 < tolerance < 1:
        raise ValueError(f"a tolerance must lie between 0 and 1, got {text}")
    return tolerance


def parse_whole(text: str) -> int:
    """Return a whole number from text."""
    try:
        return int(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a whole number") from None


def parse_matrix(text: str) -> Any:
    """Return a number, a list of numbers, or a list of rows, from text such as ``1,0;0,1``.

    Examples
    --------
    >>> from residua.cli.option_types import parse_matrix
    >>> parse_matrix("1, 0; 0, 1"), parse_matrix("1,2"), parse_matrix("1,2;"), parse_matrix("3")
    ([[1.0, 0.0], [0.0, 1.0]], [1.0, 2.0], [[1.0, 2.0]], 3.0)
    """
    rows = [[parse_number(entry.strip()) for entry in row.split(",")] for row in text.split(";") if row.strip()]
    if not rows or len({len(row) for row in rows}) > 1:
        raise ValueError(f"{text!r} is not a matrix: give numbers with commas, and rows of one length with semicolons")
    if ";" in text:
        return rows
    return rows[0] if len(rows[0]) > 1 else rows[0][0]


def parse_poles(text: str) -> tuple[complex, ...]:
    """Return poles from text such as ``-3,-3`` or ``-1+2j, -1-2j`` (``i`` stands for ``j`` too).

    Parameters
    ----------
    text : str

    Returns
    -------
    tuple of complex

    Raises
    ------
    ValueError
        If an entry is not a number.

    Examples
    --------
    >>> from residua.cli.option_types import parse_poles
    >>> parse_poles("-3, -1+2i, -1-2i")
    ((-3+0j), (-1+2j), (-1-2j))
    """
    poles = []
    for entry in text.split(","):
        plain = "".join(entry.split())
        try:
            pole = complex(plain[:-1] + "j" if plain.endswith(("i", "I")) else plain)
        except ValueError:
            pole = complex("nan")
        if not (abs(pole) < float("inf")):
            raise ValueError(
                f"{entry.strip()!r} is not a pole: give numbers with commas between them, such as -3,-3 or -1+2j,-1-2j"
            )
        poles.append(pole)
    return tuple(poles)


def parse_rows(text: str) -> list[str]:
    """Return the rows of a structure from text such as ``011,101,110``.

    Parameters
    ----------
    text : str

    Returns
    -------
    list of str

    Raises
    ------
    ValueError
        If an entry has other characters than 0 and 1, or the lengths differ, or a row occurs twice.

    Examples
    --------
    >>> from residua.cli.option_types import parse_rows
    >>> parse_rows("011, 101")
    ['011', '101']
    """
    rows = ["".join(entry.split()) for entry in text.split(",")]
    if any(not row or set(row) - set("01") for row in rows) or len({len(row) for row in rows}) > 1:
        raise ValueError(f"{text!r} are not rows: give zeros and ones, one for each fault, such as 011,101,110")
    _check_different(rows)
    return rows
