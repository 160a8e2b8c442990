"""Size of a fault over time: shapes that are added through the plant, and those that act on one channel."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.errors import SettingError
from residua.tolerances import SAME
from residua.visible import echo

#: When a fault arrives: a time in seconds, or the earliest and the latest, between which each run draws its own.
Onset = float | tuple[float, float]


@dataclass(frozen=True)
class Shape:
    r"""Course of a fault: :math:`f(t) = s\, g(t - t_0)` for :math:`t \ge t_0`, zero before; times in seconds.

    Attributes
    ----------
    at : float or (float, float)
        The onset :math:`t_0`, in seconds after the first sample, which is at 0. Of a pair each run draws its
        own, evenly.
    until : float or None
        Time at which the fault is gone again; ``None``: it stays.
    """

    #: Action: ``adds`` the size through the plant's fault input, ``holds`` or ``weakens`` the channel itself.
    acts: ClassVar[str] = "adds"
    #: Whether the course differs from run to run, whatever the onset.
    drawn: ClassVar[bool] = False
    #: Parameters that are positive numbers.
    positive: ClassVar[tuple[str, ...]] = ()

    at: Onset
    until: float | None

    def __post_init__(self) -> None:
        """Check the times, and the parameters that are positive."""
        object.__setattr__(self, "at", _checked_onset(self.at))
        if self.until is not None:
            last = self.at[1] if isinstance(self.at, tuple) else self.at
            object.__setattr__(self, "until", _number(self.until, "until"))
            if not self.until > last:
                raise SettingError(f"until={self.until:g} s must be after the onset at {last:g} s")
        for name in self.positive:
            value = _number(getattr(self, name), name)
            if not value > 0:
                raise SettingError(f"{name} must be positive, got {value:g}; the size of the scenario has the sign")
            object.__setattr__(self, name, value)

    def course(self, since: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the size, as a share of the scenario's size, at times in seconds since the onset; one by default."""
        return np.ones_like(since)

    @property
    def differs(self) -> bool:
        """True if the course differs from run to run."""
        return self.drawn or isinstance(self.at, tuple)

    @property
    def latest(self) -> float:
        """The latest onset, in seconds."""
        return self.at[1] if isinstance(self.at, tuple) else self.at

    def earliest_sample(self, dt: float) -> int:
        """Return the first sample that the fault can affect."""
        return _sample_at(self.at[0] if isinstance(self.at, tuple) else self.at, dt)

    def latest_sample(self, dt: float) -> int:
        """Return the last sample at which it may begin."""
        return _sample_at(self.latest, dt)

    @property
    def name(self) -> str:
        """The shape in a word or two."""
        return re.sub("(?!^)(?=[A-Z])", " ", type(self).__name__).lower()

    def over(self, samples: int, dt: float, rng: np.random.Generator) -> tuple[int, NDArray[np.float64]]:
        """Return the sample of the onset, and the share of the size at each sample.

        Parameters
        ----------
        samples : int
        dt : float
            Step in seconds.
        rng : numpy.random.Generator
            The run's own.
        """
        onset = float(rng.uniform(*self.at)) if isinstance(self.at, tuple) else float(self.at)
        first = _sample_at(onset, dt)
        stop = samples if self.until is None else min(samples, _sample_at(self.until, dt))
        share = np.zeros(samples)
        if first < stop:
            share[first:stop] = self.course(np.maximum(dt * np.arange(first, stop) - onset, 0.0), rng)
        return first, share

    def __str__(self) -> str:
        shown = [(one.name, getattr(self, one.name)) for one in fields(self)]
        return f"{self.name}({', '.join(f'{k}={_text(v)}' for k, v in shown if v is not None)})"


@dataclass(frozen=True)
class Step(Shape):
    """See :func:`step`."""


