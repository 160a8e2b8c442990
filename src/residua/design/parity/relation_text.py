"""Parity relations as equations to read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray


def terms_of(rows: NDArray[np.float64], signals: Sequence[str], discrete: bool) -> Iterator[tuple[float, str]]:
    """Yield the terms of one relation: newest sample, or highest derivative, first."""
    k = len(rows) - 1
    for column, signal in zip(rows.T, signals, strict=True):
        for i in range(k, -1, -1):
            if column[i]:
                late = k - i
                where = (
                    ("[k]" if not late else f"[k-{late}]")
                    if discrete
                    else ("" if not i else "'" * i if i < 4 else f"^({i})")
                )
                yield column[i], f"{signal}{where}"


def joined(terms: Sequence[tuple[float, str]]) -> str:
    """Return a sum as text."""
    out = ""
    for value, name in terms:
        sign = " - " if value < 0 else " + "
        if not out:
            sign = "-" if value < 0 else ""
        size = abs(value)
        out += sign + (name if abs(size - 1) < 1e-12 else f"{size:.6g} {name}")
    return out or "0"
