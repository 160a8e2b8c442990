"""The one-step prediction errors of a plant on recordings, with start and offsets that are not known taken out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, ModelError
from residua.identify.prediction import one_step_predictor
from residua.linear.poles.riccati import filter_riccati
from residua.linear.poles.spectrum import spectral_radius
from residua.linear.subspaces.rank import range_basis
from residua.linear.systems.recursion import run_filter
from residua.plant import Plant
from residua.tolerances import DATA_ROUNDING, RESPONSE_ROUNDING, ROUNDING, SAME, TINY
from residua.words import counted

Matrix = NDArray[np.float64]
#: Rows after which it is looked at how much is left of the start.
_CHUNK = 256
#: Doublings after which a Riccati equation counts as not solved: 2^40 steps of its recursion.
_MOST_DOUBLINGS = 40
#: Smallest eigenvalue of the correlations of the errors: outputs that say the same would get weights without bound.
_LEAST_CORRELATION = 2.0**-20


class Predictor(NamedTuple):
    """A filter from the deviations of inputs and outputs to the prediction errors, and the operating point."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    point: Matrix
    innovation_covariance: Matrix | None


def predictor(plant: Plant, dt: float, *, simulation: bool = False) -> Predictor:
    r"""Return the one-step predictor of a plant at the step of a recording.

    .. math:: \hat x_{k+1} = A \hat x_k + B u_k + K e_k, \qquad e_k = y_k - C \hat x_k - D u_k

    with the gain of the stationary Kalman filter where the plant has process noise. Without, or for a
    ``simulation``, the gain is zero: the error is that of the outputs that the inputs alone give.
    """
    if plant.is_discrete and abs(plant.dt - dt) > SAME * dt:
        raise DataError(f"the plant has dt={plant.dt:g} s, the recording {dt:g} s")
    sampled = plant.explicit() if plant.is_discrete else plant.discretize(dt)
    A, B, C, D = sampled.A, sampled.B, sampled.C, sampled.D
    K, covariance = np.zeros((len(A), len(C))), None
    if np.any(sampled.process_noise) and not simulation:
        K, covariance = _kalman_gain(sampled)
    elif np.any(sampled.measurement_noise) and not simulation:
        covariance = np.asarray(sampled.measurement_noise)
    point = np.array([*plant.operating_point.inputs, *plant.operating_point.outputs])
    made = one_step_predictor(A, B, C, D, K, dt=sampled.dt)
    outputs = np.hstack([np.zeros(D.shape), np.eye(len(C))])
    return Predictor(made.A, made.B, -made.C, outputs - made.D, point, covariance)


def _kalman_gain(plant: Plant) -> tuple[Matrix, Matrix]:
    r"""Return the gain of the stationary predictor and the covariance of its errors.

    A search asks for hundreds of them, so the Riccati equation is solved by doubling here,

    .. math::

       W = (I + G H)^{-1}, \quad A \leftarrow A W A, \quad G \leftarrow G + A W G A^T, \quad
       H \leftarrow H + A^T H W A,

    and by :func:`filter_riccati`, which says what is wrong, where that does not settle on a stable predictor.

    References
    ----------
    Chu, Fan, Lin and Wang (2004), Int. J. Control 77(8), algorithm SDA.
    """
    Q, R, S = plant.process_noise, plant.measurement_noise, plant.cross_noise
    with np.errstate(all="ignore"):
        try:
            gain = np.linalg.solve(R, S.T).T
            P = _doubled((plant.A - gain @ plant.C).T, plant.C.T @ np.linalg.solve(R, plant.C), Q - gain @ S.T)
            covariance = plant.C @ P @ plant.C.T + R
            K = np.asarray(np.linalg.solve(covariance, (plant.A @ P @ plant.C.T + S).T).T, dtype=np.float64)
            if np.abs(np.linalg.eigvals(plant.A - K @ plant.C)).max(initial=0.0) < 1:
                return K, covariance
        except (np.linalg.LinAlgError, ValueError):
            pass
    solution = filter_riccati(plant.A, plant.C, Q, R, S, dt=plant.dt)
    return np.asarray(solution.gain), np.asarray(solution.innovation_covariance)


def _doubled(A: Matrix, G: Matrix, H: Matrix) -> Matrix:
    """Return the limit of the doubling iteration; raises where it has none."""
    for _ in range(_MOST_DOUBLINGS):
        W = np.linalg.inv(np.eye(len(A)) + G @ H)
        after = H + A.T @ H @ W @ A
        A, G, before, H = A @ W @ A, G + A @ W @ G @ A.T, H, (after + after.T) / 2
        size = np.sqrt(np.abs(np.diag(H)))
        if np.all(np.abs(H - before) <= ROUNDING * np.outer(size, size)):
            return H
    raise ValueError


