"""Numbers, arrays and records as JSON: every float to its last bit, every entry checked on reading."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache
from types import NoneType, UnionType
from typing import Any, ClassVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError
from residua.number_kinds import FINITE, INDEX, USUAL, NumberKind, kind_of, number_in, numbers_in
from residua.visible import echo

#: Largest extent of an array in a file; more is a damaged file, not a design.
MAX_EXTENT = 10**8
_KINDS = {"c": "complex", "f": "float", "b": "bool", "i": "int", "u": "int"}
_TYPES = {"complex": "c", "float": "f", "bool": "b", "int": "i"}


def record(value: Any, where: str, names: Iterable[str]) -> dict[str, Any]:
    """Return a table that has exactly these entries, or raise with a missing or unknown one."""
    if not isinstance(value, Mapping):
        raise FileFormatError(f"{where or 'the file'}: expected a table, got {kind_of(value)}")
    known = tuple(names)
    for name in known:
        if name not in value:
            raise FileFormatError(f"the entry {echo(joined(where, name))} is missing")
    for name in value:
        if name not in known:
            raise FileFormatError(f"the entry {echo(joined(where, name))} is unknown")
    return dict(value)


def joined(where: str, name: str | int) -> str:
    """Return the full name of an entry."""
    return f"{where}.{name}" if where else str(name)


def table_in(value: Any, where: str) -> dict[str, Any]:
    """Return a table with any entries."""
    if not isinstance(value, Mapping):
        raise FileFormatError(f"{where}: expected a table, got {kind_of(value)}")
    return dict(value)


def list_in(value: Any, where: str, count: int | None = None) -> list[Any]:
    """Return a list, of a certain length if asked."""
    if not isinstance(value, list) or (count is not None and len(value) != count):
        wanted = "a list" if count is None else f"a list of {count}"
        raise FileFormatError(f"{where}: expected {wanted}, got {kind_of(value)}")
    return value


def texts_in(value: Any, where: str) -> tuple[str, ...]:
    """Return a list of texts."""
    return tuple(text_in(item, joined(where, i)) for i, item in enumerate(list_in(value, where)))


def text_in(value: Any, where: str) -> str:
    """Return a text."""
    if not isinstance(value, str):
        raise FileFormatError(f"{where}: expected text, got {kind_of(value)}")
    if any("\ud800" <= letter <= "\udfff" for letter in value):  # halves of characters, which no file can hold
        raise FileFormatError(f"{where}: expected text, got {kind_of(value)}, which is not Unicode")
    return value


def whole_in(value: Any, where: str, kind: NumberKind = INDEX) -> int:
    """Return a whole number, not negative unless another kind is named."""
    return number_in(value, where, kind)


def float_out(x: float) -> float | str:
    """Return a number; ``"nan"``, ``"inf"`` and ``"-inf"`` are texts, since JSON lacks them."""
    return float(x) if np.isfinite(x) else repr(float(x))


def float_in(value: Any, where: str, kind: NumberKind = FINITE) -> float:
    """Return a number written by :func:`float_out`, finite unless another kind is named."""
    return number_in(value, where, kind)


def array_out(value: NDArray) -> dict[str, Any]:
    """Return an array as its shape and its numbers in order."""
    kind, flat = _KINDS[value.dtype.kind], value.ravel().tolist()
    if kind == "complex":
        flat = [[float_out(z.real), float_out(z.imag)] for z in flat]
    elif kind == "float":
        for k in np.flatnonzero(~np.isfinite(value)).tolist():
            flat[k] = float_out(flat[k])
    return {"shape": list(value.shape), kind: flat}


def array_in(value: Any, where: str, kind: NumberKind = FINITE, ndim: int | None = None) -> NDArray:
    """Return an array written by :func:`array_out`, of numbers of a kind, with a given number of dimensions."""
    content = table_in(value, where)
    name = next((name for name in content if name in _TYPES), "")
    if set(content) != {"shape", name}:
        raise FileFormatError(f"{where}: an array must be {{shape, float | complex | int | bool}}")
    shape = tuple(whole_in(n, joined(where, "shape")) for n in list_in(content["shape"], joined(where, "shape")))
    flat = list_in(content[name], joined(where, name))
    if len(shape) > 4 or max(shape, default=0) > MAX_EXTENT or math.prod(shape) != len(flat):
        raise FileFormatError(f"{where}: an array of shape {echo(shape)} has {len(flat)} numbers")
    if _TYPES[name] != kind.dtype:
        raise FileFormatError(f"{where}: expected an array of {_KINDS[kind.dtype]}, got one of {name}")
    if ndim is not None and len(shape) != ndim:
        raise FileFormatError(f"{where}: expected an array of {ndim} dimensions, got shape {shape}")
    return numbers_in(flat, where, kind, shape)


class Record:
    """Base of saved dataclasses.

    Attributes
    ----------
    NUMBER_KINDS : mapping of str to NumberKind
        What the numbers of a field may be, where that is not the usual for its type
        (:data:`residua.number_kinds.USUAL`): more, such as NaN for what is not known, or less, such as positive.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {}


@dataclass(frozen=True)
class RecordOf:
    """The record of a dataclass that is no :class:`Record`.

    Attributes
    ----------
    cls : type
    kinds : mapping of str to NumberKind
        As ``Record.NUMBER_KINDS``.
    make : callable, optional
        Makes it from its fields; the class when omitted.
    check : callable, optional
        Takes it and its name in the file, and raises :class:`FileFormatError` if its fields do not fit together.
    """

    cls: type[Any]
    kinds: Mapping[str, NumberKind] = field(default_factory=dict)
    make: Callable[..., Any] | None = None
    check: Callable[[Any, str], object] | None = None


