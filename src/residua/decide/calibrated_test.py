"""Threshold of any test by simulated worlds, a user's own too: it has to run, and nothing else is asked of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.calibrate import SETTLING, calibrated, held_out, inverse_root, levels_of, raw_worlds
from residua.decide.fault_free import FaultFree, check_enough
from residua.decide.test import Block, FaultFreeRun, ResidualTest
from residua.decide.treatment import Treated, fit_parts, inverse_of, whitened_part
from residua.errors import DataError


def calibrated_test(
    test: Any, run: FaultFreeRun, rate: float, *, falls_to: float = 1.0, settling: int = SETTLING
) -> Any:
    """Return a test with the threshold for a rate of false alarms, as of new data.

    Worlds of a model of the residual are simulated, and mean and covariance fitted anew to each. What such a fit would
    make of other rows of its world goes through the test, all worlds at once, as so many plants. So the threshold
    allows for few rows, memory and heavy tails, whatever the statistic is; and it is raised where quarters of the data,
    seen by a fit to the others, show more than worlds do.

    Parameters
    ----------
    test : ResidualTest
        Fitted to the mean and covariance of the run, with an infinite threshold; a dataclass with the fields
        ``threshold`` and ``basis``. Fields called ``promised`` and ``mean_time`` are filled in too.
    run : FaultFreeRun
        Fault-free residuals.
    rate : float
        Fraction of fault-free samples in alarm.
    falls_to : float
        Where an alarm ends: its statistic at or below this part of the threshold; 1 where it ends with the sample.
    settling : int
        Samples after which the statistic has forgotten its start.

    Returns
    -------
    ResidualTest
        Of the same class.

    Examples
    --------
    >>> import numpy as np
    >>> from residua.decide import CUSUM, FaultFreeRun, calibrated_test
    >>> rows = np.random.default_rng(0).standard_normal((2000, 1))
    >>> run = FaultFreeRun(rows, np.ones(2000, dtype=bool), (), np.ones(1))
    >>> from residua.decide.stream_test import plain
    >>> test = CUSUM().test(**plain(rows.mean(axis=0), np.eye(1)), threshold=np.inf, release=0.0, basis="")
    >>> 5 < calibrated_test(test, run, 0.01, falls_to=0.5).threshold < 7
    True
    """
    k, count = run.residuals.shape[1], int(run.usable.sum())
    check_enough(count, k, 1)
    own = whitened_part("auto", run, range(k))
    model = fit_parts([own], [range(k)], run).model
    raw = raw_worlds(model, settling=settling)
    fitted, truth = raw.q[:, : raw.rows], np.swapaxes(raw.q, 1, 2) @ raw.q / raw.q.shape[1]
    theirs = np.swapaxes(fitted, 1, 2) @ fitted / raw.rows
    whole = truth.mean(axis=0) + raw.shrink * (theirs - truth.mean(axis=0))
    back = inverse_of(own.parts["whitening"])
    rows = own.parts["center"] + raw.q[:, raw.rows :] @ inverse_root(whole) @ back
    worlds = levels_of(_statistics(test, rows), falls_to)[:, settling:]
    data = FaultFree(run.residuals, run.usable, 1, run.seams)
    worth = count / data.worth[0] / max(data.moving, 1)
    found = calibrated(worlds, _held_out_levels(test, run, own, falls_to), rate, count, worth=worth)
    known = {"promised": float(found.promised), "mean_time": found.time}
    more = {name: value for name, value in known.items() if name in test.__dataclass_fields__}
    return replace(test, threshold=found.threshold, basis=str(found), **more)


def _statistics(test: ResidualTest, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the statistic of series of rows, from a start each."""
    usable = np.ones(rows.shape[:2], dtype=bool)
    return np.nan_to_num(test.run(test.start(len(rows)), Block(rows, usable))[1].statistic)


def _held_out_levels(test: ResidualTest, run: FaultFreeRun, own: Treated, falls_to: float) -> NDArray[np.float64]:
    """Return the levels of each quarter, in the units of a fit to all, by a fit to the others."""
    out, back = [], inverse_of(own.parts["whitening"])
    for others, mine in held_out(run):
        try:
            parts = whitened_part("none", others, range(run.residuals.shape[1])).parts
        except DataError:  # too few samples remain for a fit
            return np.zeros(0)
        for part in FaultFree(mine.residuals, mine.usable, 1, mine.seams).parts:
            rows = run.residuals[part][mine.usable[part]]
            if len(rows):
                seen = own.parts["center"] + (rows - parts["center"]) @ parts["whitening"] @ back
                out.append(levels_of(_statistics(test, seen[None]), falls_to)[0])
    return np.concatenate(out) if out else np.zeros(0)


__all__ = ["calibrated_test"]