@dataclass(frozen=True, eq=False)
class Errors:
    """Prediction errors of stretches of data, before and after the part of start and offsets was taken out.

    Attributes
    ----------
    raw : list of ndarray, shape (time, outputs)
        From a start at the operating point.
    nuisance : list of ndarray, shape (time, outputs, unknowns)
        What each unknown of a stretch (state at its start, then offsets) does to the errors; the rows after those are
        zero.
    """

    raw: list[Matrix]
    nuisance: list[NDArray[np.float64]]

    def left(self, weights: Matrix) -> list[Matrix]:
        """Return the weighted errors less their projection on start and offsets (least squares)."""
        return [_without(e @ weights.T, weights @ G) for e, G in zip(self.raw, self.nuisance, strict=True)]

    @property
    def unknowns(self) -> int:
        """States at starts, and offsets, of all stretches."""
        return sum(G.shape[2] for G in self.nuisance)


def prediction_errors(filter_: Predictor, data: Sequence[Matrix], offsets: Sequence[int]) -> Errors:
    """Return the prediction errors of a plant on stretches of data, ``[u, y]`` each.

    Parameters
    ----------
    filter_ : Predictor
    data : sequence of ndarray, shape (time, inputs + outputs)
    offsets : sequence of int
        Columns of the data that have an unknown constant offset in each stretch.
    """
    raw, nuisance = [], []
    n = len(filter_.A)
    for block in data:
        deviations = np.ascontiguousarray(block - filter_.point)
        _, e = run_filter(*filter_[:4], np.zeros((1, n)), deviations[None])
        raw.append(e[0])
        nuisance.append(_responses(filter_, len(block), offsets))
    growth = np.log(max(spectral_radius(filter_.A), 1.0)) * max(map(len, data), default=0)
    if growth > -np.log(DATA_ROUNDING) or not all(np.isfinite(e).all() for e in raw):
        raise ModelError(
            "its predictions grow without bound: the plant is unstable and has no process noise, from which a stable "
            "predictor would be made (with_noise)"
        )
    return Errors(raw, nuisance)


def _responses(filter_: Predictor, samples: int, offsets: Sequence[int]) -> NDArray[np.float64]:
    """Return the responses of the errors to a start in each state, and to a constant one in each of some channels."""
    n, m = len(filter_.A), filter_.B.shape[1]
    count = n + len(offsets)
    held = np.zeros((count, m))
    held[np.arange(n, count), list(offsets)] = 1.0
    state = np.zeros((count, n))
    state[:n] = np.eye(n)
    parts, done, most = [], 0, TINY
    while done < samples:
        rows = min(_CHUNK, samples - done)
        chunk = np.ascontiguousarray(np.broadcast_to(held[:, None, :], (count, rows, m)))
        state, e = run_filter(*filter_[:4], state, chunk)
        parts.append(e)
        done += rows
        size = float(np.abs(e).max(initial=0.0))
        most = max(most, size)
        if not offsets and not size > RESPONSE_ROUNDING * most:
            break
    return np.ascontiguousarray(np.concatenate(parts, axis=1).transpose(1, 2, 0))


def _without(errors: Matrix, responses: NDArray[np.float64]) -> Matrix:
    """Return errors less the combination of responses that explains most of them."""
    rows, p, q = responses.shape
    out = errors.copy()
    if not q or not rows:
        return out
    G = responses.reshape(rows * p, q)
    size = np.linalg.norm(G, axis=0)
    U, _ = range_basis(G / np.where(size > 0, size, 1.0))
    first = out[:rows].reshape(-1)
    out[:rows] = (first - U @ (U.T @ first)).reshape(rows, p)
    return out


def error_covariance(errors: Sequence[Matrix], unknowns: int) -> Matrix:
    """Return the covariance of prediction errors, about zero, less the degrees of freedom of the estimate."""
    stacked = np.vstack(errors)
    samples, p = stacked.shape
    return stacked.T @ stacked / max(samples - unknowns / p, 1.0)


def weights_of(covariance: Matrix, signal: Matrix) -> tuple[Matrix, tuple[str, ...]]:
    """Return ``W`` with ``W covariance W' = I``, held finite where there is no noise; and notes.

    Parameters
    ----------
    covariance : ndarray, shape (outputs, outputs)
    signal : ndarray, shape (outputs,)
        The spread of each output: errors below the rounding of recorded values count as that.
    """
    spread = np.sqrt(np.diag(covariance))
    least = DATA_ROUNDING * np.where(signal > 0, signal, 1.0)
    size, notes = np.maximum(spread, least), ()
    if np.any(spread < least):
        notes = (
            f"{counted(int((spread < least).sum()), 'output')} without noise: errors count as rounding of the data",
        )
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size) + np.diag(np.where(spread < least, 1.0, 0.0)))
    if values[0] < _LEAST_CORRELATION * values[-1]:
        notes += ("outputs whose errors are the same but for a factor: the data count them as nearly one",)
    values = np.maximum(values, _LEAST_CORRELATION * values[-1])
    return (vectors / np.sqrt(values)).T / size, notes
