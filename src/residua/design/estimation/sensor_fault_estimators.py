"""One fault estimator per sensor."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from residua import arrays
from residua.design.core.method import method
from residua.design.estimation.fault_estimator import FaultEstimator, fault_estimator
from residua.errors import AccuracyError, DesignError
from residua.plant import Plant
from residua.shown import Shown
from residua.words import counted


@dataclass(frozen=True, eq=False, repr=False)
class SensorFaultEstimators(Shown, Mapping[str, FaultEstimator]):
    """Fault estimators by the name of the sensor that each is for; a mapping.

    Each assumes that its own sensor alone is faulty. Which one is right shows in
    :meth:`FaultEstimator.consistency`: its output errors stay zero, while those of the others answer.

    Attributes
    ----------
    members : mapping of str to FaultEstimator
    failures : mapping of str to str
        Sensors whose fault cannot be estimated, and why.
    """

    members: Mapping[str, FaultEstimator] = field(repr=False)
    failures: Mapping[str, str]

    def __getitem__(self, name: str) -> FaultEstimator:
        if name in self.failures:
            raise KeyError(f"no estimator for {name!r}: {self.failures[name]}")
        return self.members[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.members)

    def __len__(self) -> int:
        return len(self.members)

    def __str__(self) -> str:
        lines = [f"{name}: {estimator}" for name, estimator in self.members.items()]
        return "\n".join(lines + [f"{name}: none, {reason}" for name, reason in self.failures.items()])


@method(
    needs=["sensors"],
    exists_when="as fault_estimator, one sensor at a time",
    order="k n",
    source="Sueur, eqs. (15) and (16)",
    state="one estimate per sensor",
    faults="by size, one at a time",
    size=True,
    decouples=True,
    singular=True,
    many=True,
)
def sensor_fault_estimators(
    plant: Plant,
    *,
    outputs: Iterable[str | int] | str | None = None,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    bandwidth: float | None = None,
) -> SensorFaultEstimators:
    """Design one fault estimator for each sensor, each ignoring what its own sensor reads.

    One observer for all sensors at once would have all poles of the plant as fixed poles, and could not tell the
    sensors apart; a bank of one for each has neither weakness, as long as one sensor fails at a time.

    Parameters
    ----------
    plant : Plant
        Sensor faults that it does not have are added.
    outputs : sequence of str or int, optional
        The sensors; all when omitted.
    poles, margin, bandwidth
        Of every estimator; see :func:`fault_estimator`.

    Returns
    -------
    SensorFaultEstimators
        Mapping of sensor to :class:`FaultEstimator`, with the sensors for which there is none.

    Raises
    ------
    DesignError
        If there is none for any sensor.
    AccuracyError
        If what was computed missed its check for every sensor.

    See Also
    --------
    fault_estimator : Several faults at once.
    sensor_fault_bank : Names the sensor.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, eqs. (15) and (16).

    Examples
    --------
    >>> import residua as rs
    >>> bank = rs.design.sensor_fault_estimators(rs.library.vtol(), poles=[-30, -40, -40, -50])
    >>> list(bank)
    ['v_horizontal', 'v_vertical', 'pitch']
    """
    names = [plant.outputs[i] for i in arrays.different_positions(outputs, plant.outputs, "output")]
    faults = {fault.component: fault.name for fault in reversed(plant.fault_list) if fault.kind == "sensor"}
    missing = [name for name in names if name not in faults]
    plant = plant.with_sensor_faults(missing) if missing else plant
    faults |= dict(zip(missing, plant.faults[len(plant.faults) - len(missing) :], strict=True))
    members: dict[str, FaultEstimator] = {}
    errors: dict[str, Exception] = {}
    for name in names:
        try:
            members[name] = fault_estimator(
                plant, faults=[faults[name]], poles=poles, margin=margin, bandwidth=bandwidth
            )
        except (DesignError, AccuracyError) as error:
            errors[name] = error
    if not members:
        reasons = "; ".join(f"{name}: {error}" for name, error in errors.items())
        if all(isinstance(error, AccuracyError) for error in errors.values()):  # there may be some
            raise AccuracyError(f"the estimates of {counted(len(errors), 'sensor')} missed a check: {reasons}")
        raise DesignError(f"no fault of a sensor can be estimated: {reasons}")
    return SensorFaultEstimators(members, {name: str(error) for name, error in errors.items()})
