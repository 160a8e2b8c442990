"""Whether the outputs of a command can be written, before any work is done."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from residua.errors import DataError
from residua.files import check_output, real, special


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path] = ()) -> None:
    """Raise unless every output can be written.

    Parameters
    ----------
    outputs : iterable of Path or None
        ``None`` stands for an output that was not asked for.
    inputs : iterable of Path
        Files that must not be overwritten.
    """
    taken = {real(path): "is read by this command" for path in inputs}
    for path in outputs:
        if path is None:
            continue
        check_output(path)
        if special(path):
            continue
        if real(path) in taken:
            raise DataError(f"{path} {taken[real(path)]}; give the output another name")
        taken[real(path)] = "is given for two outputs"
