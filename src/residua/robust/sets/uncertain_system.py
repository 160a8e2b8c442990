"""Linear systems with constant uncertain parameters, as values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import frozen, matrix
from residua.errors import DesignError, ModelError, SettingError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.systems.scaling import scaling
from residua.linear.systems.state_space import StateSpace, square

#: With more parameters than this a box has too many corners to visit.
MOST_CORNERS = 12


#: What to do about a member that is not stable, of a loop with an estimator.
REMEDY = "narrow the set, or change the controller or estimator"


def corners(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return all corners of a box, shape (2^k, k); the first is ``low``."""
    k = len(low)
    if k > MOST_CORNERS:
        raise SettingError(
            f"{k} parameters have 2^{k} corners; up to {MOST_CORNERS} are listed: draw members at random instead"
        )
    bits = (np.arange(2**k)[:, None] >> np.arange(k)) & 1
    return np.where(bits.astype(bool), high, low)


def corner_points(
    low: NDArray[np.float64], high: NDArray[np.float64], samples: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return all corners of the parameters, or, of more than 12 that vary, as many as ``samples`` at random, or 256."""
    moving = np.flatnonzero(high > low)
    if len(moving) <= MOST_CORNERS:
        ends = corners(low[moving], high[moving])
    else:
        ends = np.where(rng.integers(0, 2, (max(samples, 256), len(moving))) > 0, high[moving], low[moving])
    points = np.repeat(low[None], len(ends), axis=0)
    points[:, moving] = ends
    return points


def check_modes(
    modes: NDArray, values: NDArray[np.float64], parameters: Sequence[str], dt: float, consequence: str
) -> None:
    """Raise unless members are stable; the message names the least stable, and says what follows.

    Parameters
    ----------
    modes : ndarray, shape (members, n)
    values : ndarray, shape (members, parameters)
    parameters : sequence of str
    dt : float
    consequence : str
        What follows from it, and what to do.
    """
    modes = np.asarray(modes, dtype=complex)
    if not modes.size or is_stable_mode(modes.ravel(), dt).all():
        return
    size = np.abs(modes) if dt else np.real(modes)
    i, j = np.unravel_index(int(np.argmax(size)), size.shape)
    named = ", ".join(f"{name} = {v:g}" for name, v in zip(parameters, values[i], strict=True))
    raise DesignError(
        f"a member of the set is not stable: pole {describe_modes(modes[i, [j]])}{f' at {named}' if named else ''}; "
        f"{consequence}"
    )


@dataclass(frozen=True, init=False, eq=False)
class UncertainSystem:
    r"""A sampled or continuous system in which constant parameters of a box stand.

    .. math::

       x_{k+1} = A x_k + B_p p_k + B_w w_k, \quad q_k = C_q x_k, \quad p_k = F q_k, \quad
       z_k = C_z x_k + D_{zp} p_k + D_{zw} w_k

    with :math:`F = \mathrm{diag}(f_{c(1)}, f_{c(2)}, \dots)`: the channel :math:`i` of ``p`` and ``q`` belongs to
    the parameter :math:`c(i)`, which may own several channels. ``low <= f <= high``, constant in time.

    Parameters
    ----------
    A : array_like, shape (n, n)
    Bp : array_like, shape (n, k)
    Bw : array_like, shape (n, m)
    Cq : array_like, shape (k, n)
    Cz : array_like, shape (r, n)
    Dzp : array_like, shape (r, k), optional
    Dzw : array_like, shape (r, m), optional
        Zero when omitted.
    low, high : array_like, shape (parameters,)
    channels : sequence of int, optional
        The parameter of each channel; one channel each, in order, when omitted.
    parameters : sequence of str, optional
        Names; ``f1..`` when omitted.
    dt : float
        0 for continuous time, otherwise the sample step in seconds.

    Raises
    ------
    ModelError
        If a shape does not fit, a bound is not finite or ``low > high``.

    References
    ----------
    Robust l1 fault detection, eqs. (30)-(36), with ``Bp = -H0`` and ``Cq = G0``.

    Examples
    --------
    >>> from residua.linear import UncertainSystem
    >>> lag = UncertainSystem([[0.5]], [[1.0]], [[1.0]], [[1.0]], [[2.0]], low=[-0.1], high=[0.2], dt=1.0)
    >>> lag.member([0.2]).A
    array([[0.7]])
    """

    A: NDArray[np.float64]
    Bp: NDArray[np.float64]
    Bw: NDArray[np.float64]
    Cq: NDArray[np.float64]
    Cz: NDArray[np.float64]
    Dzp: NDArray[np.float64]
    Dzw: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    channels: tuple[int, ...]
    parameters: tuple[str, ...]
    dt: float

    def __init__(
        self,
        A: ArrayLike,
        Bp: ArrayLike,
        Bw: ArrayLike,
        Cq: ArrayLike,
        Cz: ArrayLike,
        Dzp: ArrayLike | None = None,
        Dzw: ArrayLike | None = None,
        *,
        low: ArrayLike,
        high: ArrayLike,
        channels: Iterable[int] | None = None,
        parameters: Iterable[str] | None = None,
        dt: float = 0,
    ) -> None:
        A_ = square(A, "A")
        n = A_.shape[0]
        Bp_ = matrix(Bp, "Bp", (n, None), what="one row per state")
        k = Bp_.shape[1]
        Bw_ = matrix(Bw, "Bw", (n, None), what="one row per state")
        Cz_ = matrix(Cz, "Cz", (None, n), what="one column per state")
        r, m = Cz_.shape[0], Bw_.shape[1]
        low_, high_ = bounds(low, high)
        if channels is None and k != len(low_):
            raise ModelError(f"{k} channels for {len(low_)} parameters: say with channels= which belongs to which")
        owners = tuple(range(k) if channels is None else map(int, channels))
        if len(owners) != k or any(not 0 <= i < len(low_) for i in owners):
            raise ModelError(f"channels must hold {k} numbers from 0 to {len(low_) - 1}, got {owners}")
        self.__dict__.update(
            A=A_,
            Bp=Bp_,
            Bw=Bw_,
            Cq=matrix(Cq, "Cq", (k, n), what="channels x states"),
            Cz=Cz_,
            Dzp=frozen(np.zeros((r, k))) if Dzp is None else matrix(Dzp, "Dzp", (r, k), what="outputs x channels"),
            Dzw=frozen(np.zeros((r, m))) if Dzw is None else matrix(Dzw, "Dzw", (r, m), what="outputs x inputs"),
            low=low_,
            high=high_,
            channels=owners,
            parameters=arrays.names(parameters, len(low_), "f", "parameters"),
            dt=arrays.sample_step(dt),
        )

    @property
    def n_states(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return len(self.low)

    def member(self, values: ArrayLike | Mapping[str, float]) -> StateSpace:
        """Return the system from ``w`` to ``z`` with these parameters.

        Parameters
        ----------
        values : array_like, shape (parameters,), or mapping of every name to its value
        """
        f = parameter_values(values, self.parameters, self.low, self.high)
        F = f[list(self.channels)][:, None] * self.Cq
        return StateSpace(self.A + self.Bp @ F, self.Bw, self.Cz + self.Dzp @ F, self.Dzw, dt=self.dt)

    def within(self, low: ArrayLike, high: ArrayLike) -> UncertainSystem:
        """Return the system with other bounds of its parameters."""
        low_, high_ = bounds(low, high)
        if low_.shape != self.low.shape:
            raise ModelError(f"expected bounds of {self.n_parameters} parameters, got {len(low_)}")
        new = object.__new__(UncertainSystem)
        new.__dict__.update(vars(self) | {"low": low_, "high": high_})
        return new

    def balanced_states(self) -> NDArray[np.float64]:
        """Return balanced units of the states, with the channels of the parameters."""
        B, C = np.hstack([self.Bw, self.Bp]), np.vstack([self.Cz, self.Cq])
        return scaling(self.A, B, C, np.zeros((len(C), B.shape[1])), sampled=self.dt > 0).states

    def vertices(self) -> NDArray[np.float64]:
        """Return the corners of the box, shape (2^parameters, parameters); for up to 12 parameters."""
        return corners(self.low, self.high)

    def sample(self, rng: np.random.Generator | int, count: int) -> NDArray[np.float64]:
        """Return parameters drawn evenly from the box, shape (count, parameters)."""
        return np.random.default_rng(rng).uniform(self.low, self.high, (count, self.n_parameters))

    def __repr__(self) -> str:
        kind = f"dt={self.dt:g}" if self.dt else "continuous"
        return (
            f"UncertainSystem({self.n_states} states, {self.n_parameters} parameters in {len(self.channels)} channels, "
            f"{self.Bw.shape[1]} inputs, {self.Cz.shape[0]} outputs, {kind})"
        )


def bounds(low: ArrayLike, high: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return checked bounds of parameters as read-only vectors."""
    out = []
    for value, name in ((low, "low"), (high, "high")):
        try:
            v = np.atleast_1d(np.asarray(value, dtype=float))
        except (TypeError, ValueError) as error:
            raise ModelError(f"{name} must be numbers, one for each parameter: {error}") from error
        if v.ndim != 1 or not np.isfinite(v).all():
            raise ModelError(f"{name} must be finite numbers, one for each parameter, got {value!r}")
        out.append(frozen(v))
    if out[0].shape != out[1].shape:
        raise ModelError(f"low has {out[0].size} entries and high has {out[1].size}")
    wrong = np.flatnonzero(out[0] > out[1])
    if wrong.size:
        i = int(wrong[0])
        raise ModelError(f"parameter {i + 1}: low = {out[0][i]:g} exceeds high = {out[1][i]:g}")
    return out[0], out[1]


def parameter_values(
    values: ArrayLike | Mapping[str, float],
    known: tuple[str, ...],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    default: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return checked values of all parameters, in order; a mapping may leave out those that have a default."""
    if isinstance(values, Mapping):
        for name in values:
            arrays.index_of(name, known, "parameter")
        missing = [name for name in known if name not in values]
        if missing and default is None:
            raise ModelError(f"no value for the parameter {missing[0]!r}")
        v = np.array([values[name] if name in values else default[i] for i, name in enumerate(known)], dtype=float)  # type: ignore[index]
    else:
        v = np.asarray(values, dtype=float)
    if v.shape != low.shape or not np.isfinite(v).all():
        raise ModelError(
            f"expected {len(known)} finite parameter values ({', '.join(known) or 'none'}), got {values!r}"
        )
    room = 1e-9 * np.maximum(high - low, np.maximum(np.abs(low), np.abs(high)) * 1e-3)
    outside = np.flatnonzero((v < low - room) | (v > high + room))
    if outside.size:
        i = int(outside[0])
        raise ModelError(f"parameter {known[i]!r} = {v[i]:g} lies outside of its bounds [{low[i]:g}, {high[i]:g}]")
    return v
