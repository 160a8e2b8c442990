"""A user's own equations, linearised at a steady state."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import frozen, names, sample_step, unique
from residua.errors import AccuracyError, ModelError
from residua.identify.jacobian import Function, checked, first_look, jacobian
from residua.linear.subspaces.rank import decide_rank
from residua.plant import Plant
from residua.plant.channels import channel_values
from residua.shown import Shown
from residua.tolerances import ROUNDING, SAME, TINY
from residua.visible import echo
from residua.words import number, some

Vector = NDArray[np.float64]
Equations = Callable[..., ArrayLike]
#: From so large a ratio of the sizes of states on, it is noted.
_UNLIKE = 1e6
_MOST_STEPS, _MOST_HALVINGS = 100, 40
#: Singular values this far below the largest are zero: slopes of a first look are known to some 2^-30.
_ROUGH_RANK = 2.0**-23


@dataclass(frozen=True, eq=False, repr=False)
class TangentModel(Shown):
    """The linear model of nonlinear equations at a point, with its accuracy.

    Attributes
    ----------
    plant : Plant
    inputs, states, outputs : dict of str to float
        The point. That of inputs and outputs is the plant's operating point.
    residual : float
        Distance of the states from rest there: the largest rate (sampled: the largest change over a step), relative
        to the terms that it is the sum of.
    drift : dict of str to float
        The rate of each state there, in the user's units; rounding, unless the point was taken as it is.
    jacobian_error : float
        The largest estimated error of a slope, relative to the terms of its row.
    complex_step : bool
        True for slopes of a complex step, checked by differences; otherwise by extrapolated differences.
    sizes : dict of str to float
        The size of each input, state and fault, which steps are fractions of.
    notes : tuple of str
    """

    plant: Plant
    inputs: dict[str, float]
    states: dict[str, float]
    outputs: dict[str, float]
    residual: float
    drift: dict[str, float]
    jacobian_error: float
    complex_step: bool
    sizes: dict[str, float]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        way = "complex step" if self.complex_step else "extrapolated differences"
        lines = [
            f"{self.plant!r}",
            f"at {_point(self.inputs)}; {_point(self.states)}; outputs {_point(self.outputs)}",
            f"residual of the steady state {number(self.residual, 2)} of its terms",
            f"slopes by {way}, estimated error {number(self.jacobian_error, 2)} of the terms of their row",
        ]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])


def linearise(
    rate: Equations,
    output: Equations | None = None,
    *,
    at: tuple[Any, Any],
    hold: str | Mapping[str, float] = "inputs",
    faults: Iterable[str] = (),
    dt: float = 0,
    inputs: Iterable[str] | str | None = None,
    outputs: Iterable[str] | str | None = None,
    states: Iterable[str] | str | None = None,
    units: Mapping[str, str] | None = None,
    sizes: Mapping[str, float] | None = None,
    name: str = "plant",
    description: str = "",
) -> Plant:
    r"""Return the plant that equations of one's own are near a steady state.

    .. math::

       \dot x = f(x, u, f_0), \quad y = h(x, u, f_0) \qquad \text{becomes} \qquad
       A = \frac{\partial f}{\partial x}, \quad B = \frac{\partial f}{\partial u}, \quad
       C = \frac{\partial h}{\partial x}, \quad D = \frac{\partial h}{\partial u}

    at :math:`f(x_0, u_0, 0) = 0`; for ``dt > 0`` the function gives the next state, and :math:`f(x_0, u_0, 0) = x_0`.
    The point is the plant's operating point, so that recordings go in as they are. :func:`tangent_model` does the same
    and returns with the plant how near to rest the point is and how accurate the slopes are.

    Guaranteed: the rates at the point are below 1e-9 of their terms (unless ``hold="point"``), and the estimated error
    of every slope is below 1e-3 of the terms of its row, or an error is raised. Neither depends on units.

    Parameters
    ----------
    rate : callable
        ``rate(x, u)``, or ``rate(x, u, f)`` with ``faults``: 1-D arrays in, one number for each state out. Written
        with NumPy it may also take complex numbers, which gives its slopes without rounding.
    output : callable, optional
        ``output(x, u)`` or ``output(x, u, f)``; the states are measured when omitted.
    at : (states, inputs)
        The point, or the start of the search for it: vectors, or mappings of names to numbers.
    hold : {"inputs", "point"} or mapping of str to float
        The values held while the steady state is looked for. The inputs: states are looked for. A mapping of outputs
        (and inputs) to values: states, and the inputs that are not named, are looked for; as many outputs as inputs
        that may move. ``"point"``: nothing moves; what the states drift there is left out of the plant, and said in its
        description.
    faults : sequence of str
        Names of the entries of ``f``, which are zero without faults: each becomes a component fault of the plant.
    dt : float
        0 when ``rate`` gives derivatives; the step in seconds when it gives the next state.
    inputs, outputs, states : sequence of str, optional
        ``u1..``, ``y1..``, ``x1..`` when omitted. Outputs have the names of the states when these are measured.
    units : mapping of str to str, optional
        Unit of each input, output or state.
    sizes : mapping of str to float, optional
        The usual change of an input, state or fault, which steps are fractions of. Needed only where every value is
        zero, or where the function is noisy.
    name, description : str
        Of the plant; the description gets a sentence on the point and on the accuracy.

    Returns
    -------
    Plant
        Continuous for ``dt = 0``: ``.discretize(dt)`` samples it.

    Raises
    ------
    ModelError
        If a shape or a name does not fit, the functions give no finite numbers, or they are not smooth at the point:
        the message says which state or input, with the slopes to both sides.
    AccuracyError
        If no steady state was reached, or a slope could not be computed to 1e-3.

    See Also
    --------
    tangent_model : The same, with the point and its accuracy.
    grey_box : Parameters of such equations, from a recording.

    Notes
    -----
    Assumes: the functions are deterministic, and smooth within 1e-6 of the size of each variable. The plant holds near
    the point only: how near is not examined.

    References
    ----------
    Ridders (1982), Advances in Engineering Software 4(2) (differences and their error); Squire and Trapp (1998), SIAM
    Review 40(1) (complex step).

    Examples
    --------
    A tank with an outflow, at the level at which an inflow of 3 leaves again:

    >>> import numpy as np
    >>> import residua as rs
    >>> def rate(x, u, f):
    ...     return [u[0] - np.sqrt(x[0]) - f[0]]
    >>> tank = rs.identify.linearise(rate, at=([4.0], [3.0]), faults=["leak"], inputs="inflow", states="level")
    >>> tank.operating_point.outputs, tank.A.round(6), tank.Bf.round(6)
    ((9.0,), array([[-0.166667]]), array([[-1.]]))
    """
    return tangent_model(
        rate,
        output,
        at=at,
        hold=hold,
        faults=faults,
        dt=dt,
        inputs=inputs,
        outputs=outputs,
        states=states,
        units=units,
        sizes=sizes,
        name=name,
        description=description,
    ).plant


def tangent_model(
    rate: Equations,
    output: Equations | None = None,
    *,
    at: tuple[Any, Any],
    hold: str | Mapping[str, float] = "inputs",
    faults: Iterable[str] = (),
    dt: float = 0,
    inputs: Iterable[str] | str | None = None,
    outputs: Iterable[str] | str | None = None,
    states: Iterable[str] | str | None = None,
    units: Mapping[str, str] | None = None,
    sizes: Mapping[str, float] | None = None,
    name: str = "plant",
    description: str = "",
) -> TangentModel:
    r"""Return the plant of :func:`linearise`, with the point and its accuracy.

    .. math:: f(x_0 + \delta x, u_0 + \delta u) = f(x_0, u_0) + A\, \delta x + B\, \delta u + \ldots

    Parameters
    ----------
    rate, output, at, hold, faults, dt, inputs, outputs, states, units, sizes, name, description
        As :func:`linearise` takes them.

    Returns
    -------
    TangentModel

    Raises
    ------
    ModelError, AccuracyError
        As :func:`linearise` does.

    See Also
    --------
    linearise : The plant alone.

    Notes
    -----
    Assumes what :func:`linearise` does.

    References
    ----------
    Ridders (1982), Advances in Engineering Software 4(2); Squire and Trapp (1998), SIAM Review 40(1).

    Examples
    --------
    >>> import residua as rs
    >>> model = rs.identify.tangent_model(lambda x, u: [u[0] - x[0] ** 2], at=([1.0], [4.0]), states="level")
    >>> round(model.states["level"], 9), model.complex_step
    (2.0, True)
    """
    if not callable(rate) or not (output is None or callable(output)):
        raise ModelError("rate and output must be functions of (x, u), or of (x, u, f) with faults")
    if not isinstance(at, (tuple, list)) or len(at) != 2:
        raise ModelError(f"at must be a pair (states, inputs) of vectors or mappings, got {echo(at)}")
    x, states = _values(at[0], states, "x", "states")
    u, inputs = _values(at[1], inputs, "u", "inputs")
    faults = tuple([faults] if isinstance(faults, str) else faults)
    faults = names(faults, len(faults), "f", "faults")
    rate = _named_call(rate, "rate", states, inputs, faults)
    output = None if output is None else _named_call(output, "output", states, inputs, faults)
    if outputs is None and output is None:
        outputs = states
        if set(states) & set(inputs):
            raise ModelError("give names for the outputs: the states are measured, and inputs have the same names")
    else:
        arguments = (x.copy(), u.copy(), *((np.zeros(len(faults)),) if faults else ()))
        count = len(x) if output is None else int(np.size(output(*arguments)))  # pyright: ignore[reportArgumentType]
        outputs = names(outputs, count, "y", "outputs")
    unique((*states, *inputs, *faults), "states, inputs and faults")
    model = _Model(rate, output, np.concatenate([x, u]), states, inputs, outputs, faults, sample_step(dt))
    n, m = len(states), len(inputs)
    point = model.start if hold == "point" else model.rest(hold, sizes)
    x0, u0, z = point[:n], point[n:], np.concatenate([point, np.zeros(len(model.faults))])
    rows = (*(f"the rate of {echo(x)}" for x in model.states), *(f"the output {echo(y)}" for y in model.outputs))
    variables = (*model.states, *model.inputs, *model.faults)
    slopes = jacobian(model.everything, z, rows, variables, sizes)
    values = np.asarray(model.everything(z), dtype=float)
    drift, terms = values[:n] - (x0 if model.dt else 0.0), slopes.terms[:n]
    residual = float((np.abs(drift) / np.where(terms > 0, terms, 1.0)).max(initial=0.0))
    notes, size = slopes.notes, slopes.sizes[:n]
    if n and size.max() >= _UNLIKE * size.min():
        extremes = (f"{model.states[k]} {number(size[k], 2)}" for k in (size.argmax(), size.argmin()))
        notes += (
            f"states are of very different sizes: {', '.join(extremes)}; designs work in units of their own, but "
            "tables are easier to read in other units",
        )
    if hold == "point" and np.any(drift):
        rates = some(f"{state} by {number(v, 3)}" for state, v in zip(model.states, drift, strict=True) if v)
        notes += (f"the states do not rest at the point, which was taken as is; they drift {rates} per unit of time",)
    way = "a complex step" if slopes.complex_step else "differences"
    about = (
        f"Linearised at {_point(_by_name(model.states, x0))} and {_point(_by_name(model.inputs, u0))} by {way}, slopes "
        f"known to {number(slopes.relative_error, 2)}, at rest to {number(residual, 2)} of the terms."
    )
    upper, lower = slopes.matrix[:n], slopes.matrix[n:]
    matrices = (upper[:, :n], upper[:, n : n + m], lower[:, :n], lower[:, n : n + m])
    text = " ".join(filter(None, [description, about]))
    plant = Plant(
        *matrices, dt=model.dt, inputs=model.inputs, outputs=model.outputs, states=model.states, units=units, name=name
    )
    plant = plant._with(description=text)
    plant = plant.with_operating_point(inputs=u0, outputs=values[n:])
    for k, fault in enumerate(model.faults, n + m):
        plant = plant.with_faults({fault: (frozen(upper[:, k]), frozen(lower[:, k]))})
    return TangentModel(
        plant,
        _by_name(model.inputs, u0),
        _by_name(model.states, x0),
        _by_name(model.outputs, plant.operating_point.outputs),
        residual,
        _by_name(model.states, drift),
        slopes.relative_error,
        slopes.complex_step,
        _by_name(variables, slopes.sizes),
        notes,
    )


@dataclass(frozen=True, eq=False)
class _Model:
    """A user's functions with their names and a first point."""

    rate: Equations
    output: Equations | None
    start: Vector
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    faults: tuple[str, ...]
    dt: float

    def everything(self, z: Vector) -> Vector:
        """Return rates and outputs at states, inputs and faults, one after another."""
        parts = np.split(z, np.cumsum([len(self.states), len(self.inputs)]))
        parts = parts if self.faults else parts[:2]
        # copies for each: a function may change its arguments
        rates = np.atleast_1d(np.asarray(self.rate(*(part.copy() for part in parts))))
        measured = parts[0] if self.output is None else self.output(*(part.copy() for part in parts))
        measured = np.atleast_1d(np.asarray(measured))
        if rates.shape != (len(self.states),):
            raise ModelError(f"rate must give {len(self.states)} numbers, one for each state, got shape {rates.shape}")
        if measured.ndim != 1:
            raise ModelError(f"output must give one number for each output, got shape {measured.shape}")
        return np.concatenate([rates, measured])

    def rest(self, hold: str | Mapping[str, float], sizes: Mapping[str, float] | None) -> Vector:
        """Return states and inputs at rest, with the outputs and inputs at the values that are held."""
        held = {} if hold == "inputs" else hold
        if not isinstance(held, Mapping):
            raise ModelError(f"hold must be 'inputs', 'point' or a mapping of outputs to values, got {echo(hold)}")
        n, start = len(self.states), self.start.copy()
        free = np.concatenate([np.ones(n, bool), np.full(len(self.inputs), bool(held))])
        targets: dict[int, float] = {}
        for key, value in held.items():
            if not isinstance(value, (int, float, np.number)) or not np.isfinite(value):
                raise ModelError(f"hold[{echo(key)}] must be a finite number, got {echo(value)}")
            if key in self.outputs:
                targets[self.outputs.index(key)] = float(value)
            elif key in self.inputs:
                start[n + self.inputs.index(key)] = float(value)
                free[n + self.inputs.index(key)] = False
            else:
                raise ModelError(f"hold: {echo(key)} is no output or input; known: {some(self.outputs + self.inputs)}")
        if len(targets) != int(free[n:].sum()):
            moving = [name for name, may in zip(self.inputs, free[n:], strict=True) if may]
            raise ModelError(
                f"{len(targets)} outputs are held and {len(moving)} inputs may move ({some(moving) or 'none'}): give "
                "as many of the one as of the other, by naming inputs with their values"
            )

        def miss(z: Vector) -> Vector:
            values = self.everything(np.concatenate([z, np.zeros(len(self.faults))]))
            rest = values[:n] - z[:n] if self.dt else values[:n]
            return np.concatenate([rest, [values[n + i] - value for i, value in targets.items()]])

        rows = (*(f"the rate of {x}" for x in self.states), *(f"the miss of {self.outputs[i]}" for i in targets))
        known = {k: v for k, v in (sizes or {}).items() if k not in self.faults}
        return steady_state(miss, start, free, rows, (*self.states, *self.inputs), known)


