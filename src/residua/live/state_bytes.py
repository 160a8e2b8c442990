"""The running state of one plant as bytes, and back: what the store keeps of it."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.persistence import stopped
from residua.decide.stream_test import StreamTest
from residua.errors import FileFormatError
from residua.monitor.plant_records import SELDOM, takes_no_memory
from residua.monitor.running import State, initial_state
from residua.monitor.specification import Specification
from residua.monitor.starting import MOVED_FROM

#: The first byte, which changes with the layout. In version 1 counters had 64 bits, Kalman filters held the values of
#: outputs too, tests that do not look at it counted the samples below their threshold, and CUSUM kept its alarm behind
#: its sums too.
VERSION = 2


def state_to_bytes(state: State) -> bytes:
    """Return the state of one plant: its arrays one after the other, little-endian; the monitor says their shapes.

    Before each stands whether it is there; one that is not is zero throughout.
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
        if content[0] not in (1, VERSION):
            raise ValueError("another version")
        state, stop = _filled(_like(spec, content[0]), content, 1)
        if content[0] == 1:
            state = _renewed(state, initial_state(spec, 1))
        if stop != len(content) or not np.isfinite(state.filter.x).all():
            raise ValueError("another length, or no filter")
    except (ValueError, IndexError) as error:
        raise FileFormatError(f"the store holds a state that is none of this monitor: {error}") from error
    return state


def _like(spec: Specification, version: int) -> State:
    """Return the state before the first sample, with arrays of the types that they had in a version."""
    state = initial_state(spec, 1)
    if version == 1:
        state = replace(state, filter=replace(state.filter, held=np.zeros((1, spec.B.shape[1]))))
        if isinstance(spec.test, StreamTest):
            state = replace(state, test=replace(state.test, sums=spec.test.first_sums(1)))
        state = _with_wide_counters(state)
    return state


def _with_wide_counters(whole: Any) -> Any:
    if isinstance(whole, np.ndarray):
        return whole.astype(np.int64) if whole.dtype == np.int32 else whole
    if not is_dataclass(whole):
        return whole
    values = {one.name: _with_wide_counters(getattr(whole, one.name)) for one in fields(whole)}
    return type(whole)(**values)  # pyright: ignore[reportCallIssue]


def _renewed(whole: Any, like: Any, name: str = "") -> Any:
    """Return a state of version 1 as one of today."""
    if isinstance(whole, np.ndarray):
        if name == "down" and takes_no_memory(like):
            return like
        if name in ("held", "sums") and whole.shape != like.shape:
            whole = whole[:, : like.shape[1]]
        if name == "moved":
            whole = np.where(whole >= MOVED_FROM, whole, 0.0)
        return stopped(whole) if like.dtype == np.int32 else whole
    if not is_dataclass(whole):
        return whole
    values = {one.name: _renewed(getattr(whole, one.name), getattr(like, one.name), one.name) for one in fields(whole)}
    return type(whole)(**values)  # pyright: ignore[reportCallIssue]


def _arrays(whole: Any, name: str = "") -> list[tuple[bool, NDArray]]:
    """Return the arrays in order, each with whether it is zero as a rule."""
    if isinstance(whole, np.ndarray):
        return [(name in SELDOM and whole.size > 0, whole)]
    if not is_dataclass(whole):
        return []
    return [pair for one in fields(whole) for pair in _arrays(getattr(whole, one.name), one.name)]


def _filled(like: Any, content: bytes, start: int) -> tuple[Any, int]:
    """Return a dataclass of arrays with the values of bytes, and where they end."""
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


__all__ = ["VERSION", "state_from_bytes", "state_to_bytes"]
