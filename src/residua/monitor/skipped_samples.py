"""Samples without a decision while plants of a fleet were over the threshold: the onset lies before them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray


class SkippedSamples:
    """Samples that were not judged since the statistics of plants went over the threshold.

    A test counts the samples over its threshold; what is missing between them is not counted, and an alarm that is
    raised later began so much earlier.

    Parameters
    ----------
    spans : iterable of (int, int, int)
        Row of the plant, number of the first sample that was not judged, and of the first one after it that was; those
        of a plant in order.
    """

    def __init__(self, spans: Iterable[tuple[int, int, int]] = ()) -> None:
        self._spans: dict[int, list[tuple[int, int]]] = {}
        for row, start, stop in spans:
            self._spans.setdefault(row, []).append((start, stop))

    def rows(self) -> NDArray[np.int64]:
        """Return the rows of the plants that have any, in order."""
        return np.array(sorted(self._spans), dtype=np.int64)

    def table(self, count: NDArray[np.int64], over: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return row, first sample and the one after the last of each relevant span, in the order of the rows.

        ``count`` and ``over``, of :meth:`rows`: samples that each plant has had, and those over the threshold that no
        alarm stands for.
        """
        spans = [
            (row, *span)
            for row, end, above in zip(self.rows().tolist(), count.tolist(), over.tolist(), strict=True)
            for span in _since_onset(self._spans[row], end, above)
        ]
        return np.array(spans, dtype=np.int64).reshape(-1, 3)

    def of(self, rows: NDArray[np.int64]) -> SkippedSamples:
        """Return the spans of some plants."""
        part = SkippedSamples()
        if self._spans:
            part._spans = {k: list(self._spans[row]) for k, row in enumerate(rows.tolist()) if row in self._spans}
        return part

    @staticmethod
    def joined(parts: Sequence[tuple[SkippedSamples, int]]) -> SkippedSamples:
        """Return the spans of several blocks as one, given their numbers of plants."""
        whole, before = SkippedSamples(), 0
        for part, plants in parts:
            whole._spans |= {before + row: list(spans) for row, spans in part._spans.items()}
            before += plants
        return whole

    def note(
        self, rows: NDArray[np.int64], before: NDArray[np.int64], usable: NDArray[np.bool_], over: NDArray[np.int64]
    ) -> None:
        """Record the samples of a block that were not judged.

        Parameters
        ----------
        rows, before : ndarray of int, shape (plants,)
            The plants, and how many samples each had before the block.
        usable : ndarray of bool, shape (plants, time)
            Whether the sample was judged.
        over : ndarray of int, shape (plants,)
            After the block: samples over the threshold that no alarm stands for.
        """
        for k in np.flatnonzero(over > 0).tolist():
            row, begin = int(rows[k]), int(before[k])
            edges = np.flatnonzero(np.diff(usable[k], prepend=True, append=True))
            spans = self._before(row, begin)
            for start, stop in zip((begin + edges[::2]).tolist(), (begin + edges[1::2]).tolist(), strict=True):
                if spans and spans[-1][1] == start:
                    start = spans.pop()[0]
                spans.append((start, stop))
            self._spans[row] = _since_onset(spans, begin + usable.shape[1], int(over[k]))

    def _before(self, row: int, begin: int) -> list[tuple[int, int]]:
        """Return the spans of a plant before a block, which may have been noted already."""
        return [(start, min(stop, begin)) for start, stop in self._spans.get(row, []) if start < begin]

    def onsets(
        self,
        rows: NDArray[np.int64],
        before: NDArray[np.int64],
        usable: NDArray[np.bool_],
        up: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Return the numbers of the samples at which the statistic of plants went over its threshold and stayed.

        Parameters
        ----------
        rows, before : ndarray of int, shape (plants,)
        usable : ndarray of bool, shape (plants, time)
            Whether the samples of the block were judged, the last of them that at which the alarm was raised.
        up : ndarray of int, shape (plants,)
            Samples over the threshold then.
        """
        raised = before + usable.shape[1]
        out = raised - up
        there = np.zeros(len(rows), dtype=bool)
        if self._spans:
            there = np.fromiter((row in self._spans for row in rows.tolist()), dtype=bool, count=len(rows))
        for k in np.flatnonzero((there | ~usable.all(axis=1)) & (up > 0)).tolist():
            judged, count, begin = np.flatnonzero(usable[k]), int(up[k]), int(before[k])
            if len(judged) >= count:
                out[k] = begin + judged[len(judged) - count]
            else:
                out[k] = _counted_back(self._before(int(rows[k]), begin), begin, count - len(judged))
        return out


def _since_onset(spans: list[tuple[int, int]], end: int, over: int) -> list[tuple[int, int]]:
    """Return the spans within this excursion."""
    onset = _counted_back(spans, end, over)
    return [span for span in spans if span[1] > onset]


def _counted_back(spans: Sequence[tuple[int, int]], end: int, count: int) -> int:
    """Return the number of the first of ``count`` judged samples, the last of which comes before ``end``."""
    for start, stop in reversed(spans):
        if end - stop >= count:
            break
        count -= end - stop
        end = start
    return end - count


__all__ = ["SkippedSamples"]
