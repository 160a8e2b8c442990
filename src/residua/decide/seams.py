"""Several recordings in a row: where one ends and the next begins, nothing is summed or counted across."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise


def parts_between(samples: int, seams: Sequence[int]) -> list[slice]:
    """Return the recordings; ``seams`` are the first samples of all but the first."""
    edges = [0, *(int(s) for s in seams), samples]
    return [slice(a, b) for a, b in pairwise(edges)]


def told_sample(sample: int, seams: Sequence[int]) -> str:
    """Say which sample that is, and of which recording where there are several."""
    if not seams:
        return f"sample {sample}"
    before = [0, *(int(s) for s in seams)]
    number = max(i for i, start in enumerate(before) if start <= sample)
    return f"sample {sample - before[number]} of recording {number + 1}"
