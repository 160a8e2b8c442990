"""The decision on one sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Candidate, PresentFault, put_down_to
from residua.decide.code_reading import CodeReading
from residua.decide.isolation import Named, Seen
from residua.decide.sizes import estimates_of
from residua.design import ResidualGenerator
from residua.monitor.running import Decisions, State
from residua.monitor.specification import Specification


@dataclass(frozen=True, eq=False)
class Decision:
    """What a monitor decided on one sample.

    Attributes
    ----------
    residual : ndarray, shape (residuals,)
        NaN when a value was missing.
    statistic : float
        Norm of the (whitened) residual; for a bank the largest ratio of a member's to its threshold; NaN when
        nothing was decided.
    alarm : bool
    decided : bool
        False while the filter settles and where data are missing.
    missing : bool
    candidates : tuple of Candidate
        Best first while the alarm is on; empty otherwise, and by a code of several faults at once (``named``).
    fired : tuple of str
        For a bank: the members that are in alarm; for groups of residuals those.
    reading : CodeReading or None
        For a bank while the alarm is on: what the members that fired over the window say.
    estimates : mapping of str to float
        For an estimator: the estimated size of every fault now.
    arrived : float or None
        For matched filters while the alarm is on: how many seconds ago the fault arrived that the alarm is put down
        to; ``None`` if that was before the window.
    blamed : str
        For matched filters while the alarm is on: that fault. The candidates are those of this very sample, their
        arrivals in seconds since the first sample; once the arrival of that fault has left the window, the last of
        their sizes are by the steady responses.
    present : tuple of PresentFault
        By the code of a dedicated bank while the alarm is on: the faults that are read and when their members fired, in
        seconds since the first sample of the run, the first one first. Without those of which that is not known: the
        monitor was saved by an earlier version while they fired.
    """

    residual: NDArray[np.float64]
    statistic: float
    alarm: bool
    decided: bool
    missing: bool
    candidates: tuple[Candidate, ...] = field(default=())
    fired: tuple[str, ...] = ()
    reading: CodeReading | None = None
    estimates: Mapping[str, float] = field(default_factory=dict)
    arrived: float | None = None
    blamed: str = ""
    present: tuple[PresentFault, ...] = ()

    @property
    def named(self) -> tuple[tuple[str, ...], ...]:
        """The faults that are named now, one or several, each with its indistinguishable ones; else empty."""
        return put_down_to(self.reading, self.candidates)


def decision_from(decisions: Decisions, spec: Specification, generator: ResidualGenerator, state: State) -> Decision:
    """Return the decision on the one sample of the first plant of a block; ``state`` is that after it."""
    tested = decisions.tested
    alarm, fired = bool(tested.alarm[0, 0]), ()
    if spec.members:
        fired = tuple(name for name, on in zip(spec.members, tested.fired[0, 0], strict=True) if on)
    named = Named()
    if alarm:
        one, count = decisions.of(0), state.count - 1  # the number of this sample in the run
        time = np.array([count * generator.dt])
        seen = Seen(time, one.residuals, one.tested, one.named, generator, spec.test, state.isolation, count)
        named = spec.isolation.name_now(seen)
    return Decision(
        residual=decisions.residuals[0, 0],
        statistic=float(tested.statistic[0, 0]),
        alarm=alarm,
        decided=bool(tested.usable[0, 0]),
        missing=bool(decisions.missing[0, 0]),
        candidates=named.candidates,
        fired=fired,
        reading=named.reading,
        estimates={name: float(value) for name, value in estimates_of(generator, decisions.residuals[0, 0]).items()},
        arrived=named.arrived,
        blamed=named.blamed,
        present=named.present,
    )
