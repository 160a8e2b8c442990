"""A local search without derivatives, from the best point of a global one."""

from __future__ import annotations

import numpy as np

from residua.robust.estimators.search_box import BoxedCost

#: Steps at the start and at the end, as fractions of the box, and how many are taken at most.
_FIRST, _LAST, _MOST = 0.02, 1e-6, 150


def polish(box: BoxedCost, seed: int) -> None:
    r"""Improve the best point of a box by a pattern search: steps along random orthogonal directions, and on the last.

    At each step :math:`x \pm s (u - l) \circ q_i` for all columns of a random orthogonal matrix, and on along the last
    improvement, all at once; ``s`` grows by a half where one is better, and halves where none is. Never makes it worse:
    the box remembers the best of all points that were looked at.

    References
    ----------
    Kolda, Lewis and Torczon (2003), SIAM Review 45(3), 385-482.
    """
    rng = np.random.default_rng([seed, 0])
    d, size, last = box.dimension, _FIRST, np.zeros(box.dimension)
    for _ in range(_MOST):
        point, cost = box.checked_best()
        directions = np.linalg.qr(rng.standard_normal((d, d)))[0] * (size * np.sqrt(d)) * box.width
        trial = [point + directions, point - directions, point + np.outer([0.5, 1.0, 2.0], last)]
        box(np.vstack(trial[: 3 if last.any() else 2]))
        moved, found = box.checked_best()
        last = moved - point
        size = min(1.5 * size, _FIRST) if found < cost else size / 2
        if size < _LAST:
            break
