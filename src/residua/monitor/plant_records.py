"""Dataclasses of arrays with a row per plant: some of their rows, several as one, and plants as records.

The record of one plant is contiguous, so that a plant costs a few lines of cache.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Numbers begin at multiples of so many bytes; records of more than a line begin with a line of the cache.
_ALIGNED, _LINE = 8, 64
#: Fields that are usually zero. Each has its own array, whose memory the system provides where something is written;
#: for plants that all have zeros it is one zero, broadcast, and room is made when one of them needs it.
SELDOM = ("start_sums", "moved", "resets", "broken", "spread", "bent")


def takes_no_memory(array: NDArray) -> bool:
    """Tell whether an array is one broadcast number."""
    return bool(array.size) and not any(array.strides)


def mapped(change: Callable[..., Any], *wholes: Any) -> Any:
    """Return a dataclass of changed arrays, each from those of the same place in all of some dataclasses.

    Parameters
    ----------
    change : callable
        From arrays to an array.
    *wholes : dataclass, ndarray, or None
        Of the same structure. What is neither stays as it is in the first.
    """
    first = wholes[0]
    if isinstance(first, np.ndarray):
        return change(*wholes)
    names = _names(type(first))
    if names is None:
        return first
    if len(wholes) == 1:  # as a rule, and with every sample where an alarm stands
        return type(first)(**{name: mapped(change, getattr(first, name)) for name in names})
    return type(first)(**{name: mapped(change, *(getattr(whole, name) for whole in wholes)) for name in names})


@cache
def _names(cls: type[Any]) -> tuple[str, ...] | None:
    """Return the names of the fields of a dataclass; ``None`` for any other class."""
    return tuple(one.name for one in fields(cls)) if is_dataclass(cls) else None


def copied(whole: Any) -> Any:
    """Return a dataclass with copies of its arrays; broadcast numbers stay so."""
    return mapped(lambda array: array if takes_no_memory(array) else array.copy(), whole)


def rows_of(whole: Any, plants: int | NDArray[np.int64]) -> Any:
    """Return a dataclass of arrays of one plant, or of some."""

    def rows(array: NDArray) -> NDArray:
        if isinstance(plants, np.ndarray) and takes_no_memory(array):
            count = len(np.broadcast_to(np.False_, len(array))[plants])
            return np.broadcast_to(array.flat[0], (count, *array.shape[1:]))
        return array[plants]

    return mapped(rows, whole)


def written_rows(whole: Any, plants: NDArray[np.int64], part: Any) -> Any:
    """Return a dataclass of arrays with those of some plants written in place, unless it takes no memory."""

    def write(array: NDArray, new: NDArray) -> NDArray:
        if takes_no_memory(array):
            if not new.any():
                return array
            array = array.copy()
        array[plants] = new
        return array

    return mapped(write, whole, part)


def stacked_plants(parts: Sequence[Any]) -> Any:
    """Return dataclasses of arrays as one, concatenated over plants."""

    def stack(*arrays: NDArray) -> NDArray:
        if all(takes_no_memory(one) for one in arrays):
            return np.broadcast_to(arrays[0].dtype.type(0), (sum(map(len, arrays)), *arrays[0].shape[1:]))
        return np.concatenate(arrays)

    return mapped(stack, *parts)


def as_records(wholes: list[Any]) -> list[Any]:
    """Return dataclasses of arrays with a row per plant as views of one block, filled with their values.

    Arrays that are broadcast from one number stay so; those of :data:`SELDOM` are copied, or become so.
    """
    return records_and_block(wholes)[0]


def records_and_block(wholes: list[Any]) -> tuple[list[Any], NDArray[np.uint8]]:
    """Return dataclasses as records, and the block of these."""
    named = [pair for whole in wholes for pair in _arrays(whole)]
    views: list[NDArray] = [_seldom(one) if name in SELDOM and one.size else one for name, one in named]
    which = [k for k, (name, one) in enumerate(named) if name not in SELDOM and one.size]
    block = np.zeros(0, dtype=np.uint8)
    if which:
        arrays = [named[k][1] for k in which]
        offsets, size = _offsets(arrays)
        block, stride = _block(len(arrays[0]), size)
        for k, one, offset in zip(which, arrays, offsets, strict=True):
            views[k] = np.ndarray(one.shape, one.dtype, block.data, offset, (stride, *_inner_strides(one)))
            views[k][...] = one
    rebuilt = iter(one if one.size else one.copy() for one in views)
    return [mapped(lambda one: one if takes_no_memory(one) else next(rebuilt), whole) for whole in wholes], block


def _seldom(array: NDArray) -> NDArray:
    return array.copy() if array.any() else np.broadcast_to(array.dtype.type(0), array.shape)


def _block(plants: int, size: int) -> tuple[NDArray[np.uint8], int]:
    """Return zeros for so many records aligned to lines of the cache, and their stride."""
    stride = -(-size // _LINE) * _LINE if size > _LINE else size
    room = np.zeros(plants * stride + _LINE, dtype=np.uint8)
    begin = -room.ctypes.data % _LINE
    return room[begin : begin + plants * stride], stride


def bytes_of_record(wholes: list[Any]) -> int:
    """Return the bytes of state of one plant; for rarely used fields, those allocated now."""
    named = [pair for whole in wholes for pair in _arrays(whole)]
    often = [one for name, one in named if name not in SELDOM]
    return _offsets(often)[1] + sum(one.nbytes // len(one) for name, one in named if name in SELDOM and len(one))


def _arrays(whole: Any, name: str = "") -> Iterator[tuple[str, NDArray]]:
    """Yield the arrays with the names of their fields."""
    if isinstance(whole, np.ndarray):
        if not takes_no_memory(whole):
            yield name, whole
    elif is_dataclass(whole):
        for field in fields(whole):
            yield from _arrays(getattr(whole, field.name), field.name)


def _offsets(arrays: list[NDArray]) -> tuple[list[int], int]:
    """Return the offset of each array in a record, the widest numbers first, and the size of a record."""
    offsets, at = [0] * len(arrays), 0
    for k in sorted(range(len(arrays)), key=lambda k: -arrays[k].itemsize):
        offsets[k] = at
        at += int(np.prod(arrays[k].shape[1:])) * arrays[k].itemsize
    return offsets, max(-(-at // _ALIGNED) * _ALIGNED, _ALIGNED)


def _inner_strides(array: NDArray) -> list[int]:
    strides, size = [], array.itemsize
    for extent in reversed(array.shape[1:]):
        strides.append(size)
        size *= extent
    return strides[::-1]


__all__ = [
    "SELDOM",
    "as_records",
    "bytes_of_record",
    "copied",
    "mapped",
    "records_and_block",
    "rows_of",
    "stacked_plants",
    "takes_no_memory",
    "written_rows",
]
