"""Readings from messages: valid JSON, and reasons for refusal."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from itertools import chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import missing_extra
from residua.kernels import kernel
from residua.live.source import LARGEST, LONGEST_ID, Message
from residua.recording.matching import matched_names
from residua.visible import echo, listed
from residua.words import counted

try:
    import orjson
except ImportError as error:
    raise missing_extra("orjson", "live") from error

_kernel = kernel("residua.live._rows")

#: Rows of a packed message at most.
MOST_ROWS = 100_000
#: Seconds from 1970 that a time is taken for: dates from the year -29,700 to 33,600.
_LARGEST_TIME = 1e12
_NUMBERS = frozenset({int, float, type(None)})
#: Channels that a sample has at most: a message may have some of them.
_SAMPLED = 4
#: Errors of the kernel.
_WRONG = ("", "shape", "number")
_KEYS = (
    frozenset({"plant", "t", "u", "y"}),
    frozenset({"plant", "t", "values"}),
    frozenset({"plant", "t0", "dt", "u", "y"}),
)

#: Why a message is refused: the labels by which they are counted; sources have some of their own.
REASONS = ("json", "size", "shape", "number", "time", "channel", "plant")


class MessageError(ValueError):
    """A message that is refused.

    Attributes
    ----------
    reason : str
        One of :data:`REASONS`.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


@dataclass(frozen=True)
class Layout:
    """The channels of a plant.

    Attributes
    ----------
    inputs, outputs : tuple of str
    dt : float
        Seconds between samples.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    places: Mapping[str, int] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "places", {name: k for k, name in enumerate(self.channels)})

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the inputs, then of the outputs."""
        return (*self.inputs, *self.outputs)


@dataclass(slots=True)
class Readings:
    """Readings of one plant in a message.

    Attributes
    ----------
    plant : str
    times : list of float, or ndarray
        In seconds, as they were stated; an array where a message states many as a start and a step.
    values : ndarray, shape (rows, channels)
        NaN for a missing value.
    stated : tuple of int, or None
        The channels that are spoken of; ``None`` for all.
    dated : bool
        Whether times are dates.
    past : bool
        Whether they are from a source that ends, such as a file that may be read again: old times are no clock then.
    arrived : float
        When the message came, by the clock.
    """

    plant: str
    times: list[float] | NDArray[np.float64]
    values: NDArray[np.float64]
    stated: tuple[int, ...] | None
    dated: bool
    past: bool = False
    arrived: float = 0.0


#: Returns the channels of a plant; ``None`` where the plant is not known.
Layouts = Callable[[str], Layout | None]


def readings_of(message: Message, layouts: Layouts) -> Readings:
    """Return the readings of a message.

    Parameters
    ----------
    message : Message
    layouts : callable
        Called with the id of a plant; ``None`` where it is not watched.

    Raises
    ------
    MessageError
        If it is no JSON, or not of the shape that is read; nothing of it is used then.
    """
    content = message.payload
    if message.refused:
        raise MessageError(message.refused, "refused by the source")
    if message.channel:
        return _channel(message, content, layouts)
    if not isinstance(content, bytes):
        raise MessageError("shape", "a number without a channel")
    whole = _json(content)
    if type(whole) is not dict:
        raise MessageError("shape", "no JSON object")
    plant = whole.get("plant", message.plant)
    if message.plant and plant != message.plant:
        raise MessageError("plant", f"plant {echo(plant, 40)}, where the source gives {message.plant!r}")
    layout = _layout(plant, layouts)
    keys = whole.keys() | {"plant"}
    if "values" in keys and keys <= _KEYS[1]:
        time, dated = time_of(whole.get("t"))
        return _named(plant, time, dated, whole["values"], layout)
    if "t0" in keys and keys <= _KEYS[2]:
        return _packed(plant, whole, layout)
    if "y" in keys and keys <= _KEYS[0]:
        if type(whole.get("t")) is list:
            return _packed(plant, whole, layout)
        time, dated = time_of(whole.get("t"))
        return Readings(plant, [time], _rows(layout, [whole.get("u", [])], [whole["y"]]), None, dated)
    raise MessageError("shape", "keys must be plant, t, u, y; or plant, t, values; or plant, t0, dt, u, y")


