"""The columns of a recording in a file of named arrays: MATLAB .mat and NumPy .npz."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import NDArray

from residua.errors import DataError
from residua.visible import echo, listed

Arrays = dict[str, NDArray]


def table_from_arrays(
    arrays: Arrays,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    variable: str | None,
    names: Sequence[str] | None,
    source: str,
) -> dict[str, NDArray]:
    """Return the named columns of a file of arrays.

    In this order: the matrix ``variable``; one array per channel; the matrices ``u`` and ``y``; the only
    matrix with as many columns as there are channels, inputs first.
    """
    channels = (*inputs, *outputs)
    if variable is not None:
        if variable not in arrays:
            raise DataError(f"{source}: no array {echo(variable)}; there are: {_listed(arrays)}")
        return _singles(arrays, skip=variable) | _columns(arrays[variable], variable, channels, names, source)
    if names is not None:
        chosen = _fitting(arrays, len(names))
    else:
        if channels and set(channels) <= set(arrays):
            return _singles(arrays)
        parts = [("u", inputs), ("y", outputs)]
        if channels and all(part in arrays for part, group in parts if group):
            out = _singles(arrays)
            for part, group in parts:
                if group:
                    out |= _columns(arrays[part], part, group, None, source)
            return out
        chosen = _fitting(arrays, len(channels) or None)
    if len(chosen) != 1:
        if names is None and set(channels) & set(arrays):
            return _singles(arrays)  # some channels are there: the caller says which are not
        wanted = f"{len(names or channels)} columns" if names or channels else "columns"
        problem = f"several matrices have {wanted}" if chosen else f"no matrix has {wanted}"
        raise DataError(f"{source}: {problem}: choose one with variable=; there are: {_listed(arrays)}")
    return _singles(arrays, skip=chosen[0]) | _columns(arrays[chosen[0]], chosen[0], channels, names, source)


def _columns(
    M: NDArray, label: str, channels: Sequence[str], names: Sequence[str] | None, source: str
) -> dict[str, NDArray]:
    """Return the columns of a matrix by their names, or by the order of the channels."""
    M = M[:, None] if M.ndim == 1 else M
    if M.ndim != 2 or not _is_numeric(M):
        raise DataError(f"{source}: {echo(label)} must be a matrix of numbers, (time, channels)")
    wanted = tuple(names if names is not None else channels)
    if not wanted:
        wanted = tuple(f"{label}{i + 1}" for i in range(M.shape[1]))
    if M.shape[1] != len(wanted) and 1 in M.shape and len(wanted) == 1:
        M = M.reshape(-1, 1)
    if M.shape[1] != len(wanted):
        hint = "; time runs down the rows: transpose it" if M.shape[0] == len(wanted) else "; name them by columns="
        raise DataError(
            f"{source}: {echo(label)} has {M.shape[1]} columns, expected {len(wanted)} ({listed(wanted)}){hint}"
        )
    return {name: M[:, i] for i, name in enumerate(wanted)}


def _fitting(arrays: Arrays, count: int | None) -> list[str]:
    return [
        name
        for name, M in arrays.items()
        if _is_numeric(M) and M.ndim == 2 and min(M.shape) > 0 and (count is None or M.shape[1] == count)
    ]


def _singles(arrays: Arrays, skip: str = "") -> dict[str, NDArray]:
    """Return every array that is one column (or row)."""
    return {name: M.ravel() for name, M in arrays.items() if name != skip and M.size == max(M.shape, default=0)}


def _is_numeric(M: NDArray) -> bool:
    return M.dtype.kind in "fiub"


def _listed(arrays: Arrays) -> str:
    """List the arrays with their shapes; entries without numbers are cell arrays or structures."""
    return listed(
        [
            f"{name} {'(no numbers)' if M.dtype.kind == 'V' else ' x '.join(map(str, M.shape))}"
            for name, M in arrays.items()
        ]
    )
