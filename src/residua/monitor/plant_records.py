"""State as records: what is remembered of one plant lies side by side, so that a plant costs a few lines of cache."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Numbers begin at multiples of so many bytes; records of more than a line begin with a line of the cache.
_ALIGNED, _LINE = 8, 64
#: What an ordinary sample does not touch lies in records of its own.
SELDOM = frozenset({"start_sums", "moved", "resets", "broken", "spread", "bent"})


def takes_no_memory(array: NDArray) -> bool:
    """Tell whether an array is one number, broadcast."""
    return bool(array.size) and not any(array.strides)


def as_records(wholes: list[Any]) -> list[Any]:
    """Return dataclasses of arrays with a row per plant as views of two blocks, filled with their values.

    What every sample touches is in one block, the rest in the other. Arrays that are broadcast from one number stay so.
    """
    named = [pair for whole in wholes for pair in _arrays(whole)]
    views: list[NDArray] = [one for _, one in named]
    for seldom in (False, True):
        which = [k for k, (name, one) in enumerate(named) if (name in SELDOM) == seldom and one.size]
        arrays = [named[k][1] for k in which]
        if not arrays:
            continue
        offsets, size = _offsets(arrays)
        block, stride = _block(len(arrays[0]), size)
        for k, one, offset in zip(which, arrays, offsets, strict=True):
            views[k] = np.ndarray(one.shape, one.dtype, block.data, offset, (stride, *_inner_strides(one)))
            views[k][...] = one
    rebuilt = iter(one if one.size else one.copy() for one in views)
    return [_rebuilt(whole, rebuilt) for whole in wholes]


def _block(plants: int, size: int) -> tuple[NDArray[np.uint8], int]:
    """Return zeros for so many records, which begin with a line of the cache, and how far apart they are."""
    stride = -(-size // _LINE) * _LINE if size > _LINE else size
    room = np.zeros(plants * stride + _LINE, dtype=np.uint8)
    begin = -room.ctypes.data % _LINE
    return room[begin : begin + plants * stride], stride


def bytes_of_record(wholes: list[Any]) -> int:
    """Return the bytes of what is remembered of one plant."""
    named = [pair for whole in wholes for pair in _arrays(whole)]
    parts = ([one for name, one in named if (name in SELDOM) == seldom] for seldom in (False, True))
    return sum(_offsets(part)[1] for part in parts if part)


def _arrays(whole: Any, name: str = "") -> Iterator[tuple[str, NDArray]]:
    """Yield the arrays with the names of their fields."""
    if isinstance(whole, np.ndarray):
        if not takes_no_memory(whole):
            yield name, whole
    elif is_dataclass(whole):
        for field in fields(whole):
            yield from _arrays(getattr(whole, field.name), field.name)


def _rebuilt(whole: Any, views: Iterator[NDArray]) -> Any:
    if isinstance(whole, np.ndarray):
        return whole if takes_no_memory(whole) else next(views)
    if is_dataclass(whole) and not isinstance(whole, type):
        return type(whole)(**{field.name: _rebuilt(getattr(whole, field.name), views) for field in fields(whole)})
    return whole


def _offsets(arrays: list[NDArray]) -> tuple[list[int], int]:
    """Return where each array begins in a record, the wide numbers first, and the size of a record."""
    offsets, at = [0] * len(arrays), 0
    for wide in (True, False):
        for k, one in enumerate(arrays):
            if (one.itemsize > 1) == wide:
                offsets[k] = at
                at += int(np.prod(one.shape[1:])) * one.itemsize
    return offsets, max(-(-at // _ALIGNED) * _ALIGNED, _ALIGNED)


def _inner_strides(array: NDArray) -> list[int]:
    strides, size = [], array.itemsize
    for extent in reversed(array.shape[1:]):
        strides.append(size)
        size *= extent
    return strides[::-1]


__all__ = ["as_records", "bytes_of_record", "takes_no_memory"]