def _named_call(
    function: Equations, what: str, states: tuple[str, ...], inputs: tuple[str, ...], faults: tuple[str, ...]
) -> Equations:
    """Return the function of a user, whose errors name the point at which it was called."""

    def called(*arguments: Vector) -> Any:
        at = [np.array(one) for one in arguments]  # the function may change its arguments
        try:
            return function(*arguments)
        except Exception as error:  # whatever a user's function raises
            if any(map(np.iscomplexobj, at)):
                raise  # it need not take complex numbers
            point = _point(_by_name((*states, *inputs, *faults), np.concatenate(at)))
            raise ModelError(f"{what} raised {type(error).__name__} at {point}: {error}") from error

    return called


def _values(value: Any, given: Iterable[str] | str | None, prefix: str, what: str) -> tuple[Vector, tuple[str, ...]]:
    """Return numbers and names of states or inputs, from a vector or from a mapping."""
    if isinstance(value, Mapping):
        known = tuple(value) if given is None else (given,) if isinstance(given, str) else tuple(given)
        if set(known) != set(value):
            raise ModelError(f"at: {what} are {some(map(str, known))}, values were given for {some(map(str, value))}")
        known = names(known, len(known), prefix, what)
        return np.array(channel_values(value, known, (0.0,) * len(known), f"at, {what}")), known
    count = int(np.size(value))
    known = names(given, count, prefix, what)
    return np.array(channel_values(np.reshape(value, (count, 1)), known, (), f"at, {what}")), known


