"""The columns of a recording in a file of named arrays: MATLAB .mat and NumPy .npz."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import NDArray

from residua.errors import DataError
from residua.recording.columns import ReadOptions
from residua.visible import echo, listed

Arrays = dict[str, NDArray]


def table_from_arrays(arrays: Arrays, options: ReadOptions, source: str) -> dict[str, NDArray]:
    """Return the named columns of a file of arrays.

    In this order: the matrix that the caller has chosen; one array per channel; the matrices ``u`` and ``y``; the only
    matrix with as many columns as there are channels, inputs first.
    """
    if options.transpose:
        arrays = {name: M.T if M.ndim == 2 else M for name, M in arrays.items()}
    inputs, outputs = options.named_in(list(arrays))
    channels, names, variable = (*inputs, *outputs), options.matrix_names, options.variable
    if variable is not None:
        if variable not in arrays:
            raise DataError(f"{source}: no array {echo(variable)}; there are: {_listed(arrays)}")
        return _singles(arrays, skip=variable) | matrix_columns(arrays[variable], variable, channels, names, source)
    if names is None:
        if channels and set(channels) <= set(arrays):
            return _singles(arrays)
        parts = {part: group for part, group in (("u", inputs), ("y", outputs)) if group}
        if parts and all(part in arrays for part in parts):
            out = _singles(arrays)
            for part, group in parts.items():
                out |= matrix_columns(arrays[part], part, group, None, source)
            return out
    wanted = len(names or channels) or None
    chosen = [
        name
        for name, M in arrays.items()
        if _is_numeric(M) and M.ndim == 2 and min(M.shape) > 0 and wanted in (None, M.shape[1])
    ]
    if len(chosen) != 1:
        if names is None and set(channels) & set(arrays):
            return _singles(arrays)  # some channels are there: the caller says which are not
        columns = f"{wanted} columns" if wanted else "columns"
        problem = f"several matrices have {columns}" if chosen else f"no matrix has {columns}"
        raise DataError(f"{source}: {problem}: choose one with variable=; there are: {_listed(arrays)}")
    return _singles(arrays, skip=chosen[0]) | matrix_columns(arrays[chosen[0]], chosen[0], channels, names, source)


def matrix_columns(
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
