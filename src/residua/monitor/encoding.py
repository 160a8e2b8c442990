"""Numbers, arrays and records as JSON: every float to its last bit, every entry checked when it is read."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError

#: Largest extent of an array in a file; more is a damaged file, not a design.
MAX_EXTENT = 10**8
_KINDS = {"c": "complex", "f": "float", "b": "bool", "i": "int", "u": "int"}


def dumps(content: Mapping[str, Any]) -> str:
    """Return the text of a JSON file."""
    return json.dumps(content, allow_nan=False) + "\n"


def loads(content: bytes, source: str) -> dict[str, Any]:
    """Return the object in a JSON file; NaN and infinity, which are no JSON, are refused."""

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"it holds {constant}, which JSON does not have")

    try:
        found = json.loads(content.decode("utf-8"), parse_constant=refuse)
    except RecursionError as error:
        raise FileFormatError(f"{source} is not JSON: nested too deeply") from error
    except ValueError as error:  # also text that is not UTF-8, and integers without end
        raise FileFormatError(f"{source} is not JSON: {error}") from error
    return found if isinstance(found, dict) else {}


def record(value: Any, where: str, names: Iterable[str]) -> dict[str, Any]:
    """Return a table that has just these entries, or say which one is missing or unknown."""
    if not isinstance(value, Mapping):
        raise FileFormatError(f"{where or 'the file'}: expected a table, got {_kind(value)}")
    known = tuple(names)
    for name in known:
        if name not in value:
            raise FileFormatError(f"the entry {joined(where, name)!r} is missing")
    for name in value:
        if name not in known:
            raise FileFormatError(f"the entry {joined(where, name)!r} is unknown")
    return dict(value)


def joined(where: str, name: str | int) -> str:
    """Return the full name of an entry."""
    return f"{where}.{name}" if where else str(name)


def table_in(value: Any, where: str) -> dict[str, Any]:
    """Return a table with any entries."""
    if not isinstance(value, Mapping):
        raise FileFormatError(f"{where}: expected a table, got {_kind(value)}")
    return dict(value)


def list_in(value: Any, where: str, count: int | None = None) -> list[Any]:
    """Return a list, of a certain length if asked."""
    if not isinstance(value, list) or (count is not None and len(value) != count):
        wanted = "a list" if count is None else f"a list of {count}"
        raise FileFormatError(f"{where}: expected {wanted}, got {_kind(value)}")
    return value


def texts_in(value: Any, where: str) -> tuple[str, ...]:
    """Return a list of texts."""
    return tuple(text_in(item, joined(where, i)) for i, item in enumerate(list_in(value, where)))


def text_in(value: Any, where: str) -> str:
    """Return a text."""
    if not isinstance(value, str):
        raise FileFormatError(f"{where}: expected text, got {_kind(value)}")
    return value


def whole_in(value: Any, where: str) -> int:
    """Return a whole number that is not negative."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**62:
        raise FileFormatError(f"{where}: expected a whole number, got {_kind(value)}")
    return value


def flag_in(value: Any, where: str) -> bool:
    """Return true or false."""
    if not isinstance(value, bool):
        raise FileFormatError(f"{where}: expected true or false, got {_kind(value)}")
    return value


def float_out(x: float) -> float | str:
    """Return a number; ``"nan"``, ``"inf"`` and ``"-inf"`` are texts, since JSON lacks them."""
    return float(x) if np.isfinite(x) else repr(float(x))


def float_in(value: Any, where: str) -> float:
    """Return a number that :func:`float_out` made."""
    if value in ("nan", "inf", "-inf"):
        return float(value)
    try:
        if not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value):
            return float(value)
    except OverflowError:
        pass
    raise FileFormatError(f"{where}: expected a number, got {_kind(value)}")


def array_out(value: NDArray) -> dict[str, Any]:
    """Return an array as its shape and its numbers in order."""
    kind = _KINDS[value.dtype.kind]
    if kind == "complex":
        flat: list[Any] = [[float_out(z.real), float_out(z.imag)] for z in value.ravel()]
    elif kind == "float":
        flat = [float_out(x) for x in value.ravel()]
    else:
        flat = value.ravel().tolist()
    return {"shape": list(value.shape), kind: flat}


def array_in(value: Any, where: str) -> NDArray:
    """Return an array that :func:`array_out` made."""
    content = table_in(value, where)
    kind = next((kind for kind in content if kind in _KINDS.values()), "")
    if set(content) != {"shape", kind}:
        raise FileFormatError(f"{where}: an array must be {{shape, float | complex | int | bool}}")
    shape = tuple(whole_in(n, joined(where, "shape")) for n in list_in(content["shape"], joined(where, "shape")))
    flat = list_in(content[kind], joined(where, kind))
    if len(shape) > 4 or max(shape, default=0) > MAX_EXTENT or math.prod(shape) != len(flat):
        raise FileFormatError(f"{where}: an array of shape {shape} has {len(flat)} numbers")
    if kind == "float":
        numbers = np.array([float_in(x, where) for x in flat], dtype=float)
    elif kind == "complex":
        pairs = [list_in(pair, where, 2) for pair in flat]
        numbers = np.array([complex(float_in(a, where), float_in(b, where)) for a, b in pairs], dtype=complex)
    elif kind == "int":
        numbers = np.array([whole_in(x, where) for x in flat], dtype=np.int64)
    else:
        numbers = np.array([flag_in(x, where) for x in flat], dtype=bool)
    return numbers.reshape(shape)


_READERS = {"int": whole_in, "float": float_in, "str": text_in, "bool": flag_in, "tuple[str, ...]": texts_in}
_DTYPES = {"float64": "f", "int64": "i", "bool_": "b"}


def values_out(values: Any) -> dict[str, Any]:
    """Return a dataclass of numbers, texts and arrays as a record."""
    out = {}
    for name in field_names(values):
        value = getattr(values, name)
        if isinstance(value, np.ndarray):
            value = array_out(value)
        elif isinstance(value, (float, np.floating)):
            value = float_out(float(value))
        elif isinstance(value, np.integer):
            value = int(value)
        elif isinstance(value, tuple):
            value = list(value)
        out[name] = value
    return out


def values_in(value: Any, where: str, cls: type[Any]) -> Any:
    """Return the dataclass that a record describes, each entry of the type that its field declares."""
    content = record(value, where, field_names(cls))
    out = {}
    for field in fields(cls):
        entry, at, declared = content[field.name], joined(where, field.name), str(field.type)
        kind = declared.removesuffix(" | None")
        if entry is None and kind != declared:
            out[field.name] = None
        elif kind.startswith("NDArray["):
            array = array_in(entry, at)
            if array.dtype.kind != _DTYPES[kind[len("NDArray[np.") : -1]]:
                raise FileFormatError(f"{at}: expected an array of {kind[len('NDArray[np.') : -1]}")
            out[field.name] = array
        else:
            out[field.name] = _READERS[kind](entry, at)
    return cls(**out)


def field_names(cls: Any) -> list[str]:
    """Return the names of the fields of a dataclass."""
    return [field.name for field in fields(cls)]


def _kind(value: Any) -> str:
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
