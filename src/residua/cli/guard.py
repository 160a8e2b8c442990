"""Conversion of exceptions to one line on stderr and an exit status."""

from __future__ import annotations

import errno
import os
import re
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import typer

from residua.cli.streams import complain, unwritten
from residua.errors import ResiduaError
from residua.visible import visible

#: Exit statuses of every command.
NO_FAULT, FAULT, ERROR, UNLIKE, CANNOT_TELL, INTERRUPTED, BROKEN_PIPE = 0, 1, 2, 3, 4, 130, 141

# Typer brings its own copy of click from 0.20 or so on: take the class from where typer has it.
USAGE: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


#: Errors of writing.
_FULL = (errno.ENOSPC, errno.EIO, errno.EFBIG, errno.EBADF)

#: The options of the command that runs: advice names those, and no other's.
_OPTIONS: ContextVar[frozenset[str]] = ContextVar("options", default=frozenset())
#: Options that stand for arguments of a Python call, and how their words get into a message.
ARGUMENTS: dict[str, Callable[[str], str]] = {}


def speak_of(command: Any) -> None:
    """Let remedies name the options of a command."""
    _OPTIONS.set(frozenset(name for parameter in command.params for name in parameter.opts))


@contextmanager
def guarded() -> Iterator[None]:
    """Turn every exception into a line on stderr and an exit status."""
    try:
        yield
    except (typer.Exit, USAGE):
        raise
    except (Exception, KeyboardInterrupt) as error:
        raise typer.Exit(status_of(error)) from None


def status_of(error: BaseException) -> int:
    """Print an error as one line on stderr, and return the exit status."""
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        complain("interrupted")
        return INTERRUPTED
    if isinstance(error, OSError):
        unwritten()
    if isinstance(error, BrokenPipeError):  # the reader of the output has gone
        return BROKEN_PIPE
    if os.environ.get("RESIDUA_TRACEBACK", "") not in ("", "0"):
        complain(traceback.format_exc().rstrip())
    complain(f"error: {describe(error)}")
    return ERROR


def end(status: int) -> int:
    """Flush the output; return the status, or that of an error in doing so."""
    lost = unwritten()
    if lost is None:
        return status
    if isinstance(lost, BrokenPipeError):
        return BROKEN_PIPE
    complain(f"error: {describe(lost)}")
    return ERROR


def describe(error: BaseException) -> str:
    """Return an error as one line."""
    text = visible(" ".join(str(error).split()))
    if isinstance(error, ResiduaError):
        return in_cli_words(text)
    if isinstance(error, OSError) and error.strerror:
        # An error about a file has its name; without one it is about the output.
        name = visible(str(error.filename)) if error.filename else "standard output" if error.errno in _FULL else ""
        return f"{name}: {error.strerror}" if name else error.strerror
    if isinstance(error, MemoryError):
        return f"not enough memory{': ' + text if text else ''}"
    return f"unexpected {type(error).__name__}: {text} (a defect; RESIDUA_TRACEBACK=1 shows the traceback)"


_FAULTS = r"with_(?:sensor_faults|actuator_faults|faults)"
#: Advice for Python, as patterns, and the same for the command line.
_WORDS = {
    r"allow_missing=True": "--allow-missing",
    r"missing='hold'": "--hold",
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
    r"NormThreshold\(window=(\d+|\.\.\.)\)": r"--window \1",
    r"NormThreshold\(persistence=(\d+|\.\.\.)\)": r"--persistence \1",
    r"\b(poles|margin|faults)=(?:\[\.\.\.\]|\.\.\.|(?=[,;. )]|$))": r"--\1",
    r"\b(observer|scheme|transient)='([a-z-]+)'": r"--\1 \2",
}


def in_cli_words(text: str) -> str:
    """Return remedies for Python in terms of the running command."""
    for python, here in _WORDS.items():
        text = re.sub(python, here, text)
    options = _OPTIONS.get()
    for option, in_words in ARGUMENTS.items():
        text = in_words(text) if option in options else text
    for option in options:
        name = option.lstrip("-").replace("-", "_")
        text = re.sub(rf"\b{name}=(?:True\b|\[\.\.\.\]|\.\.\.|(?=[,;. )]|$))", option, text)
    return text


def show_usage(error: Any) -> int:
    """Show the usage of a command, and the mistake; return the exit status."""
    if type(error).__name__ == "NoArgsIsHelpError":  # its message is the help
        complain(error.format_message())
        return end(ERROR)
    context = getattr(error, "ctx", None)
    if context is not None:
        complain(f"{context.get_usage()}\nTry '{context.command_path} --help' for help.\n")
    message = visible(error.format_message())
    if message.startswith("Got unexpected extra argument") and "--output" in _OPTIONS.get():
        message += ": the file to write is named by -o"
    complain(f"error: {message}")
    return end(ERROR)


def warn(line: str) -> None:
    """Write a warning to stderr."""
    complain(f"warning: {visible(line)}")
