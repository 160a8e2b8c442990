"""The decision on one sample."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Candidate, PresentFault, put_down_to
from residua.decide.code_reading import CodeReading
from residua.decide.isolation import Named, Seen
from residua.decide.sizes import estimates_of
from residua.design import ResidualGenerator
from residua.monitor.running import Decisions, State
from residua.monitor.specification import Specification


class Decision:
    """Decision of a monitor on one sample.

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
        For a bank while the alarm is on: the reading of the members that fired over the window.
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

    __slots__ = (
        "_alarm",
        "_decided",
        "_estimates",
        "_fired",
        "_generator",
        "_missing",
        "_named",
        "_residual",
        "_statistic",
    )

    def __init__(
        self,
        residual: NDArray[np.float64],
        statistic: float,
        alarm: bool,
        decided: bool,
        missing: bool,
        candidates: tuple[Candidate, ...] = (),
        fired: tuple[str, ...] = (),
        reading: CodeReading | None = None,
        estimates: Mapping[str, float] | None = None,
        arrived: float | None = None,
        blamed: str = "",
        present: tuple[PresentFault, ...] = (),
    ) -> None:
        self._residual, self._statistic = residual, statistic
        self._alarm, self._decided, self._missing = alarm, decided, missing
        self._fired, self._named = (
            fired,
            Named(candidates, reading=reading, arrived=arrived, blamed=blamed, present=present),
        )
        self._estimates: Mapping[str, float] | None = {} if estimates is None else estimates
        self._generator: ResidualGenerator | None = None

    @classmethod
    def quiet(
        cls, residual: NDArray[np.float64], statistic: float, decided: bool, missing: bool, generator: ResidualGenerator
    ) -> Decision:
        """Return the decision on a sample without an alarm; its estimates are computed on demand."""
        one = cls.__new__(cls)  # the slowest part of a step
        one._residual, one._statistic = residual, statistic
        one._alarm, one._decided, one._missing = False, decided, missing
        one._fired, one._named = (), _NOBODY
        one._estimates, one._generator = None, generator
        return one

    @property
    def residual(self) -> NDArray[np.float64]:
        """Residual of the sample; NaN when a value was missing."""
        return self._residual

    @property
    def statistic(self) -> float:
        """Statistic of the sample; NaN without a decision."""
        return self._statistic

    @property
    def alarm(self) -> bool:
        """True while an alarm stands."""
        return self._alarm

    @property
    def decided(self) -> bool:
        """True if the sample was decided."""
        return self._decided

    @property
    def missing(self) -> bool:
        """True if a value was missing."""
        return self._missing

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Candidates, best first, while the alarm is on."""
        return self._named.candidates

    @property
    def fired(self) -> tuple[str, ...]:
        """The members or groups that are in alarm."""
        return self._fired

    @property
    def reading(self) -> CodeReading | None:
        """The reading of the members that fired."""
        return self._named.reading

    @property
    def estimates(self) -> Mapping[str, float]:
        """The estimated sizes."""
        if self._estimates is None:
            self._estimates = {} if self._generator is None else sizes_now(self._generator, self._residual)
        return self._estimates

    @property
    def arrived(self) -> float | None:
        """Time since the arrival of the fault, in seconds."""
        return self._named.arrived

    @property
    def blamed(self) -> str:
        """The fault to which the alarm is attributed."""
        return self._named.blamed

    @property
    def present(self) -> tuple[PresentFault, ...]:
        """The faults that are read, with their times."""
        return self._named.present

    def __repr__(self) -> str:
        names = ("residual", "statistic", "alarm", "decided", "missing", "candidates", "fired", "reading", "estimates")
        values = (f"{name}={getattr(self, name)!r}" for name in (*names, "arrived", "blamed", "present"))
        return f"Decision({', '.join(values)})"

    @property
    def named(self) -> tuple[tuple[str, ...], ...]:
        """The faults that are named now, one or several, each with its indistinguishable ones; else empty."""
        return put_down_to(self.reading, self.candidates)


#: Attribution without a name.
_NOBODY = Named()


def sizes_now(generator: ResidualGenerator, residual: NDArray[np.float64]) -> dict[str, float]:
    """Return the estimated sizes at one sample."""
    return {name: float(value) for name, value in estimates_of(generator, residual).items()}


def decision_from(decisions: Decisions, spec: Specification, generator: ResidualGenerator, state: State) -> Decision:
    """Return the decision on the one sample of the first plant of a block; ``state`` is that after it."""
    tested = decisions.tested
    alarm, fired = bool(tested.alarm[0, 0]), ()
    if spec.members:
        fired = tuple(name for name, on in zip(spec.members, tested.fired[0, 0], strict=True) if on)
    named = Named()
    if alarm:
        one, count = decisions.of(0), int(state.count[0]) - 1  # the number of this sample in the run
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
        estimates=sizes_now(generator, decisions.residuals[0, 0]),
        arrived=named.arrived,
        blamed=named.blamed,
        present=named.present,
    )
