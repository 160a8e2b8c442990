"""The plant: a linear system whose inputs have roles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import frozen, matrix, names, unique
from residua.errors import ModelError
from residua.linear import StateSpace
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.linear.systems.state_space import square
from residua.plant.channels import (
    FAULT_NOTES,
    ROLES,
    Direction,
    Fault,
    OperatingPoint,
    by_role,
    channel_units,
    channel_values,
    direction,
    direction_matrices,
    operating_point as checked_point,
)
from residua.plant.disturbances import factor_disturbance
from residua.plant.fault_facts import FaultFacts
from residua.plant.identification import Identification, identification as checked_identification
from residua.plant.noise import covariance, cross_covariance, joint_factors, sampled_noise
from residua.shown import Shown, grid, notes, table
from residua.visible import listed
from residua.wrong_guesses import Guessed, guessed

if TYPE_CHECKING:
    from residua.plant.balanced import BalancedPlant


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Plant(FaultFacts, Guessed, Shown):
    r"""A linear plant with control, disturbance, fault and noise inputs.

    .. math::

       E \dot x = A x + B u + B_d d + B_f f + B_w w, \qquad y = C x + D u + D_d d + D_f f + D_w w

    with ``dt = 0``; for a sampled plant (``dt > 0``) :math:`E x_{k+1}` stands on the left. The noise ``w`` is
    white with unit covariance (continuous time: unit intensity). A plant never changes: every ``with_...``
    method returns a new one.

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, inputs)
        Control inputs.
    C : array_like, shape (outputs, n)
    D : array_like, shape (outputs, inputs), optional
        Zero when omitted.
    E : array_like, shape (n, n), optional
        Identity when omitted.
    dt : float
        0 for continuous time, otherwise the sample step in seconds.
    inputs, outputs, states : sequence of str, optional
        ``u1..``, ``y1..``, ``x1..`` when omitted.
    name : str
        Used in tables and reports.
    operating_point : OperatingPoint, optional
        Zero when omitted; recordings have it subtracted before they meet the model.
    units : mapping of str to str, optional
        Unit of each input, output or state, for plots and tables.
    description : str
        Description of the plant, in a sentence or two.
    identification : Identification, optional
        How it came from recordings; none for a plant that was given.

    Raises
    ------
    ModelError
        If a shape does not fit, an entry is not finite, or a name is unknown or occurs twice.

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (1), (14), (19).

    Examples
    --------
    >>> import residua as rs
    >>> tank = rs.Plant([[-0.1]], [[1.0]], [[2.0]], inputs=["valve"], outputs=["level"])
    >>> tank = tank.with_actuator_faults().with_sensor_faults().with_faults({"leak": [-1.0]})
    >>> tank.faults
    ('valve actuator', 'level sensor', 'leak')
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    E: NDArray[np.float64] | None
    Bd: NDArray[np.float64]
    Dd: NDArray[np.float64]
    Bf: NDArray[np.float64]
    Df: NDArray[np.float64]
    Bw: NDArray[np.float64]
    Dw: NDArray[np.float64]
    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    disturbances: tuple[str, ...]
    fault_list: tuple[Fault, ...]
    name: str
    operating_point: OperatingPoint
    units: Mapping[str, str]
    description: str
    identification: Identification | None

    @guessed("Plant")
    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike | None = None,
        *,
        E: ArrayLike | None = None,
        dt: float = 0,
        inputs: Iterable[str] | str | None = None,
        outputs: Iterable[str] | str | None = None,
        states: Iterable[str] | str | None = None,
        name: str = "plant",
        operating_point: OperatingPoint | None = None,
        units: Mapping[str, str] | None = None,
        description: str = "",
        identification: Identification | None = None,
    ) -> None:
        A_ = square(A, "A")
        n = A_.shape[0]
        B_ = matrix(B, "B", (n, None), what="one row per state")
        C_ = matrix(C, "C", (None, n), what="one column per state")
        m, p = B_.shape[1], C_.shape[0]
        if p == 0:
            raise ModelError("a plant needs at least one measured output")
        core = StateSpace(A_, B_, C_, D, E=E, dt=dt)
        fields = {
            "A": core.A,
            "B": core.B,
            "C": core.C,
            "D": core.D,
            "E": core.E,
            "dt": core.dt,
            "inputs": names(inputs, m, "u", "inputs"),
            "outputs": names(outputs, p, "y", "outputs"),
            "states": names(states, n, "x", "states"),
            "disturbances": (),
            "fault_list": (),
            "name": str(name),
            "description": str(description),
        }
        for letter in "dfw":
            fields["B" + letter] = frozen(np.zeros((n, 0)))
            fields["D" + letter] = frozen(np.zeros((p, 0)))
        fields["operating_point"] = checked_point(operating_point, fields["inputs"], fields["outputs"])
        fields["units"] = channel_units(units, {*fields["inputs"], *fields["outputs"], *fields["states"]})
        unique(fields["inputs"] + fields["outputs"], "inputs and outputs")
        fields["identification"] = checked_identification(identification, fields["inputs"], fields["outputs"])
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    # ------------------------------------------------------------------- facts

    @property
    def n_states(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def n_outputs(self) -> int:
        """Number of measured outputs."""
        return self.C.shape[0]

    @property
    def is_discrete(self) -> bool:
        """True if the plant is sampled."""
        return self.dt > 0

    @property
    def noises(self) -> tuple[str, ...]:
        """Names of the noise inputs."""
        return tuple(f"w{i + 1}" for i in range(self.Bw.shape[1]))

    @property
    def process_noise(self) -> NDArray[np.float64]:
        """Covariance of the state noise, ``Bw Bw'``, shape (n, n)."""
        return self.Bw @ self.Bw.T

    @property
    def measurement_noise(self) -> NDArray[np.float64]:
        """Covariance of the measurement noise, ``Dw Dw'``, shape (outputs, outputs)."""
        return self.Dw @ self.Dw.T

    @property
    def cross_noise(self) -> NDArray[np.float64]:
        """Covariance between state and measurement noise, ``Bw Dw'``."""
        return self.Bw @ self.Dw.T

    def system(self, roles: Iterable[str] = ("control", "disturbance", "fault", "noise")) -> StateSpace:
        """Return the plant as a plain system driven by the inputs of the given roles, in that order."""
        chosen = (roles,) if isinstance(roles, str) else tuple(roles)
        if chosen in self._systems:
            return self._systems[chosen]
        for role in chosen:
            if role not in ROLES:
                raise ModelError(f"unknown role {role!r}; known: {', '.join(ROLES)}")
        channels = {
            "control": self.inputs,
            "disturbance": self.disturbances,
            "fault": self.faults,
            "noise": self.noises,
        }
        letters = [ROLES[role] for role in chosen]
        labels = tuple(name for role in chosen for name in channels[role])
        empty_B, empty_D = np.zeros((self.n_states, 0)), np.zeros((self.n_outputs, 0))
        driven = {
            "B": np.hstack([empty_B, *(getattr(self, "B" + letter) for letter in letters)]),
            "D": np.hstack([empty_D, *(getattr(self, "D" + letter) for letter in letters)]),
            "inputs": labels if len(set(labels)) == len(labels) else by_role(list(chosen), channels),
        }
        known = next(iter(self._systems.values()), None)  # the same states and outputs, with their poles
        fixed = {"E": self.E, "dt": self.dt, "outputs": self.outputs, "states": self.states}
        system = StateSpace(self.A, C=self.C, **fixed, **driven) if known is None else known.replaced(**driven)
        return self._systems.setdefault(chosen, system)

    @cached_property
    def balanced(self) -> BalancedPlant:
        """The plant in balanced units, as ordinary state equations."""
        from residua.plant.balanced import balanced

        return balanced(self)

    @cached_property
    def _systems(self) -> dict[tuple[str, ...], StateSpace]:
        """Systems by roles: designs request each many times, and they keep their poles."""
        return {}

    def _headline(self) -> str:
        kind = f"dt={self.dt:g} s" if self.is_discrete else "continuous"
        return (
            f"{self.name!r}: {self.n_states} states, {len(self.inputs)} inputs, {self.n_outputs} outputs, "
            f"{len(self.disturbances)} disturbances, {len(self.faults)} faults, {kind}"
        )

    def _parts(self) -> list[str]:
        lists = {name: getattr(self, name) for name in ("inputs", "outputs", "states", "disturbances", "faults")}
        whole = self.system(("control", "disturbance", "fault"))
        filled = np.block([[self.A, whole.B], [self.C, whole.D]]) != 0
        return [
            table(["", "names"], [(kind, listed(names)) for kind, names in lists.items() if names]),
            grid(
                filled,
                (*self.states, *self.outputs),
                (*self.states, *self.inputs, *self.disturbances, *self.faults),
                label="Which states and inputs (columns) act on which states and outputs (rows)",
            ),
            notes([self.description] if self.description else []),
        ]

    # ---------------------------------------------------- from and to elsewhere

    @classmethod
    def from_state_space(cls, system: Any, **options: Any) -> Plant:
        """Return the plant made of another package's system; see :func:`plant_from_state_space`."""
        from residua.plant.conversion import plant_from_state_space

        return plant_from_state_space(system, **options)

    @classmethod
    def from_toml(cls, path: str | Path) -> Plant:
        """Return the plant that a plant file describes; see :func:`load_plant`."""
        from residua.plant.plant_file import load_plant

        return load_plant(path)

    def to_toml(self, path: str | Path) -> Path:
        """Write a plant file from which :meth:`from_toml` restores the same plant, to the last bit."""
        from residua.plant.plant_writer import save_plant

        return save_plant(self, path)

    # -------------------------------------------------------------- new plants

    def _with(self, **changes: object) -> Plant:
        new = object.__new__(Plant)
        own = vars(self)
        vars(new).update({key: own[key] for key in self.__dataclass_fields__}, **changes)
        return new

    def with_disturbances(
        self,
        directions: ArrayLike | Mapping[str, Direction],
        names: Iterable[str] | str | None = None,
        *,
        output: ArrayLike | None = None,
        rtol: float = DEFAULT_RTOL,
    ) -> Plant:
        r"""Return the plant with unknown inputs added.

        A mapping keeps its names and directions as they are, also where these depend on one another: the
        designs factor them. A matrix without full column rank is factored here, :math:`E d = E_1 (E_2 d)`, and
        :math:`E_1 = U_r S_r` of its singular value decomposition is kept: decoupling depends on its range only.

        Parameters
        ----------
        directions : array_like, shape (n, q), or mapping of name to direction
            How each disturbance enters the state equation; a mapping may also give ``(state, output)`` pairs.
        names : sequence of str, optional
            For a matrix; ``d1..`` when omitted, and whenever it had to be factored.
        output : array_like, shape (outputs, q), optional
            How each disturbance enters the outputs; zero when omitted.
        rtol : float
            Of a matrix: singular values of ``[directions; output]`` below this fraction of the largest count as zero.

        Returns
        -------
        Plant

        Raises
        ------
        ModelError
            If a named disturbance has no effect, a shape does not fit or a name occurs twice.

        References
        ----------
        Chen, Patton and Zhang (1996), section 2, below eq. (1).
        """
        if isinstance(directions, Mapping):
            if names is not None or output is not None:
                raise ModelError("a mapping of disturbances brings its own names and (state, output) pairs")
            Bd, Dd = direction_matrices(directions, self.states, self.outputs, "disturbance")
            return self._with_disturbances(Bd, Dd, arrays.names(tuple(directions), Bd.shape[1], "d", "disturbances"))
        Bd = matrix(directions, "disturbance directions", (self.n_states, None), what="one row per state")
        shape = (self.n_outputs, Bd.shape[1])
        Dd = np.zeros(shape) if output is None else matrix(output, "output", shape)
        factored, decision = factor_disturbance(np.vstack([Bd, Dd]), rtol=rtol)
        full = decision.rank == Bd.shape[1]
        start = len(self.disturbances)
        if not full:
            Bd, Dd = factored[: self.n_states], factored[self.n_states :]
        if names is None or not full:
            labels = tuple(f"d{start + i + 1}" for i in range(Bd.shape[1]))
        else:
            labels = arrays.names(names, Bd.shape[1], "d", "disturbances")
        return self._with_disturbances(Bd, Dd, labels)

    def with_sensor_faults(self, outputs: Iterable[str | int] | str | None = None) -> Plant:
        """Return the plant with an additive fault on each of the given outputs (all when omitted).

        The fault of output ``name`` is called ``"name sensor"`` and adds directly to that output.
        """
        for i in arrays.positions(outputs, self.outputs, "output"):
            column = np.zeros(self.n_outputs)
            column[i] = 1.0
            name = self.outputs[i]
            self = self._with_fault(Fault(f"{name} sensor", "sensor", name), np.zeros(self.n_states), column)
        return self

    def with_actuator_faults(self, inputs: Iterable[str | int] | str | None = None) -> Plant:
        """Return the plant with an additive fault on each of the given control inputs (all when omitted).

        The fault of input ``name`` is called ``"name actuator"`` and enters as that input does.
        """
        for i in arrays.positions(inputs, self.inputs, "input"):
            name = self.inputs[i]
            self = self._with_fault(Fault(f"{name} actuator", "actuator", name), self.B[:, i], self.D[:, i])
        return self

    def with_faults(
        self, directions: Mapping[str, Direction], *, kind: str = "component", component: str | None = None
    ) -> Plant:
        """Return the plant with component faults added.

        Parameters
        ----------
        directions : mapping of str to array_like, or to a pair of array_like
            Fault name to its direction in the state equation, shape (n,), or to ``(state, output)``;
            a mapping ``{state name: value}`` may stand for either vector.
        kind : {"component", "actuator", "sensor"}
        component : str, optional
            The component that all of these faults belong to; each fault's own name when omitted.
        """
        if not isinstance(directions, Mapping):
            raise ModelError("with_faults takes a mapping {name: direction}")
        if kind not in ("component", "actuator", "sensor"):
            raise ModelError(f"kind must be 'component', 'actuator' or 'sensor', got {kind!r}")
        for name, value in directions.items():
            b, d = direction(value, self.states, self.outputs, f"fault {name!r}")
            self = self._with_fault(Fault(name, kind, component or name), b, d)
        return self

    def with_fault_notes(self, notes: Mapping[str, Mapping[str, str]]) -> Plant:
        """Return the plant with notes on its faults, for reports: no computation depends on them.

        Parameters
        ----------
        notes : mapping of str to mapping of str to str
            Fault name to any of ``description``, ``check`` (first checks when it is named) and
            ``unit`` (of its size). Notes that are not given stay unchanged.

        Raises
        ------
        ModelError
            If the plant has no such fault, or a note is none of these.

        Examples
        --------
        >>> import residua as rs
        >>> tank = rs.Plant([[-0.1]], [[1.0]], [[2.0]]).with_faults({"leak": [-1.0]})
        >>> tank = tank.with_fault_notes({"leak": {"unit": "cm2", "check": "the bottom valve"}})
        >>> tank.fault_list[0].check
        'the bottom valve'
        """
        faults = {fault.name: fault for fault in self.fault_list}
        for name, entries in notes.items():
            i = arrays.index_of(name, self.faults, "fault notes: fault")
            for key, text in entries.items():
                if key not in FAULT_NOTES or not isinstance(text, str):
                    known = ", ".join(FAULT_NOTES)
                    raise ModelError(f"notes on fault {name!r}: {key} = {text!r}: expected texts for {known}")
            faults[self.faults[i]] = replace(faults[self.faults[i]], **entries)
        return self._with(fault_list=tuple(faults.values()))

    def without_faults(self, names: Iterable[str] | str | None = None) -> Plant:
        """Return the plant without the named faults (without any, when omitted)."""
        drop = set(arrays.positions(names, self.faults, "fault"))
        keep = [i for i in range(len(self.fault_list)) if i not in drop]
        return self._with(
            Bf=frozen(self.Bf[:, keep]),
            Df=frozen(self.Df[:, keep]),
            fault_list=tuple(self.fault_list[i] for i in keep),
        )

    def with_noise(
        self,
        *,
        process: ArrayLike | Mapping[str, float] | None = None,
        measurement: ArrayLike | Mapping[str, float] | None = None,
        cross: ArrayLike | Mapping[tuple[str, str], float] | None = None,
    ) -> Plant:
        r"""Return the plant with white noise, in place of its own.

        .. math::

           \mathrm{cov} \begin{bmatrix} B_w w \\ D_w w \end{bmatrix} =
           \begin{bmatrix} W & S \\ S^T & V \end{bmatrix}

        with ``process`` :math:`W`, ``measurement`` :math:`V` and ``cross`` :math:`S`.

        Parameters
        ----------
        process : array_like or mapping, optional
            Covariance of the state noise: a matrix (n, n), its diagonal, one number for all states, or
            ``{state: variance}``. For a continuous plant: intensity, covariance per second.
        measurement : array_like or mapping, optional
            Covariance of the measurement noise, likewise. For a continuous plant: intensity,
            covariance times seconds; a sample averaged over ``h`` seconds has ``measurement / h``.
        cross : array_like or mapping, optional
            Covariance between state and measurement noise: a matrix (n, outputs), or
            ``{(state, output): covariance}``; zero when omitted. For a sampled plant that of the noise that moves
            :math:`x_k` to :math:`x_{k+1}` and that in :math:`y_k`; for a continuous plant the intensity, covariance
            as it is.

        Raises
        ------
        ModelError
            If a covariance is not symmetric positive semidefinite, or all together are not.

        Examples
        --------
        >>> import residua as rs
        >>> plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1)
        >>> plant.with_noise(process=0.04, measurement=0.01, cross=[[0.015]]).cross_noise.round(9)
        array([[0.015]])
        """
        W = covariance(process, self.states, "process noise")
        V = covariance(measurement, self.outputs, "measurement noise")
        S = cross_covariance(cross, self.states, self.outputs)
        Bw, Dw = joint_factors(W, V, S, self.states, self.outputs)
        return self._with(Bw=frozen(Bw), Dw=frozen(Dw))

    def with_assumed_noise(self) -> Plant:
        """Return the plant with noise assumed from the size of its signals, if it has none.

        The standard deviation of a measurement is a tenth of the steady effect of inputs of size one on that output,
        and that of the noise of a state 0.3 % of their effect on it. For signals that no control input moves the
        effects of disturbances count, then of faults; for a plant that integrates, those within a hundred samples. A
        continuous plant is taken to be sampled ten times in the time constant of its mean rate.

        Returns
        -------
        Plant
            Thresholds that rest on this noise are guesses: fit a monitor on fault-free recordings.

        Raises
        ------
        ModelError
            If it has noise already, or its equations do not determine the steady effect of an input.

        Examples
        --------
        >>> import residua as rs
        >>> tank = rs.Plant([[0.9]], [[2.0]], [[1.0]], dt=1).with_assumed_noise()
        >>> tank.measurement_noise.round(6), tank.process_noise.round(6)
        (array([[4.]]), array([[0.0036]]))
        """
        from residua.plant.assumed_noise import with_assumed_noise

        return with_assumed_noise(self)

    def with_noise_input(self, Bw: ArrayLike | None = None, Dw: ArrayLike | None = None) -> Plant:
        """Return the plant driven by white noise of unit covariance, in place of its own.

        The same as :meth:`with_noise` by the factors of its covariances: ``process = Bw Bw'``,
        ``measurement = Dw Dw'``, ``cross = Bw Dw'``. For a continuous plant the noise has unit intensity.

        Parameters
        ----------
        Bw : array_like, shape (n, q), optional
            How each noise enters the state equation; zero when omitted.
        Dw : array_like, shape (outputs, q), optional
            How each noise enters the outputs; zero when omitted.

        Raises
        ------
        ModelError
            If a shape does not fit, an entry is not finite, or neither is there.

        Examples
        --------
        One noise in the state and, half as large, in the output; another in the output alone:

        >>> import residua as rs
        >>> plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1).with_noise_input([[0.2, 0.0]], [[0.1, 0.05]])
        >>> plant.cross_noise.round(9), plant.measurement_noise.round(9)
        (array([[0.02]]), array([[0.0125]]))
        """
        if Bw is None and Dw is None:
            raise ModelError("with_noise_input needs Bw, Dw or both: how unit white noise enters states and outputs")
        B = None if Bw is None else matrix(Bw, "Bw", (self.n_states, None), what="one row per state")
        D = None if Dw is None else matrix(Dw, "Dw", (self.n_outputs, None), what="one row per output")
        count = (D if B is None else B).shape[1]  # pyright: ignore[reportOptionalMemberAccess]
        B = np.zeros((self.n_states, count)) if B is None else B
        D = np.zeros((self.n_outputs, count)) if D is None else D
        if B.shape[1] != D.shape[1]:
            raise ModelError(f"Bw has {B.shape[1]} columns and Dw has {D.shape[1]}: one for each noise, in both")
        return self._with(Bw=frozen(B), Dw=frozen(D))

    def with_operating_point(
        self,
        *,
        inputs: ArrayLike | Mapping[str, float] | None = None,
        outputs: ArrayLike | Mapping[str, float] | None = None,
    ) -> Plant:
        """Return the plant with the constant inputs and outputs around which its matrices hold."""
        u = channel_values(inputs, self.inputs, self.operating_point.inputs, "operating_point inputs")
        y = channel_values(outputs, self.outputs, self.operating_point.outputs, "operating_point outputs")
        return self._with(operating_point=OperatingPoint(u, y))

    def with_identification(self, made: Identification | None) -> Plant:
        """Return the plant with a record of its identification; without one for ``None``."""
        return self._with(identification=checked_identification(made, self.inputs, self.outputs))

    def without_disturbances(self) -> Plant:
        """Return the plant without its disturbances."""
        return self._with(Bd=frozen(self.Bd[:, :0]), Dd=frozen(self.Dd[:, :0]), disturbances=())

    def faults_as_disturbances(self, names: Iterable[str] | str | None = None) -> Plant:
        """Return the plant with the named faults (all when omitted) as disturbances, after its own.

        A residual that no disturbance of the new plant reaches is one that ignores these faults.
        """
        chosen = arrays.positions(names, self.faults, "fault")
        labels = tuple(self.faults[i] for i in chosen)
        return self.without_faults(labels)._with_disturbances(self.Bf[:, chosen], self.Df[:, chosen], labels)

    def explicit(self) -> Plant:
        """Return the plant with an invertible ``E`` divided out; raises if ``E`` is singular."""
        if self.E is None:
            return self
        whole = self.system().explicit()
        sizes = np.cumsum([self.B.shape[1], self.Bd.shape[1], self.Bf.shape[1]])
        Bu, Bd, Bf, Bw = (frozen(B) for B in np.hsplit(whole.B, sizes))
        return self._with(A=whole.A, E=None, B=Bu, Bd=Bd, Bf=Bf, Bw=Bw)

    def discretize(self, dt: float) -> Plant:
        """Return the plant sampled with step ``dt``.

        Exact for control inputs that are held between samples. Disturbances and faults are assumed to be
        held too; their course between samples is not represented. Noise stays white: the
        state noise over one step has the covariance of the continuous noise, integrated; the measurement
        noise of intensity ``V`` becomes covariance ``V / dt`` (a sensor that averages over the step).
        Algebraic equations are eliminated first, exactly, which lowers the order; a plant of index 2 or more
        cannot be sampled, for held inputs would give it impulses.
        """
        from residua.plant.algebraic_equations import without_algebraic_equations

        plain = without_algebraic_equations(self).explicit()
        sampled = plain.system(("control", "disturbance", "fault")).discretize(dt)
        sizes = np.cumsum([self.B.shape[1], self.Bd.shape[1]])
        Bu, Bd, Bf = (frozen(B) for B in np.hsplit(sampled.B, sizes))
        Bw, Dw = sampled_noise(plain.A, plain.Bw, plain.Dw, sampled.dt)
        return plain._with(A=sampled.A, E=None, B=Bu, Bd=Bd, Bf=Bf, Bw=frozen(Bw), Dw=frozen(Dw), dt=sampled.dt)

    def _with_disturbances(self, Bd: NDArray, Dd: NDArray, labels: tuple[str, ...]) -> Plant:
        labels = self.disturbances + labels
        unique(labels, "disturbances")
        return self._with(Bd=frozen(np.hstack([self.Bd, Bd])), Dd=frozen(np.hstack([self.Dd, Dd])), disturbances=labels)

    def _with_fault(self, fault: Fault, b: NDArray, d: NDArray) -> Plant:
        if not fault.name or not isinstance(fault.name, str):
            raise ModelError(f"a fault needs a name, got {fault.name!r}")
        if not (np.any(b) or np.any(d)):
            raise ModelError(f"fault {fault.name!r} has no effect: its direction is zero everywhere")
        unique((*self.faults, fault.name), "faults")
        return self._with(
            Bf=frozen(np.column_stack([self.Bf, b])),
            Df=frozen(np.column_stack([self.Df, d])),
            fault_list=(*self.fault_list, replace(fault)),
        )
