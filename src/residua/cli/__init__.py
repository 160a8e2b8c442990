"""The command ``residua``: analyze, codes, suggest, design, fit, run, demo."""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]

_NEEDED = ("typer", "rich", "click")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; those of the process when omitted.

    Returns
    -------
    int
        0 for success and no fault, 1 when ``residua run`` raised an alarm, 2 for an error, 130 when
        interrupted.
    """
    try:
        from residua.cli.app import app
    except ImportError as error:
        if (error.name or "").split(".")[0] not in _NEEDED:
            raise
        print(f"error: the command line needs the package {error.name!r}: pip install 'residua[cli]'", file=sys.stderr)
        return 2
    for stream in (sys.stdout, sys.stderr):
        # A name that the terminal's encoding lacks must not end a run.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # pyright: ignore[reportAttributeAccessIssue]
    try:
        app(args=None if argv is None else list(argv), prog_name="residua")
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 2 if stop.code else 0
    except KeyboardInterrupt:
        return 130
    return 0
