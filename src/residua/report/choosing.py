"""Choice among many faults and signals for a page: the ten that matter, and the number of others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from residua.monitor.diagnosis import Diagnosis

#: Faults, or groups of them, that are shown of many.
SHOWN_FAULTS = 10


def shown_groups(diagnosis: Diagnosis) -> list[int]:
    """Return the numbers of the groups to show: all in order, or of many the ten with the best scores.

    They are those of the main alarm, its candidates first; without an alarm by the mean score of all judged samples.
    """
    n = len(diagnosis.groups)
    if n <= SHOWN_FAULTS:
        return list(range(n))
    main = diagnosis.main_alarm
    rows = diagnosis.scores if main is None else diagnosis.scores[main.start : main.stop]
    known = np.isfinite(rows)
    mean = np.where(known, rows, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    order = [int(g) for g in np.argsort(-mean, kind="stable")]
    first = [g for c in diagnosis.candidates for g, group in enumerate(diagnosis.groups) if group == c.faults]
    return list(dict.fromkeys([*first, *order]))[:SHOWN_FAULTS]


def look_alikes(labels: Sequence[str], similarity: NDArray[np.float64], least: float) -> list[list[str]]:
    """Return the clusters of signatures that are linked by cosines of at least ``least``, the largest first."""
    n = len(labels)
    left, out = set(range(n)), []
    for first in range(n):
        if first not in left:
            continue
        cluster, new = [], [first]
        while new:
            i = new.pop()
            if i in left:
                left.remove(i)
                cluster.append(i)
                new += [j for j in left if similarity[i, j] >= least]
        if len(cluster) > 1:
            out.append([labels[i] for i in sorted(cluster)])
    return sorted(out, key=len, reverse=True)


def signal_order(diagnosis: Diagnosis) -> list[int]:
    """Return the numbers of the outputs in the order of display.

    First those that left their prediction furthest in the main alarm, in units of what they did before; where nothing
    predicts them, those that changed the most. As they come without an alarm, or where nothing was judged before it.
    """
    m = len(diagnosis.generator.plant.inputs)
    values = diagnosis.signals[:, m:].copy()
    main = diagnosis.main_alarm
    if main is None:
        return list(range(values.shape[1]))
    for i, j in diagnosis.recording.compared:
        values[:, j] = diagnosis.residuals[:, i]
    before = values[: main.start][diagnosis.decided[: main.start]]
    during = values[main.start : main.stop]
    if len(before) < 2 or not len(during):
        return list(range(values.shape[1]))
    moved = np.abs(_means(during) - _means(before))
    spread = np.sqrt(np.maximum(_means((before - _means(before)) ** 2), 0.0))
    rounding = 1e-12 * np.abs(np.where(np.isfinite(values), values, 0.0)).max(axis=0)
    spread = np.maximum(spread, rounding)
    return np.argsort(-moved / np.where(spread > 0, spread, 1.0), kind="stable").tolist()


def _means(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    known = np.isfinite(rows)
    return np.where(known, rows, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
