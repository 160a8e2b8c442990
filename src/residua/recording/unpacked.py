"""Limit on the unpacked size of a compressed file: a file of a megabyte can hold a terabyte of zeros."""

from __future__ import annotations

import os

from residua.errors import FileFormatError, SettingError
from residua.visible import echo

#: Bytes that the arrays of a packed file may have, unless the environment says another number.
MAX_UNPACKED = 2 * 2**30
#: The variable of the environment that does.
VARIABLE = "RESIDUA_MAX_UNPACKED"


def unpacked_limit() -> int:
    """Return the largest number of bytes for the arrays of a .mat, .npz or Parquet file.

    Raises
    ------
    SettingError
        If the environment says something that is not a number of bytes.
    """
    text = os.environ.get(VARIABLE, "")
    if not text:
        return MAX_UNPACKED
    if not (text.isascii() and text.isdigit() and 0 < int(text[:30]) < 2**62):
        raise SettingError(f"{VARIABLE} must be a number of bytes, such as {MAX_UNPACKED}, got {echo(text)}")
    return int(text)


def too_large(source: str, limit: int) -> FileFormatError:
    """Return the error about a file that unpacks to more."""
    return FileFormatError(
        f"{source}: unpacked, its arrays are larger than {limit} bytes: it is damaged or made to fill the memory; if "
        f"it is as large as that on purpose, set {VARIABLE} to a larger number of bytes"
    )
