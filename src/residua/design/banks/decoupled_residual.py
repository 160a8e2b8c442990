"""The residual that ignores chosen faults and all disturbances, whenever one exists."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.evidence import Evidence
from residua.design.generator import ResidualGenerator, make_generator
from residua.design.internal_form import check_decoupling
from residua.design.observers.observer_gain import margin_from, place, pole_evidence
from residua.design.signals import signal_names
from residua.errors import AccuracyError, DesignError
from residua.linear import StateSpace, arrays
from residua.linear.balancing import descriptor_units, without_rounding
from residua.linear.detection_space import confining_gain, detection_space
from residua.linear.placement import Placement
from residua.linear.rank import DEFAULT_RTOL, RankDecision, decide_rank, left_null_basis, range_basis
from residua.linear.reachability import reachable_basis
from residua.linear.riccati import filter_riccati
from residua.plant import Plant


def decoupled_residual(
    plant: Plant,
    *,
    insensitive_to: Iterable[str | int] | str = (),
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    gain: str | None = None,
    rtol: float = DEFAULT_RTOL,
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
        Stability margin in 1/s when no poles are given.
    gain : {"kalman", "placement"}, optional
        ``"kalman"`` takes the gain of the Kalman filter of what is left of the plant, so that the residual of a sampled
        plant is white; ``"placement"`` the poles or the margin. When omitted: ``"kalman"`` for a plant with noise, if
        neither poles nor margin are given and that filter exists (the evidence says which).
    rtol : float
        Relative tolerance of every rank decision, in balanced units.

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
    ignored = [plant.faults[i] for i in arrays.positions(insensitive_to, plant.faults, "fault")]
    parts = _explicit_parts(plant.faults_as_disturbances(ignored))
    quotient = _quotient(parts, rtol)
    if not quotient.read.shape[0]:
        names = ", ".join(f"'{name}'" for name in (*plant.disturbances, *ignored))
        raise DesignError(
            f"no residual ignores {names or 'nothing'}: the {plant.n_outputs} measurements are all used up; "
            "add a sensor or ignore less"
        )
    failure: AccuracyError | None = None
    for attempt, note in _attempts(quotient, poles, margin, gain, plant, rtol):
        try:
            return _assembled(plant, parts, quotient, attempt(), ignored, note)
        except AccuracyError as error:
            failure = failure or error
    assert failure is not None  # there is at least one attempt
    raise failure


def _assembled(
    plant: Plant, parts: _Parts, quotient: _Quotient, placed: Placement, ignored: list[str], note: str
) -> ResidualGenerator:
    """Return the generator of a gain on the quotient, in the units of the plant."""
    F = quotient.A - placed.gain @ quotient.C
    K = quotient.inject + placed.gain @ quotient.read
    n_y = plant.n_outputs
    T = _without_rounding(quotient.T1 - K[:, n_y:] @ parts.algebra) * parts.equations
    V = quotient.read[:, n_y:] @ parts.algebra * parts.equations
    used = _above_rounding(K[:, :n_y]) | _above_rounding(quotient.read[:, :n_y])
    Ky, Hy = K[:, :n_y] * parts.outputs * used, quotient.read[:, :n_y] * parts.outputs * used
    system = StateSpace(
        F,
        np.hstack([T @ plant.Bu - Ky @ plant.Du, Ky]),
        -quotient.C,
        np.hstack([-V @ plant.Bu - Hy @ plant.Du, Hy]),
        dt=plant.dt,
        inputs=signal_names(plant),
        outputs=[f"r{i + 1}" for i in range(len(Hy))],
    )
    evidence = Evidence(
        method="decoupled residual",
        **pole_evidence(placed, F),
        decoupling=_checked_decoupling(system, plant, ignored),
        ranks={"unknown inputs in the outputs": quotient.direct},
        conditions={"pole error": placed.error, "norm of the gain": placed.norm},
        notes=((f"ignores {', '.join(ignored)}",) if ignored else ()) + ((note,) if note else ()),
        references=("Massoumnia, Verghese and Willsky (1989), IEEE TAC 34(3)", "Gertler (1991), section 4"),
    )
    static = V if plant.E is not None else None
    made = make_generator(system, plant, "decoupled residual", evidence, state_map=T, static_map=static)
    silent = {name: np.zeros((made.n_residuals, 0)) for name in ignored}  # what is left of them has passed the check
    return replace(made, subspaces={**made.subspaces, **silent})


def _checked_decoupling(system: StateSpace, plant: Plant, ignored: list[str]) -> dict[str, float]:
    """Return the leakage of controls and of everything ignored, or raise when there is one."""
    found = check_decoupling(system, plant.faults_as_disturbances(ignored), decoupled=True)
    if ignored and "disturbance" in found:
        found["everything ignored"] = found.pop("disturbance")
    return found


def _attempts(
    quotient: _Quotient,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    kind: str | None,
    plant: Plant,
    rtol: float,
) -> list[tuple[Callable[[], Placement], str]]:
    """Return the gains to try, each with what to say about it: what was asked for, or defaults of falling demands."""
    if kind not in (None, "kalman", "placement"):
        raise DesignError(f"gain must be 'kalman' or 'placement', got {kind!r}")
    free = poles is None and margin is None
    if kind == "kalman" and not free:
        raise DesignError("the gain of a Kalman filter has no poles or margin to choose: leave them out")
    if kind == "kalman" and not plant.Bw.shape[1]:
        raise DesignError("a Kalman filter needs the noise of the plant: with_noise(process=..., measurement=...)")
    if not free:
        return [(lambda: place(quotient.A, quotient.C, poles, margin, plant.dt, rtol), "")]
    default = margin_from(quotient.A, plant)
    placed = [
        (
            lambda part=part: place(quotient.A, quotient.C, None, default / part, plant.dt, rtol),
            "" if part == 1 else f"the default margin was lowered to {default / part:.3g} per second, to be exact",
        )
        for part in (1, 4, 16, 64)
    ]
    if kind == "placement" or not plant.Bw.shape[1]:
        return placed
    try:
        best = _kalman_gain(quotient, plant)
    except (DesignError, AccuracyError) as error:
        if kind == "kalman":
            raise
        return [(attempt, f"poles placed, for there is no Kalman filter: {error}") for attempt, _ in placed]
    return [(lambda: best, "gain of the Kalman filter"), *([] if kind == "kalman" else placed)]


def _kalman_gain(quotient: _Quotient, plant: Plant) -> Placement:
    """Return the gain of the Kalman filter of the quotient."""
    G, J = quotient.process_noise, quotient.measurement_noise
    found = filter_riccati(quotient.A, quotient.C, G @ G.T, J @ J.T, G @ J.T, dt=plant.dt)
    none, K = np.zeros(0, dtype=complex), np.asarray(found.gain)
    return Placement(K, none, np.asarray(found.poles, dtype=complex), none, 0.0, 1.0, float(np.linalg.norm(K)))


def _without_rounding(M: NDArray) -> NDArray:
    """Return a matrix without the entries that are rounding against the largest of their row."""
    return np.where(np.abs(M) > 1e-14 * np.abs(M).max(axis=1, keepdims=True, initial=0.0), M, 0.0)


def _above_rounding(M: NDArray) -> NDArray[np.bool_]:
    """Tell which columns are more than what rounding leaves of nothing: an output that is not used has none."""
    size = np.abs(M).max(axis=0, initial=0.0)
    return size > 1e-13 * size.max(initial=0.0)


@dataclass(frozen=True, eq=False)
class _Parts:
    """A plant in balanced units, as ordinary state equations with further unknown inputs and known outputs.

    With ``E = U diag(S, 0) V'`` the states that ``E`` does not see are unknown inputs, and the equations without
    derivatives are outputs that are known to be zero.
    """

    A: NDArray
    C: NDArray
    B: NDArray
    D: NDArray
    derivative: NDArray  # T1 with x1' = T1 (A x + ...), x1 = T1 E x
    algebra: NDArray  # rows that annihilate E
    process_noise: NDArray
    measurement_noise: NDArray
    equations: NDArray
    outputs: NDArray


def _explicit_parts(plant: Plant) -> _Parts:
    """Return the plant with everything that must be ignored as unknown inputs ``B``, ``D``."""
    n = plant.n_states
    units = descriptor_units(
        plant.A,
        plant.E,
        np.hstack([plant.Bu, plant.Bd, plant.Bf]),
        plant.C,
        np.hstack([plant.Du, plant.Dd, plant.Df]),
    )
    R, S, Y = units.equations[:, None], units.states, units.outputs[:, None]
    A, C = R * plant.A * S, Y * plant.C * S
    unknown = np.vstack([R * plant.Bd, Y * plant.Dd])
    size = np.linalg.norm(unknown, axis=0)
    unknown = unknown / np.where(size > 0, size, 1.0)
    B, D = unknown[:n], unknown[n:]
    noise, seen = R * plant.Bw, Y * plant.Dw
    if plant.E is None:
        return _Parts(A, C, B, D, np.eye(n), np.zeros((0, n)), noise, seen, units.equations, units.outputs)
    E = R * plant.E * S
    U, s, Vh = np.linalg.svd(E)
    k = decide_rank(E).rank
    derivative, algebra = U[:, :k].T / s[:k, None], U[:, k:].T
    V1, V2 = Vh[:k].T, Vh[k:].T
    size2 = np.maximum(np.linalg.norm(A @ V2, axis=0), np.linalg.norm(C @ V2, axis=0))
    V2 = V2 / np.where(size2 > 0, size2, 1.0)
    return _Parts(
        derivative @ A @ V1,
        np.vstack([C @ V1, algebra @ A @ V1]),
        np.hstack([derivative @ A @ V2, derivative @ B]),
        np.vstack([np.hstack([C @ V2, D]), algebra @ np.hstack([A @ V2, B])]),
        derivative,
        algebra,
        derivative @ noise,
        np.vstack([seen, algebra @ noise]),
        units.equations,
        units.outputs,
    )


@dataclass(frozen=True, eq=False)
class _Quotient:
    """What is left when the unknown inputs are divided out: ``z' = A z + inject eta``, ``0 = read eta - C z``."""

    A: NDArray
    C: NDArray
    T1: NDArray  # z = T1 E x, before the algebraic equations take part
    inject: NDArray
    read: NDArray
    process_noise: NDArray
    measurement_noise: NDArray
    direct: RankDecision


