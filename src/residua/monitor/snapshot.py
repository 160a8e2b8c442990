"""State of a fleet as bytes: little-endian columns behind a header, with a checksum; nothing is executed.

The layout, version 1: the mark ``RESIDUAF``; the version and the length of the header, four bytes each; the header,
JSON in UTF-8, which names for each model the fingerprint of its monitor and its columns (name, type, shape); the
columns, one after the other, each from a multiple of eight bytes on; and the SHA-256 of everything before it. A column
of those that are zero as a rule (:data:`residua.monitor.plant_records.SELDOM`) is left out where it is zero throughout.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
from collections.abc import Hashable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError, ResiduaError
from residua.files import other_version
from residua.monitor.fleet_block import FleetBlock, StandingAlarms, fingerprint_of
from residua.monitor.monitor import Monitor
from residua.monitor.plant_records import SELDOM, takes_no_memory
from residua.monitor.running import State, initial_state
from residua.monitor.skipped_samples import SkippedSamples
from residua.monitor.specification import Specification
from residua.visible import echo, listed

#: The mark and the version.
MARK, VERSION = b"RESIDUAF", 1
_HEAD, _SUM = struct.Struct("<8sII"), 32
#: Columns that come with the first plant that needs them, and may stay when no plant does any longer.
_AT_TIMES = tuple(f"state.filter.{name}" for name in SELDOM)
_TYPES = {"<f8": np.float64, "<i8": np.int64, "<i4": np.int32, "|b1": np.bool_, "|u1": np.uint8}


def snapshot_of(blocks: Mapping[str, FleetBlock]) -> bytes:
    """Return the state of blocks of plants, as bytes."""
    models, columns = [], []
    for name, block in blocks.items():
        kept = _columns(block)
        models.append(
            {
                "model": name,
                "monitor": block.fingerprint,
                "ids": _kind_of_ids(block.ids),
                "columns": [[label, one.dtype.newbyteorder("<").str, list(one.shape)] for label, one in kept.items()],
            }
        )
        columns += kept.values()
    header = json.dumps({"models": models}, allow_nan=False).encode()
    parts: list[Any] = [_HEAD.pack(MARK, VERSION, len(header)), header, _padding(_HEAD.size + len(header))]
    for one in columns:
        little = np.ascontiguousarray(one, dtype=one.dtype.newbyteorder("<"))
        parts += [little.data.cast("B") if little.size else b"", _padding(little.nbytes)]
    check = hashlib.sha256()
    for part in parts:
        check.update(part)
    return b"".join([*parts, check.digest()])


def restored_blocks(content: bytes, monitors: Mapping[str, Monitor]) -> dict[str, FleetBlock]:
    """Return the blocks of a snapshot, for their monitors."""
    view = memoryview(content)
    header, start = _header(view)
    try:
        blocks = {}
        for model in header["models"]:
            name, kept = model["model"], {}
            for label, kind, shape in model["columns"]:
                kept[label], start = _column(view, start, kind, shape, label)
            blocks[name] = _block(name, model, kept, monitors)
    except ResiduaError:
        raise
    except (TypeError, KeyError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise FileFormatError(f"the header of this snapshot is invalid: {error}") from error
    if start != len(view) - _SUM:
        raise FileFormatError("this snapshot has more in it than its header says")
    missing = [name for name in monitors if name not in blocks]
    if missing:
        raise FileFormatError(f"this snapshot has no model {listed(missing)}; it has {listed(list(blocks))}")
    return blocks


def _header(view: memoryview) -> tuple[dict[str, Any], int]:
    """Return the header of a snapshot whose checksum is right, and the offset of its columns."""
    if len(view) < len(MARK) or bytes(view[: len(MARK)]) != MARK:
        raise FileFormatError("these bytes are not a snapshot of a fleet")
    if len(view) < _HEAD.size + _SUM:
        raise FileFormatError("this snapshot is cut short")
    _, version, length = _HEAD.unpack_from(view)
    if version != VERSION:
        raise FileFormatError(other_version("this snapshot", version, VERSION, "start the fleet without it"))
    if hashlib.sha256(view[:-_SUM]).digest() != bytes(view[-_SUM:]):
        raise FileFormatError("this snapshot is cut short or was changed: its checksum does not match")
    try:
        header = json.loads(bytes(view[_HEAD.size : _HEAD.size + length]))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"the header of this snapshot is invalid: {error}") from error
    if not isinstance(header, dict) or not isinstance(header.get("models"), list):
        raise FileFormatError("the header of this snapshot is invalid: it has no models")
    start = _HEAD.size + length
    return header, start + len(_padding(start))


def _column(view: memoryview, start: int, kind: str, shape: list[int], label: str) -> tuple[NDArray, int]:
    if kind not in _TYPES or any(not isinstance(n, int) or n < 0 for n in shape):
        raise FileFormatError(f"the column {echo(label)} of this snapshot is not an array")
    count = math.prod(shape)
    size = count * np.dtype(kind).itemsize
    if start + size > len(view) - _SUM:
        raise FileFormatError("this snapshot is shorter than its header says")
    array = np.frombuffer(view, dtype=kind, count=count, offset=start).reshape(shape)
    if array.dtype != _TYPES[kind] or not count:  # of another byte order, or nothing that could be copied later
        array = array.astype(_TYPES[kind])
    return array, start + size + len(_padding(size))


def _padding(size: int) -> bytes:
    return bytes(-size % 8)


# ----------------------------------------------------------------------------- one model


def _columns(block: FleetBlock) -> dict[str, NDArray]:
    """Return the state of a block, by name."""
    block.finish()
    out = {"ids": _ids_out(block.ids), "standing": block.standing.table()}
    rows = block.skipped.rows()
    out["skipped"] = block.skipped.table(block.state.count[rows], block.over(rows))
    return out | dict(_arrays(block.state, "state")) | dict(_arrays(block.last, "last"))


def _arrays(whole: Any, where: str) -> list[tuple[str, NDArray]]:
    """Return the arrays of a state by name, without those that take no memory or are not needed."""
    if whole is None:
        return []
    if isinstance(whole, np.ndarray):
        needs_none = takes_no_memory(whole) or (where in _AT_TIMES and whole.size > 0 and not whole.any())
        return [] if needs_none else [(where, whole)]
    return [pair for one in fields(whole) for pair in _arrays(getattr(whole, one.name), f"{where}.{one.name}")]


def _state_from(like: Any, kept: dict[str, NDArray], where: str) -> Any:
    """Return the state that columns describe, with absent fields as at the start."""
    if like is None:
        return None
    if is_dataclass(like):
        parts = {one.name: _state_from(getattr(like, one.name), kept, f"{where}.{one.name}") for one in fields(like)}
        return type(like)(**parts)  # pyright: ignore[reportCallIssue]
    array = kept.pop(where, None)
    if takes_no_memory(like) and (array is None or where == "state.test.runs.down"):
        return like
    if array is None:
        raise FileFormatError(f"this snapshot has no column {where!r}")
    if array.shape != like.shape or array.dtype != like.dtype:
        raise FileFormatError(f"the column {where!r} of this snapshot has another type or shape")
    return array


def _block(name: str, model: Any, kept: dict[str, NDArray], monitors: Mapping[str, Monitor]) -> FleetBlock:
    label = f" {name!r}" if name else ""
    if name not in monitors:
        raise FileFormatError(
            f"this snapshot has a model{label} that no monitor is given for: monitors={{name: monitor}}"
        )
    monitor = monitors[name]
    ids = _ids_in(kept.pop("ids"), str(model["ids"]))
    if model["monitor"] != fingerprint_of(monitor):
        raise FileFormatError(f"this snapshot is of another monitor{label}, or of other thresholds")
    spec = monitor._specification()
    state: State = _state_from(initial_state(spec, len(ids)), kept, "state")
    _check_state(spec, state)
    standing = _of_plants(kept.pop("standing"), len(ids), "alarms")
    skipped = _of_plants(kept.pop("skipped"), len(ids), "skipped samples")
    if not _in_order(skipped, state):
        raise FileFormatError("the skipped samples of this snapshot are not in order")
    alarms = StandingAlarms(len(ids), standing.tolist())
    block = FleetBlock(monitor, ids, state, alarms, SkippedSamples(skipped.tolist()))
    block.take_over(_state_from(block.last, kept, "last"))
    if kept:
        raise FileFormatError(f"this snapshot has columns that are not known: {listed(list(kept))}")
    return block


def _of_plants(table: NDArray, plants: int, what: str) -> NDArray:
    """Return a table whose first column names rows of plants, checked for its form."""
    if table.ndim != 2 or table.shape[1] != 3 or not ((table >= 0) & (table[:, :1] < plants)).all():
        raise FileFormatError(f"the {what} of this snapshot do not belong to its plants")
    return table


def _in_order(spans: NDArray, state: State) -> bool:
    """Tell whether spans of samples are ordered, not empty, and within the samples of the plants."""
    row, start, stop = spans.T
    same = row[1:] == row[:-1]
    after = np.where(same, start[1:] > stop[:-1], row[1:] > row[:-1])
    return bool((start < stop).all() and (stop <= state.count[row]).all() and after.all())


def _check_state(spec: Specification, state: State) -> None:
    """Raise if a state is invalid; the checksum detects damage, and this check invented states."""
    counters = (state.count, state.filter.age, state.filter.gap, state.filter.resets, state.filter.broken)
    numbers = (state.filter.x, state.filter.start_sums, state.filter.moved)
    if any((one < 0).any() for one in counters) or not all(np.isfinite(one).all() for one in numbers):
        raise FileFormatError("this snapshot holds an impossible state of the filter")
    first = spec.first
    if first is not None and (state.filter.age[state.filter.starting] >= first.samples).any():
        raise FileFormatError("this snapshot holds a start that should be over")
    try:
        spec.test.check_state(state.test)
        spec.isolation.check_state(state.isolation, int(state.count.max(initial=0)))
    except ResiduaError as error:
        raise FileFormatError(f"this snapshot holds an impossible state: {error}") from error


# -------------------------------------------------------------------------------- ids


def _kind_of_ids(ids: list[Hashable]) -> str:
    if all(type(one) is int for one in ids):
        return "whole"
    if all(type(one) is str for one in ids):
        return "text"
    raise FileFormatError("a snapshot holds plants whose ids are all whole numbers, or all texts")


def _ids_out(ids: list[Any]) -> NDArray:
    if _kind_of_ids(ids) == "whole":
        try:
            return np.array(ids, dtype=np.int64)
        except OverflowError as error:
            raise FileFormatError("the ids of plants must be whole numbers of 64 bits") from error
    return np.frombuffer(json.dumps(ids).encode(), dtype=np.uint8)


def _ids_in(column: NDArray, kind: str) -> list[Hashable]:
    if kind == "whole" and column.ndim == 1 and column.dtype == np.int64:
        return column.tolist()
    if kind == "text" and column.ndim == 1 and column.dtype == np.uint8:
        ids = json.loads(column.tobytes())
        if isinstance(ids, list) and all(isinstance(one, str) for one in ids):
            return ids
    raise FileFormatError("the ids of this snapshot are invalid")


__all__ = ["MARK", "VERSION", "restored_blocks", "snapshot_of"]
