"""Banks of observers that name the faulty actuator."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from residua.design.banks.bank import Bank, build_bank, wanted_by_scheme
from residua.design.banks.member_design import advice_for, member_design
from residua.design.core.method import ACTUATOR_FAULTS, each_scheme, method
from residua.errors import DesignError
from residua.plant import Plant


@method(
    needs=[ACTUATOR_FAULTS],
    exists_when="an observer that ignores each actuator (dedicated: all others)",
    order="k n",
    source="Chen and Patton (1999), section 3.5; Twardy and Kaczorek, part II",
    state="one estimate per member",
    faults="by code: one actuator at a time (generalized), several (dedicated)",
    decouples=True,
    singular=True,
    many=True,
    calls=each_scheme,
)
def actuator_fault_bank(
    plant: Plant,
    *,
    scheme: str = "generalized",
    observer: str = "unknown-input",
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    allow_missing: bool = False,
) -> Bank:
    r"""Design one observer per actuator, none of which any disturbance reaches.

    ``"generalized"``: observer ``i`` is decoupled from actuator ``i``, which costs one measurement, so that actuator
    ``i`` is faulty when all fire but the ``i``-th. ``"dedicated"``: observer ``i`` is decoupled from all other
    actuators, so that each fires for its own; with ``q`` disturbances and ``r`` actuators it needs more than
    ``q + r - 1`` measurements, and names faults that come together.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not. Its actuator faults are what is isolated; a plant without any
        gets one per control input. Its other faults have codes too: a sensor fault fires every observer.
    scheme : {"generalized", "dedicated"}
    observer : {"unknown-input", "reduced-order", "perfect", "minimal"}
        See :func:`sensor_fault_bank`.
    poles : sequence of complex, optional
        The same for every member.
    margin : float, optional
        Stability margin in 1/s, used without ``poles``.
    allow_missing : bool
        Whether members that do not exist are left out, and listed in ``failures``, instead of raised.

    Returns
    -------
    Bank

    Raises
    ------
    DesignError
        For each member that does not exist, which condition failed.

    See Also
    --------
    structured_bank : Any structure, faults of any kind.
    sensor_fault_bank : One observer per sensor.
    fault_estimator : The size of the fault.

    References
    ----------
    Chen and Patton (1999), section 3.5; Twardy and Kaczorek, part II.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[-1, 0], [0, -2]], [[1, 0], [0, 1]], [[1, 0], [0, 1], [1, 1]], inputs=["left", "right"])
    >>> print(rs.design.actuator_fault_bank(plant))
    generalized bank of unknown-input observers, 2 members
                             1  2
    decoupled from left      .  x
    decoupled from right     x  .
      1: left actuator
      2: right actuator
    """
    if "actuator" not in plant.fault_kinds:
        if not plant.inputs:
            raise DesignError("the plant has neither control inputs nor actuator faults")
        plant = plant.with_actuator_faults()
    actuators = {fault.name: fault.component for fault in plant.fault_list if fault.kind == "actuator"}
    return build_bank(
        plant,
        wanted_by_scheme(scheme, actuators, "decoupled from"),
        member_design(observer, plant, poles=poles, margin=margin),
        f"{scheme} bank of {observer} observers",
        allow_missing=allow_missing,
        advice=advice_for(observer),
        reference="Chen and Patton (1999), section 3.5; Twardy and Kaczorek, part II",
    )
