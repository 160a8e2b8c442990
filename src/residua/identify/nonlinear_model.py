"""A user's own equations as they are, predicted without being linearised; the gain is that of the linear plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import frozen, sample_step
from residua.errors import DataError, ModelError
from residua.identify.prediction_errors import Errors, prediction_errors, predictor
from residua.plant import Plant
from residua.plant.channels import channel_values
from residua.tolerances import SAME
from residua.visible import echo

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Equations = Callable[..., ArrayLike]


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
