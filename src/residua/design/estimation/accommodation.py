"""Living with a fault: an input that compensates it, and a closed loop on what healthy sensors would read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import matrix
from residua.design.estimation.fault_estimator import FaultEstimator
from residua.design.observers.observer import Observer
from residua.errors import DesignError, ModelError, SettingError
from residua.linear import StateSpace
from residua.plant import Plant
from residua.tolerances import RESPONSE_ROUNDING, TINY


@dataclass(frozen=True, eq=False)
class Compensation:
    r"""How control inputs undo faults: :math:`u = -\Gamma \hat f`.

    Attributes
    ----------
    gain : ndarray, shape (inputs, faults)
        ``Gamma``, with ``B Gamma`` nearest to ``Bf``.
    faults : tuple of str
    left : mapping of str to float
        For each fault the fraction of its effect on the states that no input undoes, in balanced units: 0 for an
        actuator's, 1 for one that acts where no input does. (A sensor's fault has no effect on the states: 0.)
    """

    gain: NDArray[np.float64]
    faults: tuple[str, ...]
    left: Mapping[str, float]


def compensation_gain(plant: Plant, faults: Iterable[str] | str | None = None) -> Compensation:
    r"""Return the input that undoes faults in the state equation, as far as inputs can.

    :math:`\Gamma = B^+ B_f` in balanced units of the states.

    Parameters
    ----------
    plant : Plant
    faults : sequence of str, optional
        All faults when omitted.

    Returns
    -------
    Compensation

    Raises
    ------
    DesignError
        If the plant has no control inputs.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, sections 1 and 2.2.

    Examples
    --------
    >>> import residua as rs
    >>> compensation = rs.design.compensation_gain(rs.library.vtol(), ["collective actuator", "pitch sensor"])
    >>> compensation.gain.round(12) + 0.0
    array([[1., 0.],
           [0., 0.]])
    """
    if not plant.inputs:
        raise DesignError("this plant has no control input that could compensate a fault")
    columns = arrays.positions(faults, plant.faults, "fault")
    R = plant.balanced.units.exact[0][:, None]
    B, Bf = R * plant.B, R * plant.Bf[:, columns]
    size = np.linalg.norm(B, axis=0)
    size = np.where(size > 0, size, 1.0)
    gain = np.linalg.pinv(B / size, rcond=1e-9) @ Bf / size[:, None]
    whole = np.linalg.norm(Bf, axis=0)
    rest = np.linalg.norm(Bf - B @ gain, axis=0) / np.where(whole > 0, whole, 1.0)
    rest = np.where(rest > RESPONSE_ROUNDING, rest, 0.0)
    names = tuple(plant.faults[i] for i in columns)
    return Compensation(gain, names, {name: float(part) for name, part in zip(names, rest, strict=True)})


def closed_loop(
    plant: Plant,
    estimator: FaultEstimator | Observer,
    feedback: ArrayLike | StateSpace,
    *,
    acts_on: str = "states",
    virtual: bool = True,
    compensate: bool = True,
) -> StateSpace:
    r"""Return the plant under feedback, with estimator and accommodation in the loop.

    .. math:: u = r - K s - \Gamma \hat f

    where ``s`` is the state estimate :math:`\hat x`, or the outputs: :math:`C \hat x + D u` of the virtual sensors,
    or ``y`` as measured. With an exact model and an estimator that the fault does not reach, estimation does not
    change the poles of the loop under exact feedback: the poles of the estimator are added to them.

    Parameters
    ----------
    plant : Plant
        The plant that runs, with all its faults; it may differ from the one that the estimator was designed for.
    estimator : FaultEstimator or Observer
        An observer estimates no faults: the loop without accommodation.
    feedback : array_like, shape (inputs, signals), or StateSpace
        ``K``; negative feedback. A system may have dynamics of its own, such as an integrator.
    acts_on : {"states", "outputs"}
        What ``K`` reads.
    virtual : bool
        For ``acts_on="outputs"``: whether it reads the virtual sensors or the measured outputs.
    compensate : bool
        Whether the estimated faults are compensated, with :func:`compensation_gain`; only for an estimator.

    Returns
    -------
    StateSpace
        Inputs: ``"reference <input>"``, then the plant's faults, disturbances and noise. Outputs: the plant's outputs,
        ``"state <state>"``, ``"estimate <fault>"``, ``"control <input>"``. It may be unstable; ``is_stable()`` tells.

    Raises
    ------
    DesignError
        If the algebraic loop through estimator and feedback is ill-posed.
    ModelError
        If sizes, names or sample steps do not fit.
    SettingError
        If ``acts_on`` is not one of its words.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, sections 1 and 3.2.

    Examples
    --------
    >>> import numpy as np, residua as rs
    >>> aircraft = rs.library.vtol()
    >>> estimator = rs.design.fault_estimator(aircraft, faults="collective actuator", bandwidth=50)
    >>> loop = rs.design.closed_loop(aircraft, estimator, np.zeros((2, 4)))
    >>> fault = loop.inputs.index("collective actuator")
    >>> bool(np.abs(loop.dc_gain()[:3, fault]).max() < 1e-9)  # compensated: no effect that lasts
    True
    """
    if acts_on not in ("states", "outputs"):
        raise SettingError(f"acts_on must be 'states' or 'outputs', got {acts_on!r}")
    _fitting(plant, estimator)
    m, p, n = len(plant.inputs), plant.n_outputs, plant.n_states
    K = _controller(feedback, m, n if acts_on == "states" else p, plant)
    faults, joint = _joint(estimator)
    Gamma = np.zeros((m, len(faults)))
    if compensate and faults:
        Gamma = compensation_gain(estimator.plant, faults).gain
    if acts_on == "states":
        reads = (np.zeros((n, p)), np.eye(n), np.zeros((n, m)))
    elif virtual:
        reads = (np.zeros((p, p)), estimator.plant.C, estimator.plant.D)
    else:
        reads = (np.eye(p), np.zeros((p, n)), np.zeros((p, m)))
    return _connected(plant, joint, len(faults), K, Gamma, reads)


def _fitting(plant: Plant, estimator: FaultEstimator | Observer) -> None:
    own = estimator.plant
    for what in ("inputs", "outputs", "states"):
        if getattr(own, what) != getattr(plant, what):
            raise ModelError(f"the estimator is for a plant with other {what}: {', '.join(getattr(own, what))}")
    if own.dt != plant.dt:
        raise ModelError(f"the estimator has dt={own.dt:g}, the plant dt={plant.dt:g}: sample both with the same step")


def _joint(estimator: FaultEstimator | Observer) -> tuple[tuple[str, ...], StateSpace]:
    if isinstance(estimator, FaultEstimator):
        return estimator.faults, estimator.joint_system
    return (), estimator.system


def _controller(feedback: ArrayLike | StateSpace, m: int, signals: int, plant: Plant) -> StateSpace:
    if not isinstance(feedback, StateSpace):
        K = matrix(feedback, "feedback", (m, signals), what="inputs x what it reads")
        return StateSpace(np.zeros((0, 0)), np.zeros((0, signals)), np.zeros((m, 0)), K, dt=plant.dt)
    if (feedback.n_outputs, feedback.n_inputs) != (m, signals):
        raise ModelError(
            f"feedback must read {signals} signals and give {m} inputs; this one reads {feedback.n_inputs} and gives "
            f"{feedback.n_outputs}"
        )
    if feedback.dt != plant.dt:
        raise ModelError(f"the feedback has dt={feedback.dt:g}, the plant dt={plant.dt:g}")
    return feedback.explicit()


def _connected(
    plant: Plant,
    joint: StateSpace,
    n_f: int,
    K: StateSpace,
    Gamma: NDArray,
    reads: tuple[NDArray, NDArray, NDArray],
) -> StateSpace:
    """Return the loop: of the signals ``g = (y, fhat, xhat, s, u)``, ``g = M X + L g + N v`` is solved for ``g``."""
    P = plant.system(("control", "fault", "disturbance", "noise"))
    m, p, n = len(plant.inputs), plant.n_outputs, plant.n_states
    n_q, n_k, n_v = joint.n_states, K.n_states, P.n_inputs - m
    sizes = [p, n_f, n, len(reads[0]), m]
    y, fh, xh, s, u = (slice(a, b) for a, b in zip(np.cumsum([0, *sizes]), np.cumsum(sizes), strict=False))
    total = sum(sizes)
    plant_x, filter_x, own_x = slice(0, n), slice(n, n + n_q), slice(n + n_q, n + n_q + n_k)
    M, L, N = np.zeros((total, n + n_q + n_k)), np.zeros((total, total)), np.zeros((total, m + n_v))
    M[y, plant_x], L[y, u], N[y, m:] = P.C, P.D[:, :m], P.D[:, m:]
    both = slice(fh.start, xh.stop)
    M[both, filter_x], L[both, u], L[both, y] = joint.C, joint.D[:, :m], joint.D[:, m:]
    L[s, y], L[s, xh], L[s, u] = reads
    M[u, own_x], L[u, s], L[u, fh], N[u, :m] = -K.C, -K.D, -Gamma, np.eye(m)
    loop = np.eye(total) - L
    scale = np.maximum(np.abs(loop).max(axis=1), TINY)
    condition = float(np.linalg.cond(loop / scale[:, None]))
    if not condition < 1e12:
        raise DesignError(
            f"the loop is ill-posed: feedback and compensation act on themselves at once with gain one (condition "
            f"{condition:.2g}); change the feedback, or give it a lag"
        )
    M, N = np.linalg.solve(loop, M), np.linalg.solve(loop, N)
    A = scipy.linalg.block_diag(P.A, joint.A, K.A)
    B = np.zeros((len(A), m + n_v))
    B[plant_x, m:] = P.B[:, m:]
    drive = np.zeros((len(A), total))
    drive[plant_x, u] = P.B[:, :m]
    drive[filter_x, u], drive[filter_x, y] = joint.B[:, :m], joint.B[:, m:]
    drive[own_x, s] = K.B
    states = np.hstack([np.eye(n), np.zeros((n, n_q + n_k))])
    return StateSpace(
        A + drive @ M,
        B + drive @ N,
        np.vstack([M[y], states, M[fh], M[u]]),
        np.vstack([N[y], np.zeros((n, m + n_v)), N[fh], N[u]]),
        E=None if P.E is None else scipy.linalg.block_diag(P.E, np.eye(n_q + n_k)),
        dt=plant.dt,
        inputs=[*(f"reference {name}" for name in plant.inputs), *P.inputs[m:]],
        outputs=[
            *plant.outputs,
            *(f"state {name}" for name in plant.states),
            *(name for name in joint.outputs[:n_f]),
            *(f"control {name}" for name in plant.inputs),
        ],
    )
