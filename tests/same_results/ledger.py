"""The hashes of what was measured, and the numbers behind some of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

T = TypeVar("T")

#: Rows of an array that are kept as numbers; of longer ones every so many.
KEPT_ROWS = 100


def digest(*parts: object) -> str:
    """Return the SHA-256 hash of texts, numbers and arrays: of an array its shape, kind and bytes."""
    found = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            found.update(f"{part.shape}{part.dtype.str}".encode())
            found.update(np.ascontiguousarray(part).tobytes())
        else:
            found.update(str(part).encode())
        found.update(b"\0")
    return found.hexdigest()


class Ledger:
    """Hashes by case and kind, and numbers by case and kind.

    Attributes
    ----------
    hashes : dict of str to str
        By ``"case | kind"``.
    numbers : dict of str to ndarray
    """

    def __init__(self) -> None:
        self.hashes: dict[str, str] = {}
        self.numbers: dict[str, np.ndarray] = {}

    def note(self, case: str, kind: str, *parts: object) -> None:
        """Keep the hash of what was measured; every case has each kind once."""
        key = f"{case} | {kind}"
        if key in self.hashes:
            raise ValueError(f"{key!r} was measured twice")
        self.hashes[key] = digest(*parts)

    def count(self, case: str, kind: str, values: object) -> None:
        """Keep the hash of an array, and its numbers for the largest relative difference."""
        array = np.asarray(values, dtype=float)
        self.note(case, kind, array)
        self.numbers[f"{case} | {kind}"] = array[:: max(1, -(-len(array) // KEPT_ROWS))] if array.ndim else array

    def attempt(self, case: str, make: Callable[[], T]) -> T | None:
        """Return what a function makes; of a refusal keep the hash of its kind and words, and return ``None``."""
        try:
            made = make()
        except (ValueError, ArithmeticError, RuntimeError, TypeError, AttributeError, LookupError) as error:
            self.note(case, "refusal", type(error).__name__, error)
            return None
        self.note(case, "refusal", "none")
        return made

    def write(self, path: Path) -> None:
        """Write the hashes as JSON, and the numbers beside them."""
        path.write_text(json.dumps(self.hashes, indent=0, sort_keys=True) + "\n", encoding="utf-8")
        np.savez_compressed(numbers_beside(path), **{key.replace("/", "%"): v for key, v in self.numbers.items()})


def numbers_beside(path: Path) -> Path:
    """Return where the numbers of a file of hashes are."""
    return path.with_name(f"{path.name}.npz")
