"""Child process that reads the arrays of a .mat file with SciPy and writes them as .npz.

SciPy's reader is compiled code that a damaged file can end with a signal; here nothing but this process ends. It
imports nothing of residua, so that it starts as fast as SciPy's reader is loaded. It prints nothing, or the reason why
it has written no file.
"""

from __future__ import annotations

import os
import struct
import sys
import zlib
from typing import BinaryIO

#: Bytes that the reader may need for each byte that a file unpacks to, and besides.
_SHARE, _BASE = 8, 2**29
#: Bytes that are unpacked at once to count them.
_PIECE = 2**20
#: Classes of MATLAB whose arrays are numbers or text; others are named and not read.
_NUMBERS = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "single", "double", "logical")
_READ = (*_NUMBERS, "char")


def answer(path: str, limit: int, target: str) -> str:
    """Write the arrays of a file as .npz; return the reason if that fails, else nothing."""
    try:
        size = unpacked_size(path, limit)
        if size > limit:
            return "size"
        _bound_memory(size)
        _write(path, target)
    except NotImplementedError:  # HDF5
        return "7.3"
    except MemoryError:
        return "memory"
    except Exception as error:  # whatever a reader of damaged data ends with
        return f"{type(error).__name__}: {error}"[:500]
    return ""


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


def _write(path: str, target: str) -> None:
    import warnings
    import zipfile

    import numpy as np
    from scipy.io import loadmat, whosmat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of variables that are there twice and the like; what is read is checked
        classes = {name: kind for name, _, kind in whosmat(path, appendmat=False)}
        content = loadmat(path, appendmat=False, variable_names=[n for n, kind in classes.items() if kind in _READ])
    with zipfile.ZipFile(target, "w") as archive:
        for name in classes:
            value = content.get(name)
            if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiubcU":
                value = np.zeros(0, dtype="V1")  # no numbers: a cell array, a structure
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.ascontiguousarray(value).reshape(value.shape), allow_pickle=False)


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
    print(ascii(answer(sys.argv[1], int(sys.argv[2]), sys.argv[3]))[1:-1])
