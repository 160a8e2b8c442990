"""Processes of ``python -m residua`` that share one start of Python, which takes most of the time of a short one.

A server imports the command line and forks for every request. The fork redirects its file numbers, makes its standard
streams as Python makes them at its start, and ends as every process does: what the end of Python does to the status and
to standard error is real. ``tests/cli/test_statuses.py`` compares it with real processes, for every kind of stream.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from io import BufferedReader, BufferedWriter, FileIO, TextIOWrapper
from pathlib import Path
from types import TracebackType
from typing import TextIO

#: What a redirection of the shell opens, by its arrow.
_FLAGS = {">": os.O_WRONLY | os.O_CREAT | os.O_TRUNC, "<": os.O_RDONLY}


class ForkingServer:
    """A started Python that runs ``residua`` in forks of itself; to be used in a ``with`` statement."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self) -> ForkingServer:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._process.communicate()
        assert self._process.returncode == 0

    def run(
        self, redirections: str, *argv: object, environment: Mapping[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Run ``residua`` with the shell's redirections; only ``PYTHONUNBUFFERED`` of the environment counts."""
        texts = [self._folder / name for name in ("out", "err")]
        request = {
            "argv": [*map(str, argv)],
            "redirections": [f">{texts[0]}", f"2>{texts[1]}", *redirections.split()],
            "unbuffered": bool((environment or {}).get("PYTHONUNBUFFERED")),
        }
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(request), file=self._process.stdin, flush=True)
        status = int(self._process.stdout.readline())
        out, err = (text.read_text(encoding="utf-8") for text in texts)
        return subprocess.CompletedProcess(request["argv"], status, out, err)


def _redirect(redirection: str) -> None:
    """Do what the shell does for ``>file``, ``2>file``, ``<&-``, ``2>&-`` and the like."""
    arrow = ">" if ">" in redirection else "<"
    number, target = redirection.split(arrow)
    descriptor = int(number or "<>".index(arrow))
    if target == "&-":
        os.close(descriptor)
    else:
        opened = os.open(target, _FLAGS[arrow], 0o600)
        os.dup2(opened, descriptor)
        os.close(opened)


def _stream(like: TextIO, descriptor: int, unbuffered: bool) -> TextIO | None:
    """Return a standard stream as Python's start makes it (``create_stdio`` in ``pylifecycle.c``)."""
    try:
        os.fstat(descriptor)
    except OSError:
        return None
    reads = descriptor == 0
    raw = FileIO(descriptor, "r" if reads else "w", closefd=False)
    return TextIOWrapper(
        BufferedReader(raw) if reads else raw if unbuffered else BufferedWriter(raw),  # type: ignore[arg-type]
        encoding=like.encoding,
        errors=like.errors,
        newline=None if reads else "\n",
        line_buffering=not unbuffered and descriptor == 2,
        write_through=unbuffered,
    )


def _become(request: dict) -> int:
    """Run the command in a fresh fork and return the status that the process is to end with."""
    for redirection in request["redirections"]:
        _redirect(redirection)
    os.closerange(3, 1024)  # as in a process of its own, what is opened gets the lowest numbers
    streams = (sys.stdin, sys.stdout, sys.stderr)
    made = [_stream(like, number, request["unbuffered"]) for number, like in enumerate(streams)]
    sys.stdin, sys.stdout, sys.stderr = sys.__stdin__, sys.__stdout__, sys.__stderr__ = made  # type: ignore[assignment]

    from residua.cli import main

    sys.argv = ["residua", *request["argv"]]
    return main()


def _serve() -> int:
    """Fork for every request and report its status; in a fork, return the status that it is to end with."""
    import typer.rich_utils  # noqa: F401

    from residua.cli.app import COMMANDS, command

    for name in COMMANDS:
        command(name, [])

    gc.freeze()  # a collection in a fork would copy the pages of all that is imported
    requests, reports = os.fdopen(os.dup(0), encoding="utf-8"), os.fdopen(os.dup(1), "w", encoding="utf-8")
    for line in requests:
        child = os.fork()
        if not child:
            return _become(json.loads(line))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), file=reports, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(_serve())