def _json(content: bytes) -> Any:
    if len(content) > LARGEST:
        raise MessageError("size", f"larger than {LARGEST:,} bytes")
    try:
        return orjson.loads(content)
    except (ValueError, RecursionError) as error:
        raise MessageError("json", f"not JSON: {error}") from error


def _layout(plant: Any, layouts: Layouts) -> Layout:
    if type(plant) is not str or not plant or len(plant) > LONGEST_ID or not plant.isprintable():
        raise MessageError("plant", "the id of a plant is a text of up to 200 characters")
    layout = layouts(plant)
    if layout is None:
        raise MessageError("plant", f"plant {echo(plant, 40)} is not watched")
    return layout


def time_of(stated: Any) -> tuple[float, bool]:
    """Return a time in seconds, and a flag for dates.

    Parameters
    ----------
    stated : int, float, or str
        Seconds, or ISO 8601 with a zone.

    Raises
    ------
    MessageError
        If it is neither.

    Examples
    --------
    >>> time_of("1970-01-01T01:00:05+01:00")
    (5.0, True)
    """
    if type(stated) is float or type(stated) is int:
        time = float(stated) if abs(stated) < _LARGEST_TIME else math.nan
        if time == time:
            return time, False
    elif type(stated) is str and len(stated) < 64:
        try:
            moment = datetime.fromisoformat(stated)
        except ValueError:
            moment = None
        if moment is not None and moment.tzinfo is not None:
            return moment.timestamp(), True
    raise MessageError("time", "t must be seconds, or ISO 8601 with its zone")


def _named(plant: str, time: float, dated: bool, values: Any, layout: Layout) -> Readings:
    if type(values) is not dict or not values:
        raise MessageError("shape", "values must be an object with a number for each channel")
    try:
        stated = tuple(layout.places[name] for name in values)
    except KeyError:
        unknown = next(name for name in values if name not in layout.places)
        raise _no_channel(unknown, layout) from None
    row = np.full((1, len(layout.channels)), np.nan)
    row[0, list(stated)] = _row(list(values.values()))
    return Readings(plant, [time], row, None if len(stated) == row.shape[1] else stated, dated)


def _packed(plant: str, whole: dict[str, Any], layout: Layout) -> Readings:
    y = whole.get("y")
    if type(y) is not list or not 0 < len(y) <= MOST_ROWS:
        raise MessageError("shape", f"y must be a list of 1 to {MOST_ROWS:,} rows")
    count = len(y)
    u = whole.get("u", [[]] * count if not layout.inputs else None)
    if u == [] and not layout.inputs:
        u = [[]] * count
    values = _rows(layout, u, y)
    if "t0" in whole:
        start, dated = time_of(whole["t0"])
        step: Any = whole.get("dt")
        if type(step) not in (int, float) or not 1000 * abs(step - layout.dt) <= layout.dt:
            raise MessageError("time", f"dt must be that of the monitor, {layout.dt:g} s")
        return Readings(plant, start + float(step) * np.arange(count, dtype=np.float64), values, None, dated)
    moments = [time_of(one) for one in whole["t"]]
    if len(moments) != count:
        raise MessageError("shape", "t and y must have as many rows")
    times = [time for time, _ in moments]
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise MessageError("time", "times must grow")
    return Readings(plant, times, values, None, moments[0][1])


def _rows(layout: Layout, u: Any, y: list[Any]) -> NDArray[np.float64]:
    """Return rows of JSON numbers, inputs and outputs side by side."""
    values = np.empty((len(y), len(layout.channels)))
    inputs, outputs = len(layout.inputs), len(layout.outputs)
    for name, rows, first, width in (("u", u, 0, inputs), ("y", y, inputs, outputs)):
        wrong = fill_rows(values, rows, first, width)
        if wrong == "shape":
            named = listed(layout.channels[first : first + width])
            raise MessageError(
                "shape", f"{name} must have as many rows as y, each of {counted(width, 'value')}: {named}"
            )
        _check(wrong)
    return values


