"""Reading .mat files: by SciPy, in a child process, so that a damaged file cannot end this one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from numpy.typing import NDArray

from residua.errors import FileFormatError
from residua.recording import array_child
from residua.recording.npz_files import read_npz
from residua.recording.unpacked import too_large, unpacked_limit
from residua.visible import echo, shortened, visible

#: Seconds that reading may take: these, and one more for every so many bytes of the file.
_PATIENCE, _BYTES_PER_SECOND = 60.0, 2**20

_ADVICE = "save it again with -v7, or as CSV"


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
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OPENBLAS_NUM_THREADS": "1"}
    patience = _PATIENCE + path.stat().st_size / _BYTES_PER_SECOND
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        target = Path(folder) / "arrays.npz"
        command = [sys.executable, "-P", array_child.__file__, str(path.resolve()), str(limit), str(target)]
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment,
                timeout=patience,
                check=False,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
            status, reason = done.returncode, done.stdout.decode("ascii", "replace").strip()
            crashed = status < 0 and -status in set(signal.Signals)
            death = f"crashed ({signal.Signals(-status).name})" if crashed else f"ended with status {echo(status)}"
        except subprocess.TimeoutExpired:
            status, reason, death = None, "", "was ended, it took too long"
        except OSError as error:
            raise FileFormatError(f"{path.name}: no process can be started to read it: {error}") from error
        if status == 0 and (reason or target.exists()):
            return arrays_of(target, reason, path.name)
    raise FileFormatError(f"{path.name}: the reader {death}: the file is damaged, or made to do that; {_ADVICE}")


def arrays_of(target: Path, reason: str, source: str) -> dict[str, NDArray]:
    """Return the arrays that the child process has written, or raise with the reason why there are none."""
    if not reason:
        return read_npz(target, source)
    if reason == "size":
        raise too_large(source, unpacked_limit())
    if reason == "7.3":
        raise FileFormatError(f"{source}: this is a version 7.3 .mat file (HDF5); save it with -v7, or as CSV")
    if reason == "memory":
        raise FileFormatError(f"{source}: it claims to hold more than there is in it: the file is damaged; {_ADVICE}")
    raise FileFormatError(f"{source}: not a readable .mat file: {shortened(visible(reason))}")
