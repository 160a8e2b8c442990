"""A dedicated bank, whose members each have a fault of their own: which of them an alarm names, and since when."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.decide.structured import CodeReading, CodeTest
from residua.monitor.alarm import Alarm, PresentFault

if TYPE_CHECKING:
    from residua.monitor.running import Specification


def named_pattern(
    spec: Specification,
    longest: NDArray[np.bool_],
    code: NDArray[np.bool_],
    fired: NDArray[np.bool_],
    usable: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], float]:
    """Return the members that an alarm of a dedicated bank names, and the fraction of its samples with just these.

    Those of the pattern that stood the longest, and every other that counted as fired for an isolation window in all: a
    fault that came later has its member too, and a false alarm of a member is shorter. By a peak test every member that
    fired: one sample over its threshold declares the fault, and its own window holds it.

    Parameters
    ----------
    spec : Specification
    longest : ndarray of bool, shape (members,)
    code, fired : ndarray of bool, shape (time, members)
        Of the samples of the alarm.
    usable : ndarray of bool, shape (time,)
    """
    assert spec.codes is not None
    if spec.test.kind == "peak":
        more = fired.any(axis=0)
    else:
        more = np.count_nonzero(code & usable[:, None], axis=0) >= spec.codes.window
    pattern = longest | more
    read = code[usable & code.any(axis=1)]
    return pattern, float((read == pattern).all(axis=1).mean()) if len(read) else 0.0


def present_faults(
    codes: CodeTest, reading: CodeReading, fired: NDArray[np.bool_], time: NDArray[np.float64], start: int, stop: int
) -> tuple[PresentFault, ...]:
    """Return the faults that were read with the times at which their members fired, the first one first.

    Parameters
    ----------
    codes : CodeTest
    reading : CodeReading
    fired : ndarray of bool, shape (time, members)
        Of the whole recording.
    time : ndarray, shape (time,)
    start, stop : int
        First sample of the alarm and the one after it.
    """
    found = []
    for group in reading.named if codes.dedicated else ():
        member = codes.member_of(group)
        on = start + np.flatnonzero(fired[start:stop, member])
        if on.size:  # a member may count as fired for a moment longer than its alarm lasts
            after = int(on[-1]) + 1
            until = float(time[after]) if after < len(time) else None
            found.append(PresentFault(group, codes.members[member], float(time[on[0]]), until))
    return tuple(sorted(found, key=lambda fault: fault.since))


def present_now(
    codes: CodeTest, reading: CodeReading, since: NDArray[np.int64], step: float
) -> tuple[PresentFault, ...]:
    """Return the faults that are read now, since when their members fire in the standing alarm.

    Parameters
    ----------
    codes : CodeTest
    reading : CodeReading
    since : ndarray of int, shape (members,)
        As a :class:`residua.monitor.running.State` has it.
    step : float
        Seconds between samples.
    """
    if not codes.dedicated:
        return ()
    fired = [(group, codes.member_of(group)) for group in reading.named]
    found = [PresentFault(g, codes.members[m], (int(since[m]) - 1) * step) for g, m in fired if since[m] > 0]
    return tuple(sorted(found, key=lambda fault: fault.since))


def named_faults(alarm: Alarm) -> set[tuple[str, ...]]:
    """Return the groups of faults that an alarm names by code."""
    return set(alarm.reading.named) if alarm.reading else set()
