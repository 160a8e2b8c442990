"""Binary records of the store: rows of a plant, and the running state of its monitor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError
from residua.monitor.plant_records import SELDOM, takes_no_memory
from residua.monitor.running import State, initial_state
from residua.monitor.specification import Specification

#: The first byte of a state, which changes with the layout.
VERSION = 3


def rows_to_bytes(times: NDArray[np.float64], values: NDArray[np.float64]) -> bytes:
    """Return rows as bytes: the time and the channels of each, little-endian."""
    table = np.empty((len(times), 1 + values.shape[1]), dtype="<f8")
    table[:, 0], table[:, 1:] = times, values
    return table.tobytes()


def rows_from_bytes(
    blocks: Sequence[tuple[int, bytes]], channels: int, first: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times and values of the rows from a number on, from blocks that each begin at a row number."""
    table = np.frombuffer(b"".join(content for _, content in blocks), dtype="<f8").reshape(-1, channels + 1)
    table = table[first - blocks[0][0] :] if blocks else table
    return np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1:])


def state_to_bytes(state: State) -> bytes:
    """Return the state of one plant: its arrays one after the other, little-endian; the monitor knows their shapes.

    A byte before each tells whether it follows; an array that does not is zero throughout.
    """
    parts = [bytes([VERSION])]
    for seldom, array in _arrays(state):
        absent = (seldom or takes_no_memory(array)) and not array.any()
        parts.append(b"\0" if absent else b"\1")
        if not absent:
            parts.append(np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<"), copy=False).tobytes())
    return b"".join(parts)


def state_from_bytes(content: bytes, spec: Specification) -> State:
    """Return the state of one plant of a monitor.

    Raises
    ------
    FileFormatError
        If the bytes are not a state of this monitor.
    """
    try:
        if content[0] != VERSION:
            raise ValueError("another version")
        state, stop = _filled(initial_state(spec, 1), content, 1)
        if stop != len(content) or not np.isfinite(state.filter.x).all():
            raise ValueError("another length, or no filter")
    except (ValueError, IndexError) as error:
        raise FileFormatError(f"the store holds a state of another monitor: {error}") from error
    return state


def _arrays(whole: Any, name: str = "") -> list[tuple[bool, NDArray]]:
    """Return the arrays in order, each with a flag if it is usually zero."""
    if isinstance(whole, np.ndarray):
        return [(name in SELDOM and whole.size > 0, whole)]
    if not is_dataclass(whole):
        return []
    return [pair for one in fields(whole) for pair in _arrays(getattr(whole, one.name), one.name)]


def _filled(like: Any, content: bytes, start: int) -> tuple[Any, int]:
    """Return a dataclass of arrays filled from bytes, and the offset of their end."""
    if isinstance(like, np.ndarray):
        if content[start] == 0:
            return like, start + 1
        kind = like.dtype.newbyteorder("<")
        array = np.frombuffer(content, dtype=kind, count=like.size, offset=start + 1)
        return array.astype(like.dtype).reshape(like.shape), start + 1 + like.nbytes
    if not is_dataclass(like):
        return like, start
    values = {}
    for one in fields(like):
        values[one.name], start = _filled(getattr(like, one.name), content, start)
    return type(like)(**values), start  # pyright: ignore[reportCallIssue]


__all__ = ["VERSION", "rows_from_bytes", "rows_to_bytes", "state_from_bytes", "state_to_bytes"]
