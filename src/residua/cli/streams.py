"""Standard output and error in any state: closed, full, or without a reader."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import NoReturn, TextIO


class _Closed(io.TextIOBase):
    """Substitute for a closed standard output: writing to it is an error like any other."""

    def write(self, text: str, /) -> NoReturn:
        """Raise, since it is closed."""
        raise OSError(errno.EBADF, "it is closed", "standard output")


def prepare() -> None:
    """Ensure an output and an error stream, in which no character ends a run.

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
    """Write a line to standard error; if that fails, only the exit status remains."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        sys.stderr = _silenced(sys.stderr)


def unwritten() -> OSError | None:
    """Flush standard output; return an error in doing so, after which output is discarded.

    A second attempt, at the end of the process, would end it with a status of its own.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        sys.stdout = _silenced(sys.stdout)
        return error
    return None


def silence_errors_that_cannot_be_written() -> None:
    """Flush standard error; if that fails, discard its output from then on."""
    try:
        sys.stderr.flush()
    except OSError:
        sys.stderr = _silenced(sys.stderr)


def _silenced(stream: TextIO) -> TextIO:
    """Return a stream that discards everything; the old descriptor points to the null device, also at its own end."""
    try:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
    except (OSError, ValueError):  # no stream of the operating system
        pass
    return _null()


def _null() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8")
