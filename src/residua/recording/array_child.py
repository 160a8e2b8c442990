"""Child process that reads the arrays of a .mat file with SciPy and writes them to a pipe.

SciPy's reader is compiled code that a damaged file can end with a signal; here nothing but this process ends. It
imports nothing of residua, so that it starts as fast as SciPy's reader is loaded. What it writes is data, in order: for
each array a line of JSON with its name and whether it is an array of numbers or text, and if so the array in the format
of .npy files; at last a line that says ``end``, or one with what went wrong.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import zlib
from typing import Any, BinaryIO

#: Bytes that the reader may need for each byte that a file unpacks to, and besides.
_SHARE, _BASE = 8, 2**29
#: Bytes that are unpacked at once to count them.
_PIECE = 2**20
#: Classes of MATLAB whose arrays are numbers or text; others are named and not read.
_NUMBERS = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "single", "double", "logical")
_READ = (*_NUMBERS, "char")


def answer(path: str, limit: int, out: BinaryIO) -> None:
    """Write the arrays of a file, or its error."""
    try:
        size = unpacked_size(path, limit)
        if size > limit:
            _say(out, error="size")
            return
        _bound_memory(size)
        _write(path, out)
    except NotImplementedError:  # HDF5
        _say(out, error="7.3")
    except MemoryError:
        _say(out, error="memory")
    except Exception as error:  # whatever a reader of damaged data ends with
        _say(out, error="damaged", what=f"{type(error).__name__}: {error}"[:500])


def unpacked_size(path: str, limit: int) -> int:
    """Return the number of bytes of a file after unpacking, or a number over the limit."""
    total = os.path.getsize(path)
    with open(path, "rb") as file:
        head = file.read(128)
        mark = head[126:128]
        if len(head) < 128 or mark not in (b"IM", b"MI") or 0 in head[:4]:
            return total  # version 4, which has no compression
        order = "<" if mark == b"IM" else ">"
        while total <= limit and len(tag := file.read(8)) == 8:
            kind, count = struct.unpack(f"{order}II", tag)
            if kind == 15:
                total += _unpacked(file, count, limit - total)
            else:
                file.seek(count, os.SEEK_CUR)
    return total


def _unpacked(file: BinaryIO, count: int, limit: int) -> int:
    """Return the number of bytes of a compressed part after unpacking, counted no further than a limit."""
    unpacker, total = zlib.decompressobj(), 0
    while count > 0 and total <= limit and not unpacker.eof:
        piece = file.read(min(count, _PIECE))
        if not piece:
            break
        count -= len(piece)
        while piece and total <= limit:
            total += len(unpacker.decompress(piece, _PIECE))
            piece = unpacker.unconsumed_tail
    file.seek(max(count, 0), os.SEEK_CUR)
    return total


def _bound_memory(size: int) -> None:
    """Limit memory so that a false size is a MemoryError, if the operating system supports it."""
    try:
        import resource

        with open("/proc/self/statm", encoding="ascii") as file:
            used = int(file.read().split()[0]) * resource.getpagesize()
        most = used + _SHARE * size + _BASE
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        if hard == resource.RLIM_INFINITY or most < hard:
            resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    except (ImportError, OSError, ValueError):
        pass


def _write(path: str, out: BinaryIO) -> None:
    import warnings

    import numpy as np
    from scipy.io import loadmat, whosmat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of variables that are there twice and the like; what is read is checked
        classes = {name: kind for name, _, kind in whosmat(path, appendmat=False)}
        content = loadmat(path, appendmat=False, variable_names=[n for n, kind in classes.items() if kind in _READ])
    for name, kind in classes.items():
        value = content.get(name)
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiubcU":
            _say(out, name=name, array=True)
            np.lib.format.write_array(out, np.ascontiguousarray(value).reshape(value.shape), allow_pickle=False)
        else:
            _say(out, name=name, array=False, what=kind)
    _say(out, end=True)


def _say(out: BinaryIO, **entries: Any) -> None:
    out.write(json.dumps(entries).encode("ascii") + b"\n")


def _die_quietly() -> None:
    """Leave no core file and open no window on a crash of the reader."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
    except (ImportError, OSError, ValueError):
        pass
    if sys.platform == "win32":
        import ctypes

        ctypes.windll.kernel32.SetErrorMode(0x0001 | 0x0002 | 0x8000)


if __name__ == "__main__":
    _die_quietly()
    answer(sys.argv[1], int(sys.argv[2]), sys.stdout.buffer)
    sys.stdout.buffer.flush()
