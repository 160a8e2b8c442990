"""Progress of long computations, one line on a terminal and nothing elsewhere; and their time limit."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

#: Callback for progress: name of the work, amount done, and total.
Progress = Callable[[str, int, int], None]
#: Seconds after which a computation is long enough to be shown.
_PATIENCE = 2.0
_WIDTH = 30


class ProgressLine:
    """A bar on standard error that appears after two seconds, and is wiped at the end.

    Only where standard error is a terminal, unless ``always``.
    """

    def __init__(self, *, always: bool = False) -> None:
        self._shown = always or sys.stderr.isatty()
        self._always = always
        self._start = time.monotonic()
        self._last = 0.0
        self._drawn = 0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Draw the bar, at most ten times a second."""
        now = time.monotonic()
        late = self._always or now - self._start >= _PATIENCE
        if not self._shown or not late or (now - self._last < 0.1 and done < total):
            return
        self._last = now
        filled = _WIDTH * done // max(total, 1)
        text = f"{stage}  [{'#' * filled}{'.' * (_WIDTH - filled)}] {done}/{total}  {now - self._start:.0f} s"
        sys.stderr.write("\r" + text.ljust(self._drawn))
        sys.stderr.flush()
        self._drawn = len(text)

    def close(self) -> None:
        """Wipe the line."""
        if self._drawn:
            sys.stderr.write("\r" + " " * self._drawn + "\r")
            sys.stderr.flush()
            self._drawn = 0


def progress_of(wanted: Progress | bool | None) -> tuple[Progress, Callable[[], None]]:
    """Return a progress callback, and a function to end it: a callable, a bar (``None``: on terminals), or nothing."""
    if callable(wanted):
        return wanted, lambda: None
    if wanted is False:
        return lambda stage, done, total: None, lambda: None
    line = ProgressLine(always=bool(wanted))
    return line, line.close


class TimeUsedUpError(Exception):
    """Work was stopped by :func:`time_limit`: a statement about the clock, which no cache of refusals keeps."""


_end: ContextVar[float] = ContextVar("end of the time", default=float("inf"))


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Let :func:`check_time` raise once so many seconds have passed, or those of an outer limit."""
    token = _end.set(min(time.monotonic() + seconds, _end.get()))
    try:
        yield
    finally:
        _end.reset(token)


def check_time(needed: float = 0.0) -> None:
    """Raise if the time is used up, or too short for the seconds of a step that cannot be stopped.

    Asked wherever a design decides a rank, keeps a result or makes a generator.
    """
    if time.monotonic() + needed >= _end.get():
        raise TimeUsedUpError
