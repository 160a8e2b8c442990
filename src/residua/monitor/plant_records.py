"""State as records: what is remembered of one plant lies side by side, so that a plant costs a few lines of cache."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Records begin at multiples of so many bytes.
_ALIGNED = 8


def takes_no_memory(array: NDArray) -> bool:
    """Tell whether an array is one number, broadcast."""
    return bool(array.size) and not any(array.strides)


def as_records(wholes: list[Any]) -> list[Any]:
    """Return dataclasses, or mappings, of arrays with a row per plant as views of one block, filled with their values.

    Arrays that are broadcast from one number stay so.
    """
    arrays = [array for whole in wholes for array in _arrays(whole)]
    offsets, size = _offsets(arrays)
    plants = len(arrays[0])
    block = np.zeros((plants, size), dtype=np.uint8)
    views = iter(
        np.ndarray(one.shape, one.dtype, block.data, offset, (size, *_inner_strides(one))) if one.size else one.copy()
        for one, offset in zip(arrays, offsets, strict=True)
    )
    made = []
    for whole in wholes:
        made.append(_rebuilt(whole, views))
    for one, other in zip(arrays, (array for whole in made for array in _arrays(whole)), strict=True):
        other[...] = one
    return made


def bytes_of_record(wholes: list[Any]) -> int:
    """Return the bytes of a record: of what is remembered of one plant."""
    return _offsets([array for whole in wholes for array in _arrays(whole)])[1]


def _arrays(whole: Any) -> Iterator[NDArray]:
    if isinstance(whole, np.ndarray):
        if not takes_no_memory(whole):
            yield whole
    elif isinstance(whole, dict):
        for value in whole.values():
            yield from _arrays(value)
    elif is_dataclass(whole):
        for field in fields(whole):
            yield from _arrays(getattr(whole, field.name))


def _rebuilt(whole: Any, views: Iterator[NDArray]) -> Any:
    if isinstance(whole, np.ndarray):
        return whole if takes_no_memory(whole) else next(views)
    if isinstance(whole, dict):
        return {name: _rebuilt(value, views) for name, value in whole.items()}
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
