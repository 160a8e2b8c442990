"""Times of a recording for people: clock time if the recording has dates, hours if seconds are many."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property

#: From here on a time since the start is shown in hours as well, and a length in larger units than seconds.
LONG_TIME, LONG = 7200.0, 600.0
_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86400.0
#: Beyond these seconds, 300 years, nobody counts days.
_MOST = 1e10


@dataclass(frozen=True)
class Clock:
    """Clock for the seconds of a recording.

    Attributes
    ----------
    origin : str
        The moment that they count from, ISO 8601, as it stands in the recording; empty, or anything else: seconds stay
        what they are. Times are local times of the recording: what its offset from UTC was at the start.
    step : float
        Seconds between samples: clock times have that precision.
    """

    origin: str = ""
    step: float = 1.0

    @cached_property
    def moment(self) -> datetime | None:
        """Origin of the seconds, without its time zone; ``None`` if there is none."""
        try:
            return datetime.fromisoformat(self.origin.strip()[:32]).replace(tzinfo=None) if self.origin else None
        except ValueError:
            return None

    @cached_property
    def zone(self) -> str:
        """Offset from UTC in the recording; empty if it has none."""
        if self.moment is None:
            return ""
        offset = datetime.fromisoformat(self.origin.strip()[:32]).strftime("%z")
        return f"{offset[:3]}:{offset[3:5]}" if offset else ""

    def at(self, seconds: float | None) -> str:
        """Return a time as text."""
        if seconds is None or not math.isfinite(seconds):
            return "–"
        if self.moment is not None:
            try:
                return self._clock_time(self.moment + timedelta(seconds=seconds))
            except OverflowError:
                pass
        text = f"{_short(seconds, 7)} s"
        return text if not LONG_TIME <= abs(seconds) < _MOST else f"{length(seconds)} ({text})"

    def _clock_time(self, moment: datetime) -> str:
        digits = max(0, min(6, math.ceil(-math.log10(self.step) - 1e-9))) if 0 < self.step < 1 else 0
        if not digits:
            return (moment + timedelta(seconds=0.5)).strftime("%Y-%m-%d %H:%M:%S")
        moment += timedelta(seconds=0.5 * 10.0**-digits)
        return f"{moment:%Y-%m-%d %H:%M:%S}.{f'{moment.microsecond:06d}'[:digits]}"


def length(seconds: float) -> str:
    """Return a duration in suitable units: ``45 s``, ``25 min``, ``5 h 12 min``, ``3 d 4 h``."""
    if not math.isfinite(seconds):
        return "–"
    sign, size = ("−" if seconds < 0 else ""), abs(seconds)
    if not LONG <= size < _MOST:
        return f"{sign}{_short(size, 4)} s"
    for large, name, small, part in ((_DAY, "d", _HOUR, "h"), (_HOUR, "h", _MINUTE, "min")):
        if size >= large * (2 if large == _DAY else 1):
            whole, rest = divmod(round(size / small), round(large / small))
            return f"{sign}{whole:,} {name}" + (f" {rest} {part}" if rest else "")
    return f"{sign}{_short(size / _MINUTE, 3)} min"


def _short(value: float, digits: int) -> str:
    return f"{value:.{digits}g}".replace("-", "−").replace("e+", "e")
