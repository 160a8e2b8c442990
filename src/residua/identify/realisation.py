"""The matrices of a model in innovation form, by regressions among its states, inputs and outputs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, DataError, DesignError
from residua.identify.hankel_factor import NOISE_FREE, HankelFactor, regress
from residua.identify.subspace_methods import StateMap, state_map
from residua.linear import StateSpace
from residua.linear.poles.riccati import filter_riccati
from residua.linear.poles.spectrum import spectral_radius
from residua.tolerances import IDENTITY

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Innovations:
    r"""A model in innovation form, in units of the factor.

    .. math:: x_{k+1} = A x_k + B u_k + K e_k + c_x, \qquad y_k = C x_k + D u_k + c_y + e_k

    Attributes
    ----------
    A, B, C, D, K : ndarray
    state_constant, output_constant : ndarray
    covariance : ndarray
        Of the innovations.
    states : ndarray, shape (n, past rows x channels)
        What takes the past to the states.
    past : int
    note : str
        The repair of the gain, if it needed one.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    K: Matrix
    state_constant: Matrix
    output_constant: Matrix
    covariance: Matrix
    states: Matrix
    past: int
    note: str = ""

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    def at_rest(self) -> tuple[Matrix, Matrix, float]:
        """Return states and outputs at rest for inputs of zero, and what of the constants no rest balances."""
        n = self.order
        if not n:
            return np.zeros(0), self.output_constant, 0.0
        M = np.eye(n) - self.A
        x, _, _, _ = np.linalg.lstsq(M, self.state_constant, rcond=IDENTITY)
        left = float(np.abs(M @ x - self.state_constant).max(initial=0.0))
        return np.asarray(x, dtype=float), self.C @ x + self.output_constant, left


def one_step_predictor(A: Matrix, B: Matrix, C: Matrix, D: Matrix, K: Matrix, *, dt: float) -> StateSpace:
    r"""Return the filter from inputs and outputs to the outputs predicted one row ahead, of a model with a gain.

    .. math:: x_{k+1} = (A - K C) x_k + (B - K D) u_k + K y_k, \qquad \hat y_k = C x_k + D u_k
    """
    return StateSpace(A - K @ C, np.hstack([B - K @ D, K]), C, np.hstack([D, np.zeros((len(C), len(C)))]), dt=dt)


def realise(factor: HankelFactor, states: StateMap, order: int, *, feedthrough: bool) -> Innovations:
    """Return the model of an order: outputs by states and inputs, then the next states by these and the innovations.

    Where the gain of that regression leaves the predictor unstable, the gain is that of the Riccati equation for the
    covariances of both residuals.

    Raises
    ------
    DataError
        If no stable predictor has these covariances.
    """
    R, now, m, p = factor.R, states.past, factor.n_inputs, factor.n_outputs
    T, one, u, y = states.T[:order], R[:, [0]], R[:, factor.inputs(now)], R[:, factor.outputs(now)]
    x0, x1 = R[:, factor.signals(range(now))] @ T.T, R[:, factor.signals(range(1, now + 1))] @ T.T
    A = C = None
    if states.observability is not None:
        G = states.observability[:, :order]
        A, C = np.asarray(np.linalg.lstsq(G[:-p], G[p:], rcond=None)[0], dtype=float), G[:p]
    given = np.hstack([one, *([u] if feedthrough else []), *([x0] if C is None else [])])
    fit, e = regress(y if C is None else y - x0 @ C.T, given)
    D = fit[:, 1 : 1 + m] if feedthrough else np.zeros((p, m))
    C = fit[:, fit.shape[1] - order :] if C is None else C
    e = np.where(np.linalg.norm(e, axis=0) > NOISE_FREE * np.sqrt(factor.windows), e, 0.0)
    step, left = regress(x1 if A is None else x1 - x0 @ A.T, np.hstack([one, u, *([x0] if A is None else []), e]))
    B, K = step[:, 1 : 1 + m], step[:, -p:]
    A = step[:, 1 + m : 1 + m + order] if A is None else A
    samples = max(factor.windows - order - 1 - (m if feedthrough else 0), 1)
    V = e.T @ e / samples
    K, note = _stable_gain(A, C, K, left.T @ left / samples, V)
    return Innovations(A, B, C, D, K, step[:, 0], fit[:, 0], V, T, now, note)


def resampled(
    factor: HankelFactor, states: StateMap, order: int, method: str, *, feedthrough: bool
) -> list[Innovations]:
    """Return the models of the data without each of their parts in turn, in the coordinates of the whole.

    Their spread is that of the estimate (the jackknife), however the noise is correlated within a part. The states are
    looked for again each time: with those of the whole the spread would be too small. A part without which there
    is no stable model of this order has none: the list is then shorter than the parts.
    """
    models = []
    now = factor.R[:, factor.signals(range(states.past))]
    for one in factor.without_each_part():
        own = state_map(method, one, states.past, feedthrough=feedthrough)
        if len(own.T) < order:
            continue
        try:
            model = realise(one, own, order, feedthrough=feedthrough)
        except DataError:  # no stable predictor: counted by who asks
            continue
        # the same states in other coordinates: S takes their own to those of the whole, for the rows of all data
        S = regress(now @ states.T[:order].T, now @ own.T[:order].T)[0]
        back = np.linalg.pinv(S)
        models.append(
            replace(
                model,
                A=S @ model.A @ back,
                B=S @ model.B,
                C=model.C @ back,
                K=S @ model.K,
                state_constant=S @ model.state_constant,
                states=S @ model.states,
            )
        )
    return models


def _stable_gain(A: Matrix, C: Matrix, K: Matrix, W: Matrix, V: Matrix) -> tuple[Matrix, str]:
    """Return the gain of a stable predictor, and what is said if it is not the one that was estimated."""
    radius = float(spectral_radius(A - K @ C))
    if radius < 1:
        return K, ""
    n, cross = len(A), K @ V
    joint = np.block([[K @ cross.T + W, cross], [cross.T, V]]) + NOISE_FREE**2 * np.eye(n + len(V))
    size = np.sqrt(np.diag(joint))
    values, vectors = np.linalg.eigh(joint / np.outer(size, size))  # rounding leaves some of them negative
    joint = np.outer(size, size) * ((vectors * np.maximum(values, 0.0)) @ vectors.T)
    try:
        solution = filter_riccati(A, C, joint[:n, :n], joint[n:, n:], joint[:n, n:], dt=1.0)
    except (DesignError, AccuracyError) as error:
        raise DataError(
            f"no stable predictor of order {len(A)} fits the data ({error}): choose another order, or method"
        ) from error
    note = (
        f"the estimated gain left the predictor unstable (a pole of size {radius:.4g}): it is replaced by that of the "
        "Riccati equation for the same covariances"
    )
    return np.asarray(solution.gain), note
