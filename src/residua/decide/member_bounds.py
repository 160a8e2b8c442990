"""Certified bounds of the members of a design, and other faults that may have driven one over its threshold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm
from residua.errors import FileFormatError
from residua.number_kinds import BOUND, POSITIVE, NumberKind
from residua.records import Record, joined, table_in, values_in

#: Pairs of faults that a caution lists at most.
_LISTED = 4


@dataclass(frozen=True)
class MemberBounds(Record):
    """Bounds on one member of a bank, named after its fault, over the whole uncertainty set.

    Attributes
    ----------
    disturbances : float
        Bound on the effect of disturbances alone.
    response : float
        The least that a lasting fault of size one, the member's own, causes.
    leakage : mapping of str to float
        Bound on the effect of other faults of size one, with any time course.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "disturbances": BOUND,
        "response": POSITIVE,
        "leakage": BOUND,
    }

    disturbances: float
    response: float
    leakage: Mapping[str, float]


def bounds_in(value: Any, where: str, members: Sequence[str]) -> dict[str, MemberBounds]:
    """Return the bounds of all members from a record."""
    bounds: dict[str, MemberBounds] = {
        name: values_in(entry, joined(where, name), MemberBounds) for name, entry in table_in(value, where).items()
    }
    if bounds and set(bounds) != set(members):
        raise FileFormatError(f"{where} must have each member once: {', '.join(members)}")
    return bounds


def leakage_cautions(
    bounds: Mapping[str, MemberBounds],
    members: Sequence[str],
    alarms: Sequence[Alarm],
    statistics: NDArray[np.float64],
) -> tuple[str, ...]:
    """Return for each alarm those of its residuals that a single other fault may have driven over their thresholds.

    Parameters
    ----------
    bounds : mapping of str to MemberBounds
        Of every member.
    members : sequence of str
    alarms : sequence of Alarm
    statistics : ndarray, shape (time, members)
    """
    out: list[str] = []
    for k, alarm in enumerate(alarms, 1):
        if alarm.reading is None:
            continue
        seen = statistics[alarm.start : alarm.stop]
        peaks = np.where(np.isnan(seen), 0.0, seen).max(axis=0, initial=0.0)
        largest = dict(zip(members, peaks.tolist(), strict=True))
        cautions = sorted(_explained(bounds, largest, alarm.reading.fired))
        low = [name for name in alarm.reading.fired if largest[name] <= bounds[name].disturbances]
        if low:
            out.append(
                f"disturbances alone may fire {', '.join(map(repr, low))}: thresholds are below the bounds that the "
                "design has certified"
            )
        if cautions:
            more = f"; and {len(cautions) - _LISTED} more" if len(cautions) > _LISTED else ""
            where = f"in alarm {k} " if len(alarms) > 1 else ""
            out.append(f"other faults leak: {where}{'; '.join(text for _, text in cautions[:_LISTED])}{more}")
    return tuple(out)


def _explained(
    bounds: Mapping[str, MemberBounds], peaks: Mapping[str, float], fired: Sequence[str]
) -> Iterator[tuple[float, str]]:
    """Yield the other faults that may alone have made a member fire, smallest size first.

    The residual of a member is at most ``disturbances + leakage s`` where another fault alone is of size ``s``, and a
    lasting ``s`` makes that of its own member at least ``response s - disturbances``. So the other is not excluded
    where the size that the first asks for is no larger than the one that the second allows.
    """
    for name in fired:
        excess = peaks[name] - bounds[name].disturbances
        for other, leak in bounds[name].leakage.items():
            needed = excess / leak if excess > 0 and leak > 0 else np.inf
            of_other = bounds.get(other)  # members are named by their faults
            allowed = np.inf if of_other is None else (peaks[other] + of_other.disturbances) / of_other.response
            if np.isfinite(needed) and needed <= allowed:
                room = f"its own residual allows up to {allowed:.3g} of a lasting one"
                reason = "no member sees it" if of_other is None else room
                text = f"what fires {name!r} may be {other!r} alone, if that reaches {needed:.3g} or more ({reason})"
                yield needed / allowed, text
