"""Guess which recorded columns are inputs: those that hold their values where the others move; or say why not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: Share of the rows in which a command holds its value, at least.
_HELD = 0.5
#: Deviations below which a channel follows exactly, and rows that this is looked at on.
_EXACT, _ROWS = 1e-6, 5_000


def guessed_inputs(recordings: Sequence[NDArray[np.float64]], channels: Sequence[str]) -> tuple[str, ...]:
    """Return the channels that look like commands: they change, and hold their value in most rows.

    None where all channels do so, as of sensors with a coarse resolution.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (time, channels)
    channels : sequence of str

    Examples
    --------
    >>> import numpy as np
    >>> valve, level = np.repeat([0.0, 1.0], 50), np.random.default_rng(0).standard_normal(100)
    >>> guessed_inputs([np.column_stack([level, valve])], ["level", "valve"])
    ('valve',)
    """
    steps = np.vstack([np.diff(one, axis=0) for one in recordings])
    known = np.isfinite(steps)
    held = (known & (steps == 0)).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    found = tuple(name for name, share in zip(channels, held.tolist(), strict=True) if _HELD <= share < 1)
    return () if len(found) == len(channels) else found


def exact_channels(recordings: Sequence[NDArray[np.float64]], channels: Sequence[str]) -> tuple[str, ...]:
    """Return the channels that follow from the others, and from the row before, without any noise.

    Commands of a controller do so from what it measures, and so does what it measures from its commands.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (time, channels)
    channels : sequence of str

    Examples
    --------
    >>> import numpy as np
    >>> level = np.random.default_rng(0).standard_normal((100, 2))
    >>> valve = -2 * level[:, [0]]
    >>> exact_channels([np.hstack([valve, level])], ["valve", "level", "flow"])
    ('valve', 'level')
    """
    rows = np.vstack([np.hstack([one[1:], one[:-1]]) for one in recordings])
    rows = rows[np.isfinite(rows).all(axis=1)][:_ROWS]
    spread = rows.std(axis=0) if len(rows) else np.zeros(2 * len(channels))
    rows = (rows - rows.mean(axis=0)) / np.where(spread > 0, spread, 1.0) if len(rows) else rows
    found = []
    for i, name in enumerate(channels):
        if not spread[i] > 0 or len(rows) <= rows.shape[1]:
            continue
        others = np.delete(rows, i, axis=1)
        error = rows[:, i] - others @ np.linalg.lstsq(others, rows[:, i], rcond=None)[0]
        if float(np.sqrt(np.mean(error**2))) < _EXACT:
            found.append(name)
    return tuple(found)


__all__ = ["exact_channels", "guessed_inputs"]
