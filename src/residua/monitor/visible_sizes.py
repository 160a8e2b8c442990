"""Smallest constant fault that a fitted monitor sees, soon and for as long as it lasts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.by_channel import channel_faults
from residua.decide.sizes import fault_unit
from residua.decide.test import FaultFreeRun, ResidualTest
from residua.design import ResidualGenerator
from residua.linear.systems.recursion import run_filter
from residua.number_kinds import BOUND, KNOWN_OR_NOT, NumberKind
from residua.records import Record
from residua.words import number

#: Samples within which a fault is seen soon, and those after them over which it is seen as long as it lasts.
SOON, LASTING = 100, 1000
#: Deviations of its channel up to which a fault that lasts counts as detectable.
DETECTABLE = 5.0
#: Of a table of sizes.
HEADER = (
    *("constant fault", f"seen within {SOON} samples from", "as long as it lasts from", "detectable when constant"),
)
#: Places in the fit at which changes are tried.
_PLACES = 4
#: Share of the samples in which a fault that lasts is seen.
_SHARE = 0.9
#: Largest response to a fault of one that is looked at.
_LARGEST = 1e100


@dataclass(frozen=True)
class VisibleSize(Record):
    """The smallest constant size of a fault that is seen in nine of ten runs.

    Attributes
    ----------
    fault : str
    unit : str
    soon : float
        Seen within 100 samples; infinite if none is.
    lasting : float
        In alarm as long as it lasts, over samples 100 to 1,000; infinite if none is.
    deviation : float
        Of its channel in the fit, in the same unit; NaN where it has none, or that never moved.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"soon": BOUND, "lasting": BOUND, "deviation": KNOWN_OR_NOT}

    fault: str
    unit: str
    soon: float
    lasting: float
    deviation: float

    @property
    def is_detectable(self) -> bool:
        """True if it is seen as long as it lasts, at five deviations of its channel or less; else at any size."""
        if math.isnan(self.deviation):
            return math.isfinite(self.lasting)
        return self.lasting <= DETECTABLE * self.deviation

    def text(self, size: float) -> str:
        """Return a size with its unit and in deviations of the channel."""
        if not math.isfinite(size):
            return "never"
        unit = f" {self.unit}" if self.unit else ""
        own = "" if math.isnan(self.deviation) else f" ({number(size / self.deviation, 2)} deviations)"
        return f"{number(size, 3)}{unit}{own}"

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """The row of a table under :data:`HEADER`."""
        return self.fault, self.text(self.soon), self.text(self.lasting), "yes" if self.is_detectable else "no"

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        sizes = " | ".join(number(one, 3) for one in (self.soon, self.lasting))
        if math.isnan(self.deviation):
            return f"{self.fault} {sizes}{unit}"
        own = " | ".join(number(one / self.deviation, 2) for one in (self.soon, self.lasting))
        return f"{self.fault} {sizes}{unit} ({own} deviations)"


def visible_sizes(generator: ResidualGenerator, test: ResidualTest, run: FaultFreeRun) -> tuple[VisibleSize, ...]:
    r"""Return the smallest constant sizes of all faults that a test sees; empty if the test cannot tell.

    .. math:: f_{soon} = \min_{t < 100} \frac{1}{l(t)}, \qquad f_{lasting} = \frac{1}{Q_{0.1}(l(100), \dots, l(999))}

    with the lead :math:`l(t)` of a fault of one that began at time zero: what it adds to a mean of the test, over the
    threshold and 1.28 deviations of that mean, so that nine of ten runs are over; :math:`Q_{0.1}` is what nine of ten
    samples reach.

    Parameters
    ----------
    generator : ResidualGenerator
        Sampled.
    test : ResidualTest
        Fitted.
    run : FaultFreeRun
        Its fault-free data.
    """
    plant = generator.plant
    m, p = len(plant.inputs), len(plant.outputs)
    if not plant.faults or not plant.is_discrete:
        return ()
    signals = np.zeros((0, m + p)) if run.signals is None else run.signals
    spread = np.nanstd(signals[run.usable], axis=0) if run.usable.any() and len(signals) else np.full(m + p, np.nan)
    changes, residuals = _responses(generator)
    leads = test.leads(residuals, changes, _places(signals, run, len(changes[0])))
    if leads is None:
        return ()
    columns = {name: i for i, name in enumerate((*plant.inputs, *plant.outputs))}
    channels, out = channel_faults(generator), []
    for k, fault in enumerate(plant.faults):
        soon, lasting = float(leads[k, :SOON].max(initial=0.0)), float(np.quantile(leads[k, SOON:], 1 - _SHARE))
        channel = columns.get(channels.get(fault, ""))
        deviation = float(spread[channel]) if channel is not None and spread[channel] > 0 else math.nan
        soon, lasting = (1 / one if one > 0 else math.inf for one in (soon, lasting))
        out.append(VisibleSize(fault, fault_unit(plant, fault), soon, lasting, deviation))
    return tuple(out)


def _responses(generator: ResidualGenerator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the responses of channels and residuals to a unit step of each fault, (faults, time, ...)."""
    plant, system = generator.plant, generator.system.explicit()
    steps = np.ones((len(plant.faults), LASTING, 1)) * np.eye(len(plant.faults))[:, None, :]
    faulty = plant.system("fault").explicit()
    with np.errstate(over="ignore", invalid="ignore"):
        _, y = run_filter(faulty.A, faulty.B, faulty.C, faulty.D, np.zeros((len(steps), faulty.n_states)), steps)
    y = np.clip(np.nan_to_num(y, nan=_LARGEST, posinf=_LARGEST, neginf=-_LARGEST), -_LARGEST, _LARGEST)
    changes = np.concatenate([np.zeros((*y.shape[:2], len(plant.inputs))), y], axis=2)
    _, residuals = run_filter(system.A, system.B, system.C, system.D, np.zeros((len(y), system.n_states)), changes)
    return changes, residuals


def _places(signals: NDArray[np.float64], run: FaultFreeRun, rows: int) -> NDArray[np.float64]:
    """Return stretches of the fault-free signals, (places, time, channels), each of so many rows."""
    if not len(signals):
        return signals[None]
    bounds = [0, *run.seams, len(signals)]
    start, stop = max(pairwise(bounds), key=lambda part: part[1] - part[0])
    starts = np.unique(np.linspace(start, max(start, stop - rows), _PLACES).astype(int))
    whole = np.stack([signals[np.minimum(np.arange(one, one + rows), stop - 1)] for one in starts])
    middle = np.nan_to_num(np.nanmean(signals[start:stop], axis=0))
    return np.where(np.isfinite(whole), whole, middle)


__all__ = ["VisibleSize", "visible_sizes"]
