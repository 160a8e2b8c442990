"""The command ``residua``."""

from __future__ import annotations

from collections.abc import Sequence

from residua.cli import streams

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
        0 for success and no fault, 1 when ``residua run`` or ``live`` raised an alarm, 2 for an error, 130 when
        interrupted.
    """
    streams.prepare()
    try:
        status = _run(argv)
    except KeyboardInterrupt:
        return 130
    finally:
        streams.silence_errors_that_cannot_be_written()
    return status


def _run(argv: Sequence[str] | None) -> int:
    """Run the command. Every way out has its status here: Python's own for an exception, 1, is that of an alarm."""
    try:
        import typer

        from residua.cli.app import app
        from residua.cli.guard import BROKEN_PIPE, USAGE, end, show_usage, status_of
    except ImportError as error:
        if (error.name or "").split(".")[0] in _NEEDED:
            streams.complain(f"error: the command line needs the package {error.name!r}: pip install 'residua[cli]'")
        else:
            streams.complain(f"error: the package cannot be loaded: {error}")
        return 2
    try:
        status = app(args=None if argv is None else list(argv), prog_name="residua", standalone_mode=False)
        return end(status if isinstance(status, int) else 0)
    except typer.Exit as stop:
        return end(stop.exit_code)
    except SystemExit:  # rich leaves like this when whoever read its help has gone
        return end(BROKEN_PIPE)
    except Exception as error:
        return show_usage(error) if isinstance(error, USAGE) else status_of(error)
