"""Residuals that ignore faults because these are right eigenvectors, or the residuals left ones, of the error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.decoupling import IGNORED, Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import method
from residua.design.core.needs import disturbances
from residua.design.detection_filters.directional_gain import with_poles_of_whole
from residua.design.detection_filters.ignored_columns import IgnoredColumns, ignored_columns, require_detectable
from residua.design.detection_filters.left_eigenvectors import left_design
from residua.design.detection_filters.right_eigenvectors import confinements, right_gain
from residua.design.observers.observer import plant_filter
from residua.design.observers.observer_gain import balanced_options
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear.norms.system_norms import hinf_norm
from residua.linear.poles.observer_gain import ObserverGain
from residua.linear.poles.placement import default_margin
from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.rank import RankDecision
from residua.plant import Plant
from residua.plant.balanced import is_inside
from residua.tolerances import RESIDUE, above_rounding

REFERENCE = "Gertler (1991), Automatica 27(4), section 4.3, eqs. (4-5) to (4-14), after Patton and Kangethe (1989)"


@method(
    needs=[disturbances("faults to ignore, or disturbances", "name the faults to ignore, insensitive_to=[...]")],
    exists_when="their columns can be eigenvectors of A - K C: stable zeros (left: first-order residuals, rare)",
    order="at most n",
    source="Gertler (1991), section 4.3, eqs. (4-5) to (4-14)",
    decouples=True,
)
def eigenstructure_assignment(
    plant: Plant,
    *,
    side: str = "right",
    insensitive_to: Iterable[str | int] | str = (),
    poles: Sequence[complex] | ArrayLike | Mapping[str, Sequence[complex]] | None = None,
    margin: float | None = None,
    combine: bool = True,
    approximate: bool = False,
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
        Stability margin in 1/s. When omitted, assigned eigenvectors get the geometric mean of the sizes of the plant's
        poles, and the rest is that of least squares with equal noise in all states and outputs of the balanced plant.
    combine : bool
        Right: where the columns cannot be eigenvectors themselves, because invariant zeros of theirs would be fixed
        poles that are not stable or not asked for, whether they may be combinations of more eigenvectors (5-5).
    approximate : bool
        Left: where ``h A`` is no row of ``C``, whether to take the ``h`` for which it is nearest, and the gain that
        fits best. What is ignored then leaks; ``evidence.decoupling`` tells by how much, relative to the faults
        that are seen, at the worst frequency. Control inputs never leak.

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
    parts = ignored_columns(plant, insensitive_to)
    pair, sampled = parts.pair, parts.pair.model.plant.is_discrete
    poles, margin = balanced_options(pair.model.plant, poles, margin)
    # of assigned eigenvectors when the user names no eigenvalue: as the paper, 0 in sampled time
    first = 0.0 if sampled else -(default_margin(pair.A) if margin is None else margin)
    if side == "left":
        return _generator(parts, "left", *left_design(parts, poles, margin, first, approximate=approximate))
    S, seen, ways = confinements(parts, combine=combine)
    require_detectable(parts)
    ranks = {"ignored in the outputs": parts.direct}
    failure: DesignError | AccuracyError | None = None
    for way in ways:  # the columns themselves, then combinations
        try:
            gain = right_gain(parts, way, poles, margin, first)
            return _generator(parts, "right", S, seen, gain, way.note, ranks)
        except (DesignError, AccuracyError) as error:
            failure = failure or error
    assert failure is not None  # there is at least one way
    raise failure


def _generator(
    parts: IgnoredColumns,
    side: str,
    S: NDArray,
    seen: NDArray | None,
    gain: ObserverGain,
    note: str,
    ranks: dict[str, RankDecision],
) -> ResidualGenerator:
    """Return the generator of a gain, with what it promises checked.

    Its states are those of the estimate that the residual sees, along orthonormal columns; the others, and with them
    what is ignored, are left out, so that rounding does not bring them back. Without such columns the gain is an
    approximate one, and what is ignored leaks.
    """
    pair, exact, W = parts.pair, seen is not None, parts.rows(S)
    plant, units = pair.model.plant, pair.model.units
    V = np.eye(len(pair.A)) if seen is None else seen
    F = pair.A0 - gain.K @ pair.C0
    poles = np.asarray(np.linalg.eigvals(F), dtype=complex)
    if not is_inside(poles, plant.is_discrete).all():
        raise AccuracyError(f"the observer is not stable: poles {describe_modes(units.rate * poles)}")
    notes = (*((f"ignores {parts.text}",) if parts.names else ()), *((note,) if note else ()))
    method = f"eigenstructure assignment, {side} eigenvectors"
    evidence = Evidence(method=method, ranks=ranks, notes=notes, references=(REFERENCE,))
    evidence = with_poles_of_whole(evidence, pair, gain if exact else replace(gain, requested=gain.requested[:0]))
    observer = replace(pair.observer(gain.K, evidence), decouples=exact, W=W)
    T, back = V.T @ pair.inverse / units.states, units.states[:, None] * pair.M @ V
    # measurements that repeat one another need no state
    C = above_rounding(-W @ plant.C @ back, np.abs(W) @ np.abs(plant.C) @ np.abs(back), RESIDUE)
    names = [f"r{i + 1}" for i in range(len(W))]
    system = plant_filter(plant, units.rate * T * units.states @ F @ pair.M @ V, T, T @ observer.K, C, W, None, names)
    faults = tuple(name for name in plant.faults if name in parts.names)
    decouples = Decoupled(faults=faults, apart=True) if exact else Decoupled(disturbances=False)
    made = make_generator(system, plant, method, evidence, decouples=decouples, state_map=T, observer=observer)
    leaks = made.evidence.decoupling
    own = {name: gain for name, gain in leaks.items() if name != IGNORED}
    observer = replace(observer, evidence=evidence.extended(decoupling=own))
    more = {IGNORED: leaks["disturbance"]} if exact and not faults and "disturbance" in leaks else {}
    if not exact:  # the peak gain of each ignored input over frequency, beside the largest of a fault that is seen
        form = made.internal_form()
        peaks = {
            name: hinf_norm(form.A, form.B[:, [i]], form.C, form.D[:, [i]], form.dt).value
            for i, name in enumerate((*plant.faults, *plant.disturbances))
        }
        largest = max((peaks[name] for name in plant.faults if name not in parts.names), default=0.0)
        more = {f"{name}, leaking": float(peaks[name] / largest) if largest else np.inf for name in parts.names}
    return replace(made, observer=observer, evidence=made.evidence.extended(decoupling=more))
