"""Models identified from recordings: the plant with its noise, the report, predictions and uncertainty."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.checks import check_probability
from residua.errors import DataError, SettingError
from residua.identify.fit_report import IdentificationReport
from residua.identify.prediction import Innovations, one_step_predictor
from residua.identify.segments import gather
from residua.linear.subspaces.rank import range_basis
from residua.plant import OperatingPoint, Perturbation, Plant, UncertainPlant
from residua.recording.time_axis import REGULAR
from residua.tolerances import RANK

#: Directions of the uncertainty that are kept, unless the caller says otherwise.
_DIRECTIONS = 6


@dataclass(frozen=True, eq=False)
class Prediction:
    """The outputs of one recording, each predicted from all rows before.

    Attributes
    ----------
    source : str
        Name of the recording.
    measured : ndarray, shape (T, outputs)
        In plant units; NaN in rows with a missing value.
    predicted : ndarray, shape (T, outputs)
        NaN there too, and in the first rows after, from which the state is estimated.
    """

    source: str
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]

    @property
    def error(self) -> NDArray[np.float64]:
        """Measured less predicted outputs, shape (T, outputs)."""
        return self.measured - self.predicted


class RecordedModel(ABC):
    """Base of models from recordings: the predictions of a plant, and the uncertainty of its matrices.

    Attributes
    ----------
    plant : Plant
        Sampled, without faults.
    """

    plant: Plant

    @abstractmethod
    def _predicted(self, Z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the predicted outputs for inputs and outputs without gaps, all in deviations from the point."""

    @abstractmethod
    def _directions(self, most: int) -> tuple[NDArray[np.float64], list[dict[str, NDArray[np.float64]]]]:
        """Return the largest standard deviations of the estimate, and their effects on the plant's matrices."""

    def predict(self, recordings: Any, y: ArrayLike | None = None) -> tuple[Prediction, ...]:
        r"""Return the one-step predictions of the outputs of recordings, in plant units.

        .. math:: \hat y_k = C x_k + D u_k, \qquad x_{k+1} = A x_k + B u_k + K (y_k - \hat y_k)

        in deviations from the operating point. The first rows of each stretch without missing values have none: of
        equations as many as the longest looks back; of a state-space model the ``past`` of the report and the delays,
        from which the state is estimated, by least squares in units of the innovations.

        Parameters
        ----------
        recordings : Recording, data frame, path, array, pair (u, y), or a list of these
            As for the identification; they need not be those that the model is from.
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
        >>> for model in (rs.identify.subspace(u, y, order=1), rs.identify.arx(u, y)):
        ...     [seen] = model.predict(u, y)
        ...     print(np.nanstd(seen.error).round(1))
        0.1
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

    def uncertain_plant(
        self, plant: Plant | None = None, *, level: float = 0.95, directions: int = _DIRECTIONS
    ) -> UncertainPlant:
        r"""Return the plant with the uncertainty of its matrices, as far as the data leave it open.

        The covariance of the estimate is :math:`\sum_k \lambda_k v_k v_k^T`; the leading directions :math:`v_k` are the
        parameters, each within :math:`\pm q \sqrt{\lambda_k}` with the quantile ``q`` of the level for all of them
        together. Of equations it is that of the coefficients, in units of the channels' standard deviations; of a
        state-space model that of the entries of ``A``, ``B``, ``C`` and ``D`` over parts of the data (the jackknife),
        which a controller that moved during the recording, or a plant that is not linear, widens.

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
        DataError
            If there are too few parts of data for a spread.
        SettingError
            If the level is no probability, the plant is not this one with faults, or there are more than 2000
            coefficients.

        Notes
        -----
        The directions that are left out are not covered. Of equations it assumes white errors: where the report calls
        them coloured, the box is too small; and where an input acts within the row (feedthrough) products of two errors
        are left out. An :class:`residua.InputOutputModel` has no uncertain form.

        Examples
        --------
        >>> import numpy as np
        >>> import residua as rs
        >>> rng = np.random.default_rng(0)
        >>> u = rng.standard_normal((2000, 1))
        >>> plant = rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1)
        >>> y = plant.system("control").simulate(u) + 0.1 * rng.standard_normal((2000, 1))
        >>> rs.identify.subspace(u, y, order=1).uncertain_plant().names
        ('model 1', 'model 2', 'model 3')
        >>> rs.identify.arx(u, y, order=1).uncertain_plant().names
        ('model 1', 'model 2')
        """
        from scipy.special import ndtri  # slow to import, and needed only here

        nominal = self.plant if plant is None else plant
        if nominal.A.shape != self.plant.A.shape or not np.array_equal(nominal.A, self.plant.A):
            raise SettingError("plant must be the plant of this model, with faults added")
        sizes, vectors = self._directions(directions)
        check_probability(level, "level")
        quantile = float(-ndtri((1 - level ** (1 / max(len(sizes), 1))) / 2))
        deltas: list[Perturbation] = []
        for k, (size, matrices) in enumerate(zip(sizes, vectors, strict=True), 1):
            Bf, Df = np.zeros(nominal.Bf.shape), np.zeros(nominal.Df.shape)
            for column, fault in enumerate(nominal.fault_list):
                if fault.kind == "actuator":
                    given = nominal.inputs.index(fault.component)
                    Bf[:, column], Df[:, column] = matrices["B"][:, given], matrices["D"][:, given]
            most = quantile * size
            for letter, M in {**matrices, "Bf": Bf, "Df": Df}.items():
                if M.any():  # a channel for each singular value
                    U, _ = range_basis(M)
                    deltas.append(Perturbation(letter, -U, U.T @ M, -most, most, [f"model {k}"] * U.shape[1]))
        return UncertainPlant(nominal, deltas)


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedModel(RecordedModel):
    """A plant from recordings, in innovation form, with its report and uncertainty.

    Attributes
    ----------
    plant : Plant
        Sampled; the operating point holds the means of the inputs and the outputs at rest with them, and the noise is
        that of the innovations: ``process = K V K'``, ``measurement = V``, ``cross = K V``.
    report : IdentificationReport
        ``print(model.report)`` shows it.
    gain : ndarray, shape (n, outputs)
        ``K``, of the stable one-step predictor.
    innovation_covariance : ndarray, shape (outputs, outputs)
        ``V``.
    resampled : tuple of Plant
        The same model from the data without each of their parts in turn, in the same coordinates; empty where the
        data are too few for that.
    """

    plant: Plant
    report: IdentificationReport
    gain: NDArray[np.float64]
    innovation_covariance: NDArray[np.float64]
    resampled: tuple[Plant, ...] = ()

    def _predicted(self, Z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the predictions for inputs and outputs without gaps, all in deviations."""
        plant, K, m, p = self.plant, self.gain, len(self.plant.inputs), self.plant.n_outputs
        first = self.report.past + plant.n_states - self.report.order
        if len(Z) <= first:
            return np.full((len(Z), p), np.nan)
        system = one_step_predictor(plant.A, plant.B, plant.C, plant.D, K, dt=plant.dt)
        from_rest = system.simulate(Z[:first])
        error = Z[:first, m:] - from_rest
        unit = np.sqrt(np.diag(self.innovation_covariance))
        unit = np.where(unit > 0, unit, np.maximum(np.abs(error).max(axis=0), np.finfo(float).tiny))
        responses = [plant.C]
        for _ in range(first - 1):
            responses.append(responses[-1] @ system.A)
        seen = np.vstack(responses) / np.tile(unit, first)[:, None]
        size = np.linalg.norm(seen, axis=0)
        size = np.where(size > 0, size, 1.0)
        start = np.linalg.lstsq(seen / size, (error / unit).ravel(), rcond=RANK)[0] / size
        predicted = system.simulate(Z, start)
        predicted[:first] = np.nan
        return predicted

    def _directions(self, most: int) -> tuple[NDArray[np.float64], list[dict[str, NDArray[np.float64]]]]:
        """Return the sizes of the leading directions of the jackknife's covariance, and their effects on matrices."""
        if len(self.resampled) < 3:
            raise DataError("too few parts of data to tell how uncertain the model is: identify from more rows")
        names = ("A", "B", "C", "D")
        nominal = [getattr(self.plant, name) for name in names]
        # entries are compared in units of their rows and columns: those of signals of mean square one
        rows = np.array([np.concatenate([getattr(one, name).ravel() for name in names]) for one in self.resampled])
        count = len(rows)
        spread = (rows - rows.mean(axis=0)) * np.sqrt((count - 1) / count)
        unit = np.linalg.norm(spread, axis=0)
        unit = np.where(unit > 0, unit, 1.0)
        basis, decision = range_basis((spread / unit).T)
        keep = min(most, decision.rank)
        vectors = []
        for row in basis.T[:keep] * unit:
            parts = np.split(row, np.cumsum([M.size for M in nominal])[:-1])
            vectors.append({name: part.reshape(M.shape) for name, part, M in zip(names, parts, nominal, strict=True)})
        return decision.singular_values[:keep], vectors

    def __repr__(self) -> str:
        return f"IdentifiedModel(order {self.report.order} by {self.report.method}, {self.plant!r})"


