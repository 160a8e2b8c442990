"""The Kalman filter as a residual generator: its innovations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import method
from residua.design.core.needs import NOISE
from residua.design.core.own_time import in_own_time
from residua.design.observers.observer import Observer
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.riccati import RiccatiSolution, filter_riccati
from residua.linear.systems.array_cache import cached_by_contents
from residua.linear.systems.balancing import without_rounding
from residua.plant import Plant
from residua.plant.comparable_units import canonical_units
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
@in_own_time()
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
        If the plant has no noise, or no process noise where the filter needs it, the measurement noise is singular,
        the pair (C, A) is not detectable or a mode on the stability boundary gets no noise.

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
    noiseless = not np.any(plant.process_noise)
    try:
        solution = _solution(plant)
    except AccuracyError as error:
        if not noiseless:
            raise
        raise DesignError(
            f"the plant has no process noise, and without any the Kalman filter could not be computed: {_BOTH}"
        ) from error
    n, p = plant.n_states, plant.n_outputs
    K = np.asarray(solution.gain)
    notes = ()
    if plant.disturbances:
        notes = (f"disturbances are not decoupled by a Kalman filter: {', '.join(plant.disturbances)}",)
    if noiseless and not np.any(K):
        notes += (f"no process noise, so that the gain is zero and the outputs correct nothing: {_BOTH}",)
    evidence = Evidence(
        method="Kalman filter",
        poles=np.asarray(solution.poles, dtype=complex),
        conditions={
            "residual of the Riccati equation": float(solution.residual),
            "condition of the innovation covariance": float(np.linalg.cond(solution.innovation_covariance)),
        },
        notes=notes,
        references=("Gertler (1991), Automatica 27(4), eqs. (3-14) to (3-17) and section 5.3",),
    )
    observer = Observer(
        plant,
        without_rounding(np.hstack([np.eye(n), -K]), np.vstack([plant.A, plant.C])),
        np.eye(n),
        K,
        np.eye(n),
        np.zeros((n, p)),
        np.eye(p),
        "Kalman filter",
        False,
        evidence,
    )
    return observer.residual_generator()


def _solution(plant: Plant) -> RiccatiSolution:
    """Return the solution of the Riccati equation of a plant in its own units, in those of the plant."""
    units = canonical_units(plant)
    own = units.applied(plant)
    noise = own.process_noise, own.measurement_noise, own.cross_noise
    found = _kept_riccati(own.A, own.C, *noise, plant.dt)
    S, Y = units.states, units.outputs
    return replace(
        found,
        covariance=S[:, None] * found.covariance * S / units.noise**2,
        gain=S[:, None] * found.gain * Y,
        innovation_covariance=found.innovation_covariance / Y[:, None] / Y / units.noise**2,
    )


@cached_by_contents
def _kept_riccati(
    A: NDArray[np.float64],
    C: NDArray[np.float64],
    Q: NDArray[np.float64],
    R: NDArray[np.float64],
    cross: NDArray[np.float64],
    dt: float,
) -> RiccatiSolution:
    return filter_riccati(A, C, Q, R, cross, dt=dt)
