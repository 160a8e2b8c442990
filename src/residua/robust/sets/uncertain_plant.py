"""Plants that are known up to constant parameters within bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import frozen, unique
from residua.errors import ModelError
from residua.linear import StateSpace
from residua.plant.plant import Plant
from residua.robust.sets.uncertain_system import UncertainSystem, bounds, corners, parameter_values

if TYPE_CHECKING:
    from residua.robust.sets.linearisation import Linearisation

Matrix = NDArray[np.float64]
MATRICES = ("A", "B", "C", "D", "Bd", "Dd", "Bf", "Df")
#: Up to so many parameters every corner of their box is visited, beyond as many corners at random.
_ALL_CORNERS = 10


@dataclass(frozen=True)
class UncertainParameter:
    """A constant of the plant that is known within bounds only.

    Attributes
    ----------
    name : str
    low, high : float
    nominal : float
        Its value in the nominal plant; 0 for perturbations ``dA = -H F G``.
    """

    name: str
    low: float
    high: float
    nominal: float = 0.0


@dataclass(frozen=True, init=False, eq=False)
class Perturbation:
    r"""Change of a matrix of the plant by parameters: :math:`\Delta A = -H F G`, ``F`` diagonal, ``low <= F <= high``.

    The minus sign is that of the literature; give ``-H`` for a plus.

    Parameters
    ----------
    matrix : {"A", "B", "C", "D", "Bd", "Dd", "Bf", "Df"}
        The matrix of the plant: states, control inputs, outputs, direct term; directions of all disturbances in states
        and in outputs, and those of all faults.
    H : array_like, shape (rows of the matrix, k)
    G : array_like, shape (k, columns of the matrix)
    low, high : array_like, shape (k,)
        One number stands for all. They contain 0, which is the nominal plant.
    names : sequence of str, optional
        One for each diagonal entry of ``F``; ``"A1", "A2", ..`` when omitted. The same name in several places, of one
        or of several perturbations, is the same parameter.

    Raises
    ------
    ModelError
        If a shape does not fit, bounds are not bounds, or leave out 0.

    References
    ----------
    Robust l1 fault detection, eqs. (3)-(8).

    Examples
    --------
    >>> from residua.plant import Perturbation
    >>> Perturbation("A", [[-1.0], [0.0]], [[1.0, 0.0]], low=-0.1, high=0.2, names=["friction"]).names
    ('friction',)
    """

    matrix: str
    H: NDArray[np.float64]
    G: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    names: tuple[str, ...] | None

    def __init__(
        self,
        matrix: str,
        H: ArrayLike,
        G: ArrayLike,
        low: ArrayLike,
        high: ArrayLike,
        names: Iterable[str] | str | None = None,
    ) -> None:
        if matrix not in MATRICES:
            raise ModelError(f"a perturbation belongs to one of {', '.join(MATRICES)}, got {matrix!r}")
        H_ = arrays.matrix(H, f"H of d{matrix}", (None, None))
        k = H_.shape[1]
        G_ = arrays.matrix(G, f"G of d{matrix}", (k, None), what="one row per column of H")
        lows, highs = (np.full(k, v) if np.ndim(v) == 0 else v for v in (low, high))
        low_, high_ = bounds(lows, highs)
        if len(low_) != k:
            raise ModelError(f"d{matrix}: {k} columns of H need {k} bounds, got {len(low_)}")
        wrong = np.flatnonzero((low_ > 0) | (high_ < 0))
        if wrong.size:
            i = int(wrong[0])
            raise ModelError(
                f"d{matrix}: the bounds [{low_[i]:g}, {high_[i]:g}] of parameter {i + 1} leave out 0, the nominal "
                f"plant: add the middle, {-(low_[i] + high_[i]) / 2:g} x H x G, to {matrix} of the plant, and bound "
                "deviations from it"
            )
        labels = None if names is None else (names,) if isinstance(names, str) else tuple(names)
        if labels is not None and (len(labels) != k or not all(isinstance(x, str) and x.strip() for x in labels)):
            raise ModelError(f"d{matrix}: {k} columns of H need {k} names, got {labels!r}")
        self.__dict__.update(matrix=matrix, H=H_, G=G_, low=low_, high=high_, names=labels)


@dataclass(frozen=True, init=False, eq=False, repr=False)
class UncertainPlant:
    r"""A plant with constant parameters of which only bounds are known.

    .. math::

       \Delta A = -H_x F G_x, \quad \Delta B = -H_x F G_u, \quad \Delta C = -H_y F G_x, \quad \Delta D = -H_y F G_u

    and likewise with :math:`G_d` and :math:`G_f` for the directions of disturbances and faults, in the states and in
    the outputs,

    with ``F`` diagonal: each channel (column of ``H``, row of ``G``) belongs to a parameter, which may own several;
    the entry of ``F`` is the parameter less its nominal value. Three ways to make one: perturbations of the matrices
    (here), :meth:`from_parameters` (physical parameters), :meth:`from_plants` (a list of plants).

    Parameters
    ----------
    nominal : Plant
        Continuous or sampled; ``F = 0``.
    deltas : sequence of Perturbation
        ``dA = -H F G`` and likewise; equal names, also in different matrices, are one parameter.

    Attributes
    ----------
    nominal : Plant
    parameters : tuple of UncertainParameter
        Names, bounds and nominal values.
    channels : tuple of int
        The parameter of each channel.
    Hx : ndarray, shape (n, channels)
    Hy : ndarray, shape (outputs, channels)
    Gx : ndarray, shape (channels, n)
    Gu : ndarray, shape (channels, inputs)
    Gd : ndarray, shape (channels, disturbances)
    Gf : ndarray, shape (channels, faults)
    linearisation : Linearisation or None
        What the form above leaves out of the plants that it was made from; None if the form itself was the input.
    plants : tuple of Plant
        The plants of :meth:`from_plants`.
    function : callable or None
        That of :meth:`from_parameters`, from which sampled plants are made. Not kept when the object is pickled.

    Raises
    ------
    ModelError
        If a shape does not fit, or one parameter has two different bounds.

    Notes
    -----
    Assumes
        Parameters are constant in time. Directions of noise, and ``E``, do not depend on them. Those of faults and
        disturbances do as far as the input says so: plants of :meth:`from_parameters` bring theirs, while a
        perturbation of ``B`` leaves an actuator fault with the nominal column; perturb ``"Bf"`` as well, by the same
        name.

    References
    ----------
    Robust l1 fault detection, eqs. (1)-(8).

    Examples
    --------
    >>> import residua as rs
    >>> from residua.plant import Perturbation, UncertainPlant
    >>> tank = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1.0)
    >>> unc = UncertainPlant(tank, deltas=[Perturbation("A", [[-1.0]], [[1.0]], -0.02, 0.01, ["outflow"])])
    >>> unc.member({"outflow": 0.01}).A
    array([[0.91]])
    """

    nominal: Plant
    parameters: tuple[UncertainParameter, ...]
    channels: tuple[int, ...]
    Hx: Matrix
    Hy: Matrix
    Gx: Matrix
    Gu: Matrix
    Gd: Matrix
    Gf: Matrix
    linearisation: Linearisation | None
    plants: tuple[Plant, ...]
    function: Callable[[Mapping[str, float]], Plant] | None

    def __init__(self, nominal: Plant, deltas: Iterable[Perturbation] = ()) -> None:
        if not isinstance(nominal, Plant):
            raise ModelError(f"nominal must be a Plant, got {type(nominal).__name__}")
        n, p = nominal.n_states, nominal.n_outputs
        sides = dict(zip("xudf", (n, len(nominal.inputs), len(nominal.disturbances), len(nominal.faults)), strict=True))
        left, right, labels = [np.zeros((n + p, 0))], [np.zeros((0, sum(sides.values())))], []
        entries: dict[str, UncertainParameter] = {}
        counts: dict[str, int] = dict.fromkeys(MATRICES, 0)
        for delta in deltas:
            if not isinstance(delta, Perturbation):
                raise ModelError(f"deltas holds Perturbation objects, got {type(delta).__name__}")
            k, of_outputs = len(delta.low), delta.matrix[0] in "CD"
            side = "x" if delta.matrix in "AC" else delta.matrix[1:] or "u"
            rows, columns = (p if of_outputs else n), sides[side]
            if delta.H.shape[0] != rows or delta.G.shape[1] != columns:
                raise ModelError(
                    f"d{delta.matrix} = -H F G must be {rows} x {columns} as {delta.matrix} of the plant is, "
                    f"got H with {delta.H.shape[0]} rows and G with {delta.G.shape[1]} columns"
                )
            none = np.zeros((n if of_outputs else p, k))
            left.append(np.vstack([none, delta.H] if of_outputs else [delta.H, none]))
            right.append(np.hstack([delta.G if name == side else np.zeros((k, w)) for name, w in sides.items()]))
            start = counts[delta.matrix]
            counts[delta.matrix] += k
            names = delta.names or tuple(f"{delta.matrix}{start + i + 1}" for i in range(k))
            for name, low, high in zip(names, delta.low, delta.high, strict=True):
                entry = UncertainParameter(name, float(low), float(high))
                if entries.setdefault(name, entry) != entry:
                    raise ModelError(
                        f"the parameter {name!r} is given bounds [{low:g}, {high:g}] in d{delta.matrix} and "
                        f"[{entries[name].low:g}, {entries[name].high:g}] before"
                    )
                labels.append(name)
        channels = tuple(list(entries).index(name) for name in labels)
        known = tuple(entries.values())
        self.__dict__.update(vars(make_uncertain_plant(nominal, known, channels, np.hstack(left), np.vstack(right))))

    @classmethod
    def from_parameters(
        cls,
        function: Callable[[Mapping[str, float]], Plant],
        parameters: Mapping[str, Sequence[float]],
        *,
        rtol: float = 1e-9,
        seed: int = 0,
    ) -> UncertainPlant:
        """Return the uncertain plant of named physical parameters; see :func:`uncertain_plant_from_parameters`."""
        from residua.robust.sets.linearisation import uncertain_plant_from_parameters

        return uncertain_plant_from_parameters(function, parameters, rtol=rtol, seed=seed)

    @classmethod
    def from_plants(cls, plants: Iterable[Plant]) -> UncertainPlant:
        """Return an uncertain plant that contains all plants of a list; see :func:`uncertain_plant_from_plants`."""
        from residua.robust.sets.linearisation import uncertain_plant_from_plants

        return uncertain_plant_from_plants(plants)

    # ------------------------------------------------------------------ facts

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def low(self) -> NDArray[np.float64]:
        """Lower bounds of the parameters."""
        return np.array([parameter.low for parameter in self.parameters])

    @property
    def high(self) -> NDArray[np.float64]:
        """Upper bounds of the parameters."""
        return np.array([parameter.high for parameter in self.parameters])

    @property
    def nominal_values(self) -> NDArray[np.float64]:
        """The parameters of the nominal plant."""
        return np.array([parameter.nominal for parameter in self.parameters])

    # ---------------------------------------------------------------- members

    def member(self, values: ArrayLike | Mapping[str, float]) -> Plant:
        """Return the plant with these parameters.

        Parameters
        ----------
        values : mapping of name to value, or array_like, shape (parameters,)
            A mapping may leave out parameters: these are nominal.

        Raises
        ------
        ModelError
            If a parameter is unknown or outside of its bounds.
        """
        v = parameter_values(values, self.names, self.low, self.high, self.nominal_values)
        F = (v - self.nominal_values)[list(self.channels)]
        Hx, Hy = self.Hx * F, self.Hy * F
        plant = self.nominal
        return plant._with(
            A=frozen(plant.A - Hx @ self.Gx),
            B=frozen(plant.B - Hx @ self.Gu),
            C=frozen(plant.C - Hy @ self.Gx),
            D=frozen(plant.D - Hy @ self.Gu),
            Bd=frozen(plant.Bd - Hx @ self.Gd),
            Dd=frozen(plant.Dd - Hy @ self.Gd),
            Bf=frozen(plant.Bf - Hx @ self.Gf),
            Df=frozen(plant.Df - Hy @ self.Gf),
        )

    def vertex_values(self) -> NDArray[np.float64]:
        """Return the corners of the box of parameters, shape (2^k, k); for up to 12 parameters."""
        return corners(self.low, self.high)

    def vertices(self) -> list[Plant]:
        """Return the plants at all corners of the box of parameters, in the order of :meth:`vertex_values`."""
        return [self.member(values) for values in self.vertex_values()]

    def sample_values(self, rng: np.random.Generator | int, count: int) -> NDArray[np.float64]:
        """Return parameters drawn evenly from the box, shape (count, k)."""
        return np.random.default_rng(rng).uniform(self.low, self.high, (count, len(self.parameters)))

    def sample(self, rng: np.random.Generator | int, count: int) -> list[Plant]:
        """Return plants with parameters drawn evenly from the box.

        Parameters
        ----------
        rng : numpy.random.Generator or int
            A generator, or the seed of one.
        count : int
        """
        return [self.member(values) for values in self.sample_values(rng, count)]

    # -------------------------------------------------------------- new plants

    def in_closed_loop(self, controller: StateSpace) -> UncertainPlant:
        """Return the uncertain plant under feedback; see :func:`close_loop`."""
        from residua.robust.sets.uncertain_loop import close_loop

        return close_loop(self, controller)

    def estimator_residual(
        self,
        gain: ArrayLike,
        projection: ArrayLike,
        *,
        nuisances: Iterable[str] = (),
        nuisance_size: float = 1.0,
        model: ArrayLike | None = None,
    ) -> UncertainSystem:
        r"""Return the residual of an estimator, seen from disturbances and nuisance faults, as an uncertain system.

        The estimator :math:`\hat x_{k+1} = A_e \hat x_k + W (y_k - C \hat x_k)` with the residual
        :math:`r = P (y - C \hat x)`. With :math:`e = x - \hat x` and the states :math:`[x; e]`,

        .. math::

           \tilde A = \begin{bmatrix} A & 0 \\ A - A_e & A_e - W C \end{bmatrix}, \quad
           B_p = -\begin{bmatrix} H_x \\ H_x - W H_y \end{bmatrix}, \quad C_q = [G_x \; 0], \quad
           B_w = \begin{bmatrix} D_1 \\ D_1 - W D_2 \end{bmatrix}, \\
           C_z = P [0 \; C], \quad D_{zp} = -P H_y, \quad D_{zw} = P D_2

        The part of :math:`\Delta C` in the residual, :math:`D_{zp}`, is missing in the literature's eqs. (42) and (45).

        Parameters
        ----------
        gain : array_like, shape (n, outputs)
            ``W``.
        projection : array_like, shape (r, outputs)
            ``P``.
        nuisances : sequence of str
            Faults that count as disturbances, after those of the plant.
        nuisance_size : float
            Their size, where disturbances and nuisances together have the length 1.
        model : array_like, shape (n, n), optional
            ``Ae``; the nominal ``A`` when omitted.

        Returns
        -------
        UncertainSystem
            From the disturbances (and nuisances) to the residual. Its parameters are deviations from the nominal values
            of the loop: ``residua.plant.loop_parameters``. White noise, which has no bound, is left out.

        Raises
        ------
        ModelError
            If the plant has control inputs (:meth:`in_closed_loop` closes the loop) or a shape does not fit.

        References
        ----------
        Robust l1 fault detection, eqs. (27)-(37).
        """
        from residua.robust.sets.uncertain_loop import residual_over_set

        p = self.nominal
        n, y = p.n_states, p.n_outputs
        W = arrays.matrix(gain, "gain", (n, y), what="states x outputs")
        P = arrays.matrix(projection, "projection", (None, y), what="one column per output")
        Ae = p.A if model is None else arrays.matrix(model, "model", (n, n))
        estimator = StateSpace(Ae - W @ p.C, W, -P @ p.C, P, dt=p.dt)
        signals = (*p.disturbances, *(p.faults[i] for i in arrays.positions(nuisances, p.faults, "fault")))
        sizes = dict.fromkeys(signals[len(p.disturbances) :], nuisance_size)
        return residual_over_set(self, estimator, np.eye(n), signals=signals, sizes=sizes)

    def discretize(self, dt: float) -> UncertainPlant:
        """Return the uncertain plant sampled with step ``dt``.

        Sampled matrices are not affine in the parameters of continuous ones: ``linearisation`` of what is returned
        tells what the affine form leaves out, the directions of disturbances and faults included. A set that was made
        by :meth:`from_parameters` is made anew of sampled plants of its function, so that this holds for these.
        """
        of = self.member if self.function is None else self.function
        bounds = {p.name: (p.low, p.nominal, p.high) for p in self.parameters}
        sampled = type(self).from_parameters(lambda values: of(values).discretize(dt), bounds)
        before, after = self.linearisation, sampled.linearisation
        if self.function is not None or before is None or before.exact or after is None:
            return sampled
        sampled.__dict__["linearisation"] = replace(after, exact=False, before=before)
        return sampled

    def __getstate__(self) -> dict[str, Any]:
        # functions of users are seldom importable, and their results are all here
        return vars(self) | {"function": None}

    def __repr__(self) -> str:
        kind = f"dt={self.nominal.dt:g} s" if self.nominal.is_discrete else "continuous"
        short = "" if self.linearisation is None or self.linearisation.exact else f", {self.linearisation}"
        return (
            f"UncertainPlant({self.nominal.name!r}: {self.nominal.n_states} states, {len(self.parameters)} parameters "
            f"in {len(self.channels)} channels, {kind}{short})"
        )


def make_uncertain_plant(
    nominal: Plant,
    parameters: tuple[UncertainParameter, ...],
    channels: tuple[int, ...],
    H: Matrix,
    G: Matrix,
    *,
    linearisation: Linearisation | None = None,
    plants: tuple[Plant, ...] = (),
    function: Callable[[Mapping[str, float]], Plant] | None = None,
) -> UncertainPlant:
    """Return an uncertain plant with ``[Hx; Hy]`` and ``[Gx Gu Gd Gf]``."""
    unique(tuple(p.name for p in parameters), "parameters")
    n = nominal.n_states
    sides = np.split(G, np.cumsum([n, len(nominal.inputs), len(nominal.disturbances)]), axis=1)
    parts = dict(zip(("Hx", "Hy", "Gx", "Gu", "Gd", "Gf"), map(frozen, (H[:n], H[n:], *sides)), strict=True))
    fields = {"nominal": nominal, "parameters": parameters, "channels": channels, **parts}
    new = object.__new__(UncertainPlant)
    new.__dict__.update(fields | {"linearisation": linearisation, "plants": plants, "function": function})
    return new


def visited_values(plant: UncertainPlant, inside: int, seed: int) -> NDArray[np.float64]:
    """Return parameters to look at: the nominal ones, corners (all up to 10 parameters), and points inside."""
    rng = np.random.default_rng(seed)
    k = len(plant.parameters)
    if k <= _ALL_CORNERS:
        ends = plant.vertex_values()
    else:
        ends = np.where(rng.random((2**_ALL_CORNERS, k)) < 0.5, plant.low, plant.high)
    return np.vstack([plant.nominal_values, ends, plant.sample_values(rng, inside)])
