"""Report on the residuals of fault-free recordings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from residua.decide.checks import check_samples
from residua.decide.residual_findings import ResidualReport, findings_of
from residua.decide.stream_settings import is_white
from residua.errors import SettingError
from residua.monitor.fitted_thresholds import fault_free_run
from residua.monitor.inputs import several_signals
from residua.monitor.monitor import Monitor
from residua.monitor.plausible_values import fitted_ranges, guarded_ranges
from residua.monitor.regime_monitor import RegimeMonitor
from residua.monitor.specification import blank_test


def residual_report(
    generator: Any,
    u: Any,
    y: ArrayLike | None = None,
    *,
    time: ArrayLike | None = None,
    dt: float | None = None,
    transient: int = 0,
) -> ResidualReport:
    r"""Return the properties of fault-free residuals, and the test they call for.

    Thresholds are designed for residuals that are white, Gaussian, stationary, of mean zero, and as large as the noise
    model says. This tests each of these on a recording, for all residuals together:

    memory
        Ljung and Box's sum of squared correlations up to lag 20, of each residual; if none is found, Hosking's, of all
        together:

        .. math:: Q = n^2 \sum_{l=1}^{20} \frac{\hat\varrho_l^2}{n - l} \sim \chi^2_{20}
    bursts
        The same for the ranks of the sizes of the innovations of an autoregression: noise of varying size.
    tails, light tails, skewness
        Kurtosis and skewness of the innovations, by D'Agostino and Pearson's transformations; with the
        shape of the tail by a generalised Pareto distribution.
    quantised
        Few different values.
    drift
        Changes of means, and of the norm, as a fit finds them (:func:`residua.decide.stationarity.changes`).
    offset, variance
        Against zero and against the noise model of the plant, with as many independent samples as there are.
    copies
        Residuals that are combinations of others, or that the past of all predicts exactly.

    Each kind is found on residuals without such a thing with a probability of 1 % or less (``Finding.level``), for all
    residuals together; effects too small to matter are not reported, however many samples show them.

    Parameters
    ----------
    generator : ResidualGenerator, design, or Monitor
        Of a monitor its settings of start and settling are used.
    u, y, time, dt
        One or several fault-free recordings, as :meth:`residua.Monitor.fit` takes them.
    transient : int
        Samples at the start of each recording that are left out, counted with those over which the filter settles.

    Returns
    -------
    ResidualReport
        Printed, it is a text; ``findings``, ``recommendations``, ``table()`` and ``to_dict()`` have the parts.

    Raises
    ------
    DataError
        If a recording does not fit the plant, or is too short, or holds no noise.
    SettingError
        If this is not a generator.

    See Also
    --------
    residua.Monitor.fit : Follows these recommendations with ``treatment="auto"``, and states so in its basis.

    Notes
    -----
    Assumes: the recordings are fault-free.

    References
    ----------
    Ljung and Box (1978), Biometrika 65(2), 297-303; Hosking (1980), Journal of the American Statistical Association 75,
    602-608; McLeod and Li (1983), Journal of Time Series Analysis 4(4), 269-273 (correlations of sizes);
    D'Agostino and Pearson (1973), Biometrika 60(3), 613-622.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, outputs=["level"], units={"level": "m"})
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> rng = np.random.default_rng(0)
    >>> y = 0.1 * rng.standard_t(4, (4000, 1))
    >>> report = rs.decide.residual_report(rs.design.kalman_filter(plant), np.zeros((4000, 1)), y)
    >>> [one.kind for one in report.findings]
    ['tails', 'variance']
    """
    watch = generator if isinstance(generator, Monitor) else None
    if isinstance(generator, RegimeMonitor):
        raise SettingError("a monitor by operating modes has several generators: report on that of each mode")
    watch = Monitor(generator, isolate=None) if watch is None else watch
    check_samples(transient, "transient", least=0)
    parts = several_signals(u, y, time, dt, watch.design.plant)
    for one in parts:
        watch._learn_step(one.dt)
    recordings, sampled, blank = (
        [watch._block(one.u, one.y) for one in parts],
        watch.generator,
        blank_test(watch.generator),
    )
    samples = np.concatenate([data.reshape(-1, data.shape[2]) for data in recordings])
    ranges = fitted_ranges(watch.plausible, samples, guarded_ranges(sampled, blank))
    _, run = fault_free_run(
        sampled,
        recordings,
        settle=watch.settle,
        max_hold=watch.max_hold,
        plausible=watch._limits(ranges, blank),
        start=watch.start,
    )
    usable = run.usable.copy()
    for first in (0, *run.seams):
        usable[first : first + int(transient)] = False
    covariance = sampled.covariance_of_sums(1)
    units = {name: str(sampled.plant.units.get(name.removeprefix("r "), "")) for name in sampled.residuals}
    return findings_of(
        replace(run, usable=usable),
        sampled.residuals,
        units=units,
        covariance=covariance,
        white=None if covariance is None else is_white(sampled),
    )


__all__ = ["residual_report"]
