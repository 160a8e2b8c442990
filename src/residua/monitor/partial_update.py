"""A Kalman filter with missing values: it uses the available ones, by the exact gain.

While values are missing, and until its covariance is back at the stationary one, the filter runs the recursion of
Riccati. Then it has exactly its stationary gain again. A missing input is one of which nothing is known: the last
value is held, and white noise of a very large variance comes in beside it, so that what it really was hardly matters.
Products are summed in a fixed order, on any machine.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.decide.test import ResidualTest
from residua.design import ResidualGenerator
from residua.design.banks.matched_filters import step_responses
from residua.design.core.internal_form import state_covariance
from residua.errors import AccuracyError
from residua.linear.systems.recursion import Matrices, product_checked, run_checked

Matrix = NDArray[np.float64]

#: Distance from the stationary covariance, relative to that without measurements, within which it counts as reached.
_REACHED = 1e-6
#: A gain that misses its own covariance by more is not that of a Kalman filter.
_MISSED = 1e-6
#: Variance of a state of which nothing is known, and that beyond which the filter is to start anew, likewise.
_UNKNOWN, _LOST = 1e8, 1e12
#: Doublings of the horizon over which the sight of an input is summed: a million samples.
_DOUBLINGS = 20
#: Gains that are remembered.
_MOST_GAINS = 4000


@dataclass(frozen=True, eq=False)
class Gain:
    """Step of the filter for one sample with some of its outputs.

    Attributes
    ----------
    K : ndarray, shape (n, p)
        Zero in the columns of missing outputs.
    A : of the filter with that gain.
    matrices : tuple
        From inputs and outputs to innovations, that are brought to the covariance of the stationary ones where they are
        whole.
    covariance : ndarray, shape (n, n)
        Of the error of the next prediction; zero when it is the stationary one.
    lost : bool
        Whether so little is known of the state that the filter has to start anew.
    A_T : ``A`` transposed, as it is used.
    push : ndarray, shape (ages + 1, faults, n)
        How a fault moves the error off the stationary one, by age.
    own, seen : ndarray, shapes (ages + 1, faults, residuals) and (n, residuals)
        Whitened responses to faults where the error is the stationary one; what an error beyond adds to them.
    """

    K: Matrix
    A: Matrix
    matrices: Matrices
    covariance: Matrix
    lost: bool
    A_T: Matrix = field(repr=False)
    push: Matrix = field(repr=False)
    own: Matrix = field(repr=False)
    seen: Matrix = field(repr=False)


@dataclass(frozen=True, eq=False)
class PartialUpdate:
    """A stationary Kalman filter that can do without some outputs, and without some inputs for a while.

    Attributes
    ----------
    A, B, C, D : of the plant, from its control inputs.
    K : stationary gain; Q, R, S : covariances of process and measurement noise, and between them; covariance :
    stationary, of the error of the prediction.
    faults : ndarray, shape (p + n, faults)
        ``[Df; Bf]``.
    ages : int
        For how many ages of a fault matched filters look for its response.
    settled : ndarray, shape (p, faults)
        Steady values of the innovations; without columns if nothing is matched.
    whitening : ndarray, shape (p, residuals)
        Of the test.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    K: Matrix
    Q: Matrix
    R: Matrix
    S: Matrix
    covariance: Matrix
    faults: Matrix
    ages: int
    settled: Matrix = field(repr=False)
    whitening: Matrix = field(repr=False)

    @cached_property
    def _known(self) -> dict[tuple[bytes, ...], Gain]:
        return {}

    @cached_property
    def spread(self) -> Matrix:
        """Product of the deviations of every two states, one step after no output was measured."""
        size = np.sqrt(np.diag(_product(_product(self.A, self.covariance), self.A.T) + self.Q))
        return np.multiply.outer(size, size)

    @cached_property
    def unknown(self) -> Matrix:
        """Covariance without knowledge."""
        return np.diag(_UNKNOWN * np.diag(self.spread))

    @cached_property
    def _stationary_root(self) -> Matrix:
        return _root(_product(_product(self.C, self.covariance), self.C.T) + self.R)

    @cached_property
    def free_input(self) -> Matrix:
        """Variance of each input when it is unknown.

        An error of this size would move the whitened innovations by ``1e4`` deviations, all samples after it together;
        zero for an input that none of them sees.
        """
        root = _inverse(self._stationary_root)
        seen, step = _product(root, self.C), self.A - _product(self.K, self.C)
        sight = _product(seen.T, seen)
        for _ in range(_DOUBLINGS):
            sight = sight + _product(_product(step.T, sight), step)
            step = _product(step, step)
        now, later = _product(root, self.D), self.B - _product(self.K, self.D)
        moved = np.array(
            [float(now[:, j] @ now[:, j] + later[:, j] @ sight @ later[:, j]) for j in range(now.shape[1])]
        )
        return np.where(moved > 0, _UNKNOWN / np.where(moved > 0, moved, 1.0), 0.0)

    @cached_property
    def _most(self) -> Matrix:
        """Variance of each state beyond which the filter is lost: far more than one missing input can cause.

        A state without noise, such as one that delays an input, is uncertain by its inputs alone.
        """
        moved, by = np.zeros(len(self.A)), self.B * np.sqrt(self.free_input / _UNKNOWN)
        for _ in range(len(self.A)):
            moved = np.maximum(moved, np.sum(by**2, axis=1))
            by = _product(self.A, by)
        return _LOST * (np.diag(self.spread) + moved)

    @cached_property
    def numbers(self) -> Matrix:
        """All numbers that determine gains, one after the other in the order of ``_partial_gain.h``."""
        plant, noise = (self.A, self.B, self.C, self.D, self.K), (self.Q, self.R, self.S)
        derived = (self.free_input, self._most, _REACHED * self.spread, self.unknown, self._stationary_root)
        return np.concatenate([np.ravel(one) for one in (*plant, *noise, self.covariance, *derived)])

    @cached_property
    def nominal(self) -> tuple[Matrix, Matrix]:
        """Responses of the stationary innovation by age, the settled one last: (ages + 1, faults, p); their scale.

        The scale, of every state for every fault, is how far an estimate is moved by it: (faults, n).
        """
        p, count = len(self.C), self.settled.shape[1]
        Df, Bf = self.faults[:p, :count].T, self.faults[p:, :count].T
        e, rows = np.zeros((count, len(self.A))), []
        scale = np.zeros(e.shape)
        for _ in range(self.ages):
            rows.append(_product(e, self.C.T) + Df)
            scale = np.maximum(scale, np.maximum(np.abs(e), _product(np.abs(rows[-1]), np.abs(self.K.T))))
            e = _product(e, self.A.T) + Bf - _product(rows[-1], self.K.T)
        scale = np.maximum(scale, _product(np.abs(self.settled.T), np.abs(self.K.T)))
        return np.stack([*rows, self.settled.T]), scale

    def gain(self, covariance: Matrix, there: NDArray[np.bool_], given: NDArray[np.bool_]) -> Gain:
        """Return the step for a sample; ``covariance`` is that of the prediction, zero for the stationary one.

        ``there``: the outputs that can be used; ``given``: the inputs that are known.
        """
        key = covariance.tobytes(), there.tobytes(), given.tobytes()
        known = self._known.get(key)
        if known is None:
            steady = not covariance.any()
            whole = bool(there.all() and given.all())
            known = self._gain(self.covariance if steady else covariance, there, given, steady and whole)
            if len(self._known) >= _MOST_GAINS:
                self._known.clear()
            self._known[key] = known
        return known

    def _gain(self, P: Matrix, there: NDArray[np.bool_], given: NDArray[np.bool_], stationary: bool) -> Gain:
        rows = np.flatnonzero(there)
        n, p = len(self.A), len(self.C)
        C, R, S = self.C[rows], self.R[np.ix_(rows, rows)], self.S[:, rows]
        root = _root(_product(_product(C, P), C.T) + R)
        inverse = _inverse(root)
        K = np.zeros((n, p))
        cross = _product(_product(self.A, P), C.T) + S
        K[:, rows] = _product(_product(cross, inverse.T), inverse)
        K = self.K if stationary else K
        A, B = self.A - _product(K, self.C), self.B - _product(K, self.D)
        # the form of Joseph: no difference of large numbers, whatever P
        carried = _product(K[:, rows], S.T)
        noise = self.Q - carried - carried.T + _product(_product(K[:, rows], R), K[:, rows].T)
        following = _product(_product(A, P), A.T) + noise
        if not given.all():
            held = self.B[:, ~given]
            following = following + _product(held * self.free_input[~given], held.T)
        following = (following + following.T) / 2
        reached = bool(np.all(np.abs(following - self.covariance) <= _REACHED * self.spread))
        lost = not bool(np.all(np.diag(following) <= self._most))
        units = _product(self._stationary_root, inverse) if there.all() and not stationary else np.eye(p)
        matrices = (A, np.hstack([B, K]), -_product(units, self.C), np.hstack([-_product(units, self.D), units]))
        white = _product(units.T, self.whitening)
        seen = _product(self.C.T, white)
        following = np.zeros((n, n)) if reached or stationary else following
        rho = self.nominal[0]
        return Gain(
            K, A, matrices, following, lost, A.T.copy(), _product(rho, (K - self.K).T), _product(rho, white), seen
        )

    def advance(self, gain: Gain, x: Matrix, v: Matrix) -> tuple[Matrix, Matrix]:
        """Return the next state and the innovation of one sample, missing outputs held; shapes (n,), (channels,)."""
        following, r = run_checked(gain.matrices, x[None], v[None, None])
        return following[0], r[0, 0]

    def bend(self, gain: Gain, bent: Matrix) -> Matrix:
        """Return the deviation of the errors that faults cause from the stationary ones, one sample on.

        Parameters
        ----------
        gain : Gain
        bent : ndarray, shape (ages + 1, faults, n)
            Of faults of every age, and last of those that arrived before.
        """
        off = _product(bent, gain.A_T) - gain.push
        out = np.concatenate([np.zeros((min(1, self.ages), *off.shape[1:])), off[: max(0, self.ages - 1)], off[-1:]])
        out[-1] = np.where(np.abs(out[-1]) <= _REACHED * self.nominal[1], 0.0, out[-1])
        return out

    def responses(self, gain: Gain, bent: Matrix) -> Matrix:
        """Return the whitened responses of a whole sample to faults of every age: (ages + 1, faults, residuals)."""
        return gain.own + _product(bent, gain.seen)


