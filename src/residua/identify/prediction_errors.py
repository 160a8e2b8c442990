"""The one-step prediction errors of a plant on recordings, with start and offsets that are not known taken out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import frozen, sample_step
from residua.errors import DataError, ModelError
from residua.identify.prediction import one_step_predictor
from residua.linear.poles.riccati import filter_riccati
from residua.linear.poles.spectrum import spectral_radius
from residua.linear.subspaces.rank import range_basis
from residua.linear.systems.recursion import run_filter
from residua.plant import Plant
from residua.plant.channels import channel_values
from residua.tolerances import DATA_ROUNDING, RESPONSE_ROUNDING, ROUNDING, SAME, TINY
from residua.visible import echo
from residua.words import counted

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Equations = Callable[..., ArrayLike]
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
    filter_ = one_step_predictor(A, B, C, D, K, dt=sampled.dt)
    outputs = np.hstack([np.zeros(D.shape), np.eye(len(C))])
    return Predictor(filter_.A, filter_.B, -filter_.C, outputs - filter_.D, point, covariance)


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
        The response of the errors to each unknown of a stretch (state at its start, then offsets); zero in rows after
        those.
    """

    raw: list[Matrix]
    nuisance: list[NDArray[np.float64]]

    def projected(self, weights: Matrix) -> list[Matrix]:
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
    constant = np.zeros((count, m))
    constant[np.arange(n, count), list(offsets)] = 1.0
    state = np.zeros((count, n))
    state[:n] = np.eye(n)
    parts, done, most = [], 0, TINY
    while done < samples:
        rows = min(_CHUNK, samples - done)
        chunk = np.ascontiguousarray(np.broadcast_to(constant[:, None, :], (count, rows, m)))
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


@dataclass(frozen=True, eq=False)
class NonlinearModel:
    r"""Equations of one's own, for :func:`grey_box` where recordings move too far for a linear plant.

    .. math::

       \hat x_{k+1} = F(\hat x_k, u_k) + K e_k, \qquad e_k = y_k - h(\hat x_k, u_k)

    with :math:`F` the solution of :math:`\dot x = f(x, u)` over one step with the inputs held (Runge-Kutta of fourth
    order), and :math:`K` the gain of the stationary Kalman filter of ``plant``; zero where that has no process noise.

    Parameters
    ----------
    rate, output : callable
        As :func:`linearise` takes them, without faults; the states are measured when ``output`` is omitted.
    plant : Plant
        The same equations linearised at rest (:func:`tangent_model`), with noise, continuous or sampled: what a fit
        returns, and what the gain is from.
    state : mapping of str to float, or array_like, shape (n,)
        The states at the plant's operating point: ``tangent_model(...).states``.
    dt : float
        0 when ``rate`` gives derivatives; the step in seconds when it gives the next state.
    substeps : int
        Steps of the Runge-Kutta method for each sample.

    Raises
    ------
    ModelError
        If a shape does not fit, or the outputs at the state are not those of the operating point.

    See Also
    --------
    linearise : The plant alone, for recordings near its operating point.

    Notes
    -----
    Assumes: the plant stands for the equations as to its gain, for which it need not be near. Some 30 microseconds for
    each sample and function evaluation, for these are the user's.

    References
    ----------
    Ljung (1999), System Identification, section 5.4 (predictors of nonlinear models).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> def tank(outflow):
    ...     def rate(x, u):
    ...         return u - outflow * np.sqrt(np.maximum(x, 0.0))
    ...     near = rs.identify.tangent_model(rate, at=([4.0], [1.0]), inputs="inflow", states="h", outputs="level")
    ...     return rs.identify.NonlinearModel(rate, plant=near.plant, state=near.states)
    >>> tank(0.5).plant.operating_point.outputs
    (4.0,)
    """

    rate: Equations
    output: Equations | None = None
    plant: Plant = field(kw_only=True)
    state: Any = field(kw_only=True)
    dt: float = field(default=0, kw_only=True)
    substeps: int = field(default=1, kw_only=True)

    def __post_init__(self) -> None:
        plant, substeps = self.plant, self.substeps
        if not callable(self.rate) or not (self.output is None or callable(self.output)):
            raise ModelError("rate and output must be functions of (x, u)")
        if not isinstance(plant, Plant):
            raise ModelError(f"plant must be a Plant, the equations linearised, got {type(plant).__name__}")
        if not isinstance(substeps, (int, np.integer)) or isinstance(substeps, bool) or substeps < 1:
            raise ModelError(f"substeps must be a positive whole number, got {echo(substeps)}")
        x = np.array(channel_values(self.state, plant.states, (np.nan,) * plant.n_states, "state"))
        object.__setattr__(self, "state", frozen(x))
        object.__setattr__(self, "dt", sample_step(self.dt))
        u, y = (np.array(part) for part in (self.plant.operating_point.inputs, self.plant.operating_point.outputs))
        if not np.isfinite(self.state).all():
            raise ModelError(f"state must give every state of the plant: {', '.join(self.plant.states)}")
        rates, measured = self._values(self.rate, self.state, u), self.measured(self.state, u)
        if rates.shape != self.state.shape or not np.isfinite(rates).all():
            raise ModelError(f"rate gives {echo(rates.tolist())} at the operating point, expected one number a state")
        if measured.shape != y.shape or not np.isfinite(measured).all():
            raise ModelError(f"output gives {echo(measured.tolist())} at the operating point, expected one an output")
        off = np.abs(measured - y)
        if np.any(off > SAME * np.maximum(np.abs(y), np.abs(measured))):
            i = int(off.argmax())
            raise ModelError(
                f"at the state that is given the output {self.plant.outputs[i]!r} is {measured[i]:g}, at the plant's "
                f"operating point {y[i]:g}: give the states of that point (tangent_model(...).states)"
            )

    @staticmethod
    def _values(function: Equations, x: Vector, u: Vector) -> Vector:
        return np.atleast_1d(np.asarray(function(x.copy(), u.copy()), dtype=float))  # it may change its arguments

    def measured(self, x: Vector, u: Vector) -> Vector:
        """Return the outputs."""
        return x.copy() if self.output is None else self._values(self.output, x, u)

    def after(self, x: Vector, u: Vector, dt: float) -> Vector:
        """Return the states one sample later."""
        if self.dt:
            return self._values(self.rate, x, u)
        h = dt / self.substeps
        for _ in range(self.substeps):
            a = self._values(self.rate, x, u)
            b = self._values(self.rate, x + h / 2 * a, u)
            c = self._values(self.rate, x + h / 2 * b, u)
            x = x + h / 6 * (a + 2 * b + 2 * c + self._values(self.rate, x + h * c, u))
        return x

    def errors(self, data: Matrix, K: Matrix, start: Vector, dt: float) -> Matrix:
        """Return the prediction errors on ``[u, y]`` from a start; not finite from where the equations are not."""
        m = data.shape[1] - K.shape[1]
        out, x = np.full((len(data), K.shape[1]), np.nan), start.copy()
        with np.errstate(all="ignore"):
            for k, row in enumerate(data):
                u = row[:m].copy()
                e = row[m:] - self.measured(x, u)
                if not np.isfinite(e).all():
                    break
                out[k] = e
                x = self.after(x, u, dt) + K @ e
        return out


