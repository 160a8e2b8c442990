"""Detection filters that disturbances cannot reach."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from residua.analysis.existence import unknown_input_observer_existence
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import method
from residua.design.core.needs import FAULTS, disturbances
from residua.design.detection_filters.detection_filter import REFERENCES, Scaling, directional_filters
from residua.design.detection_filters.directional_gain import Poles
from residua.design.observers.unknown_input_observer import REFERENCE, error_pair
from residua.errors import DesignError
from residua.plant import Plant
from residua.words import counted, used_up


@method(
    needs=[FAULTS, disturbances("disturbances", "detection_filter is the same")],
    exists_when="as unknown_input_observer and detection_filter",
    order="n per filter",
    source="Chen, Patton and Zhang (1996), eqs. (19) to (25)",
    faults="by direction, whatever its time course",
    decouples=True,
)
def robust_detection_filter(
    plant: Plant,
    *,
    poles: Poles = None,
    margin: float | None = None,
    faults: Iterable[str] | None = None,
    H0: ArrayLike | None = None,
    scaling: Scaling = "plant",
) -> ResidualGenerator:
    r"""Design a filter that no disturbance reaches and that tells faults apart by direction.

    An unknown input observer, :math:`r = (I - CH) y - C z`, whose gain :math:`K_1` is that of a detection
    filter for the pair :math:`(C, A_1)` and the fault directions :math:`T l_i`:

    (a) ``H`` and ``T`` from the disturbances, (b) :math:`A_1 = T A`, (c) ``K1`` so that every fault keeps to
    its own line (:math:`C T l_i`) or plane, (d) :math:`K = K_1 + F H`. The residual of a sensor fault ``j``
    stays in :math:`R_j = \operatorname{span}\{I_j, C k_{1j}, C h_j\}`; ``subspaces`` holds the part of it
    that the residual can reach.

    Parameters
    ----------
    plant : Plant
        With at least one disturbance and one fault.
    poles : sequence of complex, or mapping of fault name to sequence, optional
        As for :func:`detection_filter`.
    margin : float, optional
        Stability margin in 1/s for the poles that ``poles`` leaves open.
    faults : iterable of str, optional
        The faults to be kept apart; all faults of the plant when omitted.
    H0 : array_like, shape (n, outputs), optional
        The free matrix of the general decoupling gain, in the units of the plant; zero when omitted.
    scaling : {"plant", "even"}
        The units of the outputs in which a pseudoinverse is the smallest: those of the plant, as in the paper, or
        balanced ones, so that the filter does not depend on the units of the plant.

    Returns
    -------
    ResidualGenerator
        ``observer`` holds ``F, T, K, H, K1, K2, A1``.

    Raises
    ------
    DesignError
        If no unknown input observer exists, the disturbances use up all measurements, they hide every
        fault, or no stable directional filter exists.

    See Also
    --------
    detection_filter : Without disturbances.
    structured_bank : Names by code, whenever any method does.
    directional_parity : Directions of one's choice, with disturbances decoupled.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant; disturbances enter where the model says, and may be
    any signals; one fault is there at a time. Costs: as many independent measurements as disturbances are
    used up, so fewer faults can be kept apart than by the plain filter.

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (19) to (25), Definitions 5 and 6.

    Examples
    --------
    >>> import residua as rs
    >>> flt = rs.design.robust_detection_filter(rs.library.jet_engine(), poles=[-3, -3, -3])
    >>> {name: basis.shape[1] for name, basis in flt.subspaces.items() if name.startswith("n_")}
    {'n_low sensor': 2, 'n_high sensor': 2}
    """
    plant = plant.explicit()
    existence = unknown_input_observer_existence(plant)
    if not existence:
        raise DesignError("; ".join(existence.reasons))
    if not existence.useful:
        raise DesignError(
            f"{used_up(plant.n_outputs)} to decouple {counted(len(plant.disturbances), 'disturbance')}: "
            "nothing is left to see faults with; add a sensor or decouple fewer disturbances"
        )
    model = plant.balanced
    pair = error_pair(model, model.disturbances, existence.rank_E.rank, scaling, H0)
    base = Evidence(
        method="robust detection filter",
        ranks={"rank(CE)": existence.rank_CE, "rank(E)": existence.rank_E} if pair.decoupled else {},
        conditions={"|T E|": float(np.linalg.norm(pair.T @ (model.disturbances[0] - pair.G @ model.disturbances[1])))},
        notes=pair.notes,
        references=(REFERENCE, *REFERENCES),
    )
    return directional_filters(pair, poles, margin, faults, base)
