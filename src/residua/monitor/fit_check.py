"""Check of a fit on its fault-free data: alarms on the held-out part, and changes of the residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from residua.decide.explanation import BLOCKS
from residua.decide.false_alarms import within_tolerance
from residua.decide.held_out import HeldOut
from residua.decide.stationarity import Change
from residua.errors import DataError
from residua.monitor.visible_sizes import DETECTABLE, HEADER, SOON, VisibleSize
from residua.number_kinds import COUNT, FINITE, INDEX, PROBABILITY, SHARE, NumberKind
from residua.records import Record
from residua.shown import Shown, notes, table
from residua.words import counted, number, one_in


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


__all__ = ["FitCheck"]
