"""What a fit says of its fault-free data: alarms on the part that was held out, and where residuals change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from residua.decide.held_out import HeldOut
from residua.decide.stationarity import Change
from residua.number_kinds import COUNT, INDEX, NumberKind
from residua.records import Record


@dataclass(frozen=True)
class FitCheck(Record):
    """The check of a fit on its own recordings.

    Attributes
    ----------
    held_out : HeldOut or None
        The alarms on the last part, which was used neither for the covariance nor for the threshold; ``None`` if none
        was held out.
    changes : tuple of Change
        Where residuals change, in what was taken for fault-free.
    left_out : int
        Samples at the starts of recordings that were left out as transients.
    recordings : int
    mean, spread : tuple of float
        Of each channel of the fitted recordings, inputs first, in plant units; a spread of zero
        where nothing is known of a channel, and empty where that is not known of any.
    units : tuple of str
        The channels that may be in other units than the model, or in some recordings.
    doubts : tuple of str
        What contradicts the plant: residuals far larger than its noise makes them, outputs that stand still.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"left_out": INDEX, "recordings": COUNT}

    held_out: HeldOut | None
    changes: tuple[Change, ...] = ()
    left_out: int = 0
    recordings: int = 1
    mean: tuple[float, ...] = ()
    spread: tuple[float, ...] = ()
    units: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What speaks against the fit, and what to do; empty if nothing does."""
        found = [one.sentence(self.recordings > 1) for one in self.changes]
        held = self.held_out
        if held is not None and held.is_over:
            found.insert(0, f"{_over(held)}: {_CAUSES if not found else _CHANGES}")
        return tuple(f"the fit: {one}" for one in (*self.units, *self.doubts, *found))


_CAUSES = (
    "the last part is not like what comes before (a drift, another load), or the recording is too short; fit to a "
    "longer one, or to several"
)
_CHANGES = "the recording does not stay as it begins"


def _over(held: HeldOut) -> str:
    low, _ = held.interval
    return (
        f"{held.rate:.2g} of the {held.samples} samples that were held out are in alarm, {held.asked:g} was asked for "
        f"(with 95 % confidence it is {low:.2g} or more)"
    )


__all__ = ["FitCheck"]
