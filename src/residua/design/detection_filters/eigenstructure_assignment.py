"""Residuals that ignore faults because these are right eigenvectors, or the residuals left ones, of the error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.decoupling import IGNORED, Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import method
from residua.design.core.needs import disturbances
from residua.design.core.own_time import in_own_time
from residua.design.core.signals import signal_names
from residua.design.detection_filters.directional_gain import DirectionalGain
from residua.design.detection_filters.ignored_columns import (
    Frame,
    IgnoredColumns,
    ignored_columns,
    require_detectable,
)
from residua.design.detection_filters.left_eigenvectors import left_frame, left_gain, left_rows, row_error
from residua.design.detection_filters.right_eigenvectors import (
    column_error,
    confinements,
    right_frame,
    right_gain,
)
from residua.design.observers.observer import Observer
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear import StateSpace
from residua.linear.norms.system_norms import hinf_norm
from residua.linear.poles.matrix_poles import explicit_poles
from residua.linear.poles.placement import default_margin
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision
from residua.linear.systems.balancing import without_rounding
from residua.plant import Plant
from residua.words import unit_of_rates

REFERENCE = "Gertler (1991), Automatica 27(4), section 4.3, eqs. (4-5) to (4-14), after Patton and Kangethe (1989)"
#: Largest error of an assigned eigenvalue, and of an assigned eigenvector relative to its terms.
_POLE_ERROR, _VECTOR_ERROR = 1e-6, 1e-8


@method(
    needs=[disturbances("faults to ignore, or disturbances", "name the faults to ignore, insensitive_to=[...]")],
    exists_when="their columns can be eigenvectors of A - K C: stable zeros (left: first-order residuals, rare)",
    order="at most n",
    source="Gertler (1991), section 4.3, eqs. (4-5) to (4-14)",
    decouples=True,
)
@in_own_time()
def eigenstructure_assignment(
    plant: Plant,
    *,
    side: str = "right",
    insensitive_to: Iterable[str | int] | str = (),
    poles: Sequence[complex] | ArrayLike | Mapping[str, Sequence[complex]] | None = None,
    margin: float | None = None,
    combine: bool = True,
    approximate: bool = False,
    rtol: float = DEFAULT_RTOL,
) -> ResidualGenerator:
    r"""Design an observer whose eigenvectors keep the disturbances and the named faults out of the residual.

    .. math:: \dot{\hat x} = A \hat x + B u + K (y - D u - C \hat x), \qquad r = S (y - D u - C \hat x)

    ``"right"``: every column ``f`` to be ignored becomes a right eigenvector of :math:`G = A - K C`,
    :math:`G f = \lambda f`, that is :math:`K C f = A f - \lambda f`, and ``S`` are all rows with :math:`S C f = 0`.
    Where :math:`C f = 0` it becomes the head of the chain :math:`f, A f, \dots, A^\mu f` up to the first
    :math:`C A^\mu f` that is not zero. The gain is not unique: ``K + F X S`` with any ``X`` gives the same residual
    and the same eigenvalues.

    ``"left"``: the rows :math:`h = s C` with :math:`h f = 0` become left eigenvectors, :math:`h G = \lambda h`, so that
    :math:`\dot r = \lambda r + h F p`: first-order residuals. This asks that ``h A`` be a row of ``C`` too,
    :math:`\operatorname{rank}[C; hA] = \operatorname{rank} C`, which few plants fulfil.

    Guaranteed: the residual is zero for the fault-free plant and for everything ignored, whatever its time course
    (not with ``approximate``); it is a filtered version of :func:`decoupled_residual`.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, with invertible ``E``. A sensor whose fault is to be ignored is not used.
    side : {"right", "left"}
    insensitive_to : sequence of str
        Faults to ignore, besides all disturbances of the plant.
    poles : sequence of complex, or mapping, optional
        Eigenvalues of ``A - K C``, first those of the disturbances and ignored faults in this order (one each, one
        more for each step of a chain; left: those of the residual rows), then the others, the fixed ones included or
        not. Or a mapping of name (left: ``"left"``) and ``"rest"`` to poles. Assigned eigenvectors without a
        pole there get 0 in sampled time and the negative margin in continuous time; the rest is placed beyond the
        margin.
    margin : float, optional
        Stability margin in 1/s; the geometric mean of the sizes of the plant's poles when omitted.
    combine : bool
        Right: where the columns cannot be eigenvectors themselves, because invariant zeros of theirs would be fixed
        poles that are not stable or not asked for, whether they may be combinations of more eigenvectors (5-5).
    approximate : bool
        Left: where ``h A`` is no row of ``C``, whether to take the ``h`` for which it is nearest, and the gain that
        fits best. What is ignored then leaks; ``evidence.decoupling`` tells by how much, relative to the faults
        that are seen, at the worst frequency. Control inputs never leak.
    rtol : float
        Relative tolerance of every rank decision, in balanced units.

    Returns
    -------
    ResidualGenerator
        One residual for each independent row of ``S``. ``observer.K`` and ``observer.W`` are ``K`` and ``S``, and
        ``evidence.poles`` all eigenvalues of ``A - K C``; the generator itself has only those states of the observer
        that the residual sees (Example 2 C: the poles 0.25 and 0.3, not 0).

    Raises
    ------
    DesignError
        If it does not exist: no row ignores them all, a fixed pole is not stable, the left condition fails. The
        message has the numbers.
    AccuracyError
        If poles, eigenvectors or decoupling missed their tolerance.

    See Also
    --------
    decoupled_residual : Exists whenever any residual does, of a lower order.
    unknown_input_observer : Decouples disturbances from the estimate too.
    residual_generator_from_observer : From a gain that is there.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant, and all of its state is detectable from the measurements
    that are used. :func:`decoupled_residual` needs neither this nor stable zeros, and has a lower order.

    References
    ----------
    Gertler (1991), section 4.3, eqs. (4-5) to (4-14); section 5.1, eqs. (5-5) to (5-8) for the eigenvectors.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.gertler()
    >>> flt = rs.design.eigenstructure_assignment(plant, insensitive_to="p1", poles=[0, 0.25, 0.3])
    >>> (flt.observer.W / flt.observer.W[0, 0]).round(9)
    array([[ 1., -2.]])
    >>> rs.design.eigenstructure_assignment(plant, insensitive_to="p1", side="left")
    Traceback (most recent call last):
        ...
    residua.errors.DesignError: no left eigenvectors: ... rank [C; h A] = 3 > rank C = 2 ...
    """
    if side not in ("right", "left"):
        raise SettingError(f"side must be 'right' or 'left', got {side!r}")
    if approximate and side == "right":
        raise SettingError("approximate=True belongs to side='left': right eigenvectors are exact or do not exist")
    poles, margin = checked_options(poles, margin)
    parts = ignored_columns(plant, insensitive_to, rtol=rtol)
    ways = (
        _right_ways(parts, poles, margin, combine, rtol)
        if side == "right"
        else _left_ways(parts, poles, margin, approximate, rtol)
    )
    failure: DesignError | AccuracyError | None = None
    for way in ways:
        try:
            return way()
        except (DesignError, AccuracyError) as error:
            failure = failure or error
    assert failure is not None  # there is at least one way
    raise failure


def _margins(parts: IgnoredColumns, margin: float | None) -> list[tuple[float, str]]:
    """Return the margins to try, each with what to say about it: the one asked for, or defaults of falling demands."""
    if margin is not None:
        return [(margin, "")]
    default = default_margin(parts.A, parts.plant.dt)
    notes = (
        (part, f"the default margin was lowered to {default / part * unit_of_rates():.3g} per second")
        for part in (4, 16, 64)
    )
    return [(default, ""), *((default / part, note) for part, note in notes)]


def _first(parts: IgnoredColumns, distance: float) -> float:
    """Return the eigenvalue of assigned eigenvectors when the user names none: as the paper, 0 in sampled time."""
    return 0.0 if parts.plant.dt else -distance


def _right_ways(
    parts: IgnoredColumns, poles: Any, margin: float | None, combine: bool, rtol: float
) -> list[Callable[[], ResidualGenerator]]:
    """Return the designs to try with right eigenvectors: the columns themselves, then combinations."""
    S0, confinement = confinements(parts, combine=combine, rtol=rtol)
    require_detectable(parts)
    ranks = {"ignored in the outputs": parts.direct}

    def way(k: int, distance: float, lowered: str) -> ResidualGenerator:
        confined = confinement[k]
        gain = right_gain(parts, confined, poles, margin, distance, _first(parts, distance), rtol=rtol)
        _require(column_error(parts, confined, S0, gain.gain), "columns")
        notes = (confined.note, lowered)
        return _generator(parts, S0, gain, "right eigenvectors", notes, ranks, frame=right_frame(parts, confined))

    S0 = parts.with_even_rows(S0)
    return [
        lambda k=k, d=distance, note=note: way(k, d, note)
        for k in range(len(confinement))
        for distance, note in _margins(parts, margin)
    ]


def _left_ways(
    parts: IgnoredColumns, poles: Any, margin: float | None, approximate: bool, rtol: float
) -> list[Callable[[], ResidualGenerator]]:
    """Return the designs to try with left eigenvectors."""
    rows = left_rows(parts, approximate=approximate, rtol=rtol)
    require_detectable(parts)
    S0 = parts.with_even_rows(np.vstack([rows.moving, rows.still]))

    def way(distance: float, lowered: str) -> ResidualGenerator:
        gain = left_gain(parts, rows, poles, distance, _first(parts, distance), rtol=rtol)
        if rows.exact:
            _require(row_error(parts, rows, gain.gain), "rows")
        frame = left_frame(parts, rows) if rows.exact else None
        notes = ("" if rows.exact else "approximate: h A is no row of C, what is ignored leaks", lowered)
        return _generator(parts, S0, gain, "left eigenvectors", notes, rows.ranks, frame=frame)

    return [lambda d=distance, note=note: way(d, note) for distance, note in _margins(parts, margin)]


def _require(error: float, what: str) -> None:
    """Raise when assigned vectors are no eigenvectors after all."""
    if not error <= _VECTOR_ERROR:
        raise AccuracyError(
            f"the {what} miss being eigenvectors by {error:.2g} > {_VECTOR_ERROR:.0e} of their terms: too badly "
            "conditioned for an observer of the whole state; use decoupled_residual"
        )


def _generator(
    parts: IgnoredColumns,
    S0: NDArray,
    gain: DirectionalGain,
    kind: str,
    notes: tuple[str, ...],
    ranks: dict[str, RankDecision],
    *,
    frame: Frame | None = None,
) -> ResidualGenerator:
    """Return the generator of a gain on the outputs that are used, with what it promises checked.

    Its states are those of the estimate that the residual sees; the others, and with them what is ignored, are left
    out, so that rounding does not bring them back. Without a frame the gain is an approximate one, and what is ignored
    leaks.
    """
    if not gain.error <= _POLE_ERROR:
        raise AccuracyError(f"a pole is off by {gain.error:.2g} > {_POLE_ERROR:.0e}: ask for poles further apart")
    plant, n, exact = parts.plant, parts.plant.n_states, frame is not None
    K, S = parts.observer_gain(gain.gain), S0 @ parts.W * parts.outputs
    F = without_rounding(np.hstack([np.eye(n), -K]), np.vstack([plant.A, plant.C]))  # what cancels couples nothing
    method = f"eigenstructure assignment, {kind}"
    frame = frame or Frame(np.eye(n), np.eye(n), n)
    k = frame.seen
    whole = frame.T @ (parts.A - gain.gain @ parts.C) @ frame.inverse
    T = frame.T[:k] / parts.states
    own = frame.T[:k] @ parts.on_all_outputs(gain.gain)
    read = without_rounding(S0, parts.C, frame.inverse)  # measurements that repeat one another need no state
    system = StateSpace(
        whole[:k, :k],
        np.hstack([T @ plant.B - own @ plant.D, own]),
        -read[:, :k],
        np.hstack([-S @ plant.D, S]),
        dt=plant.dt,
        inputs=signal_names(plant),
        outputs=[f"r{i + 1}" for i in range(len(S))],
    )
    if exact:
        _require(_seen_error(parts, T, own, F, whole[:k, :k]), "vectors, with K in the units of the plant,")
    poles = explicit_poles(whole)
    if not is_stable_mode(poles, plant.dt).all():
        raise AccuracyError(f"the observer is not stable: poles {describe_modes(poles)}")
    evidence = Evidence(
        method=method,
        poles=poles,
        requested_poles=gain.requested if exact else np.zeros(0, dtype=complex),
        fixed_poles=gain.fixed,
        ranks=ranks,
        conditions={"pole error": gain.error, "size of K": parts.size_of(F, K)},
        notes=(*((f"ignores {parts.text}",) if parts.names else ()), *(note for note in notes if note)),
        references=(REFERENCE,),
    )
    observer = Observer(plant, F, np.eye(n), K, np.eye(n), np.zeros(K.shape), S, method, exact, evidence)
    faults = tuple(name for name in plant.faults if name in parts.names)
    decouples = Decoupled(faults=faults, apart=True) if exact else Decoupled(disturbances=False)
    made = make_generator(system, plant, method, evidence, decouples=decouples, state_map=T, observer=observer)
    leaks = made.evidence.decoupling
    own = {name: gain for name, gain in leaks.items() if name != IGNORED}
    observer = replace(observer, evidence=evidence.extended(decoupling=own))
    if not exact:
        more = _leaks(made, parts)
    else:
        more = {} if faults or "disturbance" not in leaks else {IGNORED: leaks["disturbance"]}
    return replace(made, observer=observer, evidence=made.evidence.extended(decoupling=more))


def _seen_error(parts: IgnoredColumns, T: NDArray, own: NDArray, F: NDArray, Q: NDArray) -> float:
    """Return how far :math:`T (A - K C) = Q T` is missed by ``K`` as it is, relative to ``T A``, ``(T K) C``, ``Q T``.

    Not to ``T`` times a ``K`` that is so large that its columns cancel: that would be rounding.
    """
    plant = parts.plant
    terms = np.abs(T) @ np.abs(plant.A) + np.abs(own) @ np.abs(plant.C) + np.abs(Q) @ np.abs(T)
    off, size = np.abs(T @ F - Q @ T) * parts.states, (terms * parts.states).max(axis=1, initial=0.0)
    return float((off.max(axis=1, initial=0.0) / np.where(size > 0, size, 1.0)).max(initial=0.0))


def _leaks(generator: ResidualGenerator, parts: IgnoredColumns) -> dict[str, float]:
    """Return the peak gain of each ignored input over frequency, relative to the largest of a fault that is seen."""
    form = generator.internal_form()
    response = {
        name: hinf_norm(form.A, form.B[:, [i]], form.C, form.D[:, [i]], form.dt).value
        for i, name in enumerate(form.inputs[: len(generator.faults) + len(generator.plant.disturbances)])
    }
    seen = max((response[name] for name in generator.faults if name not in parts.names), default=0.0)
    return {f"{name}, leaking": float(response[name] / seen) if seen else np.inf for name in parts.names}
