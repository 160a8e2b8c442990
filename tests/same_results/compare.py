"""Which hashes of two files differ, by kind, and by how much the numbers behind them do."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from same_results.ledger import numbers_beside

#: Cases that are named for each kind that differs.
NAMED = 5


def compare(first: Path, second: Path) -> int:
    """Print what differs, and return how many hashes do."""
    before, after = (json.loads(path.read_text(encoding="utf-8")) for path in (first, second))
    only = {"only before": before.keys() - after.keys(), "only after": after.keys() - before.keys()}
    differ: dict[str, list[str]] = defaultdict(list)
    for key in sorted(before.keys() & after.keys()):
        if before[key] != after[key]:
            differ[_kind(key)].append(key)
    counted = Counter(map(_kind, before))
    print(f"{len(before)} hashes before, {len(after)} after, of {len(counted)} kinds")
    for name, keys in only.items():
        if keys:
            print(f"{name}: {len(keys)}, such as {', '.join(sorted(keys)[:NAMED])}")
    for kind, keys in sorted(differ.items()):
        print(f"{kind}: {len(keys)} of {counted[kind]} differ, such as {', '.join(keys[:NAMED])}")
    _numbers(first, second)
    count = sum(map(len, differ.values())) + sum(map(len, only.values()))
    print("the same" if not count else f"{count} hashes are not the same")
    return count


def _kind(key: str) -> str:
    """Return the kind of what was measured; of a saved monitor with the word for it."""
    case, _, kind = key.rpartition(" | ")
    return f"saved {kind}" if case.endswith("/saved") else kind


def _numbers(first: Path, second: Path) -> None:
    """Print the largest relative difference of each kind of number."""
    worst: dict[str, tuple[float, str]] = {}
    with np.load(numbers_beside(first)) as before, np.load(numbers_beside(second)) as after:
        for name in sorted(set(before.files) & set(after.files)):
            found = relative_difference(before[name], after[name])
            kind = _kind(name)
            if found >= worst.get(kind, (-1.0, ""))[0]:
                worst[kind] = found, name.replace("%", "/")
    for kind, (size, name) in sorted(worst.items()):
        print(f"largest relative difference of {kind}: {size:.2g}" + (f" ({name})" if size else ""))


def relative_difference(before: np.ndarray, after: np.ndarray) -> float:
    """Return the largest difference by the largest number; infinity where shape or missing values differ."""
    if before.shape != after.shape or not np.array_equal(np.isfinite(before), np.isfinite(after)):
        return np.inf
    there = np.isfinite(before)
    if not there.any():
        return 0.0
    size = np.abs(before[there]).max()
    change = np.abs(before[there] - after[there]).max()
    return float(change / size) if size else float(np.inf if change else 0.0)