def _by_name(keys: tuple[str, ...], values: Iterable[float]) -> dict[str, float]:
    return {key: float(value) for key, value in zip(keys, values, strict=True)}


def _point(values: Mapping[str, float]) -> str:
    return some(f"{name} = {number(value)}" for name, value in values.items()) or "nothing"


def steady_state(
    function: Function,
    start: Vector,
    free: NDArray[np.bool_],
    rows: tuple[str, ...],
    columns: tuple[str, ...],
    sizes: Mapping[str, float] | None = None,
) -> Vector:
    """Return a point where the function is zero, moving the free variables only.

    Newton's method with halved steps. Equations are measured by their terms (the sum over variables of slope times
    size), variables by their sizes, so that units have no say; where the equations leave a variable open, as an
    integrator does, the step is the shortest.

    Raises
    ------
    AccuracyError
        If no such point was reached from the start; the message says where it ended and what was left.
    """
    f = checked(function, rows)
    z = start.copy()
    look = first_look(f, z, columns, sizes)
    for steps in range(_MOST_STEPS + 1):
        scale, size = np.maximum(look.terms, TINY), np.where(free, look.sizes, 0.0)
        left, slopes = look.value / scale, look.slopes * size / scale[:, None]
        if steps == _MOST_STEPS or np.abs(left).max(initial=0.0) <= ROUNDING:
            break
        move = np.asarray(size * np.linalg.lstsq(slopes, -left, rcond=_ROUGH_RANK)[0], dtype=np.float64)
        shorter = (z + move * 2.0**-halvings for halvings in range(_MOST_HALVINGS))
        before = np.linalg.norm(left)
        better = next((at for at in shorter if np.linalg.norm(f(at) / scale) < before), None)  # NaN is no better
        if better is None:
            break
        z = better
        look = first_look(f, z, columns, sizes)
    if np.abs(left).max(initial=0.0) > SAME:
        worst = int(np.abs(left).argmax())
        rank = decide_rank(slopes, rtol=_ROUGH_RANK).rank
        where = some(f"{name} = {number(x)}" for name, x in zip(columns, z, strict=True))
        why = ""
        if rank < len(rows):
            why = f"; there the {len(rows)} equations can be moved in {rank} directions only, so there may be none"
        raise AccuracyError(
            f"no steady state was reached from this start: after {steps} steps of Newton's method {rows[worst]} is "
            f"still {number(look.value[worst])}, {number(abs(left[worst]), 2)} of its terms, at {where}{why}. Give a "
            "start that is nearer, or inputs for which the plant can rest"
        )
    return z