def _quotient(parts: _Parts, rtol: float) -> _Quotient:
    """Divide out the smallest unobservability subspace that holds the unknown inputs."""
    n = len(parts.A)
    U, s, Vh = np.linalg.svd(parts.D)
    direct = decide_rank(parts.D, rtol=rtol, scale=1.0)
    k = direct.rank
    G = parts.B @ (Vh[:k].T / s[:k]) @ U[:, :k].T
    W = U[:, k:].T
    A, C = parts.A - G @ parts.C, without_rounding(W, parts.C)
    L, _ = range_basis(parts.B @ Vh[k:].T, rtol=rtol, scale=1.0)
    S = detection_space(A, C, L, rtol=rtol).basis if L.shape[1] else _unobservable(A, C, rtol)
    if S.shape[1]:
        inject = confining_gain(A, C, S)
        scale = float(np.linalg.norm(parts.C, 2)) if parts.C.size else 0.0  # what is left of C may be all rounding
        H = left_null_basis(C @ S, rtol=rtol, scale=scale)[0].T
        P = left_null_basis(S)[0]
    else:
        inject, H, P = np.zeros((n, len(C))), np.eye(len(C)), np.eye(n)
    F = without_rounding(P.T, A - inject @ C, P)
    inject, read = P.T @ (G + inject @ W), H @ W
    return _Quotient(
        F,
        without_rounding(H, C, P),
        P.T @ parts.derivative,
        inject,
        read,
        P.T @ parts.process_noise - inject @ parts.measurement_noise,
        read @ parts.measurement_noise,
        direct,
    )


def _unobservable(A: NDArray, C: NDArray, rtol: float) -> NDArray:
    """Return an orthonormal basis of the states that no output sees."""
    seen = reachable_basis(A.T, C.T, rtol=rtol)
    return left_null_basis(seen)[0] if seen.shape[1] else np.eye(len(A))