def fill_rows(values: NDArray[np.float64], rows: Any, first: int, width: int) -> str:
    """Write rows of JSON numbers into the columns of an array from one on, NaN for null.

    Parameters
    ----------
    values : ndarray, shape (rows, channels)
    rows : object
        As JSON says it: right are as many lists as there are rows, each of ``width`` numbers.
    first, width : int

    Returns
    -------
    str
        The error: ``"shape"`` of rows, ``"number"`` for a value that is not a number, such as a text or a truth value,
        or larger than any double; empty without one. After an error the written values are invalid.
    """
    if _kernel is not None:
        return _WRONG[_kernel.fill(values, rows, first, width)]
    return _fill_rows(values, rows, first, width)


def _fill_rows(values: NDArray[np.float64], rows: Any, first: int, width: int) -> str:
    """Fill rows in NumPy."""
    if type(rows) is not list or len(rows) != len(values):
        return "shape"
    if not set(map(type, rows)) <= {list} or not set(map(len, rows)) <= {width}:
        return "shape"
    flat = list(chain.from_iterable(rows))
    if not set(map(type, flat)) <= _NUMBERS:
        return "number"
    try:
        values[:, first : first + width] = np.array(flat, dtype=np.float64).reshape(len(rows), width)
    except OverflowError:
        return "number"
    return ""


def _row(numbers: list[Any]) -> NDArray[np.float64]:
    """Return JSON numbers."""
    values = np.empty((1, len(numbers)))
    _check(fill_rows(values, [numbers], 0, len(numbers)))
    return values[0]


def _check(wrong: str) -> None:
    if wrong:
        raise MessageError("number", "values must be numbers or null")


def _no_channel(name: str, layout: Layout) -> MessageError:
    """Return the error about a channel that the plant does not have."""
    like = matched_names(layout.channels, [name])
    near = difflib.get_close_matches(name, layout.channels, n=1)
    meant = next(iter(like), near[0] if near else "")
    hint = f" (did you mean {meant!r}?)" if meant else ""
    return MessageError("channel", f"no channel {echo(name, 40)}{hint}; the plant has {listed(layout.channels)}")


def sample_of(message: Message, layout: Layout, plant: str) -> str:
    """Return a valid message in place of an invalid one, as JSON.

    Examples
    --------
    >>> from residua.live.source import Message
    >>> from residua.live.readings import Layout, sample_of
    >>> sample_of(Message(None, b"", 1764288000.0), Layout(("valve",), ("level",), 1.0), "tank 1")
    '{"plant":"tank 1","t":1764288000.0,"values":{"valve":0.5,"level":0.5}}'
    """
    time = round(message.arrived, 3)
    if message.channel:
        whole: dict[str, Any] = {"t": time, "value": 0.5}
    else:
        whole = {} if message.plant else {"plant": plant}
        whole |= {"t": time, "values": dict.fromkeys(layout.channels[:_SAMPLED], 0.5)}
    return orjson.dumps(whole).decode()


def _channel(message: Message, content: bytes | float, layouts: Layouts) -> Readings:
    """Return the reading of a topic or node of one channel."""
    layout = _layout(message.plant, layouts)
    place = layout.places.get(message.channel)
    if place is None:
        raise _no_channel(message.channel, layout)
    time, dated, value = message.time, message.time is not None, content
    if isinstance(content, bytes):
        value = _json(content)
        if type(value) is dict:
            if not value.keys() <= {"t", "value"} or "value" not in value:
                raise MessageError("shape", "the reading of a channel is a number, or has the keys t and value")
            if "t" in value:
                time, dated = time_of(value["t"])
            value = value["value"]
    if time is None:
        time, dated = message.arrived, True
    row = np.full((1, len(layout.channels)), np.nan)
    number = float(_row([value])[0])
    row[0, place] = number if math.isfinite(number) else math.nan  # a protocol other than JSON may bring infinity
    return Readings(message.plant, [time], row, (place,), dated)


__all__ = [
    "REASONS",
    "Layout",
    "Layouts",
    "MessageError",
    "Readings",
    "fill_rows",
    "readings_of",
    "sample_of",
    "time_of",
]
