"""Reading .mat files: by SciPy, in a child process, so that a damaged file cannot end this one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from threading import Timer
from typing import IO, Protocol

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError
from residua.recording import array_child
from residua.recording.unpacked import too_large, unpacked_limit
from residua.visible import echo, shortened, visible

#: Seconds that reading may take: these, and one more for every so many bytes of the file.
_PATIENCE, _BYTES_PER_SECOND = 60.0, 2**20
#: Longest line between the arrays.
_LINE = 2**16

_ADVICE = "save it again with -v7, or as CSV"


class Stream(Protocol):
    """Stream written by the child process."""

    def read(self, size: int, /) -> bytes:
        """Return that many bytes, fewer at the end."""
        ...

    def readline(self, size: int, /) -> bytes:
        """Return a line."""
        ...


class _Pipe:
    """A pipe for NumPy, which must not take it for a file, since it would read past this object."""

    def __init__(self, stream: IO[bytes]) -> None:
        self.read, self.readline = stream.read, stream.readline


def read_mat(path: Path) -> dict[str, NDArray]:
    """Return the arrays of a .mat file (versions 4 to 7).

    Numbers and text; other contents (cells, structures) appear by name, with an array of no numbers.
    """
    limit = unpacked_limit()
    if getattr(sys, "frozen", False) or not sys.executable:
        raise FileFormatError(
            f"{path.name}: reading a .mat file needs a Python interpreter to run, and there is none here: save it as "
            ".npz or CSV"
        )
    command = [sys.executable, "-P", array_child.__file__, str(path.resolve()), str(limit)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OPENBLAS_NUM_THREADS": "1"}
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError as error:
        raise FileFormatError(f"{path.name}: no process can be started to read it: {error}") from error
    assert process.stdout is not None
    clock = Timer(_PATIENCE + path.stat().st_size / _BYTES_PER_SECOND, process.kill)
    clock.daemon = True
    clock.start()
    try:
        with process.stdout as stream:
            arrays = received(_Pipe(stream), path.name, limit)
    finally:
        late = not clock.is_alive()
        clock.cancel()
        process.kill()
        status = process.wait()
    if arrays is None:
        crashed = status < 0 and -status in set(signal.Signals)
        death = f"crashed ({signal.Signals(-status).name})" if crashed else f"ended with status {echo(status)}"
        raise FileFormatError(
            f"{path.name}: the reader {'was ended, it took too long' if late else death}: the file is "
            f"damaged, or made to do that; {_ADVICE}"
        )
    return arrays


def received(stream: Stream, source: str, limit: int) -> dict[str, NDArray] | None:
    """Return the arrays written by the child process, ``None`` if it ended before its last line.

    Raises
    ------
    FileFormatError
        If it reports an error in the file.
    """
    arrays: dict[str, NDArray] = {}
    while True:
        line = stream.readline(_LINE)
        if not line.endswith(b"\n"):
            return None
        said = json.loads(line)
        if said.get("end"):
            return arrays
        if "error" in said:
            raise _refused(said, source, limit)
        if not said["array"]:  # of its kind: no numbers
            arrays[said["name"]] = np.zeros(0, dtype="V1")
            continue
        try:
            arrays[said["name"]] = np.lib.format.read_array(stream, allow_pickle=False)  # pyright: ignore
        except (ValueError, EOFError):  # it ended within an array
            return None


def _refused(said: dict[str, str], source: str, limit: int) -> FileFormatError:
    if said["error"] == "7.3":
        return FileFormatError(f"{source}: this is a version 7.3 .mat file (HDF5); save it with -v7, or as CSV")
    if said["error"] == "size":
        return too_large(source, limit)
    if said["error"] == "memory":
        return FileFormatError(f"{source}: it claims to hold more than there is in it: the file is damaged; {_ADVICE}")
    return FileFormatError(f"{source}: not a readable .mat file: {shortened(visible(said.get('what', '')))}")
