"""Fault accommodation: an input that compensates faults, and a closed loop on virtual sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
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
    r"""Compensation of faults by control inputs: :math:`u = -\Gamma \hat f`.

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
    model = estimator.plant
    for what in ("inputs", "outputs", "states"):
        if getattr(model, what) != getattr(plant, what):
            raise ModelError(f"the estimator is for a plant with other {what}: {', '.join(getattr(model, what))}")
    if model.dt != plant.dt:
        raise ModelError(
            f"the estimator has dt={model.dt:g}, the plant dt={plant.dt:g}: sample both with the same step"
        )
    m, p, n = len(plant.inputs), plant.n_outputs, plant.n_states
    K = _controller(feedback, m, n if acts_on == "states" else p, plant)
    faults, joint = (), estimator.system
    if isinstance(estimator, FaultEstimator):
        faults, joint = estimator.faults, estimator.joint_system
    P = plant.system(("control", "fault", "disturbance", "noise"))
    whole = P.append(joint).append(K)
    Y, fault_estimate, estimate, output_of_K = np.split(np.eye(whole.n_outputs), np.cumsum([p, len(faults), n]))
    reference, other = np.split(np.eye(P.n_inputs), [m])
    U = -output_of_K  # the control inputs, from all outputs
    if compensate and faults:
        U = U - compensation_gain(model, faults).gain @ fault_estimate
    read, direct = Y, np.zeros((p, m))
    if acts_on == "states":
        read, direct = estimate, np.zeros((n, m))
    elif virtual:
        read, direct = model.C @ estimate, model.D
    back = np.vstack([U, np.zeros((len(other), len(whole.C))), U, Y, read + direct @ U])
    enter = np.vstack([reference, other, reference, np.zeros((p, P.n_inputs)), direct @ reference])
    loop = np.eye(len(back.T)) - whole.D @ back
    condition = float(np.linalg.cond(loop / np.maximum(np.abs(loop).max(axis=1, keepdims=True), TINY)))
    if not condition < 1e12:
        raise DesignError(
            f"the loop is ill-posed: feedback and compensation act on themselves at once with gain one (condition "
            f"{condition:.2g}); change the feedback, or give it a lag"
        )
    M, N = np.linalg.solve(loop, whole.C), np.linalg.solve(loop, whole.D @ enter)
    return StateSpace(
        whole.A + whole.B @ back @ M,
        whole.B @ (back @ N + enter),
        np.vstack([Y @ M, np.eye(n, len(whole.A)), fault_estimate @ M, U @ M]),
        np.vstack([Y @ N, np.zeros((n, P.n_inputs)), fault_estimate @ N, U @ N + reference]),
        E=whole.E,
        dt=plant.dt,
        inputs=[*(f"reference {name}" for name in plant.inputs), *P.inputs[m:]],
        outputs=[
            *plant.outputs,
            *(f"state {name}" for name in plant.states),
            *joint.outputs[: len(faults)],
            *(f"control {name}" for name in plant.inputs),
        ],
    )


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
