"""The plant: a linear system whose inputs have roles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import ModelError
from residua.linear import StateSpace, arrays
from residua.linear.arrays import frozen, index_of, matrix, names, unique
from residua.linear.rank import DEFAULT_RTOL
from residua.linear.state_space import square
from residua.plant.disturbances import factor_disturbance
from residua.plant.noise import covariance, noise_factors, sampled_noise

#: The roles an input of a plant can have, with the letter of its matrices.
ROLES = {"control": "u", "disturbance": "d", "fault": "f", "noise": "w"}

Direction = ArrayLike | tuple[ArrayLike, ArrayLike] | Mapping[str, ArrayLike]


@dataclass(frozen=True)
class OperatingPoint:
    """The constant inputs and outputs around which the model holds, in plant units.

    Attributes
    ----------
    inputs : tuple of float
        One per control input.
    outputs : tuple of float
        One per output.
    """

    inputs: tuple[float, ...]
    outputs: tuple[float, ...]


@dataclass(frozen=True)
class Fault:
    """What one fault is: its name, its kind and the component that it belongs to."""

    name: str
    kind: str
    component: str


@dataclass(frozen=True, init=False, eq=False)
class Plant:
    r"""A linear plant with control, disturbance, fault and noise inputs.

    .. math::

       E \dot x = A x + B_u u + B_d d + B_f f + B_w w, \qquad y = C x + D_u u + D_d d + D_f f + D_w w

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
    C: NDArray[np.float64]
    E: NDArray[np.float64] | None
    Bu: NDArray[np.float64]
    Du: NDArray[np.float64]
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
            "C": core.C,
            "E": core.E,
            "Bu": core.B,
            "Du": core.D,
            "dt": core.dt,
            "inputs": names(inputs, m, "u", "inputs"),
            "outputs": names(outputs, p, "y", "outputs"),
            "states": names(states, n, "x", "states"),
            "disturbances": (),
            "fault_list": (),
            "name": str(name),
        }
        for letter in "dfw":
            fields["B" + letter] = frozen(np.zeros((n, 0)))
            fields["D" + letter] = frozen(np.zeros((p, 0)))
        point = OperatingPoint((0.0,) * m, (0.0,) * p) if operating_point is None else operating_point
        if len(point.inputs) != m or len(point.outputs) != p:
            raise ModelError(f"operating_point: expected {m} inputs and {p} outputs")
        fields["operating_point"] = point
        known = {*fields["inputs"], *fields["outputs"], *fields["states"]}
        for key in units or {}:
            if key not in known:
                raise ModelError(f"units: {key!r} is no input, output or state of this plant")
        fields["units"] = dict(units or {})
        unique(fields["inputs"] + fields["outputs"], "inputs and outputs")
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
        """Whether the plant is sampled."""
        return self.dt > 0

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults, in the order of the columns of ``Bf`` and ``Df``."""
        return tuple(fault.name for fault in self.fault_list)

    @property
    def fault_kinds(self) -> tuple[str, ...]:
        """``"actuator"``, ``"sensor"`` or ``"component"`` for each fault."""
        return tuple(fault.kind for fault in self.fault_list)

    @property
    def fault_components(self) -> tuple[str, ...]:
        """The component that each fault belongs to."""
        return tuple(fault.component for fault in self.fault_list)

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
        chosen = []
        for role in (roles,) if isinstance(roles, str) else tuple(roles):
            if role not in ROLES:
                raise ModelError(f"unknown role {role!r}; known: {', '.join(ROLES)}")
            chosen.append(role)
        channels = {
            "control": self.inputs,
            "disturbance": self.disturbances,
            "fault": self.faults,
            "noise": self.noises,
        }
        letters = [ROLES[role] for role in chosen]
        labels = [name for role in chosen for name in channels[role]]
        empty_B, empty_D = np.zeros((self.n_states, 0)), np.zeros((self.n_outputs, 0))
        return StateSpace(
            self.A,
            np.hstack([empty_B, *(getattr(self, "B" + letter) for letter in letters)]),
            self.C,
            np.hstack([empty_D, *(getattr(self, "D" + letter) for letter in letters)]),
            E=self.E,
            dt=self.dt,
            inputs=labels if len(set(labels)) == len(labels) else _by_role(chosen, channels),
            outputs=self.outputs,
            states=self.states,
        )

    # -------------------------------------------------------------- new plants

    def _with(self, **changes: object) -> Plant:
        new = object.__new__(Plant)
        for key in self.__dataclass_fields__:
            object.__setattr__(new, key, changes.get(key, getattr(self, key)))
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

        A matrix without full column rank is factored, :math:`E d = E_1 (E_2 d)`, and :math:`E_1 = U_r S_r`
        of its singular value decomposition is kept: decoupling depends on its range only.

        Parameters
        ----------
        directions : array_like, shape (n, q), or mapping of name to direction
            How each disturbance enters the state equation; a mapping may also give ``(state, output)`` pairs.
        names : sequence of str, optional
            ``d1..`` when omitted, and whenever the matrix had to be factored.
        output : array_like, shape (outputs, q), optional
            How each disturbance enters the outputs; zero when omitted.
        rtol : float
            Singular values of ``[directions; output]`` below this fraction of the largest count as zero.

        Returns
        -------
        Plant

        References
        ----------
        Chen, Patton and Zhang (1996), section 2, below eq. (1).
        """
        if isinstance(directions, Mapping):
            names = tuple(directions)
            pairs = [self._direction(value, f"disturbance {key!r}") for key, value in directions.items()]
            Bd = np.column_stack([b for b, _ in pairs]) if pairs else np.zeros((self.n_states, 0))
            Dd = np.column_stack([d for _, d in pairs]) if pairs else np.zeros((self.n_outputs, 0))
        else:
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
        labels = self.disturbances + labels
        unique(labels, "disturbances")
        return self._with(
            Bd=frozen(np.hstack([self.Bd, Bd])), Dd=frozen(np.hstack([self.Dd, Dd])), disturbances=labels
        )

    def with_sensor_faults(self, outputs: Iterable[str | int] | str | None = None) -> Plant:
        """Return the plant with an additive fault on each of the given outputs (all when omitted).

        The fault of output ``name`` is called ``"name sensor"`` and adds directly to that output.
        """
        for i in self._channels(outputs, self.outputs, "output"):
            column = np.zeros(self.n_outputs)
            column[i] = 1.0
            name = self.outputs[i]
            self = self._with_fault(Fault(f"{name} sensor", "sensor", name), np.zeros(self.n_states), column)
        return self

    def with_actuator_faults(self, inputs: Iterable[str | int] | str | None = None) -> Plant:
        """Return the plant with an additive fault on each of the given control inputs (all when omitted).

        The fault of input ``name`` is called ``"name actuator"`` and enters as that input does.
        """
        for i in self._channels(inputs, self.inputs, "input"):
            name = self.inputs[i]
            self = self._with_fault(Fault(f"{name} actuator", "actuator", name), self.Bu[:, i], self.Du[:, i])
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
            b, d = self._direction(value, f"fault {name!r}")
            self = self._with_fault(Fault(name, kind, component or name), b, d)
        return self

    def without_faults(self, names: Iterable[str] | str | None = None) -> Plant:
        """Return the plant without the named faults (without any, when omitted)."""
        drop = set(self._channels(names, self.faults, "fault"))
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
    ) -> Plant:
        """Return the plant with white noise, replacing what noise it had.

        Parameters
        ----------
        process : array_like or mapping, optional
            Covariance of the state noise: a matrix (n, n), its diagonal, one number for all states, or
            ``{state: variance}``. For a continuous plant: intensity, covariance per second.
        measurement : array_like or mapping, optional
            Covariance of the measurement noise, likewise. For a continuous plant: intensity,
            covariance times seconds; a sample averaged over ``h`` seconds has ``measurement / h``.

        Raises
        ------
        ModelError
            If a covariance is not symmetric positive semidefinite.
        """
        W = covariance(process, self.states, "process noise")
        V = covariance(measurement, self.outputs, "measurement noise")
        Bw, Dw = noise_factors(W, V)
        return self._with(Bw=frozen(Bw), Dw=frozen(Dw))

    def with_operating_point(
        self,
        *,
        inputs: ArrayLike | Mapping[str, float] | None = None,
        outputs: ArrayLike | Mapping[str, float] | None = None,
    ) -> Plant:
        """Return the plant with the constant inputs and outputs around which its matrices hold."""
        u = self._offsets(inputs, self.inputs, self.operating_point.inputs, "operating_point inputs")
        y = self._offsets(outputs, self.outputs, self.operating_point.outputs, "operating_point outputs")
        return self._with(operating_point=OperatingPoint(u, y))

    def without_disturbances(self) -> Plant:
        """Return the plant without its disturbances."""
        return self._with(
            Bd=frozen(self.Bd[:, :0]), Dd=frozen(self.Dd[:, :0]), disturbances=()
        )

    def explicit(self) -> Plant:
        """Return the plant with an invertible ``E`` divided out; raises when ``E`` is singular."""
        if self.E is None:
            return self
        whole = self.system().explicit()
        sizes = np.cumsum([self.Bu.shape[1], self.Bd.shape[1], self.Bf.shape[1]])
        Bu, Bd, Bf, Bw = (frozen(B) for B in np.hsplit(whole.B, sizes))
        return self._with(A=whole.A, E=None, Bu=Bu, Bd=Bd, Bf=Bf, Bw=Bw)

    def discretize(self, dt: float) -> Plant:
        """Return the plant sampled with step ``dt``.

        Exact for control inputs that are held between samples. Disturbances and faults are assumed to be
        held too; what they do between samples beyond that is not represented. Noise stays white: the
        state noise over one step has the covariance of the continuous noise, integrated; the measurement
        noise of intensity ``V`` becomes covariance ``V / dt`` (a sensor that averages over the step).
        """
        plain = self.explicit()
        sampled = plain.system(("control", "disturbance", "fault")).discretize(dt)
        sizes = np.cumsum([self.Bu.shape[1], self.Bd.shape[1]])
        Bu, Bd, Bf = (frozen(B) for B in np.hsplit(sampled.B, sizes))
        Bw, Dw = sampled_noise(plain.A, plain.Bw, plain.Dw, sampled.dt)
        return self._with(
            A=sampled.A, E=None, Bu=Bu, Bd=Bd, Bf=Bf, Bw=frozen(Bw), Dw=frozen(Dw), dt=sampled.dt
        )

    # ------------------------------------------------------------------ helpers

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

    def _direction(self, value: Direction, what: str) -> tuple[NDArray, NDArray]:
        """Return the (state, output) vectors of a fault or disturbance."""
        is_pair = isinstance(value, tuple) and len(value) == 2 and not np.isscalar(value[0])
        state, output = value if is_pair else (value, None)
        return (
            np.asarray(self._offsets(state, self.states, (0.0,) * self.n_states, f"{what}, state direction")),
            np.asarray(
                self._offsets(output, self.outputs, (0.0,) * self.n_outputs, f"{what}, output direction")
            ),
        )

    @staticmethod
    def _offsets(
        value: object, known: tuple[str, ...], default: tuple[float, ...], what: str
    ) -> tuple[float, ...]:
        if value is None:
            return default
        if isinstance(value, Mapping):
            out = list(default)
            for key, entry in value.items():
                out[index_of(key, known, f"{what}: channel")] = float(entry)
        else:
            out = list(matrix(value, what, (len(known), 1)).ravel())  # pyright: ignore[reportArgumentType]
        if not np.isfinite(out).all():
            raise ModelError(f"{what}: every number must be finite")
        return tuple(float(x) for x in out)

    @staticmethod
    def _channels(
        chosen: Iterable[str | int] | str | int | None, known: tuple[str, ...], what: str
    ) -> list[int]:
        if chosen is None:
            return list(range(len(known)))
        if isinstance(chosen, (str, int)):
            chosen = [chosen]
        return [index_of(name, known, what) for name in chosen]

    def __repr__(self) -> str:
        kind = f"dt={self.dt:g} s" if self.is_discrete else "continuous"
        return (
            f"Plant({self.name!r}: {self.n_states} states, {len(self.inputs)} inputs, {self.n_outputs} outputs, "
            f"{len(self.disturbances)} disturbances, {len(self.faults)} faults, {kind})"
        )


def _by_role(chosen: list[str], channels: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return channel labels made unique by their role."""
    return [f"{role} {name}" for role in chosen for name in channels[role]]
