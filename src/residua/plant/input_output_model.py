"""Input-output model: one polynomial equation per output, with faults and disturbances among the inputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import unique
from residua.errors import ModelError
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.plant.channels import ROLES, Fault, OperatingPoint, channel_units, operating_point as checked_point
from residua.plant.fault_facts import FaultFacts
from residua.plant.input_output_entries import (
    Column,
    checked_variable,
    columns,
    in_other_time,
    in_z,
    input_polynomials,
    multiplied,
    output_polynomials,
    row_delays,
)
from residua.plant.observer_form import check_proper, check_regular, quotient
from residua.shown import Shown, printed

if TYPE_CHECKING:
    from residua.plant.input_output_realization import Realization
    from residua.plant.plant import Plant


@dataclass(frozen=True, init=False, eq=False, repr=False)
class InputOutputModel(FaultFacts, Shown):
    r"""A linear plant as polynomial equations between its inputs and outputs.

    .. math:: H(z)\, y = G(z)\, u + G_d(z)\, d + G_f(z)\, f

    in ``z`` for a sampled plant (``dt > 0``), in ``s`` for a continuous one (``dt = 0``). A model never changes: every
    ``with_...`` method returns a new one.

    Inputs are commanded, as ``u`` is what the controller asks for, or measured, as ``u`` is what a sensor says. With
    the true values :math:`u^o = u + \Delta u` of commanded and :math:`u^o = u - \Delta u` of measured inputs, and
    :math:`y = y^o + \Delta y`, an actuator fault enters by the column :math:`+g_j` of ``G``, a fault of the sensor
    of an input by :math:`-g_j`, and a fault of the sensor of an output by the column :math:`h_j` of ``H``.

    Parameters
    ----------
    H : PolynomialMatrix or nested sequence, outputs x outputs
        Polynomials as lists of coefficients, highest power first. A list with one polynomial per output is the
        diagonal of a diagonal ``H``. ``H`` need not be diagonal.
    G : PolynomialMatrix or nested sequence, outputs x inputs
    dt : float
        Sample step in seconds, or 0 for continuous time.
    variable : {"z", "1/z", "s"}, optional
        ``"1/z"``: coefficients are those of 1, 1/z, 1/z^2, ..., also in ``with_disturbances`` and ``with_faults``; each
        equation is multiplied by the power of ``z`` that makes it polynomial in ``z``. A ``PolynomialMatrix`` is then
        one in ``1/z``. ``"z"`` or ``"s"`` when omitted.
    inputs, outputs : sequence of str, optional
        ``u1..`` and ``y1..`` when omitted.
    measured_inputs : sequence of str, optional
        Those of the inputs that are measured; the others are commanded.
    name, operating_point, units, description
        As for :class:`residua.Plant`.
    rtol : float
        For deciding whether ``det H`` vanishes and whether ``H`` is row reduced.

    Attributes
    ----------
    H, G, Gd, Gf : PolynomialMatrix
        In powers of ``z`` or ``s``.

    Raises
    ------
    ModelError
        If a shape does not fit, ``det H`` is zero, or an output is not a proper function of the inputs.

    References
    ----------
    Gertler (1991), eqs. (2-2) to (2-4), (2-8) to (2-11).

    Examples
    --------
    >>> import residua as rs
    >>> io = rs.InputOutputModel([[1, -0.9, 0.2], [1, -1.4, 0.45]], [[[1.5, -0.65]], [[1.1, -0.95]]], inputs="u")
    >>> print(io.with_faults({"p1": [[2, -0.9], [1, -0.9]]}).with_sensor_faults("y2"))
    (z^2 - 0.9 z + 0.2) y1 = (1.5 z - 0.65) u + (2 z - 0.9) p1
    (z^2 - 1.4 z + 0.45) y2 = (1.1 z - 0.95) u + (z - 0.9) p1 + (z^2 - 1.4 z + 0.45) [y2 sensor]
    """

    H: PolynomialMatrix
    G: PolynomialMatrix
    Gd: PolynomialMatrix
    Gf: PolynomialMatrix
    dt: float
    variable: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    measured_inputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    fault_list: tuple[Fault, ...]
    name: str
    operating_point: OperatingPoint
    units: Mapping[str, str]
    description: str
    delays: tuple[int, ...]

    def __init__(
        self,
        H: Any,
        G: Any,
        *,
        dt: float = 1.0,
        variable: str | None = None,
        inputs: Iterable[str] | str | None = None,
        outputs: Iterable[str] | str | None = None,
        measured_inputs: Iterable[str] | str = (),
        name: str = "input-output model",
        operating_point: OperatingPoint | None = None,
        units: Mapping[str, str] | None = None,
        description: str = "",
        rtol: float = DEFAULT_RTOL,
    ) -> None:
        dt = arrays.sample_step(dt)
        variable = checked_variable(variable, dt)
        H_ = output_polynomials(H, variable)
        m = H_.shape[0]
        G_ = input_polynomials(G, m, variable)
        delays = (0,) * m
        if variable == "1/z":
            delays = row_delays(H_, G_)
            H_, G_ = in_z(H_, delays), in_z(G_, delays)
        y = arrays.names(outputs, m, "y", "outputs")
        u = arrays.names(inputs, G_.shape[1], "u", "inputs")
        unique(u + y, "inputs and outputs")
        measured = arrays.positions(measured_inputs, u, "measured input")
        check_regular(H_, rtol)
        check_proper(H_, G_, y, dt, rtol)
        nothing = PolynomialMatrix(np.zeros((1, m, 0)))
        fields = {
            "H": H_,
            "G": G_,
            "Gd": nothing,
            "Gf": nothing,
            "dt": dt,
            "variable": variable,
            "inputs": u,
            "outputs": y,
            "measured_inputs": tuple(u[i] for i in sorted(set(measured))),
            "disturbances": (),
            "fault_list": (),
            "name": str(name),
            "operating_point": checked_point(operating_point, u, y),
            "units": channel_units(units, {*u, *y}),
            "description": str(description),
            "delays": delays,
        }
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    # ------------------------------------------------------------------- facts

    @property
    def n_outputs(self) -> int:
        """Number of outputs, and of equations."""
        return self.H.shape[0]

    @property
    def is_discrete(self) -> bool:
        """True if the model is sampled."""
        return self.dt > 0

    def right_side(self, roles: Iterable[str] = ("control", "disturbance", "fault")) -> PolynomialMatrix:
        """Return the columns of ``G``, ``Gd`` and ``Gf`` of the given roles, in that order."""
        parts = {"control": self.G, "disturbance": self.Gd, "fault": self.Gf}
        chosen = [roles] if isinstance(roles, str) else list(roles)
        for role in chosen:
            if role not in parts:
                hint = " (an input-output model has no noise)" if role in ROLES else ""
                raise ModelError(f"unknown role {role!r}{hint}; known: {', '.join(parts)}")
        return PolynomialMatrix(np.zeros((1, self.n_outputs, 0))).beside(*(parts[role] for role in chosen))

    def transfer(
        self, points: ArrayLike, roles: Iterable[str] = ("control", "disturbance", "fault")
    ) -> NDArray[np.complex128]:
        r"""Return the transfer matrix :math:`S = H^{-1} [G\ G_d\ G_f]` at values of ``z`` or ``s``.

        Parameters
        ----------
        points : array_like of complex, shape (k,)
        roles : sequence of str
            Whose columns, in that order.

        Returns
        -------
        ndarray of complex, shape (k, outputs, inputs of these roles)
        """
        at = np.atleast_1d(np.asarray(points, dtype=complex))
        try:
            return quotient(self.H, self.right_side(roles), at)
        except np.linalg.LinAlgError as error:
            raise ModelError(f"the model has a pole at one of the points asked for: {error}") from error

    def __str__(self) -> str:
        letter = "z" if self.is_discrete else "s"
        names = (*self.inputs, *self.disturbances, *self.faults)
        right = self.right_side().coefficients
        return "\n".join(
            equation_text(
                [(self.H.coefficients[:, i, j], name) for j, name in enumerate(self.outputs)],
                [(right[:, i, j], name) for j, name in enumerate(names)],
                letter,
            )
            for i in range(self.n_outputs)
        )

    def _headline(self) -> str:
        kind = f"dt={self.dt:g} s" if self.is_discrete else "continuous"
        return (
            f"{self.name!r}: degrees {', '.join(map(str, self.H.row_degrees))}, {len(self.inputs)} "
            f"inputs, {self.n_outputs} outputs, {len(self.disturbances)} disturbances, {len(self.fault_list)} faults, "
            f"{kind}"
        )

    def _parts(self) -> list[str]:
        return [printed(str(self))]

    # ---------------------------------------------------- from and to elsewhere

    @classmethod
    def from_plant(cls, plant: Plant, **options: Any) -> InputOutputModel:
        """Return the equations of a plant; see :func:`residua.plant.input_output_from_plant`."""
        from residua.plant.input_output_conversion import input_output_from_plant

        return input_output_from_plant(plant, **options)

    @classmethod
    def from_transfer_functions(cls, system: Any, **options: Any) -> InputOutputModel:
        """Return the model of transfer functions; see :func:`residua.plant.input_output_from_transfer_functions`."""
        from residua.plant.transfer_functions import input_output_from_transfer_functions

        return input_output_from_transfer_functions(system, **options)

    def to_plant(self, **options: float) -> Plant:
        """Return a state-space plant of least order; see :func:`residua.plant.realize_input_output`."""
        return self.realization(**options).plant

    def realization(self, **options: float) -> Realization:
        """Return :meth:`to_plant` with the parts it removed; see :func:`residua.plant.realize_input_output`."""
        from residua.plant.input_output_realization import realize_input_output

        return realize_input_output(self, **options)

    # -------------------------------------------------------------- new models

    def with_disturbances(self, directions: Mapping[str, Column], *, rtol: float = DEFAULT_RTOL) -> InputOutputModel:
        """Return the model with unknown inputs added.

        Parameters
        ----------
        directions : mapping of str to sequence of polynomials, or to mapping of output to polynomial
            How each disturbance enters the equations: one polynomial per output, in ``variable``.
        rtol : float
            For deciding whether ``H`` is row reduced.
        """
        columns_ = columns(directions, self.outputs, "disturbance", self.variable)
        labels = arrays.names(tuple(directions), len(directions), "d", "disturbances")
        self, extra = self._extended(columns_, rtol)
        return self._with_disturbances(extra, labels)

    def with_faults(
        self,
        directions: Mapping[str, Column],
        *,
        kind: str = "component",
        component: str | None = None,
        rtol: float = DEFAULT_RTOL,
    ) -> InputOutputModel:
        """Return the model with faults added.

        Parameters
        ----------
        directions : mapping of str to sequence of polynomials, or to mapping of output to polynomial
            How each fault enters the equations: one polynomial per output, in ``variable``.
        kind : {"component", "actuator", "sensor"}
        component : str, optional
            The component that all of these faults belong to; each fault's own name when omitted.
        rtol : float
            For deciding whether ``H`` is row reduced.
        """
        if kind not in ("component", "actuator", "sensor"):
            raise ModelError(f"kind must be 'component', 'actuator' or 'sensor', got {kind!r}")
        columns_ = columns(directions, self.outputs, "fault", self.variable)
        self, extra = self._extended(columns_, rtol)
        return self._with_faults(extra, tuple(Fault(name, kind, component or name) for name in directions))

    def with_sensor_faults(self, outputs: Iterable[str | int] | str | None = None) -> InputOutputModel:
        """Return the model with a fault ``"name sensor"`` that adds to each of the given outputs (all when omitted)."""
        chosen = arrays.positions(outputs, self.outputs, "output")
        return self._with_channel_faults(self.H, "sensor", self.outputs, chosen)

    def with_actuator_faults(self, inputs: Iterable[str | int] | str | None = None) -> InputOutputModel:
        """Return the model with a fault ``"name actuator"`` of each of the given inputs (all commanded when omitted).

        It adds to what was commanded; a measured input has none, for its sensor sees what the actuator does.

        Raises
        ------
        ModelError
            If an input is measured, or all are and none was named.
        """
        chosen = self._inputs(inputs, measured=False)
        return self._with_channel_faults(self.G, "actuator", self.inputs, chosen)

    def with_input_sensor_faults(self, inputs: Iterable[str | int] | str | None = None) -> InputOutputModel:
        """Return the model with a fault ``"name sensor"`` of each of the given inputs (all measured when omitted).

        It adds to what is measured, so that the plant gets the measured value less the fault.

        Raises
        ------
        ModelError
            If an input is commanded, or all are and none was named.
        """
        chosen = self._inputs(inputs, measured=True)
        return self._with_channel_faults(-self.G, "sensor", self.inputs, chosen)

    def without_faults(self, names: Iterable[str] | str | None = None) -> InputOutputModel:
        """Return the model without the named faults (without any, when omitted)."""
        drop = set(arrays.positions(names, self.faults, "fault"))
        keep = [i for i in range(len(self.fault_list)) if i not in drop]
        return self._with(Gf=self.Gf.select(columns=keep), fault_list=tuple(self.fault_list[i] for i in keep))

    def without_disturbances(self) -> InputOutputModel:
        """Return the model without its disturbances."""
        return self._with(Gd=self.Gd.select(columns=[]), disturbances=())

    def faults_as_disturbances(self, names: Iterable[str] | str | None = None) -> InputOutputModel:
        """Return the model with the named faults (all when omitted) as disturbances, after its own."""
        chosen = arrays.positions(names, self.faults, "fault")
        labels = tuple(self.faults[i] for i in chosen)
        return self.without_faults(labels)._with_disturbances(self.Gf.select(columns=chosen), labels)

    def __getattr__(self, name: str) -> Any:
        """Raise with a remedy if a plant was meant; only missing names get here."""
        from residua.plant.plant import Plant

        if name.startswith("_") or not (hasattr(Plant, name) or name in Plant.__dataclass_fields__):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        raise AttributeError(f"an InputOutputModel has no {name!r}: where a plant is needed, give model.to_plant()")

    def _with(self, **changes: object) -> InputOutputModel:
        new = object.__new__(InputOutputModel)
        for key in self.__dataclass_fields__:
            object.__setattr__(new, key, changes.get(key, getattr(self, key)))
        return new

    def _in_other_time(self, factor: float) -> InputOutputModel:
        """Return a continuous model in a unit of time in which its rates are ``factor`` as large, a power of two.

        An equation keeps the coefficient of its highest power.
        """
        degrees = self.H.row_degrees
        return self._with(**{key: in_other_time(getattr(self, key), factor, degrees) for key in ("H", "G", "Gd", "Gf")})

    def _extended(self, extra: PolynomialMatrix, rtol: float) -> tuple[InputOutputModel, PolynomialMatrix]:
        """Return the model, its equations multiplied as new columns in ``1/z`` require, and these in ``z``."""
        if self.variable == "1/z":
            delays = tuple(max(pair) for pair in zip(self.delays, row_delays(extra), strict=True))
            more = [new - old for new, old in zip(delays, self.delays, strict=True)]
            parts = {key: multiplied(getattr(self, key), more) for key in ("H", "G", "Gd", "Gf")}
            self, extra = self._with(**parts, delays=delays), in_z(extra, delays)
        check_proper(self.H, extra, self.outputs, self.dt, rtol)
        return self, extra

    def _inputs(self, inputs: Iterable[str | int] | str | None, *, measured: bool) -> list[int]:
        """Return the positions of measured, or of commanded, inputs."""
        chosen = [i for i, name in enumerate(self.inputs) if (name in self.measured_inputs) == measured]
        if inputs is None:
            if self.inputs and not chosen:
                are, use = ("commanded", "actuator") if measured else ("measured", "input_sensor")
                raise ModelError(f"all inputs are {are}: their faults are those of with_{use}_faults")
            return chosen
        asked = arrays.positions(inputs, self.inputs, "input")
        for i in asked:
            if i not in chosen:
                is_, use = ("commanded", "actuator") if measured else ("measured", "input_sensor")
                raise ModelError(f"input {self.inputs[i]!r} is {is_}: its fault is one of with_{use}_faults")
        return asked

    def _with_disturbances(self, extra: PolynomialMatrix, labels: tuple[str, ...]) -> InputOutputModel:
        unique(self.disturbances + labels, "disturbances")
        return self._with(Gd=self.Gd.beside(extra), disturbances=self.disturbances + labels)

    def _with_channel_faults(
        self, P: PolynomialMatrix, kind: str, channels: tuple[str, ...], chosen: list[int]
    ) -> InputOutputModel:
        """Return the model with a fault ``"<channel> <kind>"`` of each of the chosen channels, by its column."""
        faults = tuple(Fault(f"{channels[i]} {kind}", kind, channels[i]) for i in chosen)
        return self._with_faults(P.select(columns=chosen), faults)

    def _with_faults(self, extra: PolynomialMatrix, faults: tuple[Fault, ...]) -> InputOutputModel:
        for j, fault in enumerate(faults):
            if not fault.name or not isinstance(fault.name, str):
                raise ModelError(f"a fault needs a name, got {fault.name!r}")
            if not np.any(extra.coefficients[:, :, j]):
                raise ModelError(f"fault {fault.name!r} has no effect: its polynomials are zero")
        unique((*self.faults, *(fault.name for fault in faults)), "faults")
        return self._with(Gf=self.Gf.beside(extra), fault_list=(*self.fault_list, *faults))


def polynomial_text(coefficients: NDArray[np.float64], variable: str) -> str:
    """Return a polynomial as text, highest power first.

    Parameters
    ----------
    coefficients : ndarray, shape (degree + 1,)
        Lowest power first.
    variable : str

    Returns
    -------
    str

    Examples
    --------
    >>> polynomial_text(np.array([0.2, -0.9, 1.0]), "z")
    'z^2 - 0.9 z + 0.2'
    """
    parts = [(float(value), _power(variable, k)) for k, value in reversed(list(enumerate(coefficients))) if value != 0]
    return _sum((value < 0, _monomial(abs(value), power)) for value, power in parts)


def equation_text(
    left: Iterable[tuple[NDArray[np.float64], str]],
    right: Iterable[tuple[NDArray[np.float64], str]],
    variable: str,
) -> str:
    """Return an equation between sums of polynomials times signals; signals with a zero polynomial are left out."""
    return " = ".join(_sum(_term(p, signal, variable) for p, signal in side if np.any(p)) for side in (left, right))


def _term(p: NDArray[np.float64], signal: str, variable: str) -> tuple[bool, str]:
    """Return the sign (true: minus) and the text of one polynomial times a signal."""
    used = np.flatnonzero(p)
    minus = bool(p[used[-1]] < 0)
    size = -p if minus else p
    name = f"[{signal}]" if any(c.isspace() for c in signal) else signal
    if len(used) > 1:
        return minus, f"({polynomial_text(size, variable)}) {name}"
    factor = _monomial(float(size[used[0]]), _power(variable, int(used[0])))
    return minus, name if factor == "1" else f"{factor} {name}"


def _sum(terms: Iterable[tuple[bool, str]]) -> str:
    out = ""
    for minus, text in terms:
        sign = (" - " if minus else " + ") if out else ("-" if minus else "")
        out += sign + text
    return out or "0"


def _monomial(size: float, power: str) -> str:
    number = f"{size:.5g}"
    if not power:
        return number
    return power if number == "1" else f"{number} {power}"


def _power(variable: str, k: int) -> str:
    return "" if k == 0 else variable if k == 1 else f"{variable}^{k}"
