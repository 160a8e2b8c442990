"""Banks of observers that name the faulty sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from residua.design.banks.bank import Bank, build_bank, wanted_by_scheme
from residua.design.banks.member_design import advice_for, member_design
from residua.design.core.method import SENSOR_FAULTS, each_scheme, method
from residua.errors import DesignError
from residua.plant import Plant


@method(
    needs=[SENSOR_FAULTS],
    exists_when="an observer without (dedicated: with only) each sensor",
    order="k n",
    source="Chen and Patton (1999), section 3.4; Twardy and Kaczorek, part II",
    state="one estimate per member",
    faults="by code: one sensor at a time (generalized), several (dedicated)",
    decouples=True,
    singular=True,
    many=True,
    calls=each_scheme,
)
def sensor_fault_bank(
    plant: Plant,
    *,
    scheme: str = "generalized",
    observer: str = "unknown-input",
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    allow_missing: bool = False,
) -> Bank:
    r"""Design one observer per sensor, none of which any disturbance reaches.

    ``"generalized"``: observer ``j`` uses all measurements but ``y_j``, so that sensor ``j`` is faulty when all
    fire but the ``j``-th. It names single faults, and leaves freedom to decouple disturbances. ``"dedicated"``:
    observer ``j`` uses ``y_j`` alone (and the sensors that have no fault in the model), so that each fires for its own
    sensor; it names faults that come together, but these measurements must suffice to observe the plant, and
    disturbances use them up.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not. Its sensor faults are what is isolated; a plant without any gets
        one per output. Its other faults have codes too: an actuator fault fires every observer that sees it.
    scheme : {"generalized", "dedicated"}
    observer : {"unknown-input", "reduced-order", "perfect", "minimal"}
        What the members are: full-order unknown input observers, observers of order n - p whose residual is one
        measurement held out, perfect observers, or :func:`decoupled_residual`, which exists whenever any does.
    poles : sequence of complex, optional
        The same for every member.
    margin : float, optional
        Stability margin in 1/s, used without ``poles``.
    allow_missing : bool
        Whether members that do not exist are left out, and listed in ``failures``, instead of raised.

    Returns
    -------
    Bank
        With an observer per member (``bank.observers``), except for ``"minimal"``.

    Raises
    ------
    DesignError
        For each member that does not exist, which condition failed: among others when the remaining measurements are
        all used up by the disturbances, so that its residual would be zero whatever fails.

    See Also
    --------
    structured_bank : Any structure, faults of any kind.
    actuator_fault_bank : One observer per actuator.
    sensor_fault_estimators : The size of the fault of each sensor.

    References
    ----------
    Chen and Patton (1999), section 3.4; Clark (1978) (dedicated); Frank (1990) (generalized);
    Twardy and Kaczorek, part II.

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.design.sensor_fault_bank(rs.library.jet_engine().without_faults().with_sensor_faults([0, 1, 2])))
    generalized bank of unknown-input observers, 3 members
    ...
    """
    if "sensor" not in plant.fault_kinds:
        plant = plant.with_sensor_faults()
    return build_bank(
        plant,
        wanted_by_scheme(scheme, _sensors(plant), "without"),
        member_design(observer, plant, poles=poles, margin=margin),
        f"{scheme} bank of {observer} observers",
        allow_missing=allow_missing,
        advice=advice_for(observer),
        reference="Chen and Patton (1999), section 3.4; Twardy and Kaczorek, part II",
    )


def _sensors(plant: Plant) -> dict[str, str]:
    """Return the output of each sensor fault, or raise for one that is not in one output alone."""
    out = {}
    for i, fault in enumerate(plant.fault_list):
        if fault.kind != "sensor":
            continue
        at = np.flatnonzero(plant.Df[:, i])
        if len(at) != 1 or np.any(plant.Bf[:, i]):
            raise DesignError(f"sensor fault {fault.name!r} must enter one output and no state; use structured_bank")
        out[fault.name] = plant.outputs[int(at[0])]
    return out
