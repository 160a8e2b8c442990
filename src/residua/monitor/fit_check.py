"""Check of a fit on its fault-free data: alarms held out, changes of residuals, and faults that would be seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.by_channel import channel_faults
from residua.decide.explanation import BLOCKS
from residua.decide.false_alarms import within_tolerance
from residua.decide.held_out import HeldOut
from residua.decide.sizes import fault_unit
from residua.decide.stationarity import Change
from residua.decide.test import FaultFreeRun, ResidualTest
from residua.design import ResidualGenerator
from residua.errors import DataError
from residua.linear.systems.recursion import run_filter
from residua.number_kinds import BOUND, COUNT, FINITE, INDEX, KNOWN_OR_NOT, PROBABILITY, SHARE, NumberKind
from residua.records import Record
from residua.shown import Shown, notes, table
from residua.words import counted, number, one_in

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


@dataclass(frozen=True)
class Explained(Record):
    """An output, and the share of its variance that its prediction one sample ahead explains."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"share": FINITE}

    output: str
    share: float


@dataclass(frozen=True, repr=False)
class FitCheck(Shown, Record):
    """The check of a fit on its own recordings. Prints as one line on false alarms, and objections to the fit.

    Attributes
    ----------
    held_out : HeldOut or None
        The alarms on the last part, which was used neither for the covariance nor for the threshold; ``None`` if none
        was held out.
    changes : tuple of Change
        Changes of residuals in the recordings taken as fault-free.
    left_out : int
        Samples at the starts of recordings that were left out as transients.
    recordings : int
    mean, spread : tuple of float
        Of each channel of the fitted recordings, inputs first, in plant units; a spread of zero
        where nothing is known of a channel, and empty where that is not known of any.
    units : tuple of str
        The channels that may be in other units than the model, or in some recordings.
    doubts : tuple of str
        Contradictions with the plant: residuals far larger than its noise explains, constant outputs.
    rows : int
        Usable rows that the fit used, without those held out.
    colour : tuple of float
        How much sums of whitened residuals vary beyond those of white noise; see
        :func:`residua.decide.explanation.colour_of`. Empty where the test does not whiten.
    aimed : float or None
        Fraction of fault-free samples in alarm that the fit aimed at; ``None`` for thresholds that data do not change.
    visible : tuple of VisibleSize
        The smallest constant size of each fault that is seen; empty where the test cannot tell.
    explained : tuple of Explained
        The outputs that the filter predicts, and how much of them; empty for other residuals.
    cautions : tuple of str
        Doubts about the monitor as a whole: the first words of every diagnosis.
    promised : float or None
        The fraction that these rows promise not to be exceeded, with 95 % confidence; ``None`` if nothing is known of
        it, as of a threshold that is not from data.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "left_out": INDEX,
        "recordings": COUNT,
        "rows": INDEX,
        "aimed": PROBABILITY,
        "promised": SHARE,
    }

    held_out: HeldOut | None
    changes: tuple[Change, ...] = ()
    left_out: int = 0
    recordings: int = 1
    mean: tuple[float, ...] = ()
    spread: tuple[float, ...] = ()
    units: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    rows: int = 0
    colour: tuple[float, ...] = ()
    aimed: float | None = None
    promised: float | None = None
    visible: tuple[VisibleSize, ...] = ()
    explained: tuple[Explained, ...] = ()
    cautions: tuple[str, ...] = ()

    @property
    def explains(self) -> str:
        """Explained shares of the outputs that the filter predicts, in a line; empty if it predicts none."""
        if not self.explained:
            return ""
        least = sorted(self.explained, key=lambda one: one.share)
        more = f", and {counted(len(least) - _TOLD, 'other')} more" if len(least) > _TOLD else ""
        named = ", ".join(f"{one.output} {100 * max(one.share, 0.0):.3g} %" for one in least[:_TOLD])
        return f"explained of outputs, one sample ahead: {named}{more}"

    @property
    def could_have_seen(self) -> tuple[str, ...]:
        """Sentences on the smallest constant faults that are seen, and on those that are not detectable."""
        seen = [one for one in self.visible if one.is_detectable]
        seen.sort(key=lambda one: -one.lasting / (one.deviation if one.deviation > 0 else one.lasting or 1.0))
        blind = [one for one in self.visible if not one.is_detectable]
        out = []
        if seen:
            out.append(
                f"The smallest constant faults that are seen in nine of ten cases, within {SOON} samples | as long as "
                f"they last: {_first([str(one) for one in seen])}."
            )
        if blind:
            named = _first([f"{one.fault} (from {one.text(one.lasting)} on)" for one in blind])
            out.append(f"Not detectable as a constant fault of {DETECTABLE:g} deviations: {named}.")
        return tuple(out)

    @property
    def sees_nothing(self) -> str:
        """Reason why an absence of alarms says next to nothing; empty if some lasting fault is visible."""
        if not self.visible or any(one.is_detectable for one in self.visible):
            return ""
        best = min(self.visible, key=lambda one: one.lasting / (one.deviation if one.deviation > 0 else 1.0))
        return (
            f"this monitor detects no lasting fault: at best {best.fault}, from {best.text(best.lasting)} on; it needs "
            "a better model, more sensors, or longer fault-free recordings"
        )

    @property
    def false_alarms(self) -> str:
        """Rate of false alarms: promised by the fit, and observed; empty if data change no threshold.

        Promised is the rate that the fit aimed at, within a factor of 1.5; where its rows cannot show that, both are
        said.
        """
        if self.aimed is None:
            return ""
        said = f"{one_in(self.aimed)} samples "
        if self.promised is None:
            said += "requested"
        elif within_tolerance(self.promised, self.aimed):
            said += "expected"
        elif self.promised <= _WORTH_SAYING:
            said += f"requested, {one_in(self.promised)} confirmed by {self.rows:,} samples"
        else:
            said += f"requested; {self.rows:,} samples are too few to confirm it: use a longer log or a higher rate"
        return f"false alarms: {said}, {self.held_out or 'no samples held out'}"

    @property
    def notes(self) -> tuple[str, ...]:
        """Objections to the fit, and remedies; empty if there are none."""
        found = [one.sentence(self.recordings > 1) for one in self.changes]
        held = self.held_out
        if held is not None and held.is_over:
            found.insert(0, f"{held}, too many for {one_in(held.asked)}: {_CHANGES if found else _CAUSES}")
        return tuple(f"the fit: {one}" for one in (*self.cautions, *self.units, *self.doubts, *found, *self._wandering))

    @property
    def looks_faulty(self) -> str:
        """Reason to doubt that the recordings are fault-free throughout; empty if there is none.

        More of the held-out samples are in alarm than ten times the rate aimed at, with 97.5 % confidence, or a mean
        changes far (:meth:`residua.decide.stationarity.Change.large`). Nothing is checked without samples held out.
        """
        held = self.held_out
        if held is None:
            return ""
        several = self.recordings > 1
        if held.is_far_over:
            where = f" of recording {held.recording}" if several else ""
            return (
                f"{held.alarmed:,} of {held.samples:,} held-out samples are in alarm, the first at sample "
                f"{held.sample:,}{where}, where {one_in(held.asked)} was asked"
            )
        return next(filter(None, (one.large(several) for one in self.changes)), "")

    def require_fault_free(self) -> None:
        """Raise :class:`residua.errors.DataError` if the recordings look faulty."""
        if self.looks_faulty:
            raise DataError(
                f"this does not look like a fault-free recording: {self.looks_faulty}; leave the faulty rows out; "
                "where all rows are normal, fit several recordings that have such changes more than once, or give "
                "force=True"
            )

    @property
    def _wandering(self) -> tuple[str, ...]:
        """Caution about the model from sums of whitened residuals over 20 samples, or fewer without enough data."""
        variance = self.colour[_TWENTY] if self.colour else 1.0
        if variance <= _WANDERS:
            return ()
        return (
            f"the residuals of healthy data wander {number(variance**0.5, 2)} times as far as noise would: the model "
            'misses some of the plant\'s dynamics, or a drift, and "too early" and "poor match" are more frequent; '
            "identify the plant again, estimate its noise from data, or add a disturbance",
        )

    def _headline(self) -> str:
        return self.false_alarms or "no threshold is from data"

    def _parts(self) -> list[str]:
        facts = [self.explains] if self.explains else []
        return [table(HEADER, [one.cells for one in self.visible]), notes([*facts, *self.notes])]

    def __str__(self) -> str:
        return "\n".join(filter(None, (self.false_alarms, *self.notes)))


def _first(faults: list[str]) -> str:
    """Return the first of some faults, and the number of others."""
    more = [f"and {counted(len(faults) - _TOLD, 'more fault')}"] if len(faults) > _TOLD else []
    return "; ".join([*faults[:_TOLD], *more])


#: Faults that a sentence tells the sizes of.
_TOLD = 5
#: Place in ``colour`` of the variance of sums over 20 samples, and the variance above which the model is in doubt.
_TWENTY, _WANDERS = 1 + BLOCKS.index(20), 4.0
#: Fraction in alarm up to which a promise is worth to be said.
_WORTH_SAYING = 0.1
_CAUSES = (
    "the last part differs from the rest (a drift, another load), or the recording is too short; fit to a "
    "longer one, or to several"
)
_CHANGES = "the recording changes after its start"


__all__ = ["FitCheck", "VisibleSize", "visible_sizes"]
