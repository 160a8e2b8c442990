"""Several recordings in a row: where one ends and the next begins, nothing is summed or counted across."""

from __future__ import annotations

from collections.abc import Sequence


def told_sample(sample: int, seams: Sequence[int]) -> str:
    """Say which sample that is, and of which recording where there are several."""
    if not seams:
        return f"sample {sample}"
    before = [0, *(int(s) for s in seams)]
    number = max(i for i, start in enumerate(before) if start <= sample)
    return f"sample {sample - before[number]} of recording {number + 1}"