def partial_update(generator: ResidualGenerator, test: ResidualTest) -> PartialUpdate | None:
    """Return the data for filtering with missing values; ``None`` unless it is a stationary Kalman filter."""
    matched = test.responses
    system, plant, p = generator.system, generator.plant, generator.n_residuals
    n, m = system.n_states, len(plant.inputs)
    T = generator.state_map
    is_predictor = (
        system.is_discrete
        and plant.E is None
        and plant.Bw.shape[1] > 0
        and p == plant.n_outputs
        and T is not None
        and T.shape == (n, n)
        and n > 0
        and np.array_equal(T, np.eye(n))
        and np.array_equal(system.C, -plant.C)
        and np.array_equal(system.D[:, m:], np.eye(p))
    )
    if not is_predictor:
        return None
    K = np.asarray(system.B[:, m:])
    Q, R, S = plant.process_noise, plant.measurement_noise, plant.cross_noise
    noise = Q - K @ S.T - S @ K.T + K @ R @ K.T
    try:
        P = state_covariance(system.A, (noise + noise.T) / 2)
        innovation = plant.C @ P @ plant.C.T + R
        np.linalg.cholesky(innovation)
    except (AccuracyError, np.linalg.LinAlgError):
        return None
    deviations = np.sqrt(np.diag(plant.A @ P @ plant.A.T + Q))
    best = np.linalg.solve(innovation, (plant.A @ P @ plant.C.T + S).T).T
    if np.any(np.abs(K - best) * np.sqrt(np.diag(innovation)) > _MISSED * deviations[:, None]):
        return None
    settled = step_responses(generator, 1)[1] if matched is not None else np.zeros((p, 0))
    ages = len(matched.responses) if matched is not None else 0
    noises = (np.asarray(Q), np.asarray(R), np.asarray(S))
    P = (P + P.T) / 2
    return PartialUpdate(
        plant.A, plant.B, plant.C, plant.D, K, *noises, P, np.vstack([plant.Df, plant.Bf]), ages, settled, test.metric
    )


def empty_partial(partial: PartialUpdate | None, plants: int) -> dict[str, Matrix]:
    """Return the fields for deviations from the stationary filter: zeros that take no memory."""
    n = 0 if partial is None else len(partial.A)
    rows = (0, 0) if partial is None or not partial.settled.size else (partial.ages + 1, partial.settled.shape[1])
    shapes = {"spread": (plants, n, n), "bent": (plants, *rows, n)}
    return {name: np.broadcast_to(0.0, shape) for name, shape in shapes.items()}


def _product(X: Matrix, M: Matrix) -> Matrix:
    return product_checked(X, M)


def _root(M: Matrix) -> Matrix:
    """Return the lower triangular root of a positive definite matrix."""
    L = np.zeros(M.shape)
    for j in range(len(M)):
        column = M[j:, j].copy()
        for k in range(j):
            column -= L[j:, k] * L[j, k]
        L[j:, j] = column / np.sqrt(column[0])
    return L


def _inverse(L: Matrix) -> Matrix:
    """Return the inverse of a lower triangular matrix."""
    out = np.zeros(L.shape)
    for i in range(len(L)):
        row = np.eye(len(L))[i]
        for k in range(i):
            row = row - L[i, k] * out[k]
        out[i] = row / L[i, i]
    return out