@dataclass(frozen=True)
class Drift(Shape):
    """See :func:`drift`."""

    positive: ClassVar[tuple[str, ...]] = ("slope",)
    slope: float

    def course(self, since: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the growing share."""
        return self.slope * since

    def __str__(self) -> str:
        until = "" if self.until is None else f", until={_text(self.until)}"
        return f"{self.name}(slope={_text(self.slope)}, at={_text(self.at)}{until})"


@dataclass(frozen=True)
class Ramp(Drift):
    """See :func:`ramp`."""

    def course(self, since: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the growing share, up to one."""
        return np.minimum(super().course(since, rng), 1.0)


@dataclass(frozen=True)
class Intermittent(Shape):
    """See :func:`intermittent`."""

    drawn: ClassVar[bool] = True
    positive: ClassVar[tuple[str, ...]] = ("on", "off")
    on: float
    off: float

    def course(self, since: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return one while the fault is there."""
        edges, length = [0.0], float(since[-1])
        while edges[-1] <= length:
            edges.append(edges[-1] + float(rng.exponential(self.on if len(edges) % 2 else self.off)))
        return (np.searchsorted(edges, since, side="right") % 2).astype(float)


@dataclass(frozen=True)
class Oscillation(Shape):
    """See :func:`oscillation`."""

    positive: ClassVar[tuple[str, ...]] = ("period",)
    period: float

    def course(self, since: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the sine."""
        return np.sin(2 * np.pi / self.period * since)


@dataclass(frozen=True)
class NoiseGrowth(Shape):
    """See :func:`noise_growth`."""

    drawn: ClassVar[bool] = True

    def course(self, since: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return white noise."""
        return rng.standard_normal(len(since))


@dataclass(frozen=True)
class StuckAt(Shape):
    """See :func:`stuck_at`."""

    acts: ClassVar[str] = "holds"
    value: float | None = None

    def __post_init__(self) -> None:
        """Check the value."""
        super().__post_init__()
        if self.value is not None:
            object.__setattr__(self, "value", _number(self.value, "value"))


@dataclass(frozen=True)
class LossOfEffectiveness(Shape):
    """See :func:`loss_of_effectiveness`."""

    acts: ClassVar[str] = "weakens"


def step(at: Onset, *, until: float | None = None) -> Shape:
    r"""Return a fault that is there at once: :math:`f = s` from the onset on.

    Parameters
    ----------
    at : float or (float, float)
        Onset in seconds, or the ends of the interval that each run draws its own from.
    until : float, optional
        Time in seconds at which it is gone again.

    Raises
    ------
    SettingError
        If a time is negative or not finite, or the end is not after the onset.

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.validate.step(at=60))
    step(at=60)
    """
    return Step(at, until)


def ramp(slope: float, at: Onset, *, until: float | None = None) -> Shape:
    r"""Return a fault that grows up to its size: :math:`f = s \min(c\,(t - t_0), 1)`.

    Parameters
    ----------
    slope : float
        ``c``, the share of the size that comes each second: 0.01 takes a hundred seconds.
    at, until
        As of :func:`step`.

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.validate.ramp(slope=0.01, at=600))
    ramp(slope=0.01, at=600)
    """
    return Ramp(at, until, slope)


def drift(slope: float, at: Onset, *, until: float | None = None) -> Shape:
    r"""Return a fault that grows without an end: :math:`f = s\, c\,(t - t_0)`.

    Parameters
    ----------
    slope : float
        ``c``, how many times its size the fault grows each second.
    at, until
        As of :func:`step`.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> shape = rs.validate.drift(slope=0.5, at=2)
    >>> shape.over(6, 1.0, np.random.default_rng(0))[1]
    array([0. , 0. , 0. , 0.5, 1. , 1.5])
    """
    return Drift(at, until, slope)


def intermittent(on: float, off: float, at: Onset, *, until: float | None = None) -> Shape:
    """Return a fault that comes and goes: there and away for times that are exponentially distributed.

    Parameters
    ----------
    on, off : float
        Mean times in seconds for which it is there, and away. It is there at the onset.
    at, until
        As of :func:`step`.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> shape = rs.validate.intermittent(on=2, off=2, at=1)
    >>> shape.over(6, 1.0, np.random.default_rng(0))[1]
    array([0., 1., 1., 0., 0., 1.])
    """
    return Intermittent(at, until, on, off)


def oscillation(period: float, at: Onset, *, until: float | None = None) -> Shape:
    r"""Return a fault that swings: :math:`f = s \sin(2 \pi (t - t_0) / T)`.

    Parameters
    ----------
    period : float
        ``T`` in seconds.
    at, until
        As of :func:`step`.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> shape = rs.validate.oscillation(period=4, at=1)
    >>> shape.over(6, 1.0, np.random.default_rng(0))[1].round(3)
    array([ 0.,  0.,  1.,  0., -1., -0.])
    """
    return Oscillation(at, until, period)


def noise_growth(at: Onset, *, until: float | None = None) -> Shape:
    """Return a fault that is white noise: the size is its standard deviation, sample by sample.

    On a sensor it adds to the noise that the sensor has.

    Parameters
    ----------
    at, until
        As of :func:`step`.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> shape = rs.validate.noise_growth(at=4)
    >>> shape.over(6, 1.0, np.random.default_rng(0))[1].round(3)
    array([ 0.   ,  0.   ,  0.   ,  0.   ,  0.126, -0.132])
    """
    return NoiseGrowth(at, until)


def stuck_at(at: Onset, value: float | None = None, *, until: float | None = None) -> Shape:
    """Return a channel that stays where it is, or at a value: of sensor and actuator faults only.

    A sensor then reports that value; an actuator takes that position whatever is commanded, while the recorded input
    stays the command.

    Parameters
    ----------
    at, until
        As of :func:`step`.
    value : float, optional
        In plant units, that is with the operating point. When omitted, the value of the sample before the onset.

    See Also
    --------
    residua.validate.loss_of_effectiveness : a signal that is weaker than it should be.

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.validate.Scenario("level sensor", rs.validate.stuck_at(at=60, value=1.2)))
    level sensor, stuck at(at=60, value=1.2)
    """
    return StuckAt(at, until, value)


def loss_of_effectiveness(at: Onset, *, until: float | None = None) -> Shape:
    r"""Return a channel that acts in part: :math:`(1 - s)` of its signal; of sensor and actuator faults only.

    The size is the part that is lost, over 0 and up to 1. It acts on the whole signal in plant units, operating point
    included.

    Parameters
    ----------
    at, until
        As of :func:`step`.

    See Also
    --------
    residua.validate.stuck_at : a signal that does not move at all.

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.validate.Scenario("valve actuator", rs.validate.loss_of_effectiveness(at=60), size=0.3))
    valve actuator, loss of effectiveness(at=60), size 0.3
    """
    return LossOfEffectiveness(at, until)


#: The shapes by the names that files use.
SHAPES: dict[str, Callable[..., Shape]] = {
    one.__name__: one
    for one in (step, ramp, drift, intermittent, oscillation, noise_growth, stuck_at, loss_of_effectiveness)
}


def _sample_at(time: float, dt: float) -> int:
    """Return the first sample at a time or after it."""
    return max(0, math.ceil(time / dt * (1 - SAME)))


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))})"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _number(value: object, name: str) -> float:
    if is_number(value):
        return float(value)  # pyright: ignore[reportArgumentType]
    raise SettingError(f"{name} must be a finite number, got {echo(value)}")


def _checked_onset(at: object) -> Onset:
    """Return an onset as a number or a pair of numbers."""
    if isinstance(at, (tuple, list)):
        if len(at) != 2:
            raise SettingError(f"at must be one time in seconds, or the earliest and the latest, got {echo(at)}")
        first, last = (_number(one, "at") for one in at)
        if not 0 <= first < last:
            raise SettingError(f"at: the earliest onset must be 0 s or later and before the latest, got {echo(at)}")
        return first, last
    onset = _number(at, "at")
    if onset < 0:
        raise SettingError(f"at must be 0 s or later, got {onset:g} s")
    return onset
