"""Codes of faults, the residuals that each of them fires: equal ones, and one within another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray


def equal_codes(codes: NDArray[np.bool_]) -> list[list[int]]:
    """Return the columns of a structure in groups of equal ones; those without any entry are left out."""
    groups: dict[bytes, list[int]] = {}
    for j, code in enumerate(codes.T):
        if code.any():
            groups.setdefault(code.tobytes(), []).append(j)
    return list(groups.values())


def strongly_isolating(codes: NDArray[np.bool_], faults: Sequence[tuple[str, ...]] | None = None) -> bool:
    """Tell whether no code becomes another one when some of its residuals stay silent: columns form an antichain.

    With the faults of each column, codes of the same faults may be part of one another: nobody else is meant.

    References
    ----------
    Gertler (1991), section 4.
    """
    first = [group[0] for group in equal_codes(codes)]
    different = codes[:, first]
    within = (different[:, :, None] <= different[:, None, :]).all(axis=0)
    if faults is not None:
        same = np.array([[set(faults[i]) == set(faults[j]) for j in first] for i in first], dtype=bool)
        within &= ~same.reshape(within.shape)
        return not within.any()
    return int(within.sum()) == different.shape[1]  # each within itself alone


def code_table(
    names: Sequence[str], structure: NDArray[np.bool_], faults: Sequence[str], remarks: Mapping[str, str] | None = None
) -> list[str]:
    """Return the lines of a structure as a table of crosses, with remarks on its rows, and the faults by number."""
    width = max([len(name) for name in names], default=0) + 2
    lines = [" " * width + " ".join(f"{k + 1:>2}" for k in range(len(faults)))]
    for name, row in zip(names, structure, strict=True):
        why = f"   {remarks[name]}" if remarks and name in remarks else ""
        lines.append(f"{name:<{width}}" + " ".join(" x" if one else " ." for one in row) + why)
    return [*lines, *(f"  {k + 1}: {name}" for k, name in enumerate(faults))]
