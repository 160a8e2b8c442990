"""Input-output models as state-space plants of least order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.errors import AccuracyError, ModelError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import dies_out, modes_with_uncertainty
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision, spectral_norm
from residua.linear.systems.state_space import StateSpace
from residua.plant.loewner import loewner, loewner_part
from residua.plant.observer_form import (
    ReachablePart,
    check_response,
    observer_form,
    polynomial_terms,
    reachable_part,
    response_error,
    response_points,
    unit_of_variable,
)
from residua.plant.plant import Plant

if TYPE_CHECKING:
    from residua.plant.input_output_model import InputOutputModel

#: A removed mode this near to a pole that stays, relative to its size, is another copy of that pole.
_COPY = 1e-4
#: The weakest coupling of those that count is that many times the tolerance, or the order is not clear.
_CLEAR = 1e3
_CONDITIONED = (
    "the equations are too badly conditioned; try another rtol, a model of lower order or in other units, or start "
    "from the state-space plant"
)


@dataclass(frozen=True, eq=False)
class Realization:
    """A state-space realisation of input-output equations.

    Attributes
    ----------
    plant : Plant
    removed_modes : ndarray of complex
        Modes of the equations that no input reaches, common factors of them: no transfer function has them.
    error : float
        Largest error of the frequency response, of each entry relative to itself or to a thousandth of its peak.
    decisions : tuple of RankDecision
        How the removed modes were told from the others.
    """

    plant: Plant
    removed_modes: NDArray[np.complex128]
    error: float
    decisions: tuple[RankDecision, ...]


def realize_input_output(
    model: InputOutputModel, *, rtol: float = DEFAULT_RTOL, tolerance: float = 1e-6
) -> Realization:
    r"""Return a state-space plant of least order with the transfer functions of an input-output model.

    The equations are put into observer form, from which the part that no input, disturbance or fault reaches is removed
    by the staircase: common factors of an equation, and the second and further copies of a mode that several outputs
    have in their equations. Copies that rounding of the coefficients sets apart are told from modes by the singular
    values of the Loewner matrix of the response, where these have a gap. A removed mode must be stable, or a copy of a
    pole that stays.

    Parameters
    ----------
    model : InputOutputModel
    rtol : float
        For the rank decisions, in balanced units.
    tolerance : float
        Largest error of the frequency response, of each entry relative to itself or to a thousandth of its peak.

    Returns
    -------
    Realization

    Raises
    ------
    ModelError
        If a mode that is not stable is in the equations, but in no transfer function.
    AccuracyError
        If the frequency response is missed by more than the tolerance, or the order is not clear: poles of equations of
        high degree, or far from the others, come out so inexactly that the copies of one mode look like several.

    References
    ----------
    Mayo and Antoulas (2007), Linear Algebra and its Applications 425, 634-662 (the Loewner matrix).

    Examples
    --------
    >>> import residua as rs
    >>> io = rs.InputOutputModel([[1, -0.9, 0.2]], [[[1.5, -0.6]]])  # (z - 0.4) on both sides
    >>> found = io.realization()
    >>> found.plant.n_states, found.removed_modes.round(12), found.plant.A.round(12)
    (1, array([0.4+0.j]), array([[0.5]]))
    """
    # a continuous model in the unit of time that balances its powers
    unit = 1.0 if model.is_discrete else unit_of_variable(model.H, model.right_side())
    scaled = model if unit == 1.0 else model._in_other_time(1 / unit)
    whole = observer_form(scaled.H, scaled.right_side(), scaled.outputs, scaled.dt, rtol)
    part, error = _smallest_part(scaled, whole, rtol, tolerance)
    poles, moved = modes_with_uncertainty(part.system.A)
    size = max(spectral_norm(part.system.A), float(np.abs(part.removed).max(initial=0.0)))
    lost = lost_modes(part.removed, part.uncertainty, poles, moved, scaled.dt, size)
    if lost:
        raise ModelError(
            f"mode {describe_modes(unit * np.array(lost))} is in the equations but no input, disturbance or fault "
            "reaches it, and it is not stable: a plant without it would not behave like these equations; divide the "
            "common factor out of the equations if it does not belong to the plant, or add the disturbance or fault "
            "that reaches it"
        )
    system = part.system.replaced(A=unit * part.system.A, B=unit * part.system.B)
    return Realization(_plant(model, system), unit * part.removed, error, part.decisions)


def _smallest_part(
    model: InputOutputModel, whole: StateSpace, rtol: float, tolerance: float
) -> tuple[ReachablePart, float]:
    """Return the reachable part of least order with the frequency response of the model, and its error.

    A staircase takes out what no input reaches. Rounding of the coefficients makes the copies of a mode differ, so that
    the inputs seem to reach them a little: singular values of the response tell these from modes.
    """
    right = model.right_side()
    points = response_points(whole.poles(), model.dt)
    response, terms = model.transfer(points), polynomial_terms(model.H, right, points)

    def missed(system: StateSpace) -> float:
        return response_error(system.evaluate(points), response, terms)

    part = reachable_part(whole)
    error, order = missed(part.system), part.system.n_states
    tiny = np.finfo(float).tiny
    ratios = [one.smallest_kept / max(one.tolerance, tiny) for one in part.decisions if one.rank]
    margin = min(ratios, default=np.inf)  # the weakest coupling that counts, in tolerances
    clear = error <= tolerance and margin >= _CLEAR
    if order:
        differences = loewner(model.H, right, whole)
        for k in range(order if clear else whole.n_states + 1):
            decided = differences.decided(k)
            largest = float(decided.singular_values.max(initial=0.0))
            gap = decided.tolerance <= tolerance * largest and decided.smallest_kept >= _CLEAR * decided.tolerance
            if gap and missed(differences.system(k, whole)) <= tolerance:
                smaller = loewner_part(differences, k, whole)
                return smaller, missed(smaller.system)
    check_response(error, tolerance, f"the realisation of order {order}", _CONDITIONED)
    if not clear:
        raise AccuracyError(
            f"the order of the plant is not clear: {order} of {whole.n_states} modes count as reached with "
            f"rtol={rtol:.3g}, the weakest by {margin:.2g} times the tolerance, and no lower order keeps the "
            f"frequency response to {tolerance:.2g}; {_CONDITIONED}"
        )
    return part, error


def lost_modes(
    removed: NDArray, uncertainty: NDArray, kept: NDArray, moved: NDArray, dt: float, size: float
) -> list[complex]:
    """Return the removed modes that are not stable, and that no remaining pole is equal to.

    ``uncertainty`` and ``moved`` are what rounding does to removed modes and to remaining poles, ``size`` that of the
    system.
    """
    unstable = ~dies_out(removed, uncertainty, dt, size)
    near = np.maximum(10 * (uncertainty[:, None] + moved), _COPY * (np.ones(1) if dt else np.abs(removed)[:, None]))
    copied = np.any(np.abs(kept - removed[:, None]) <= near, axis=1)
    return removed[unstable & ~copied].tolist()


def _plant(model: InputOutputModel, system: StateSpace) -> Plant:
    u, d = len(model.inputs), len(model.disturbances)
    B, D = np.hsplit(system.B, [u, u + d]), np.hsplit(system.D, [u, u + d])
    return Plant(
        system.A,
        B[0],
        system.C,
        D[0],
        dt=model.dt,
        inputs=model.inputs,
        outputs=model.outputs,
        name=model.name,
        operating_point=model.operating_point,
        units=model.units,
        description=model.description,
    )._with(
        Bd=frozen(B[1]),
        Dd=frozen(D[1]),
        disturbances=model.disturbances,
        Bf=frozen(B[2]),
        Df=frozen(D[2]),
        fault_list=model.fault_list,
    )
