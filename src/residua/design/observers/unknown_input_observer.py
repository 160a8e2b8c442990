"""Full-order observers that disturbances cannot reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua.analysis.existence import unknown_input_observer_existence
from residua.arrays import matrix
from residua.design.core.evidence import Evidence
from residua.design.core.method import method
from residua.design.observers.observer import Observer, plant_observer, with_checked_estimate
from residua.design.observers.observer_gain import asked, default_weights, pair_gain, with_gain
from residua.errors import DesignError, SettingError
from residua.linear.poles.observer_gain import cleared
from residua.linear.subspaces.quotient import NEGLIGIBLE, without_rounding
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant
from residua.tolerances import BALANCED_RANK, RESPONSE_ROUNDING, above_rounding
from residua.words import counted

REFERENCE = "Chen, Patton and Zhang (1996), Int. J. Control 63(1), eqs. (2) to (13)"


@method(
    needs=["disturbances (or none)"],
    exists_when="rank [E Bd; C 0] = n + rank Bd; stable invariant zeros of (E, A, Bd, C)",
    order="n",
    source="Chen, Patton and Zhang (1996), eqs. (2) to (13)",
    state="estimate, converges whatever the disturbances do",
    decouples=True,
    singular=True,
)
def unknown_input_observer(
    plant: Plant,
    *,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    H0: ArrayLike | None = None,
    scaling: Literal["plant", "even"] = "plant",
) -> Observer:
    r"""Design a full-order observer whose error no disturbance reaches.

    .. math::

       \dot z = F z + T B u + K y, \qquad \hat x = z + H y

    with :math:`H = E(CE)^+ + H_0 [I - CE(CE)^+]`, :math:`T = I - HC`, :math:`A_1 = T A`,
    :math:`F = A_1 - K_1 C` stable and :math:`K = K_1 + F H`. For a singular plant :math:`E_s \dot x = A x + \dots`,
    :math:`T E_s + H C = I` and :math:`T E = 0` take the place of the first two; the observer itself is an ordinary
    system. Guaranteed: the error obeys :math:`\dot e = F e` for any control input and any disturbance.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not; its disturbances are what is decoupled. A disturbance in
        the outputs is eliminated first.
    poles : sequence of complex, optional
        Poles of the error, closed under conjugation: as many as states, or as many as are free.
    margin : float, optional
        Decay rate in 1/s that every free pole must have at least, used without ``poles``. When omitted too, the gain is
        that of least squares with equal noise in all states and outputs of the balanced plant.
    H0 : array_like, shape (n, outputs), optional
        The free matrix of the general solution, in the units of the plant; zero when omitted. Of
        ``H0 [I - CE(CE)^+]`` only what acts on the outputs left over by the decoupling matters.
    scaling : {"plant", "even"}
        The units of the outputs in which :math:`(CE)^+` is the smallest inverse: those of the plant, as in the paper,
        or balanced ones, so that the observer does not depend on the units of the plant.

    Returns
    -------
    Observer
        With the matrices ``F, T, K, H, K1, K2, A1`` and its evidence.

    Raises
    ------
    DesignError
        If no such observer exists; the message says which condition failed, with its numbers.
    AccuracyError
        If the poles or the decoupling missed their tolerance.

    See Also
    --------
    decoupled_residual : A residual without the condition on zeros.
    reduced_order_observer : Of the order n - p.
    robust_detection_filter : Names the fault too.
    fault_estimator : Estimates faults as unknown inputs.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant; disturbances enter where the model says, and may
    be any signals. Costs: as many independent measurements as
    disturbances are used up, and the error's poles include the invariant zeros of (A, E, C).

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (2) to (13), Lemma 1 and Theorem 1; the general solution with
    ``H0`` is in the proof of Lemma 1.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.twardy()
    >>> observer = rs.design.unknown_input_observer(plant, poles=[-2, -2 + 1j, -2 - 1j])
    >>> observer.H
    array([[1., 0.],
           [0., 0.],
           [0., 0.]])
    """
    existence = unknown_input_observer_existence(plant)
    if not existence:
        raise DesignError("; ".join(existence.reasons))
    ranks = {"rank(CE)": existence.rank_CE, "rank(E)": existence.rank_E} if existence.rank_E.rank else {}
    if plant.E is not None:
        ranks = {"rank [E D; C 0]": existence.rank_CE, "rank D": existence.rank_E}
    near = tuple(f"near: {one}; double precision hardly decides this rank" for one in existence.near[:1])
    evidence = Evidence(method="unknown input observer", ranks=ranks, notes=near, references=(REFERENCE,))
    if len(plant.balanced.algebra):
        if H0 is not None:
            raise DesignError("H0 is the free matrix of an ordinary plant; for a singular one leave it out")
        return with_checked_estimate(_of_singular_plant(plant.balanced, evidence, poles, margin))
    model = plant.explicit().balanced
    pair = error_pair(model, model.disturbances, existence.rank_E.rank, scaling, H0, white_outputs=poles is None)
    gain = pair_gain(model, pair.A, pair.C, (pair.process, pair.measurement), *asked(model.plant, poles, margin))
    evidence = with_gain(replace(evidence, notes=pair.notes + near), gain, model, "K1")
    return with_checked_estimate(pair.observer(pair.on_outputs(gain.K), evidence))


@dataclass(frozen=True, eq=False)
class ErrorPair:
    r"""A full-order observer before its gain is chosen: the pair of its error, in coordinates :math:`x = M z`.

    All matrices are of the balanced plant. With :math:`\dot x = A_0 x + G y + \dots` and outputs :math:`W y` that no
    disturbance enters, :math:`T = I - H W C_0` and any gain ``K1`` on these outputs makes
    :math:`F = T A_0 - K_1 C_0`.

    Attributes
    ----------
    model : BalancedPlant
    A, C : ndarray
        :math:`M^{-1} T A_0 M` and :math:`S C_0 M`.
    M, inverse : ndarray
    outputs : ndarray
        ``S``.
    process, measurement : ndarray
        Covariances of the default noise, in these coordinates.
    T, H, W, G : ndarray
    decoupled : int
        Independent disturbances that the outputs do not show at once.
    decouples : bool
        Whether any were to be decoupled.
    """

    model: BalancedPlant
    A: NDArray[np.float64]
    C: NDArray[np.float64]
    M: NDArray[np.float64]
    inverse: NDArray[np.float64]
    outputs: NDArray[np.float64]
    process: NDArray[np.float64]
    measurement: NDArray[np.float64]
    T: NDArray[np.float64]
    H: NDArray[np.float64]
    W: NDArray[np.float64]
    G: NDArray[np.float64]
    decoupled: int
    decouples: bool

    @property
    def A0(self) -> NDArray[np.float64]:
        """``A - G C``."""
        return self.model.A - self.G @ self.model.C

    @property
    def C0(self) -> NDArray[np.float64]:
        """``W C``."""
        return self.W @ self.model.C

    def white(self) -> ErrorPair:
        """Return the pair in coordinates in which all of its noise is white: no unit of the plant is left in it."""
        L, S = np.linalg.cholesky(self.process), np.linalg.cholesky(self.measurement)
        x, y = np.linalg.inv(L), np.linalg.inv(S)
        return replace(
            self,
            A=x @ self.A @ L,
            C=y @ self.C @ L,
            M=self.M @ L,
            inverse=x @ self.inverse,
            outputs=y @ self.outputs,
            process=np.eye(len(x)),
            measurement=np.eye(len(y)),
        )

    def seen(self, basis: NDArray) -> ErrorPair:
        """Return a pair with white noise on some of its states: those that the outputs see."""
        return replace(
            self,
            A=without_rounding(basis.T @ self.A @ basis),
            C=without_rounding(self.C @ basis),
            M=self.M @ basis,
            inverse=basis.T @ self.inverse,
            process=np.eye(basis.shape[1]),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """The costs of decoupling."""
        p, q = len(self.W), self.decoupled
        if not q or p == q:
            return ()
        return (
            f"{p - q} of the {p} residuals are independent: the others are filtered copies, the price of decoupling "
            f"{counted(q, 'disturbance')}",
        )

    def on_outputs(self, K: NDArray) -> NDArray[np.float64]:
        """Return a gain of the pair as one on the outputs ``W y``, for the states of the balanced plant."""
        return _summed(np.zeros((len(self.M), len(self.W))), self.M @ K, self.outputs)

    def observer(self, K1: NDArray, evidence: Evidence) -> Observer:
        """Return the observer of a gain for the balanced plant and the outputs ``W y``, in the units of the plant."""
        Y, none = self.model.units.outputs, np.zeros((len(self.M), len(self.model.C)))
        A, C, HW = self.A0, self.C0, _summed(none, self.H, self.W)
        terms = np.abs(self.T) @ np.abs(A) + np.abs(K1) @ np.abs(C)
        F = above_rounding(self.T @ A - K1 @ C, terms, NEGLIGIBLE)
        K = _summed(_summed(_summed(none, self.T, self.G), F, HW), K1, self.W)
        W = self.W * Y / largest(self.W * Y)
        return plant_observer(self.model, F, self.T, K, W, evidence, H=HW, decouples=self.decouples)


def error_pair(
    model: BalancedPlant,
    unknown: tuple[NDArray, NDArray] | None,
    rank: int,
    scaling: str,
    H0: ArrayLike | None = None,
    *,
    white_outputs: bool = True,
) -> ErrorPair:
    """Return the error pair of an observer that disturbances do not reach.

    Parameters
    ----------
    model : BalancedPlant
        Of a plant without ``E``.
    unknown : tuple of ndarray or None
        ``B`` and ``D`` of what is decoupled, of the balanced plant; ``None`` for an observer that decouples nothing.
    rank : int
        Of the disturbances that the outputs do not show at once.
    scaling : {"plant", "even"}
        The units of the outputs in which ``H`` is the smallest.
    H0 : array_like, optional
        See :func:`unknown_input_observer`.
    white_outputs : bool
        Whether the outputs are combined so that their default noise is white, instead of left as they are.
    """
    if scaling not in ("plant", "even"):
        raise SettingError(f"scaling must be 'plant' or 'even', got {scaling!r}")
    units, n = model.units, len(model.A)
    process, measurement = default_weights(model)
    Y = units.outputs if scaling == "plant" else np.sqrt(units.measurement_weight)
    decouples, B, D = unknown is not None, *(unknown or (np.zeros((n, 0)), np.zeros((len(model.C), 0))))
    # the outputs W y without disturbances, of which W has orthonormal rows in the units Y, G y for those of the others
    U, s, Vh = np.linalg.svd(D) if D.size else (np.eye(len(D)), np.zeros(0), np.eye(D.shape[1]))
    k, U = int(np.count_nonzero(s > BALANCED_RANK)), without_rounding(U)
    W, G = U[:, k:].T, cleared(B @ (Vh[:k].T / s[:k]) @ U[:, :k].T)
    W = without_rounding(np.linalg.qr((W * Y).T)[0].T) / Y if len(W) else W
    E = without_rounding(np.linalg.svd(B @ Vh[k:].T)[0])[:, :rank] if rank else B[:, :0]
    A, C = model.A - G @ model.C, W @ model.C
    q = E.shape[1]
    P = np.linalg.pinv(C @ E)
    P = cleared(P + (np.eye(q) - P @ C @ E) @ P)
    H, N = _summed(np.zeros((n, len(C))), E, P), without_rounding(np.linalg.svd(P @ C)[2][q:].T) if q else np.eye(n)
    plain = H0 is None or not np.any(H0)
    if H0 is not None and not plain:
        given = matrix(H0, "H0", (n, model.plant.n_outputs), what="states x outputs")
        H = H + given / units.states[:, None] / units.outputs @ np.linalg.pinv(W) @ (np.eye(len(C)) - C @ H)
    T = _summed(np.eye(n), -H, C)
    # outputs in which what inverts C E and what annihilates it are rows, and their noises have nothing in common
    white = np.linalg.inv(np.linalg.qr(np.sqrt(measurement) @ W.T, mode="r")).T if white_outputs else np.eye(len(W))
    rest = without_rounding(np.linalg.svd(white @ (C @ E))[0][:, q:].T) if q else np.eye(len(W))
    read = cleared(np.linalg.pinv(white @ (C @ E)))
    # x = E a + N b, and the outputs read a, and b alone: of T E = 0 nothing is left to rounding
    M, outputs = np.hstack([E, N]), np.vstack([read, rest]) @ white
    inverse = np.asarray(np.linalg.inv(M), dtype=np.float64)
    A1, C1 = inverse @ T @ A @ M, outputs @ C @ M
    C1[:, :q] = np.eye(len(C1), q)
    if not white_outputs:
        C1[:q, q:] = 0.0
    if plain:
        A1[:q] = 0.0
    noise = scipy.linalg.block_diag(read @ read.T, np.eye(len(rest)))
    return ErrorPair(model, A1, C1, M, inverse, outputs, inverse @ process @ inverse.T, noise, T, H, W, G, q, decouples)


def _summed(M: NDArray, left: NDArray, right: NDArray) -> NDArray[np.float64]:
    """Return ``M + left right`` without the rounding of sums that cancel."""
    return above_rounding(M + left @ right, np.abs(M) + np.abs(left) @ np.abs(right), RESPONSE_ROUNDING)


def largest(W: NDArray) -> NDArray[np.float64]:
    """Return the largest entry of each row, as a column; one for a row of zeros.

    A residual that is the error of one output, divided by it, is in the units of that output.
    """
    found = W[np.arange(len(W)), np.abs(W).argmax(axis=1)][:, None]
    return np.where(found != 0, found, 1.0)


def _of_singular_plant(
    model: BalancedPlant, evidence: Evidence, poles: Sequence[complex] | ArrayLike | None, margin: float | None
) -> Observer:
    """Return the observer of the quotient of a singular plant by its disturbances."""
    q, (process, measurement), p = model.quotient(), default_weights(model), model.plant.n_outputs
    F, G = q.pair
    noise = q.N @ process @ q.N.T, q.H @ measurement @ q.H.T
    gain = pair_gain(model, F, G, noise, *asked(model.plant, poles, margin), split=q.split)
    inverse = without_rounding(q.R @ q.known[0])
    read = q.H[:, :p] * model.units.outputs
    K, algebra = _summed(q.J, gain.K, q.H), model.algebra
    return plant_observer(
        model,
        F - gain.K @ G,
        without_rounding(q.N @ model.derivative - K[:, p:] @ algebra),
        K[:, :p],
        read / largest(read),
        with_gain(evidence, gain, model, "K1"),
        M=without_rounding(q.P - inverse @ q.C),
        H=inverse[:, :p],
        J=inverse[:, p:] @ algebra,
        V=q.H[:, p:] @ algebra * model.units.equations / model.units.rate / largest(read),
    )
