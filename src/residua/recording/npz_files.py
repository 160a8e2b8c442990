"""Reading .npz files: archives of NumPy arrays, within a size limit, and without Python objects."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError
from residua.recording.unpacked import too_large, unpacked_limit
from residua.visible import echo

#: First bytes of every zip archive, and of every single array of NumPy.
_ZIP, _NPY = (b"PK\x03\x04", b"PK\x05\x06"), b"\x93NUMPY"


def read_npz(path: Path, source: str = "") -> dict[str, NDArray]:
    """Return the arrays of a .npz file; Python objects are refused, and sizes beyond the file.

    Messages name the ``source``, by default the file.
    """
    limit, source = unpacked_limit(), source or path.name
    with path.open("rb") as file:
        head = file.read(len(_NPY))
    if head == _NPY:
        raise FileFormatError(f"{source}: this is a single array (.npy); save named arrays with numpy.savez")
    if not head.startswith(_ZIP):
        raise FileFormatError(
            f"{source}: this is not a .npz file, or it holds Python objects; only arrays of numbers are read"
        )
    try:
        with zipfile.ZipFile(path) as archive:
            parts = archive.infolist()
            if sum(part.file_size for part in parts) > limit:
                raise too_large(source, limit)
            return {_name(part): _array(archive, part, source) for part in parts}
    except FileFormatError:
        raise
    except (
        Exception
    ) as error:  # whatever a reader of damaged data ends with: zlib.error, TokenError, AttributeError, ...
        raise FileFormatError(
            f"{source}: not a readable .npz file: {type(error).__name__}: {echo(str(error))}"
        ) from error


def _name(part: zipfile.ZipInfo) -> str:
    return part.filename.removesuffix(".npy")


def _array(archive: zipfile.ZipFile, part: zipfile.ZipInfo, source: str) -> NDArray:
    """Return one array, after a check of its header against its size: NumPy allocates by the header."""
    with archive.open(part) as member:
        shape, _, dtype = array_header(member)
        if dtype.hasobject:
            raise FileFormatError(
                f"{source}: {echo(_name(part))} holds Python objects; only arrays of numbers are read"
            )
        if math.prod(shape) * dtype.itemsize > part.file_size:
            raise FileFormatError(f"{source}: {echo(_name(part))} is shorter than it says: the file is damaged")
    with archive.open(part) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def array_header(member: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return shape, order (whether columns come first), and type of an array."""
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    return read(member)
