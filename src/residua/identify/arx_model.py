"""Equations identified from recordings: as an input-output model, as a plant with its noise, and how uncertain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import DataError, SettingError
from residua.identify.arx_report import EquationReport
from residua.identify.equations import Equations
from residua.identify.fit_report import SteadyGain
from residua.identify.identified_model import (
    Prediction,
    plant_of,
    uncertain_along,
    with_faults_of,
    with_input_delays,
)
from residua.identify.segments import gather
from residua.linear import PolynomialMatrix
from residua.linear.subspaces.rank import range_basis
from residua.plant import InputOutputModel, Plant, UncertainPlant
from residua.recording.time_axis import REGULAR
from residua.tolerances import POLE

Matrix = NDArray[np.float64]
#: Directions of the uncertainty that are kept, unless the caller says otherwise.
_DIRECTIONS = 6
#: Coefficients whose covariance is taken apart at most.
_MOST_COEFFICIENTS = 2000


@dataclass(frozen=True, eq=False, repr=False)
class ArxModel:
    """Linear equations from recordings, one for each output, and what is known of them.

    Attributes
    ----------
    model : InputOutputModel
        The equations, for parity relations; ``with_sensor_faults()`` and the like add faults.
    plant : Plant
        The same in state space, with the equation errors as its noise, in innovation form: a state for each row of the
        past of each equation, and for each row of delay.
    report : EquationReport
        ``print(model.report)`` shows it; its ``equations`` have the coefficients with their covariance.
    innovation_covariance : ndarray, shape (outputs, outputs)
        Of the equation errors.
    basis : Basis
        What makes the plant of the coefficients.
    """

    model: InputOutputModel
    plant: Plant
    report: EquationReport
    innovation_covariance: Matrix
    basis: Basis = field(repr=False)

    @property
    def covariance(self) -> Matrix:
        """Covariance of the coefficients of all equations, in the order of ``report.equations`` and their terms.

        In the units of the channels, shape (coefficients, coefficients).
        """
        size = np.concatenate(self.basis.scale())
        return self.basis.equations.covariance * np.outer(size, size)

    def uncertain_plant(
        self, plant: Plant | None = None, *, level: float = 0.95, directions: int = _DIRECTIONS
    ) -> UncertainPlant:
        r"""Return the plant with the uncertainty of its coefficients.

        The covariance of the coefficients of all equations is :math:`\sum_k \lambda_k v_k v_k^T`, in units of the
        channels' standard deviations; the leading directions :math:`v_k` are the parameters, each within
        :math:`\pm q \sqrt{\lambda_k}` with the quantile ``q`` of the level for all of them together.

        Parameters
        ----------
        plant : Plant, optional
            The model's plant with faults; :attr:`plant` when omitted. The columns of actuator faults vary with those
            of their inputs.
        level : float
            Probability that a Gaussian estimate lies in the box.
        directions : int
            Directions that are kept, the largest ones first.

        Raises
        ------
        SettingError
            If the level is no probability, the plant is not this one with faults, or there are more than 2000
            coefficients.

        Notes
        -----
        An :class:`residua.InputOutputModel` has no uncertain form: designs from its equations take the nominal one.

        Assumes white equation errors: where the report calls them coloured, the box is too small. What the directions
        that are left out would add is not covered, and where an input acts within the row (feedthrough) products of
        two errors are left out.

        Examples
        --------
        >>> import numpy as np
        >>> import residua as rs
        >>> rng = np.random.default_rng(0)
        >>> u = rng.standard_normal((2000, 1))
        >>> plant = rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1)
        >>> y = plant.system("control").simulate(u) + 0.1 * rng.standard_normal((2000, 1))
        >>> model = rs.identify.arx(u, y, order=1)
        >>> model.uncertain_plant().names
        ('model 1', 'model 2')
        """
        nominal = with_faults_of(self.plant, plant)
        values, vectors = self.basis.directions(directions)
        return uncertain_along(nominal, values, vectors, level)

    def predict(self, recordings: Any, y: ArrayLike | None = None) -> tuple[Prediction, ...]:
        r"""Return the one-step predictions of the outputs of recordings by the equations, in plant units.

        The first rows of each stretch without missing values, as many as the longest equation looks back, have none.

        Parameters
        ----------
        recordings : Recording, data frame, path, array, pair (u, y), or a list of these
            As in :func:`residua.identify.arx`; they need not be those that the model is from.
        y : array_like, shape (time, outputs), optional

        Returns
        -------
        tuple of Prediction
            One for each recording.

        Raises
        ------
        DataError
            If a channel is missing, the step is another, or no row is complete.

        Examples
        --------
        >>> import numpy as np
        >>> import residua as rs
        >>> rng = np.random.default_rng(0)
        >>> u = rng.standard_normal((2000, 1))
        >>> plant = rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1)
        >>> y = plant.system("control").simulate(u) + 0.1 * rng.standard_normal((2000, 1))
        >>> [seen] = rs.identify.arx(u, y).predict(u, y)
        >>> float(np.nanstd(seen.error).round(1))
        0.1
        """
        plant = self.plant
        gathered = gather(recordings, y, inputs=plant.inputs, outputs=plant.outputs)
        if gathered.timed and abs(gathered.dt - plant.dt) > REGULAR * plant.dt:
            raise DataError(f"the model has a step of {plant.dt:g} s, the recordings have {gathered.dt:g} s")
        point, m = np.array([*plant.operating_point.inputs, *plant.operating_point.outputs]), len(plant.inputs)
        shapes = [(rows, plant.n_outputs) for rows in gathered.samples]
        measured, predicted = ([np.full(shape, np.nan) for shape in shapes] for _ in range(2))
        for segment in gathered.segments:
            Z = segment.rows(0, len(segment))
            rows = slice(segment.start, segment.stop)
            measured[segment.recording][rows] = Z[:, m:]
            predicted[segment.recording][rows] = self._predicted(Z - point) + point[m:]
        return tuple(map(Prediction, gathered.sources, measured, predicted))

    def _predicted(self, Z: Matrix) -> Matrix:
        """Return the predictions for inputs and outputs without gaps, all in deviations."""
        channels = {name: i for i, name in enumerate(self.plant.inputs + self.plant.outputs)}
        equations = self.report.equations
        past = max((row for one in equations for _, row in one.terms), default=0)
        out = np.full((len(Z), len(equations)), np.nan)
        if len(Z) <= past:
            return out
        out[past:] = 0.0
        for i, one in enumerate(equations):
            for (name, row), value in zip(one.terms, one.coefficients, strict=True):
                out[past:, i] += value * Z[past - row : len(Z) - row, channels[name]]
        return out

    def __repr__(self) -> str:
        orders = ", ".join(str(one.order) for one in self.report.equations)
        return f"ArxModel(orders {orders}, {self.plant!r})"


@dataclass(frozen=True, eq=False)
class Basis:
    """Equations in units of the factor with all that makes a plant of them, for variations of the coefficients."""

    equations: Equations
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    reference: Matrix
    units: Matrix
    delays: Mapping[str, int]

    def plant(self, equations: Equations, **options: object) -> tuple[Plant, Matrix]:
        """Return the plant of equations in the units of the recordings, and the covariance of their errors."""
        around = (self.inputs, self.outputs, self.dt, self.reference, self.units)
        made, _, V = plant_of(equations.innovations(), *around, **options)
        return with_input_delays(made, self.delays), V

    def scale(self) -> list[Matrix]:
        """Return what takes the coefficients of each equation to the units of the recordings."""
        m = len(self.inputs)
        return [
            self.units[m + i] / np.array([self.units[channel] for channel, _ in one.terms])
            for i, one in enumerate(self.equations.each)
        ]

    def directions(self, most: int) -> tuple[Matrix, list[dict[str, Matrix]]]:
        """Return the largest standard deviations of the coefficients, and what each does to the plant's matrices."""
        count = sum(len(one.terms) for one in self.equations.each)
        if count > _MOST_COEFFICIENTS:
            raise SettingError(
                f"the covariance of {count} coefficients, over {_MOST_COEFFICIENTS}, is too large to take apart: "
                "ask for fewer, with past_of='own' or a lower order"
            )
        root, decision = range_basis(self.equations.covariance)
        keep = min(most, decision.rank)
        sizes = np.sqrt(decision.singular_values[:keep])
        values = np.concatenate([one.values for one in self.equations.each])
        made = []
        for size, direction in zip(sizes, root.T, strict=False):
            step = size if size > 0 else 1.0
            up, down = (self.plant(self.equations.with_values(values + sign * step * direction))[0] for sign in (1, -1))
            made.append({name: (getattr(up, name) - getattr(down, name)) / (2 * step) for name in ("A", "B", "C", "D")})
        return sizes, made

    def model(self, *, name: str, units: Mapping[str, str] | None, plant: Plant) -> InputOutputModel:
        """Return the equations as polynomials, in the units of the recordings."""
        m, p, late = len(self.inputs), len(self.outputs), max(self.delays.values(), default=0)
        past = self.equations.past
        theta = self.equations.coefficients() * self.units[m:, None] / self.units
        H, G = np.zeros((past + 1, p, p)), np.zeros((past + late + 1, p, m))
        H[0], H[1:] = np.eye(p), -theta[1:, :, m:]
        for j, given in enumerate(self.inputs):
            rows = self.delays.get(given, 0)
            G[rows : rows + past + 1, :, j] = theta[:, :, j]
        return InputOutputModel(
            PolynomialMatrix(H),
            PolynomialMatrix(G),
            dt=self.dt,
            variable="1/z",
            inputs=self.inputs,
            outputs=self.outputs,
            name=name,
            units=units,
            operating_point=plant.operating_point,
        )


def steady_gain(basis: Basis) -> SteadyGain | None:
    r"""Return what constant inputs do in the end, with the standard errors that those of the coefficients make.

    .. math:: S = M^{-1} N, \quad M = I - \sum_l A_l, \quad N = \sum_l B_l, \qquad dS = M^{-1} (dN + \sum_l dA_l\, S)
    """
    equations, m = basis.equations, len(basis.inputs)
    theta = equations.coefficients().sum(axis=0)
    poles = np.linalg.eigvals(equations.innovations().A)
    if not m or (len(poles) and np.abs(poles - 1).min() < POLE):
        return None
    M = np.linalg.inv(np.eye(len(theta)) - theta[:, m:])
    gain = M @ theta[:, :m]
    seen = np.vstack([np.eye(m), gain])  # what a channel is at rest for each input
    variance = np.zeros(gain.shape)
    for r, j in np.ndindex(gain.shape):
        slopes = [M[r, i] * seen[[c for c, _ in one.terms], j] for i, one in enumerate(equations.each)]
        variance[r, j] = equations.variance(slopes)
    scale = basis.units[m:, None] / basis.units[:m]
    return SteadyGain(gain * scale, np.sqrt(variance) * scale)