def plant_of(
    model: Innovations,
    inputs: Sequence[str],
    outputs: Sequence[str],
    dt: float,
    reference: NDArray[np.float64],
    scale: NDArray[np.float64],
    **options: object,
) -> tuple[Plant, NDArray[np.float64], NDArray[np.float64]]:
    """Return the plant of a model in innovation form, in the units of the recordings, with its gain and covariance.

    ``reference`` was subtracted from the channels, which were then divided by ``scale``.
    """
    m = len(inputs)
    su, sy = scale[:m], scale[m:]
    _, level, _ = model.at_rest()
    plant = Plant(
        model.A,
        model.B / su,
        sy[:, None] * model.C,
        sy[:, None] * model.D / su,
        dt=dt,
        inputs=inputs,
        outputs=outputs,
        operating_point=OperatingPoint(tuple(reference[:m]), tuple(reference[m:] + sy * level)),
        **options,  # pyright: ignore[reportArgumentType]
    )
    V = sy[:, None] * model.covariance * sy
    K = model.K / sy
    values, vectors = np.linalg.eigh(model.covariance)
    root = sy[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    if root.any():
        plant = plant.with_noise_input(K @ root, root)
    return plant, K, V


def with_input_delays(plant: Plant, delays: Mapping[str, int]) -> Plant:
    """Return a sampled plant without faults and disturbances whose inputs act so many samples later.

    Each sample of delay is a state: ``w1[k+1] = u[k]``, ``w2[k+1] = w1[k]``, and so on.
    """
    total = sum(delays.values())
    if not total:
        return plant
    n, m = plant.n_states, len(plant.inputs)
    A, C = np.zeros((n + total, n + total)), np.zeros((plant.n_outputs, n + total))
    B, D = np.zeros((n + total, m)), np.array(plant.D)
    A[:n, :n], C[:, :n], B[:n] = plant.A, plant.C, plant.B
    first = n
    for name, rows in delays.items():
        j = plant.inputs.index(name)
        if not rows:
            continue
        last = first + rows - 1
        A[:n, last], C[:, last], D[:, j] = plant.B[:, j], plant.D[:, j], 0.0
        B[:n, j], B[first, j] = 0.0, 1.0
        A[range(first + 1, last + 1), range(first, last)] = 1.0
        first += rows
    delayed = Plant(
        A,
        B,
        C,
        D,
        dt=plant.dt,
        inputs=plant.inputs,
        outputs=plant.outputs,
        name=plant.name,
        operating_point=plant.operating_point,
        units=plant.units,
    )
    if not plant.Bw.shape[1]:
        return delayed
    return delayed.with_noise_input(np.vstack([plant.Bw, np.zeros((total, plant.Bw.shape[1]))]), plant.Dw)


def with_channel_faults(plant: Plant, *, sensors: bool, actuators: bool) -> Plant:
    """Return the plant with a fault of every output, of every input that has an effect, or both."""
    plant = plant.with_sensor_faults() if sensors else plant
    idle = idle_inputs(plant)
    effective = [name for name in plant.inputs if name not in idle]
    return plant.with_actuator_faults(effective) if actuators and effective else plant


def idle_inputs(plant: Plant) -> list[str]:
    """Return the inputs that do nothing in the model."""
    return [name for name, b, d in zip(plant.inputs, plant.B.T, plant.D.T, strict=True) if not (b.any() or d.any())]
