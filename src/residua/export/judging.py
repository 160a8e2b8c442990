"""Test and isolation of a monitor in the form of exports: the test, its parts, and the direction or code of faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.decide.compiled import CompiledIsolation, CompiledTest
from residua.decide.member_thresholds import BankTest, GroupTest
from residua.decide.multiscale_ewma import MultiscaleEWMATest
from residua.decide.peak_threshold import PeakTest
from residua.decide.structured import CodeTest
from residua.errors import SettingError
from residua.monitor.specification import Specification

#: The statistic of residuals whose parts are tested by themselves: the largest ratio of one to its own threshold.
OF_PARTS = "norm of parts"


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of the residual that are tested separately: the members of a bank, or groups.

    Attributes
    ----------
    names : tuple of str
    sizes : ndarray of int, shape (parts,)
        Whitened residuals of each.
    thresholds : ndarray, shape (parts,)
    whole : ndarray, shape (residuals, k), or None
        Units in which the direction of the whole is judged.
    """

    names: tuple[str, ...]
    sizes: NDArray[np.int64]
    thresholds: NDArray[np.float64]
    whole: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class Judging:
    """Test and isolation of a monitor.

    Attributes
    ----------
    test : CompiledTest
    naming : CompiledIsolation
        By direction; without bases for none, and for codes.
    parts : Parts or None
    codes : CodeTest or None
        By which the members that fired are read.
    """

    test: CompiledTest
    naming: CompiledIsolation
    parts: Parts | None = None
    codes: CodeTest | None = None

    @property
    def per_threshold(self) -> NDArray[np.float64]:
        """Whitening matrix in units of the thresholds."""
        if self.parts is None:
            return self.test.whitening / self.test.threshold
        return self.test.whitening / np.repeat(self.parts.thresholds, self.parts.sizes)


def judging_of(spec: Specification) -> Judging:
    """Return test and isolation in the form of exports.

    Raises
    ------
    SettingError
        If one of them cannot be, or a threshold is infinite.
    """
    one, naming = spec.test, spec.isolation.compiled
    codes = spec.isolation if isinstance(spec.isolation, CodeTest) else None
    test, parts = one.compiled, None
    if isinstance(one, PeakTest):
        test = CompiledTest("norm", one.center, one.whitening, one.threshold, one.window, one.persistence, one.release)
    if isinstance(one, BankTest):
        test = CompiledTest(OF_PARTS, one.center, one.whitening, 1.0, one.window, one.persistence, one.release)
        whole = one.whole if isinstance(one, GroupTest) else None
        parts = Parts(one.part_names, one.sizes, one.thresholds, whole)
    if isinstance(one, MultiscaleEWMATest) and one.names:
        parts = Parts(one.names, one.sizes, one.thresholds)
    if test is None or spec.test.responses is not None or spec.test.reads_signals:
        raise SettingError(
            f"the test of this monitor ({type(one).__name__}) cannot be exported: MultiscaleEWMA, NormThreshold, "
            "PeakThreshold, CUSUM, EWMA, ChiSquared and GLR can"
        )
    if codes is not None and parts is not None and codes.groups:
        naming = CompiledIsolation()
    elif not isinstance(naming, CompiledIsolation):
        raise SettingError(
            f"the isolation of this monitor ({type(spec.isolation).__name__}) cannot be exported: Directional can, "
            "Structured for a bank with codes, or isolate=None, which only raises the alarm"
        )
    elif parts is not None and parts.whole is None and naming.bases:
        raise SettingError("a direction cannot be exported for members of a bank: Structured, or isolate=None, can")
    if not np.isfinite([test.threshold, *([] if parts is None else parts.thresholds)]).all():
        raise SettingError("a threshold of this monitor is infinite: it never raises an alarm")
    return Judging(test, naming, parts, codes)


__all__ = ["OF_PARTS", "Judging", "Parts", "judging_of"]
