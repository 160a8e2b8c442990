"""Models in innovation form, their one-step predictions of data, and the errors: fit, whiteness, feedback."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.identify.segments import BLOCK, Gathered
from residua.linear import StateSpace
from residua.linear.poles.spectrum import spectral_radius
from residua.tolerances import IDENTITY, TINY

Matrix = NDArray[np.float64]
#: Rows by which errors are compared with themselves and with inputs.
LAGS = 20
#: Correlations that chance gives once in so many data sets count as real, all lags and channels together.
CHANCE = 1e-3


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
        The map from the past to the states.
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
        """Return states and outputs at rest for inputs of zero, and the part of the constants that no rest balances."""
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


@dataclass(frozen=True, eq=False)
class ErrorFacts:
    """Statistics of the prediction errors of a model on data.

    Attributes
    ----------
    rows : int
        Rows that were predicted.
    error : ndarray, shape (outputs,)
        Root mean square of the prediction error, in the outputs' units.
    fit : ndarray, shape (outputs,)
        ``1 - |y - yhat| / |y - mean y|``: one for a perfect prediction, zero for none, below for a worse one.
    simulated_fit : ndarray or None, shape (outputs,)
        The same for outputs simulated from the inputs alone; ``None`` for a plant that is not stable or has no inputs.
    autocorrelation : ndarray, shape (outputs,)
        The largest one of each output's errors at lags 1 to 20, in size.
    whiteness : ndarray, shape (outputs,)
        Probability that white errors are as correlated (Ljung and Box).
    feedback : tuple of (str, str, float)
        The outputs whose errors the inputs of their row or later ones follow, with the largest correlation.
    """

    rows: int
    error: NDArray[np.float64]
    fit: NDArray[np.float64]
    simulated_fit: NDArray[np.float64] | None
    autocorrelation: NDArray[np.float64]
    whiteness: NDArray[np.float64]
    feedback: tuple[tuple[str, str, float], ...]


def predictions(
    model: Innovations, gathered: Gathered, reference: NDArray, units: NDArray
) -> Iterator[tuple[NDArray, NDArray, NDArray]]:
    """Yield inputs, outputs and predicted outputs of pieces of the data, in units of the factor, from rest.

    The state at the start of each piece is that of the rows before it.
    """
    m = len(gathered.inputs)
    predictor = one_step_predictor(model.A, model.B, model.C, model.D, model.K, dt=1.0)
    rest, level, _ = model.at_rest()
    for segment in gathered.segments:
        for start in range(0, len(segment) - model.past, BLOCK):
            rows = segment.rows(start, min(start + BLOCK + model.past, len(segment)))
            Z = (rows - reference) / units
            x = model.states @ Z[: model.past].ravel() - rest
            Z = Z[model.past :] - np.concatenate([np.zeros(m), level])
            yield Z[:, :m], Z[:, m:], predictor.simulate(Z, x)


def error_facts(model: Innovations, gathered: Gathered, reference: NDArray, units: NDArray) -> ErrorFacts | None:
    """Return the statistics of the errors on data; ``None`` where no segment is long enough to predict any row."""
    m, p = len(gathered.inputs), len(gathered.outputs)
    radius = float(spectral_radius(model.A))
    simulable = bool(m) and radius < 1
    skip = rows_to_forget(radius) if simulable else BLOCK
    system = StateSpace(model.A, model.B, model.C, model.D, dt=1.0)
    rows, counts, products = 0, np.zeros(LAGS + 1), np.zeros((LAGS + 1, p))
    after, before = np.zeros((LAGS + 1, p, m)), np.zeros((LAGS + 1, p, m))
    totals, squares = np.zeros(2 * p + m), np.zeros(2 * p + m)  # of inputs, outputs and errors
    simulated, simulated_rows = np.zeros(p), 0
    for u, y, predicted in predictions(model, gathered, reference, units):
        e = y - predicted
        rows += len(y)
        totals += np.concatenate([one.sum(axis=0) for one in (u, y, e)])
        squares += np.concatenate([np.einsum("ij,ij->j", one, one) for one in (u, y, e)])
        for lag in range(min(LAGS + 1, len(e))):
            counts[lag] += len(e) - lag
            products[lag] += np.einsum("ij,ij->j", e[lag:], e[: len(e) - lag])
            after[lag] += e[: len(e) - lag].T @ u[lag:]
            before[lag] += e[lag:].T @ u[: len(e) - lag]
        if simulable and len(u) > 2 * skip:
            simulated += ((y - system.simulate(u))[skip:] ** 2).sum(axis=0)
            simulated_rows += len(u) - skip
    if not rows:
        return None
    centred = np.maximum(squares - totals**2 / rows, 0.0)
    inputs, variance = centred[:m], np.where(centred[m : m + p] > 0, centred[m : m + p], 1.0)
    # without their means: a level that is off is no correlation
    mean = totals / rows
    products = products - counts[:, None] * mean[m + p :] ** 2
    level = counts[:, None, None] * np.outer(mean[m + p :], mean[:m])
    # many short pieces have fewer pairs of rows at a lag than rows
    share = np.maximum(counts, 1.0)[:, None] / rows
    autocorrelation = products[1:] / np.where(products[0] > 0, products[0], 1.0)
    scale = np.sqrt(np.maximum(np.outer(products[0], inputs), TINY)) * share[:, None]
    after, before = (after - level) / scale, (before - level)[1:] / scale[1:]
    return ErrorFacts(
        rows,
        np.sqrt(squares[m + p :] / rows) * units[m:],
        1 - np.sqrt(squares[m + p :] / variance),
        1 - np.sqrt(simulated / simulated_rows / (variance / rows)) if simulated_rows else None,
        np.abs(autocorrelation / share[1:]).max(axis=0),
        ljung_box(autocorrelation, counts[1:], rows),
        _significant(after, before, counts, gathered.outputs, gathered.inputs),
    )


def ljung_box(correlations: NDArray, pairs: NDArray, rows: int) -> NDArray[np.float64]:
    """Return the probability of so much correlation over time in each column if it was white (Ljung and Box).

    Parameters
    ----------
    correlations : ndarray, shape (lags, columns)
        Sums of products at lags from 1, relative to the sum of squares.
    pairs : ndarray, shape (lags,)
        The products in each sum; lags without any do not count.
    rows : int
    """
    from scipy.special import gammaincc  # slow to import, and needed only here

    seen = pairs > 0
    if not seen.any():
        return np.ones(correlations.shape[1])
    statistic = rows * (rows + 2) * (correlations[seen] ** 2 / pairs[seen, None]).sum(axis=0)
    return np.asarray(gammaincc(seen.sum() / 2, statistic / 2))  # the upper tail of chi-squared


def _significant(
    correlation: NDArray, before: NDArray, pairs: NDArray, outputs: tuple[str, ...], inputs: tuple[str, ...]
) -> tuple[tuple[str, str, float], ...]:
    """Return the outputs and inputs that are correlated by more than chance at some lag, the largest first.

    Without those whose errors go with the inputs ``before`` them at least as much: there the model misses what the
    input does, and one that varies slowly goes with what comes after, too.
    """
    from scipy.special import ndtri  # slow to import, and needed only here

    if not correlation.size:
        return ()
    limit = -ndtri(CHANCE / (2 * correlation.size)) / np.sqrt(np.maximum(pairs, 1.0))
    strong = (np.abs(correlation) > limit[:, None, None]) & (pairs > 0)[:, None, None]
    largest = np.where(strong, np.abs(correlation), 0.0).max(axis=0)
    largest[largest <= np.abs(before).max(axis=0, initial=0.0)] = 0.0
    places = zip(*np.nonzero(largest), strict=True)
    return tuple(sorted(((outputs[i], inputs[j], float(largest[i, j])) for i, j in places), key=lambda one: -one[2]))


def rows_to_forget(radius: float) -> int:
    """Return the number of rows until 1 % of the start of a simulation is left, for a spectral radius below one."""
    with np.errstate(divide="ignore"):
        return int(min(np.ceil(np.log(0.01) / np.log(radius)), BLOCK))
