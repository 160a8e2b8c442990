"""The residual that ignores chosen faults and all disturbances, whenever one exists."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import FAULTS, method
from residua.design.observers.observer import plant_filter
from residua.design.observers.observer_gain import asked, default_weights, gain_evidence
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.observer_gain import ObserverGain, observer_gain
from residua.linear.subspaces.quotient import Quotient, observable_split, without_rounding
from residua.linear.subspaces.rank import decide_rank
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant
from residua.tolerances import BALANCED_RANK, NEAR, RESPONSE_ROUNDING, above_rounding
from residua.words import used_up

Matrix = NDArray[np.float64]


@method(
    needs=[FAULTS],
    exists_when="more independent outputs than unknown inputs reach; no condition on zeros",
    order="least that sees all it can",
    source="Massoumnia, Verghese and Willsky (1989)",
    decouples=True,
    singular=True,
)
def decoupled_residual(
    plant: Plant,
    *,
    insensitive_to: Iterable[str | int] | str = (),
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    gain: str | None = None,
) -> ResidualGenerator:
    r"""Design a residual that neither the disturbances nor the named faults reach, whatever their time course.

    The smallest unobservability subspace ``S`` that holds everything to be ignored is divided out; what is left
    of the plant, :math:`z = P^T x` with :math:`P^T S = 0`, is observed through the outputs that do not see ``S``:

    .. math:: \dot z = (A_0 - G_0 C_0) z + K y + G u, \qquad r = H W y - C_0 z

    Guaranteed: zero for the fault-free plant and for the ignored faults; every other residual that ignores them
    is a filtered version of this one, so that a fault it does not see is seen by none of them. All poles are
    free; nothing need be detectable or stable.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled; ``E`` may be singular: then the algebraic equations count as measurements, and what
        they leave undetermined as unknown inputs.
    insensitive_to : sequence of str
        Faults to ignore, besides all disturbances of the plant.
    poles : sequence of complex, optional
        One for each state of the filter, closed under conjugation; their number is in the message when it
        does not fit.
    margin : float, optional
        Decay rate in 1/s that every pole must have at least, used without ``poles``.
    gain : {"kalman", "placement"}, optional
        ``"kalman"`` takes the gain of the Kalman filter of what is left of the plant, so that the residual of a sampled
        plant is white; ``"placement"`` the poles or the margin, or least squares with equal noise in all balanced
        states and outputs. When omitted: ``"kalman"`` for a plant with noise, if there are neither ``poles`` nor
        ``margin`` and that filter exists (the evidence says which).

    Returns
    -------
    ResidualGenerator
        Of the smallest order with which all residuals of this kind are had at once.

    Raises
    ------
    DesignError
        If no such residual exists: all measurements are used up; or if poles, margin and gain do not go together.
    AccuracyError
        If the poles or the decoupling missed their tolerance.

    See Also
    --------
    structured_bank : One for each row of a structure.
    eigenstructure_assignment : As an observer of the whole state.
    parity_relations : A moving average of the last samples.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant.

    References
    ----------
    Massoumnia, Verghese and Willsky (1989), IEEE TAC 34(3) (fundamental problem of residual generation);
    Gertler (1991), section 4.

    Examples
    --------
    >>> import residua as rs
    >>> flt = rs.design.decoupled_residual(rs.library.gertler(), insensitive_to="p1")
    >>> flt.structure.any(axis=0)
    array([False,  True])
    """
    chosen = arrays.positions(insensitive_to, plant.faults, "fault")
    ignored = [plant.faults[i] for i in chosen]
    model, p = plant.balanced, plant.n_outputs
    q = model.quotient(chosen)
    if not len(q.H):
        names = ", ".join(f"'{name}'" for name in (*plant.disturbances, *ignored))
        raise DesignError(
            f"no residual ignores {names or 'nothing'}: the {used_up(plant.n_outputs)}; add a sensor or ignore less"
        )
    try:
        found, F, G = _gain(model, q, poles, margin, gain)
    except AccuracyError:  # of modes that double precision hardly tells to be seen no gain may be found
        near = model.quotient(chosen, tolerance=NEAR * BALANCED_RANK)
        if near.split.seen.shape[1] == q.split.seen.shape[1] or not len(near.H):
            raise
        q, (found, F, G) = near, _gain(model, near, poles, margin, gain)
    O = q.split.seen  # noqa: E741
    J = without_rounding(O.T @ q.J)  # of an output that is not read nothing may be left
    K = above_rounding(J + found.K @ q.H, np.abs(J) + np.abs(found.K) @ np.abs(q.H), RESPONSE_ROUNDING)
    units, R, Y = model.units, model.units.equations, model.units.outputs
    T = without_rounding(O.T @ q.N @ model.derivative - K[:, p:] @ model.algebra) * R
    Ky, Hy, V = units.rate * K[:, :p] * Y, q.H[:, :p] * Y, q.H[:, p:] @ model.algebra * R / units.rate
    names = [f"r{i + 1}" for i in range(len(Hy))]
    system = plant_filter(plant, units.rate * (F - found.K @ G), T, Ky, -G, Hy, V, names)
    evidence = Evidence(
        method="decoupled residual",
        ranks={"unknown inputs in the outputs": q.decisions[-2]},
        conditions={"pole error": found.error, "norm of the gain": found.norm},
        notes=(
            *((f"ignores {', '.join(ignored)}",) if ignored else ()),
            *(f"near: {one}; double precision hardly decides this rank" for one in q.near[:1]),
        ),
        references=("Massoumnia, Verghese and Willsky (1989), IEEE TAC 34(3)", "Gertler (1991), section 4"),
    )
    return make_generator(
        system,
        plant,
        "decoupled residual",
        evidence.extended(**gain_evidence(found, units.rate)),
        decouples=Decoupled(faults=tuple(ignored)),
        state_map=T,
        static_map=V if plant.E is not None else None,
    )


def _gain(
    model: BalancedPlant,
    q: Quotient,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    kind: str | None,
) -> tuple[ObserverGain, Matrix, Matrix]:
    """Return the gain that is asked for, and the pair that it is for: the part of the quotient that is seen."""
    plant = model.plant
    if kind not in (None, "kalman", "placement"):
        raise DesignError(f"gain must be 'kalman' or 'placement', got {kind!r}")
    free = poles is None and margin is None
    if kind == "kalman" and not free:
        raise DesignError("the gain of a Kalman filter has no poles or margin to choose: leave them out")
    if kind == "kalman" and not plant.Bw.shape[1]:
        raise DesignError("a Kalman filter needs the noise of the plant: with_noise(process=..., measurement=...)")
    poles, margin = asked(plant, poles, margin)
    O, (F, G) = q.split.seen, q.pair  # noqa: E741
    F, G, note = without_rounding(O.T @ F @ O), without_rounding(G @ O), ""
    split = observable_split(F, G)
    if free and kind != "placement" and plant.Bw.shape[1]:
        w, v = _noise(model)
        w, v = O.T @ (q.N @ w - q.J @ v), q.H @ v
        size = np.sqrt(np.maximum((v**2).sum(axis=1), np.finfo(float).tiny))
        try:
            if decide_rank(v / size[:, None]).rank < len(v):
                raise DesignError("a residual has no measurement noise of its own")
            found = observer_gain(
                F,
                G / size[:, None],
                split,
                sampled=plant.is_discrete,
                process=w @ w.T,
                measurement=v @ v.T / size[:, None] / size,
                cross=w @ v.T / size,
                rate=model.units.rate,
            )
            return replace(found, K=found.K / size, note="gain of the Kalman filter"), F, G
        except (AccuracyError, DesignError) as error:
            if kind == "kalman":
                raise
            note = f"no gain of a Kalman filter: {error}"
    process, measurement = default_weights(model)
    found = observer_gain(
        F,
        G,
        split,
        sampled=plant.is_discrete,
        process=O.T @ q.N @ process @ q.N.T @ O,
        measurement=q.H @ measurement @ q.H.T,
        poles=poles,
        margin=margin,
        rate=model.units.rate,
    )
    return replace(found, note=found.note or note), F, G


def _noise(model: BalancedPlant) -> tuple[Matrix, Matrix]:
    """Return the directions of white noise in states and outputs of the balanced plant, the algebraic ones too."""
    plant, units = model.plant, model.units
    root = np.sqrt(units.rate)
    w = units.equations[:, None] * plant.Bw / root
    v = np.vstack([units.outputs[:, None] * plant.Dw * root, model.algebra @ w])
    size = max(float(np.abs(w).max(initial=0.0)), float(np.abs(v).max(initial=0.0))) or 1.0
    return model.derivative @ w / size, v / size
