"""Standard output and error as they may be: closed, full, or read by nobody any more."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import NoReturn, TextIO


class _Closed(io.TextIOBase):
    """A standard output that the caller has closed: writing to it is an error like any other."""

    def write(self, text: str, /) -> NoReturn:
        """Say that it is closed."""
        raise OSError(errno.EBADF, "it is closed", "standard output")


def prepare() -> None:
    """Make sure that there are an output and an error stream, and that no character ends a run.

    Numbers 0 to 2 of closed streams are taken by the null device: a file that the program opens would get them, and
    what others write there would end up in it.
    """
    while (plug := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(plug)
    if sys.stdout is None:
        sys.stdout = _Closed()
    if sys.stderr is None:
        sys.stderr = _null()
    for stream in (sys.stdout, sys.stderr):
        # A name that the terminal's encoding lacks must not end a run.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def complain(line: str) -> None:
    """Write a line to standard error; where that cannot be written to, only the exit status is left."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        sys.stderr = _silenced(sys.stderr)


def unwritten() -> OSError | None:
    """Flush standard output; return the error that hinders it, after which output is discarded.

    A second attempt, at the end of the process, would end it with a status of its own.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        sys.stdout = _silenced(sys.stdout)
        return error
    return None


def silence_errors_that_cannot_be_written() -> None:
    """Flush standard error; where that fails, discard its output from then on."""
    try:
        sys.stderr.flush()
    except OSError:
        sys.stderr = _silenced(sys.stderr)


def _silenced(stream: TextIO) -> TextIO:
    """Return a stream that takes everything; the old one's number points to the null device, also at its own end."""
    try:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
    except (OSError, ValueError):  # no stream of the operating system
        pass
    return _null()


def _null() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8")
