"""The Kalman filter as a residual generator: its innovations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import NOISE, method
from residua.design.observers.observer import balanced_observer
from residua.design.observers.observer_gain import gain_evidence, require_detectable
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.observer_gain import ObserverGain, observer_gain
from residua.linear.subspaces.quotient import ObservableSplit, observable_split
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant
from residua.tolerances import BALANCED_ANSWER, RANK
from residua.wrong_guesses import guessed

_BOTH = "give both kinds, with_noise(process=..., measurement=...)"


@method(
    needs=[NOISE],
    exists_when="(C, A) detectable; noise in every measurement",
    order="n",
    source="Gertler (1991), eqs. (3-14) to (3-17), section 5.3",
    state="estimate of least variance",
    faults="by direction, once a constant fault has settled",
    noise="least",
    time_course="constant",
)
@guessed("kalman_filter")
def kalman_filter(plant: Plant) -> ResidualGenerator:
    r"""Use the innovations of the stationary Kalman filter as residuals.

    In sampled time the one-step predictor :math:`\hat x_{k+1} = A \hat x_k + B u_k + K r_k`,
    :math:`r_k = y_k - C \hat x_k - D u_k`, with :math:`K = (A P C^T + S)(C P C^T + R)^{-1}`. Without faults
    the innovations are white with covariance :math:`C P C^T + R`, which makes testing them easy. A fault
    adds a bias; its direction settles to the steady-state direction of that fault
    (``steady_directions``), but turns on the way there. In continuous time the Kalman-Bucy filter.

    Parameters
    ----------
    plant : Plant
        With process and measurement noise (:meth:`residua.Plant.with_noise`), and what they share, :math:`S`
        (``cross``). Disturbances are not decoupled: give those that should not raise alarms as process noise.

    Returns
    -------
    ResidualGenerator
        ``covariance`` is the innovation covariance when the plant is sampled.

    Raises
    ------
    DesignError
        If the plant has no noise, or no process noise where the filter needs it; the measurement noise of a continuous
        plant is singular, or the covariance of the innovations of a sampled one; the pair (C, A) is not detectable; or
        a mode on the stability boundary gets no noise.

    See Also
    --------
    matched_filters : The whole response to a step, with arrival time and size.
    luenberger_observer : With poles of one's choice.
    detection_filter : Directions that hold for any time course.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant; noise is white and Gaussian with the covariances
    of the plant, and the filter has settled. A steady direction holds for constant faults after the
    transient only.

    References
    ----------
    Gertler (1991), eqs. (3-14) to (3-17); steady-state directions: section 5.3, eqs. (5-19) to (5-21),
    simplified as described at its end.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1).with_sensor_faults()
    >>> kalman = rs.design.kalman_filter(plant.with_noise(process=0.1, measurement=0.2))
    >>> kalman.covariance.round(4)
    array([[0.3758]])
    """
    plant = plant.explicit()
    if plant.Bw.shape[1] == 0:
        raise DesignError("a Kalman filter needs the noise of the plant: with_noise(process=..., measurement=...)")
    model = plant.balanced
    require_detectable(model)
    gain = _gain(plant, model)
    notes = ()
    if plant.disturbances:
        notes = (f"disturbances are not decoupled by a Kalman filter: {', '.join(plant.disturbances)}",)
    if not np.any(plant.process_noise) and not np.any(gain.K):
        notes += (f"no process noise, so that the gain is zero and the outputs correct nothing: {_BOTH}",)
    evidence = Evidence(
        method="Kalman filter",
        conditions={"size of K": gain.norm},
        notes=notes,
        references=("Gertler (1991), Automatica 27(4), eqs. (3-14) to (3-17) and section 5.3",),
    )
    evidence = evidence.extended(**gain_evidence(gain, model.units.rate))
    return balanced_observer(model, gain.K, evidence).residual_generator()


def _gain(plant: Plant, model: BalancedPlant) -> ObserverGain:
    """Return the gain of least variance, with noise in the units of the balanced plant."""
    units, rate = model.units, model.units.rate
    X, Y = units.states, units.outputs
    R = Y[:, None] * plant.measurement_noise * Y
    level = float(np.diag(R).max(initial=0.0)) or 1.0  # states beside outputs, in whatever unit of time
    R = R / level
    size = np.sqrt(np.where(np.diag(R) > 0, np.diag(R), 1.0))  # outputs as large as their noise
    n = plant.n_states
    singular = not np.linalg.eigvalsh(R / size[:, None] / size).min(initial=1.0) > RANK
    try:
        if not plant.is_discrete and singular:
            raise DesignError(
                "the measurement noise is singular, and a continuous Kalman filter divides by it: give every "
                f"measurement noise of its own, with_noise(measurement=...), or sample the plant: {_BOTH}"
            )
        gain = observer_gain(
            model.A,
            model.C / size[:, None],
            ObservableSplit(np.eye(n), np.zeros((n, 0)), []),
            sampled=plant.is_discrete,
            process=plant.process_noise / X[:, None] / X / rate**2 / level,
            measurement=R / size[:, None] / size,
            cross=plant.cross_noise / X[:, None] * Y / rate / level / size,
            rate=rate,
        )
    except AccuracyError as error:
        if not _moves_by_itself(plant, model):
            if singular:
                raise DesignError(
                    "the innovations have a singular covariance: measurements without noise repeat one another, or "
                    f"show states without noise; leave them out, or give each noise of its own: {_BOTH}"
                ) from error
            raise
        raise DesignError(
            f"there is no stationary Kalman filter: a mode on the boundary of stability gets no noise; {_BOTH}"
        ) from error
    return replace(gain, K=gain.K / size)


def _moves_by_itself(plant: Plant, model: BalancedPlant) -> bool:
    """Tell of a mode on the boundary of stability that no process noise reaches beside that of the measurements."""
    X = model.units.states[:, None]
    through = plant.cross_noise @ np.linalg.pinv(plant.measurement_noise)
    A = model.A - through @ plant.C / X * model.units.states / model.units.rate
    noise = (plant.Bw - through @ plant.Dw) / X
    still = observable_split(A.T, noise.T / (np.abs(noise).max(initial=0.0) or 1.0)).hidden
    modes = np.linalg.eigvals(still.T @ A.T @ still)
    away = np.abs(modes) - 1 if plant.is_discrete else np.real(modes)
    return bool(np.any(np.abs(away) < BALANCED_ANSWER))
