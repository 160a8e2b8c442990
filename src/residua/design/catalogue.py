"""What each design function needs and gives: one record per function, for tables and for suggestions."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """A design function in words.

    Attributes
    ----------
    name : str
        The function in :mod:`residua.design`.
    returns : str
        The class of what it returns.
    needs : str
        What the plant must have.
    condition : str
        When it exists.
    state : str
        What it says about the state; empty when nothing.
    faults : str
        How it tells which fault it is; empty when it does not by itself.
    size : bool
        Whether it estimates how large a fault is.
    decouples : bool
        Whether the disturbances of the plant do not reach it.
    singular : bool
        Whether ``E`` may be singular.
    order : str
        Number of states: ``n`` states, ``p`` independent outputs, ``k`` members.
    source : str
        Where the method is from.
    """

    name: str
    returns: str
    needs: str
    condition: str
    state: str
    faults: str
    size: bool
    decouples: bool
    singular: bool
    order: str
    source: str


_UIO_CONDITION = "rank [E Bd; C 0] = n + rank Bd; stable invariant zeros of (E, A, Bd, C)"

METHODS = (
    Method(
        "luenberger_observer",
        "Observer",
        "nothing more",
        "(C, A) detectable",
        "estimate, converges",
        "",
        False,
        False,
        False,
        "n",
        "Twardy and Kaczorek, part I, Theorems 1 and 2",
    ),
    Method(
        "reduced_order_observer",
        "Observer",
        "nothing more",
        "as unknown_input_observer",
        "estimate, converges; measurements enter unfiltered",
        "",
        False,
        True,
        False,
        "n - p",
        "Twardy and Kaczorek, part I, eqs. (3), (18) to (29)",
    ),
    Method(
        "unknown_input_observer",
        "Observer",
        "disturbances (or none)",
        _UIO_CONDITION,
        "estimate, converges whatever the disturbances do",
        "",
        False,
        True,
        True,
        "n",
        "Chen, Patton and Zhang (1996), eqs. (2) to (13)",
    ),
    Method(
        "descriptor_observer",
        "Observer",
        "nothing more; made for singular E",
        "as unknown_input_observer",
        "estimate, converges; measurements enter unfiltered",
        "",
        False,
        True,
        True,
        "n - p",
        "Twardy and Kaczorek, part I, eqs. (18) to (29)",
    ),
    Method(
        "perfect_observer",
        "PerfectObserver",
        "singular E or disturbances, or least_order=True",
        "rank [sE - A, -Bd; C, Dd] = n + rank Bd for every finite s",
        "the state itself, without a transient; differentiates the measurements",
        "",
        False,
        True,
        True,
        "of its filter",
        "Twardy and Kaczorek, part I, eqs. (30) to (33), Theorem 4",
    ),
    Method(
        "kalman_filter",
        "ResidualGenerator",
        "noise",
        "(C, A) detectable; noise in every measurement",
        "estimate of least variance",
        "by direction, once a constant fault has settled",
        False,
        False,
        False,
        "n",
        "Gertler (1991), eqs. (3-14) to (3-17), section 5.3",
    ),
    Method(
        "matched_filters",
        "MatchedFilters",
        "noise, faults, sampled",
        "as kalman_filter",
        "",
        "by expected response, with arrival time; one step at a time",
        True,
        False,
        False,
        "n",
        "Gertler (1991), section 5.3, eqs. (5-19) to (5-21)",
    ),
    Method(
        "detection_filter",
        "ResidualGenerator",
        "faults",
        "a stable filter keeps each fault to its direction or plane",
        "",
        "by direction, whatever its time course",
        False,
        False,
        False,
        "n per filter",
        "Chen, Patton and Zhang (1996), eqs. (14) to (18); Gertler (1991), section 5.1",
    ),
    Method(
        "robust_detection_filter",
        "ResidualGenerator",
        "faults, disturbances",
        "as unknown_input_observer and detection_filter",
        "",
        "by direction, whatever its time course",
        False,
        True,
        False,
        "n per filter",
        "Chen, Patton and Zhang (1996), eqs. (19) to (25)",
    ),
    Method(
        "decoupled_residual",
        "ResidualGenerator",
        "faults",
        "more independent outputs than unknown inputs reach; no condition on zeros",
        "",
        "",
        False,
        True,
        True,
        "least that sees all it can",
        "Massoumnia, Verghese and Willsky (1989)",
    ),
    Method(
        "structured_bank",
        "Bank",
        "faults",
        "every row attainable: rank conditions of diagnosability",
        "",
        "by code, as the structure says",
        False,
        True,
        True,
        "least for each member",
        "Gertler (1991), section 4",
    ),
    Method(
        "eigenstructure_assignment",
        "ResidualGenerator",
        "faults to ignore, or disturbances",
        "their columns can be eigenvectors of A - K C: stable zeros (left: first-order residuals, rare)",
        "",
        "",
        False,
        True,
        False,
        "at most n",
        "Gertler (1991), section 4.3, eqs. (4-5) to (4-14)",
    ),
    Method(
        "residual_generator_from_observer",
        "ResidualGenerator",
        "an observer from elsewhere: its gain, or the matrices of the general form",
        "these are stable and fulfil the conditions of a residual generator",
        "",
        "",
        False,
        True,
        True,
        "that of the observer",
        "Gertler (1991), eqs. (3-11), (3-13), (4-15) to (4-20)",
    ),
    Method(
        "primary_residuals",
        "ResidualGenerator",
        "nothing more",
        "always; form='arma': a stable plant",
        "",
        "",
        False,
        False,
        True,
        "sum of the orders of the equations",
        "Gertler (1991), eqs. (3-1), (3-2)",
    ),
    Method(
        "parity_relations",
        "ResidualGenerator",
        "nothing more",
        "as decoupled_residual",
        "",
        "",
        False,
        True,
        True,
        "sum of the orders of the relations",
        "Chow and Willsky (1984); Gertler (1991), eqs. (3-5) to (3-10), section 4.2",
    ),
    Method(
        "structured_parity",
        "Bank",
        "faults",
        "as structured_bank",
        "",
        "by code, as the structure says",
        False,
        True,
        True,
        "of each relation, at most n",
        "Gertler (1991), section 4.1, eqs. (4-1) to (4-4)",
    ),
    Method(
        "directional_parity",
        "ResidualGenerator",
        "faults, a direction for each",
        "in general: s (r - 1) < r (p - q), for s directions of r components and q signals ignored",
        "",
        "by direction, whatever its time course",
        False,
        True,
        True,
        "r times the order of the relations",
        "Gertler (1991), section 5.2, eqs. (5-9) to (5-18)",
    ),
    Method(
        "sensor_fault_bank",
        "Bank",
        "sensor faults",
        "an observer without (dedicated: with only) each sensor",
        "one estimate per member",
        "by code: one sensor at a time (generalized), several (dedicated)",
        False,
        True,
        True,
        "k n",
        "Chen and Patton (1999), section 3.4; Twardy and Kaczorek, part II",
    ),
    Method(
        "actuator_fault_bank",
        "Bank",
        "actuator faults",
        "an observer that ignores each actuator (dedicated: all others)",
        "one estimate per member",
        "by code: one actuator at a time (generalized), several (dedicated)",
        False,
        True,
        True,
        "k n",
        "Chen and Patton (1999), section 3.5; Twardy and Kaczorek, part II",
    ),
    Method(
        "fault_estimator",
        "FaultEstimator",
        "faults",
        "an unknown input observer with these faults as disturbances; their effects independent",
        "estimate that the faults do not reach",
        "by size, several at once",
        True,
        True,
        True,
        "n and one per filtered fault",
        "Sueur, eqs. (5) and (8)",
    ),
    Method(
        "sensor_fault_estimators",
        "SensorFaultEstimators",
        "sensors",
        "as fault_estimator, one sensor at a time",
        "one estimate per sensor",
        "by size, one at a time",
        True,
        True,
        True,
        "k n",
        "Sueur, eqs. (15) and (16)",
    ),
    Method(
        "inverse_form_observer",
        "InverseFormObserver",
        "faults",
        "as fault_estimator, A and H A^-1 F invertible, no fault in the outputs",
        "estimate that the faults do not reach",
        "by size, several at once",
        True,
        True,
        False,
        "n",
        "Sueur, eqs. (1) to (11)",
    ),
)


def method(name: str) -> Method:
    """Return the record of a design function.

    Examples
    --------
    >>> from residua.design.catalogue import method
    >>> method("reduced_order_observer").order
    'n - p'
    """
    return next(one for one in METHODS if one.name == name)


HEADER = ("function", "needs", "exists when", "state", "names the fault", "size", "decouples", "singular E", "order")


def table() -> list[tuple[str, ...]]:
    """Return the records as rows of text under :data:`HEADER`, for a table in the documentation."""
    return [
        (
            f":func:`~residua.design.{one.name}`",
            one.needs,
            one.condition,
            one.state or "-",
            one.faults or "-",
            _mark(one.size),
            _mark(one.decouples),
            _mark(one.singular),
            one.order,
        )
        for one in METHODS
    ]


def _mark(yes: bool) -> str:
    return "yes" if yes else "-"
