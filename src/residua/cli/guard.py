"""From exceptions to one line on stderr and an exit status."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from residua.errors import ResiduaError

#: Exit statuses of every command.
NO_FAULT, FAULT, ERROR, INTERRUPTED, BROKEN_PIPE = 0, 1, 2, 130, 141

# Typer brings its own copy of click from 0.20 or so on: take the class from where typer has it.
_USAGE: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


class GuardedGroup(TyperGroup):
    """A group of commands none of which ends in a traceback, nor with the status of a found fault by accident."""

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen command."""
        with guarded():
            try:
                return super().invoke(ctx)
            finally:
                sys.stdout.flush()


@contextmanager
def guarded() -> Iterator[None]:
    """Turn every exception into a line on stderr and an exit status."""
    try:
        yield
    except (typer.Exit, typer.Abort, _USAGE):
        raise
    except KeyboardInterrupt:
        complain("interrupted")
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        # Whoever read the output has gone; what is left in the buffer goes nowhere, without a second error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(BROKEN_PIPE) from None
    except Exception as error:
        if os.environ.get("RESIDUA_TRACEBACK", "") not in ("", "0"):
            traceback.print_exc()
        complain(f"error: {describe(error)}")
        raise typer.Exit(ERROR) from None


def describe(error: BaseException) -> str:
    """Return one line that says what went wrong."""
    text = " ".join(str(error).split())
    if isinstance(error, ResiduaError):
        return in_cli_words(text)
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    if isinstance(error, MemoryError):
        return f"not enough memory{': ' + text if text else ''}"
    return f"unexpected {type(error).__name__}: {text} (a defect; RESIDUA_TRACEBACK=1 shows where)"


_FAULTS = r"with_(?:sensor_faults|actuator_faults|faults)"
#: What is done in Python, as a pattern, and how the same is asked for here.
_WORDS = {
    r"allow_missing=True": "--allow-missing",
    r"constant=True": "--constant",
    r"plant\.discretize\(dt\)": "by sample_time in the plant file",
    rf"(?:plant\.)?{_FAULTS}(?:(?:, or | or |, ){_FAULTS})*": "[[faults]] in the plant file",
    r"(?:plant\.)?with_disturbances(?:\(\.\.\.\))?": "[[disturbances]] in the plant file",
    r"\((?:plant\.)?with_noise\)": "([noise] in the plant file)",
    r"(?:plant\.)?with_noise(?:\(process=\.\.\., measurement=\.\.\.\)|\(\.\.\.\))?": (
        "[noise] in the plant file, with process and measurement"
    ),
    r"(?:\.)?\bfit\(u, y\) it to fault-free data": "give it one by residua fit, from fault-free data",
    r"\.?\bfit\(u, y\)": "residua fit",
    r",? or set (?:NormThreshold\(threshold|PeakThreshold\(thresholds)=\.\.\.\)": "",
    r"NormThreshold\(window=(\d+|\.\.\.)\)": r"--average \1",
    r"NormThreshold\(persistence=(\d+|\.\.\.)\)": r"--persistence \1",
    r"\b(poles|margin|faults)=(?:\[\.\.\.\]|\.\.\.|(?=[,;. )]|$))": r"--\1",
    r"\bdt=(?:\.\.\.|(?=[,;. )]|$))": "--sample-time",
    r"\bstructure=(?:\.\.\.|(?=[,;. )]|$))": "--rows",
    r"\b(observer|scheme)='([a-z-]+)'": r"--\1 \2",
}


def in_cli_words(text: str) -> str:
    """Return advice that is meant for Python as advice for the command line."""
    for python, here in _WORDS.items():
        text = re.sub(python, here, text)
    return text


def complain(line: str) -> None:
    """Write a line to stderr."""
    print(line, file=sys.stderr, flush=True)


def warn(line: str) -> None:
    """Write a warning to stderr."""
    complain(f"warning: {line}")