_SCALARS: dict[Any, str] = {float: "f", int: "i", bool: "b"}
_DTYPES: dict[Any, str] = {
    NDArray[np.float64]: "f", NDArray[np.int64]: "i", NDArray[np.bool_]: "b", NDArray[np.complex128]: "c",
}  # fmt: skip


def plain(value: Any) -> Any:
    """Return a value in the terms of JSON, for readers that do not need a record.

    Arrays become lists, numbers that are not finite null, complex numbers pairs, and all else its text.
    """
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def values_out(values: Any, but: Collection[str] = ()) -> dict[str, Any]:
    """Return a dataclass as a record: numbers, texts, arrays, tuples and tables of these, and such dataclasses.

    Fields that are named in ``but`` are left out.
    """
    return {name: _value_out(getattr(values, name)) for name in field_names(values) if name not in but}


def _value_out(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return array_out(value)
    if isinstance(value, (float, np.floating)):
        return float_out(float(value))
    if isinstance(value, (int, np.integer, np.bool_)) and not isinstance(value, bool):
        return bool(value) if isinstance(value, np.bool_) else int(value)
    if isinstance(value, tuple):
        return [_value_out(item) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _value_out(item) for name, item in value.items()}
    return values_out(value) if is_dataclass(value) else value


def values_in(
    value: Any,
    where: str,
    cls: type[Any],
    known: Mapping[str, Any] | None = None,
    usual: Mapping[str, NumberKind] = USUAL,
    others: Sequence[RecordOf] = (),
) -> Any:
    """Return the dataclass of a record.

    Each entry is of the type that its field declares, and its numbers are of the kind that the class names
    (:class:`Record`), else of the ``usual`` kind of that type. Fields that are ``known`` already are not entries of the
    record. ``others``: dataclasses that are no :class:`Record`.
    """
    out = dict(known or {})
    content = record(value, where, [name for name in field_names(cls) if name not in out])
    other = next((one for one in others if one.cls is cls), RecordOf(cls))
    kinds = cls.NUMBER_KINDS if issubclass(cls, Record) else other.kinds
    types = _declared(cls, tuple(one.cls for one in others))
    for name, entry in content.items():
        out[name] = _value_in(entry, joined(where, name), types[name], kinds.get(name), usual, others)
    made = (other.make or cls)(**out)
    if other.check is not None:
        other.check(made, where)
    return made


@lru_cache(maxsize=256)
def _declared(cls: type[Any], others: tuple[type[Any], ...]) -> dict[str, Any]:
    """Return the types of the fields; modules may import the ``others`` for checks of types alone."""
    return get_type_hints(cls, localns={one.__name__: one for one in others})


def _value_in(
    entry: Any,
    where: str,
    declared: Any,
    kind: NumberKind | None,
    usual: Mapping[str, NumberKind],
    others: Sequence[RecordOf],
) -> Any:
    if get_origin(declared) is UnionType:
        options = [one for one in get_args(declared) if one is not NoneType]
        tables = [one for one in options if get_origin(one) is Mapping and isinstance(entry, Mapping)]
        return None if entry is None else _value_in(entry, where, (tables or options)[0], kind, usual, others)
    if declared in _DTYPES:
        return array_in(entry, where, kind or usual[_DTYPES[declared]])
    if declared in _SCALARS:
        return number_in(entry, where, kind or usual[_SCALARS[declared]])
    if get_origin(declared) is tuple:
        inner = get_args(declared)[0]
        if inner is str:
            return texts_in(entry, where)
        parts = enumerate(list_in(entry, where))
        return tuple(_value_in(one, joined(where, k), inner, kind, usual, others) for k, one in parts)
    if get_origin(declared) is Mapping:
        inner = get_args(declared)[1]
        parts = table_in(entry, where).items()
        return {name: _value_in(one, joined(where, name), inner, kind, usual, others) for name, one in parts}
    if is_dataclass(declared) and isinstance(declared, type):
        return values_in(entry, where, declared, usual=usual, others=others)
    return text_in(entry, where)


def state_in(value: Any, where: str, like: Any) -> Any:
    """Return the state of a record: a dataclass with the entries and shapes of another one.

    Parameters
    ----------
    value : object
        From a file.
    where : str
        Its name there.
    like : dataclass
        The state before the first sample, of as many plants.
    """
    content, kinds = record(value, where, field_names(like)), like.NUMBER_KINDS if isinstance(like, Record) else {}
    out = {}
    for name, entry in content.items():
        at, example = joined(where, name), getattr(like, name)
        if example is None:
            if entry is not None:
                raise FileFormatError(f"{at} must be null, got {kind_of(entry)}")
            out[name] = None
        elif is_dataclass(example):
            out[name] = state_in(entry, at, example)
        elif isinstance(example, np.ndarray):
            out[name] = _as_narrow(array_in(entry, at, kinds.get(name, USUAL[example.dtype.kind])), example.dtype)
            if out[name].shape != example.shape:
                raise FileFormatError(f"{at} must have shape {example.shape}, got {out[name].shape}")
        else:
            out[name] = number_in(entry, at, kinds.get(name, USUAL[_SCALARS[type(example)]]))
    return type(like)(**out)


def _as_narrow(array: NDArray, kind: np.dtype) -> NDArray:
    """Return counts as counters of another size, which saturate."""
    if array.dtype.kind != "i" or array.dtype == kind:
        return array
    return np.minimum(array, np.iinfo(kind).max).astype(kind)


def field_names(cls: Any) -> list[str]:
    """Return the names of the fields of a dataclass."""
    return [field.name for field in fields(cls)]
