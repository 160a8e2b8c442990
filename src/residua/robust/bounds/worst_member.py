"""The worst member of an uncertain system that a search reaches: every bound must exceed its output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear.norms.peak_norm import peak_norm
from residua.robust.sets.uncertain_system import MOST_CORNERS, REMEDY, UncertainSystem, check_modes, corner_points

Matrix = NDArray[np.float64]
#: Numbers of impulse responses that are held at a time.
_CHUNK = 4_000_000
_TERMS = 4000


@dataclass(frozen=True, eq=False)
class WorstMember:
    """The largest peak norm among the members that were visited.

    Attributes
    ----------
    attained : float
        Attained by an input of unit size.
    values : ndarray, shape (parameters,)
    radius : float
        Largest spectral radius of all members visited.
    visited : int
    all_corners : bool
    """

    attained: float
    values: NDArray[np.float64]
    radius: float
    visited: int
    all_corners: bool


def worst_member(system: UncertainSystem, *, samples: int, seed: int) -> WorstMember:
    """Visit the corners of the set, or as many at random, and points inside; then climb by single parameters."""
    rng = np.random.default_rng(seed)
    moving = np.flatnonzero(system.high > system.low)
    every = len(moving) <= MOST_CORNERS
    points = corner_points(system.low, system.high, samples, rng)
    points = np.vstack([points, system.sample(rng, samples)]) if len(moving) else points
    sizes, radius = _visit(system, points)
    visited = len(points)
    best = points[int(np.argmax(sizes))]
    if not every:
        for _ in range(5):
            near = np.repeat(best[None], len(moving), axis=0)
            row = np.arange(len(moving))
            near[row, moving] = system.low[moving] + system.high[moving] - near[row, moving]
            nearby, r = _visit(system, near)
            radius, visited = max(radius, r), visited + len(near)
            if nearby.max() <= sizes.max():
                break
            sizes, best = nearby, near[int(np.argmax(nearby))]
    candidates = np.vstack([best[None], points[np.argsort(-sizes)[:3]]]) if len(sizes) == len(points) else best[None]
    attained, values = max(((_attained(system, v), tuple(v)) for v in candidates), key=lambda item: item[0])
    return WorstMember(attained, np.array(values), radius, visited, every)


def _attained(system: UncertainSystem, values: NDArray[np.float64]) -> float:
    member = system.member(values)
    try:
        return peak_norm(member, rtol=1e-4).attained
    except AccuracyError:  # slow, or many outputs: a lower bound is all that is wanted
        return float(_visit(system, values[None])[0][0])


def _visit(system: UncertainSystem, points: Matrix) -> tuple[NDArray[np.float64], float]:
    """Return an output that some unit input attains, for every member, and the largest spectral radius."""
    p, m = system.Dzw.shape
    T = system.balanced_states()
    own = list(system.channels)
    A0, Bp, Cq = system.A / T[:, None] * T, system.Bp / T[:, None], system.Cq * T
    Bw, Cz = system.Bw / T[:, None], system.Cz * T
    n = len(A0)
    radius, sizes = 0.0, []
    step = max(1, _CHUNK // max(_TERMS // 8 * p * m, 64 * n * n, 1))
    for start in range(0, len(points), step):
        part = points[start : start + step]
        F = part[:, own][:, :, None] * Cq
        A, C = A0 + Bp @ F, Cz + system.Dzp @ F
        modes = np.linalg.eigvals(A) if n else np.zeros((len(part), 1))
        rho = np.abs(modes).max(axis=1)
        check_modes(modes, part, system.parameters, system.dt, f"no bound exists: {REMEDY}")
        radius = max(radius, float(rho.max()))
        count = int(np.clip(np.ceil(np.log(1e-4) / np.log(max(rho.max(), 1e-3))), 8, _TERMS))
        sizes.append(_sizes(A, Bw, C, system.Dzw, count))
    return np.concatenate(sizes), radius


def _sizes(A: Matrix, B: Matrix, C: Matrix, D: Matrix, count: int) -> NDArray[np.float64]:
    """Return what a few steps of ascent attain with the first terms of each impulse response."""
    p, m = D.shape
    if not p or not m:
        return np.zeros(len(A))
    H = np.empty((len(A), count, p, m))
    H[:, 0] = D
    X = np.broadcast_to(B, (len(A), *B.shape))
    for k in range(1, count):
        H[:, k] = C @ X
        X = A @ X
    if p == 1:
        return np.linalg.norm(H, axis=3).sum(axis=1)[:, 0]
    rows = np.linalg.norm(H, axis=3).sum(axis=1)
    g = np.eye(p)[np.argmax(rows, axis=1)]
    best = rows.max(axis=1)
    for _ in range(8):
        parts = np.einsum("vkpm,vp->vkm", H, g)
        length = np.linalg.norm(parts, axis=2, keepdims=True)
        best = np.maximum(best, length.sum(axis=(1, 2)))
        unit = parts / np.maximum(length, np.finfo(float).tiny)
        gradient = np.einsum("vkpm,vkm->vp", H, unit)
        g = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), np.finfo(float).tiny)
    return best
