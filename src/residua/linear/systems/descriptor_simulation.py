"""Consistent states and simulation of descriptor systems."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import DataError, ModelError, SettingError
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.linear.systems.descriptor import WeierstrassForm, weierstrass_form
from residua.linear.systems.recursion import run_filter
from residua.linear.systems.sampling import exponentials
from residua.linear.systems.state_space import StateSpace
from residua.tolerances import SAME


@dataclass(frozen=True, eq=False)
class ConsistentState:
    """A state that a descriptor system can be in, made from one that it perhaps cannot; a bool as a condition.

    Attributes
    ----------
    state : ndarray, shape (n,)
        The state right after the jump: the dynamic part of ``x0``, with the algebraic part that the inputs
        demand.
    consistent : bool
        Whether ``x0`` was consistent already.
    distance : float
        How far it was off, relative to the sizes of the states that are added up.
    """

    state: NDArray[np.float64]
    consistent: bool
    distance: float

    def __bool__(self) -> bool:
        return self.consistent


def consistent_state(
    system: StateSpace,
    x0: ArrayLike,
    v: ArrayLike | None = None,
    *,
    derivatives: Sequence[ArrayLike] = (),
    tolerance: float = 1e-8,
    rtol: float = DEFAULT_RTOL,
) -> ConsistentState:
    r"""Project a state onto those that the equations allow for the inputs at that moment.

    In the Weierstrass form the dynamic part :math:`x_1` is free and the algebraic part is
    :math:`x_2 = -\sum_{i < \nu} N^i B_2 v^{(i)}`. A system that starts elsewhere jumps: :math:`x_1` is kept.

    Parameters
    ----------
    system : StateSpace
        Continuous, or sampled; then later inputs take the place of derivatives.
    x0 : array_like, shape (n,)
    v : array_like, shape (m,), optional
        The inputs; zero when omitted.
    derivatives : sequence of array_like, shape (m,)
        First, second, ... derivative of the inputs (sampled: the inputs of the next steps). Only those that the
        state depends on are needed.
    tolerance : float
        A state that is off by less counts as consistent.
    rtol : float
        For the rank decisions.

    Returns
    -------
    ConsistentState

    Raises
    ------
    ModelError
        If the system is not regular, or derivatives are missing.
    AccuracyError
        If its dynamic and algebraic parts cannot be separated, see `weierstrass_form`.

    References
    ----------
    Twardy and Kaczorek, part I, eqs. (15), (16).

    Examples
    --------
    >>> from residua.linear import StateSpace, consistent_state
    >>> system = StateSpace([[-1, 0], [1, -1]], [[0], [1]], [[1, 0]], E=[[1, 0], [0, 0]])
    >>> start = consistent_state(system, [2.0, 0.0], [0.5])
    >>> bool(start), start.state
    (False, array([2. , 2.5]))
    """
    form = weierstrass_form(system.A, system.E, rtol=rtol)
    m, n = system.n_inputs, system.n_states
    inputs = [np.zeros(m) if v is None else _vector(v, m, "v")]
    inputs += [_vector(d, m, "derivatives") for d in derivatives]
    start = _vector(x0, n, "x0")
    needed = input_order(form, system)
    if v is None:
        inputs += [np.zeros(m)] * max(0, needed + 1 - len(inputs))
    fast = _fast_part(form, system, [g[None] for g in inputs])[0]
    k = form.n_finite
    z = form.Q_inverse @ start
    state = form.Q @ np.concatenate([z[:k], fast])
    size = np.abs(form.Q) @ np.abs(np.concatenate([z[:k], fast])) + np.abs(start)
    size = np.maximum(size, size.max(initial=0.0) * 1e-12)
    distance = float(np.max(np.abs(state - start) / np.where(size > 0, size, 1.0), initial=0.0))
    return ConsistentState(state, distance <= tolerance, distance)


def input_order(form: WeierstrassForm, system: StateSpace) -> int:
    """Return the highest derivative of the inputs (or step ahead) that the states depend on; -1 for none."""
    power = (form.P @ system.B)[form.n_finite :]
    size = np.abs(form.P[form.n_finite :]) @ np.abs(system.B)
    order = -1
    for i in range(form.index):
        if np.any(np.abs(power) > 1e-11 * np.maximum(size, np.finfo(float).tiny)):
            order = i
        power, size = form.N @ power, np.abs(form.N) @ size
    return order


def _vector(value: ArrayLike, count: int, name: str) -> NDArray[np.float64]:
    out = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    if out.shape != (count,) or not np.isfinite(out).all():
        raise ModelError(f"{name} must have {count} finite entries, got shape {np.shape(value)}")
    return out


def _fast_part(form: WeierstrassForm, system: StateSpace, signals: Sequence[NDArray]) -> NDArray[np.float64]:
    """Return ``-sum N^i B2 v^(i)``, shape (time, n2); ``signals`` are the inputs and their derivatives."""
    order = input_order(form, system)
    if len(signals) <= order:
        word = "inputs of the next steps" if system.is_discrete else "derivatives of the inputs"
        raise ModelError(
            f"the state depends on the first {order} {word} (index {form.index}): give derivatives=[...], "
            f"{order} of them; {len(signals) - 1} given"
        )
    power = (form.P @ system.B)[form.n_finite :]
    out = np.zeros((len(signals[0]), len(power)))
    for signal in signals[: order + 1]:
        out -= signal @ power.T
        power = form.N @ power
    return out


@dataclass(frozen=True, eq=False)
class DescriptorRun:
    """States and outputs of a descriptor system over time.

    Attributes
    ----------
    states : ndarray, shape (samples, n)
    outputs : ndarray, shape (samples, p)
        For a sampled system fewer samples than inputs: the last ones depend on inputs still to come.
    """

    states: NDArray[np.float64]
    outputs: NDArray[np.float64]


def simulate_descriptor(
    system: StateSpace,
    v: ArrayLike,
    *,
    x0: ArrayLike | None = None,
    dt: float | None = None,
    derivatives: Sequence[ArrayLike] = (),
    hold: str = "zero",
    rtol: float = DEFAULT_RTOL,
) -> DescriptorRun:
    r"""Run a descriptor system over an input sequence.

    The dynamic part is sampled exactly for inputs that are held, or linear, between samples. The algebraic part
    is :math:`x_2 = -\sum_{i < \nu} N^i B_2 v^{(i)}`: of index 1 it follows from the inputs at the same instant; of
    a higher index it also takes their derivatives, which nothing but the caller knows, unless the inputs do not
    reach that far down the chain. A sampled system takes its inputs of the next steps instead, and its run ends
    that many steps early.

    Parameters
    ----------
    system : StateSpace
    v : array_like, shape (time, m)
    x0 : array_like, shape (n,), optional
        Must be consistent; when omitted the dynamic part starts at zero.
    dt : float, optional
        Step of ``v``; needed for a continuous system.
    derivatives : sequence of array_like, shape (time, m)
        First, second, ... derivative of ``v``; continuous systems of index above 1 only.
    hold : {"zero", "linear"}
        What the inputs do between samples; continuous systems only. Inputs that are held jump, so a system that
        needs their derivatives takes ``"linear"``: the dynamic part is then exact to second order in the step.
    rtol : float
        For the rank decisions.

    Returns
    -------
    DescriptorRun

    Raises
    ------
    ModelError
        If the system is not regular, or ``dt`` or derivatives are missing.
    DataError
        If signals do not fit the system, or ``x0`` is not consistent; `consistent_state` makes it so.
    SettingError
        If ``hold`` is not one of its words, or a sampled system gets derivatives.
    AccuracyError
        If its dynamic and algebraic parts cannot be separated, see `weierstrass_form`.

    References
    ----------
    Twardy and Kaczorek, part I, eqs. (15), (16).

    Examples
    --------
    >>> from residua.linear import StateSpace, simulate_descriptor
    >>> system = StateSpace([[-1, 0], [1, -1]], [[1], [0]], [[0, 1]], E=[[1, 0], [0, 0]])
    >>> simulate_descriptor(system, [[1.0], [1.0], [1.0]], dt=0.5).outputs.ravel().round(6)
    array([0.      , 0.393469, 0.632121])
    """
    if system.is_discrete and dt is not None and abs(dt - system.dt) > SAME * system.dt:
        raise DataError(f"the system has dt={system.dt:g} s, the inputs {dt:g} s")
    step = system.dt or arrays.sample_step(dt or 0.0)
    if not step:
        raise ModelError("the system is continuous: give the step of the inputs, dt=...")
    if hold not in ("zero", "linear"):
        raise SettingError(f"hold must be 'zero' or 'linear', got {hold!r}")
    form = weierstrass_form(system.A, system.E, rtol=rtol)
    v = _signal(v, system.n_inputs, None, "v")
    signals = [v, *(_signal(d, system.n_inputs, len(v), "derivatives") for d in derivatives)]
    order = max(input_order(form, system), 0)
    if system.is_discrete:
        if derivatives:
            raise SettingError("derivatives are for continuous systems; a sampled one takes its later inputs from v")
        if len(v) <= order:
            raise DataError(f"the state depends on the inputs of {order} steps ahead: {len(v)} samples are too few")
        covered = len(v) - order
        signals = [v[i : i + covered] for i in range(order + 1)]
    elif order and hold == "zero":
        raise ModelError(
            f"the state depends on the first {order} derivatives of the inputs (index {form.index}), and held inputs "
            "would give it impulses: give derivatives=[...] of smooth inputs and hold='linear'"
        )
    fast = _fast_part(form, system, signals)
    v, k = v[: len(fast)], form.n_finite
    first, slow = np.zeros(k), np.zeros((len(v), k))
    if x0 is not None and len(v):
        start = consistent_state(system, x0, v[0], derivatives=[s[0] for s in signals[1:]], rtol=rtol)
        if not start:
            raise DataError(
                f"x0 is not consistent with the algebraic equations and the first input (off by {start.distance:.2g}, "
                "relative): start at consistent_state(system, x0, v[0]).state"
            )
        first = form.Q_inverse[:k] @ np.asarray(x0, dtype=float).ravel()
    if k and len(v):
        Phi, Gamma = form.A1, (form.P @ system.B)[:k]
        ramp = np.zeros_like(Gamma)
        if not system.is_discrete:
            Phi, Gamma, Gamma2 = exponentials(Phi, Gamma, step)
            ramp = Gamma2 if hold == "linear" else ramp
        # The state shifted by what the ramp adds obeys a causal recursion; see `sample`.
        state = (first - ramp @ v[0])[None]
        slow = run_filter(Phi, Gamma + Phi @ ramp - ramp, np.eye(k), ramp, state, v[None])[1][0]
    states = np.hstack([slow, fast]) @ form.Q.T
    return DescriptorRun(states, states @ system.C.T + v @ system.D.T)


def _signal(value: ArrayLike, m: int, length: int | None, name: str) -> NDArray[np.float64]:
    out = np.asarray(value, dtype=float)
    if out.ndim == 1 and m == 1:
        out = out[:, None]
    if out.ndim != 2 or out.shape[1] != m or (length is not None and len(out) != length):
        wanted = f"({'time' if length is None else length}, {m})"
        raise DataError(f"{name} must be {wanted}, got shape {out.shape}")
    return out