def plant_of(model: Plant | NonlinearModel) -> Plant:
    """Return the linear plant of a model."""
    return model.plant if isinstance(model, NonlinearModel) else model


def model_errors(
    model: Plant | NonlinearModel,
    data: Sequence[Matrix],
    dt: float,
    offsets: Sequence[int],
    *,
    simulation: bool = False,
) -> Errors:
    """Return the prediction errors of a linear or nonlinear model on stretches of data, ``[u, y]`` each.

    Of a nonlinear one, what start and offsets do is that of the linear plant; the start that explains most by it is
    where the predictions begin, so that only a remainder of second order is not exact; where the equations do not hold
    from there, they begin at the operating point.
    """
    filter_ = predictor(plant_of(model), dt, simulation=simulation)
    linear = prediction_errors(filter_, data, offsets)
    if not isinstance(model, NonlinearModel):
        return linear
    if model.dt and abs(model.dt - dt) > SAME * dt:
        raise DataError(f"the model has dt={model.dt:g} s, the recording {dt:g} s")
    K = filter_.B[:, len(model.plant.inputs) :]
    raw = []
    for block, G in zip(data, linear.nuisance, strict=True):
        first, start = model.errors(block, K, model.state, dt), model.state
        rows, p, q = G.shape
        if rows and np.isfinite(first[:rows]).all():
            spread = np.sqrt(np.mean(first[:rows] ** 2, axis=0))
            size = np.where(spread > 0, spread, 1.0)
            unknowns = (G / size[:, None]).reshape(rows * p, q)
            width = np.linalg.norm(unknowns, axis=0)
            width = np.where(width > 0, width, 1.0)
            # e = raw + G b vanishes best at b = -(G b fit of raw)
            b = np.linalg.lstsq(unknowns / width, -(first[:rows] / size).reshape(-1), rcond=None)[0] / width
            start = start + b[: len(start)]
        better = model.errors(block, K, start, dt)
        raw.append(better if np.isfinite(better).all() else first)
    if not all(np.isfinite(e).all() for e in raw):
        raise ModelError(
            "its predictions are no finite numbers: the equations leave where they hold, or need more substeps"
        )
    return Errors(raw, linear.nuisance)
