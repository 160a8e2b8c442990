"""Checked conversion of user input: finite matrices of the right shape, unique names, valid steps."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import ModelError
from residua.visible import echo, listed

#: Largest number of a model: a product of three of them is still a floating-point number.
LARGEST = 1e100


def aligned(array: NDArray) -> NDArray:
    """Return an array aligned for C: itself, or a copy.

    A view into the middle of some bytes, such as ``np.frombuffer(content, offset=1)``, need not be so.
    """
    return array if array.flags.aligned else array.copy()


def frozen(M: NDArray) -> NDArray[np.float64]:
    """Return a read-only C-ordered float64 copy of ``M``."""
    out = np.array(M, dtype=np.float64, order="C")
    out.flags.writeable = False
    return out


def matrix(value: ArrayLike, name: str, shape: tuple[int | None, int | None], *, what: str = "") -> NDArray[np.float64]:
    """Return ``value`` as a read-only matrix of the given shape, or raise with the mistake.

    Every entry is finite and at most ``LARGEST`` in size.

    A one-dimensional value is taken as one column when the shape asks for ``shape[0]`` rows, as one row
    when it asks for exactly one row. ``None`` in ``shape`` leaves that side open.
    """
    M = value if type(value) is np.ndarray and value.dtype == np.float64 else _numbers(value, name)
    rows, columns = shape
    if M.ndim == 0:
        M = M.reshape(1, 1)
    elif M.ndim == 1:
        as_column = rows != 1 if rows is not None else columns != M.size
        M = M.reshape(-1, 1) if as_column else M.reshape(1, -1)
    if M.ndim != 2:
        raise ModelError(f"{name} must have two dimensions, got {M.ndim}")
    if (rows is not None and M.shape[0] != rows) or (columns is not None and M.shape[1] != columns):
        wanted = " x ".join("any" if side is None else str(side) for side in shape)
        hint = f" ({what})" if what else ""
        raise ModelError(f"{name} must be {wanted}{hint}, got {M.shape[0]} x {M.shape[1]}")
    if not np.maximum.reduce(np.abs(M), axis=None, initial=0.0) <= LARGEST:  # or not a number
        if not np.isfinite(M).all():
            i, j = np.argwhere(~np.isfinite(M))[0]
            raise ModelError(f"{name}[{i}, {j}] is {M[i, j]}: every entry of a model must be finite")
        i, j = np.argwhere(np.abs(M) > LARGEST)[0]
        raise ModelError(
            f"{name}[{i}, {j}] is {M[i, j]:.3g}: every entry of a model must be at most {LARGEST:g} in size"
        )
    return frozen(M)


def _numbers(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return ``value`` as an array of floats, or raise."""
    try:
        if np.iscomplexobj(value):  # NumPy would only warn, and drop the imaginary parts
            raise ModelError(f"{name} must be real, got complex entries")
        return np.asarray(value, dtype=np.float64)
    except ModelError:
        raise
    except (TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"{name} must be a matrix of numbers: {error}") from error


def sample_step(dt: float) -> float:
    """Return ``dt`` as a float: 0 for continuous time, positive for sampled."""
    try:
        step = float(dt)
    except (TypeError, ValueError, OverflowError):
        step = np.nan
    if isinstance(dt, (bool, np.bool_, str, bytes)) or not np.isscalar(dt) or not 0 <= step <= LARGEST:
        raise ModelError(f"dt must be 0 (continuous) or a positive step in seconds, got {echo(dt)}")
    return step


def names(given: Iterable[str] | str | None, count: int, prefix: str, what: str) -> tuple[str, ...]:
    """Return ``count`` unique names: those given, or ``prefix1, prefix2, ...``."""
    if given is None:
        return tuple(f"{prefix}{i + 1}" for i in range(count))
    out = (given,) if isinstance(given, str) else tuple(given)
    for name in out:
        if not isinstance(name, str) or not name.strip():
            raise ModelError(f"{what}: every name must be a non-empty string, got {echo(name)}")
    if len(out) != count:
        raise ModelError(f"{what}: expected {count} names, got {len(out)}: {listed(out)}")
    unique(out, what)
    return out


def unique(given: tuple[str, ...], what: str) -> None:
    """Raise if a name occurs twice."""
    seen: set[str] = set()
    for name in given:
        if name in seen:
            raise ModelError(f"{what}: the name {echo(name)} occurs twice")
        seen.add(name)


def index_of(name: str | int, known: tuple[str, ...], what: str) -> int:
    """Return the position of a channel given by name or number, or raise with the names that exist."""
    if isinstance(name, (int, np.integer)) and not isinstance(name, bool):
        if -len(known) <= name < len(known):
            return int(name) % len(known)
        raise ModelError(f"{what} {name} does not exist: there are {len(known)}")
    if name in known:
        return known.index(name)  # pyright: ignore[reportArgumentType]
    raise ModelError(f"unknown {what} {echo(name)}; known: {listed(known)}")


def runs(flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the runs of true samples as rows ``(first, one past the last)``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2)


def different_positions(chosen: Iterable[str | int] | str | int | None, known: tuple[str, ...], what: str) -> list[int]:
    """Return the positions of the chosen channels (all when ``None``), or raise if one is chosen twice."""
    numbers = positions(chosen, known, what)
    unique(tuple(known[i] for i in numbers), f"{what}s")
    return numbers


def positions(chosen: Iterable[str | int] | str | int | None, known: tuple[str, ...], what: str) -> list[int]:
    """Return the positions of the chosen channels (all when ``None``)."""
    if chosen is None:
        return list(range(len(known)))
    if isinstance(chosen, (str, int)):
        chosen = [chosen]
    return [index_of(name, known, what) for name in chosen]
