"""Reading .npz files: archives of NumPy arrays, within a size limit, and without Python objects."""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError
from residua.recording.unpacked import too_large, unpacked_limit
from residua.visible import echo

#: First bytes of every zip archive, and of every single array of NumPy.
_ZIP, _NPY = (b"PK\x03\x04", b"PK\x05\x06"), b"\x93NUMPY"


def read_npz(path: Path, source: str = "", *, mapped: bool = False) -> dict[str, NDArray]:
    """Return the arrays of a .npz file; Python objects are refused, and sizes beyond the file.

    Parameters
    ----------
    path : Path
    source : str
        Name of the file in messages; its own when omitted.
    mapped : bool
        Return memory maps, with checked checksums; compressed arrays are refused.
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
            if not mapped and sum(part.file_size for part in parts) > limit:
                raise too_large(source, limit)
            read = _mapped if mapped else _array
            return {_name(part): read(archive, part, source) for part in parts}
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
    shape, _, dtype, _ = _header(archive, part, source)
    if math.prod(shape) * dtype.itemsize > part.file_size:
        raise FileFormatError(f"{source}: {echo(_name(part))} is shorter than it says: the file is damaged")
    with archive.open(part) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def _mapped(archive: zipfile.ZipFile, part: zipfile.ZipInfo, source: str) -> NDArray:
    """Return one array as a memory map."""
    if part.compress_type != zipfile.ZIP_STORED or not part.filename.endswith(".npy"):
        raise FileFormatError(f"{source}: its arrays are compressed")
    shape, fortran, dtype, start = _header(archive, part, source)
    file, path = archive.fp, archive.filename
    assert file is not None
    assert path is not None
    file.seek(part.header_offset)
    header = file.read(30)
    sizes = [int.from_bytes(header[k : k + 2], "little") for k in (26, 28)]  # of the name and the extra entries
    raw = np.memmap(path, np.uint8, "r", part.header_offset + 30 + sum(sizes), (part.file_size,))
    if header[:4] != _ZIP[0] or zlib.crc32(raw.data) != part.CRC or not shape:
        raise FileFormatError(f"{source}: {echo(_name(part))} is damaged")
    return raw[start:].view(dtype).reshape(shape, order="F" if fortran else "C")


def _header(
    archive: zipfile.ZipFile, part: zipfile.ZipInfo, source: str
) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """Return shape, order (whether columns come first), and type of an array, and the place of its first number."""
    with archive.open(part) as member:
        version = np.lib.format.read_magic(member)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(member)
        start = member.tell()
    if dtype.hasobject:
        raise FileFormatError(f"{source}: {echo(_name(part))} holds Python objects; only arrays of numbers are read")
    return shape, fortran, dtype, start
