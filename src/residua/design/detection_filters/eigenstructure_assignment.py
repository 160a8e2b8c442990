"""Residuals that ignore faults because these are right eigenvectors, or the residuals left ones, of the error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.design.core.decoupling import IGNORED, Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import disturbances, method
from residua.design.detection_filters.directional_gain import (
    FaultEvent,
    block_gain,
    hidden_modes,
    share_poles,
    with_poles_of_whole,
)
from residua.design.observers.observer import plant_filter
from residua.design.observers.observer_gain import balanced_options, pair_gain
from residua.design.observers.unknown_input_observer import ErrorPair, error_pair
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear.norms.system_norms import hinf_norm
from residua.linear.poles.observer_gain import ObserverGain
from residua.linear.poles.pole_assignment import real_block_diagonal
from residua.linear.poles.spectrum import balanced_rate, describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.detection_space import are_independent, complement, confined_space, split_blocks
from residua.linear.subspaces.quotient import observable_split, quotient, without_rounding
from residua.linear.subspaces.rank import RankDecision, decide_rank
from residua.plant import Plant
from residua.plant.balanced import is_inside, is_singular
from residua.tolerances import BALANCED_RANK, RESIDUE, TINY, above_rounding

Matrix = NDArray[np.float64]
REFERENCE = "Gertler (1991), Automatica 27(4), section 4.3, eqs. (4-5) to (4-14), after Patton and Kangethe (1989)"


@dataclass(frozen=True, eq=False)
class _IgnoredColumns:
    r"""The error pair of a plant whose ignored inputs have been taken out of the outputs that are used.

    A sensor whose fault is to be ignored is not used: no gain on ``W y`` reads it.

    Attributes
    ----------
    pair : ErrorPair
        With white noise; :math:`T = I`.
    columns : dict of str to ndarray, shape (n, 1)
        Directions left to be ignored in the state equation: unit vectors, one for each ignored input that has such.
    names : tuple of str
        Everything that is to be ignored: the disturbances, then the faults named.
    direct : RankDecision
        Rank of the ignored inputs in the outputs.
    """

    pair: ErrorPair
    columns: dict[str, Matrix]
    names: tuple[str, ...]
    direct: RankDecision

    @property
    def text(self) -> str:
        """The names in words."""
        return ", ".join(f"'{name}'" for name in self.names) or "nothing"

    @property
    def stacked(self) -> Matrix:
        """The columns side by side."""
        return np.hstack([np.zeros((len(self.pair.A), 0)), *self.columns.values()])

    def rows(self, S: Matrix) -> Matrix:
        """Return a basis, on the outputs of the plant, of the rows on those of the pair.

        Each has an output of its own and length one, the first entry positive.
        """
        even, pivots = S @ self.pair.outputs @ self.pair.W, []
        basis = np.linalg.qr(even.T)[0].T  # what is left of it has columns of the same length whatever the rows
        while len(basis):
            size = np.linalg.norm(basis, axis=0)
            pivots.append(int(np.argmax(size > 0.9 * size.max())))
            basis = complement(basis[:, pivots[-1:]]).T @ basis
        inverse = np.linalg.inv(even[:, sorted(pivots)])
        whole = above_rounding(inverse @ even, np.abs(inverse) @ np.abs(even)) * self.pair.model.units.outputs
        lead = np.argmax(whole != 0, axis=1)
        return whole * (np.sign(whole[np.arange(len(S)), lead]) / np.linalg.norm(whole, axis=1))[:, None]


def _ignored_columns(plant: Plant, insensitive_to: Iterable[str | int] | str) -> _IgnoredColumns:
    """Return the inputs that an observer of a plant has to ignore: all disturbances and the named faults.

    Raises
    ------
    DesignError
        If ``E`` is singular, or no measurement is left.
    """
    if is_singular(plant):
        raise DesignError(
            "eigenvectors are assigned to an observer of state equations, and E is singular: "
            "use decoupled_residual, which serves singular plants too"
        )
    plant = plant.explicit()
    chosen = arrays.positions(insensitive_to, plant.faults, "fault")
    names = plant.faults_as_disturbances([plant.faults[i] for i in chosen]).disturbances
    model = plant.balanced
    B, D = (np.hstack([model.disturbances[k], model.faults[k][:, chosen]]) for k in (0, 1))
    pair = error_pair(model, (B, D), 0, "even")
    if not len(pair.W):
        raise DesignError(f"no residual ignores {', '.join(names)}: they enter all {plant.n_outputs} outputs directly")
    pair = pair.white()
    left, direct = pair.inverse @ (B - pair.G @ D), np.any(D, axis=0)
    size = np.linalg.norm(left, axis=0)
    columns = {
        name: left[:, [i]] / size[i] for i, name in enumerate(names) if not direct[i] and size[i] > BALANCED_RANK
    }
    U, s, _ = np.linalg.svd(left[:, direct], full_matrices=False)  # those that the outputs express in part
    columns |= {f"ignored {i + 1}": U[:, [i]] for i in range(np.count_nonzero(s > BALANCED_RANK))}
    return _IgnoredColumns(pair, columns, names, decide_rank(D, rtol=BALANCED_RANK, scale=1.0))


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
    parts = _ignored_columns(plant, insensitive_to)
    pair, sampled = parts.pair, parts.pair.model.plant.is_discrete
    poles, margin = balanced_options(pair.model.plant, poles, margin)
    # of assigned eigenvectors when the user names no eigenvalue: as the paper, 0 in sampled time
    first = 0.0 if sampled else -(balanced_rate(pair.A, sampled) if margin is None else margin)
    if side == "left":
        return _generator(parts, "left", *_left_design(parts, poles, margin, first, approximate))
    S, seen, ways = _confinements(parts, combine)
    _require_detectable(parts, margin)
    ranks = {"ignored in the outputs": parts.direct}
    failure: DesignError | AccuracyError | None = None
    for events, note in ways:  # the columns themselves, then combinations
        try:
            gain = _right_gain(parts, events, poles, margin, first)
            return _generator(parts, "right", S, seen, gain, note, ranks)
        except (DesignError, AccuracyError) as error:
            failure = failure or error
    assert failure is not None  # there is at least one way
    raise failure


def _require_detectable(parts: _IgnoredColumns, margin: float | None = None) -> None:
    """Raise when no observer that uses the outputs left over is stable, with a margin if there is one."""
    plant, rate = parts.pair.model.plant, parts.pair.model.units.rate
    modes = hidden_modes(parts.pair.A, parts.pair.C)
    fast = is_inside(modes, plant.is_discrete) & is_stable_mode(modes, float(plant.is_discrete), margin or 0.0)
    if not fast.all():
        raise DesignError(
            f"no observer of the whole state ignores {parts.text}: the mode {describe_modes(rate * modes[~fast])}, "
            f"which the measurements that are left do not see, is not {_stable(parts, margin)}; add a sensor, or use "
            "decoupled_residual, which observes only what it needs"
        )


def _stable(parts: _IgnoredColumns, margin: float | None) -> str:
    plant = parts.pair.model.plant
    per_second = 1 / plant.dt if plant.is_discrete else parts.pair.model.units.rate
    return "stable" if margin is None else f"stable with the margin {margin * per_second:g}"


def _confinements(parts: _IgnoredColumns, combine: bool) -> tuple[Matrix, Matrix, list[tuple[list[FaultEvent], str]]]:
    r"""Return the rows that do not see the ignored columns, the states they see, and the ways to confine the columns.

    The smallest space ``V`` that a gain can make invariant and that holds the columns is :math:`f, A f, \dots,
    A^\mu f` for each, with :math:`C A^\mu f` the first that is not zero. Where the vectors :math:`C A^\mu f` are
    independent each column has its chain; otherwise there is one space for all. The rows annihilate :math:`C V`, and
    see the states that are no part of the space in which also the invariant zeros of the columns are free: with
    ``combine`` that is another way.
    """
    A, C = parts.pair.A, parts.pair.C
    q = quotient(A, parts.stacked, C, np.zeros((len(C), len(parts.columns))))
    together, whole = (confined_space(A, C, parts.stacked, zeros=zeros) for zeros in (False, True))
    rank = together.outputs.shape[1]
    if not len(q.H):
        raise DesignError(
            f"no residual ignores {parts.text}: rank(S C) must be less than the {len(C)} measurements that are left, "
            f"and C V, the outputs of their columns and of the chains that these start, has rank {rank}; "
            "add a sensor or ignore less"
        )
    chains: list[tuple[Matrix, FaultEvent]] = []  # parallel columns share one, and those that no output sees have none
    for name, f in parts.columns.items():
        twin = next((k for k, (g, _) in enumerate(chains) if abs(abs(float((g.T @ f)[0, 0])) - 1) < 1e-14), None)
        if twin is not None:
            g, event = chains[twin]
            chains[twin] = g, replace(event, faults=(*event.faults, name))
        elif (space := confined_space(A, C, f, zeros=False)).outputs.shape[1]:
            chains.append((f, FaultEvent((name,), space)))
    events, everything = [event for _, event in chains], (*parts.columns, "ignored")
    ways: list[tuple[list[FaultEvent], str]] = []
    if not events or all(
        are_independent([getattr(event.space, part) for event in events]) for part in ("outputs", "basis")
    ):
        long = [" or ".join(e.faults) for e in events if e.space.dimension > 1]
        note = f"C f = 0: eigenvector chains f, A f, ... for {', '.join(long)}" if long else ""
        ways.append((events, note))
    elif rank:
        note = (
            f"the outputs of the {len(events)} columns are dependent (rank {rank}): they lie in one "
            f"invariant space of dimension {together.dimension}, of which they are no eigenvectors"
        )
        ways.append(([FaultEvent(everything, together)], note))
    if combine and rank and whole.dimension > together.dimension:
        note = (
            f"the ignored columns are combinations of {whole.dimension} eigenvectors (5-5), so that their "
            "invariant zeros are no fixed poles"
        )
        ways.append(([FaultEvent(everything, whole)], note))
    return q.H, (q.split.seen.T @ q.N).T, ways


def _right_gain(
    parts: _IgnoredColumns, events: list[FaultEvent], poles: Any, margin: float | None, first: float
) -> ObserverGain:
    r"""Return a gain with the space of every event invariant, for a chain :math:`K C A^\mu f = p(A) f` with its poles.

    For a column that the outputs see, :math:`\mu = 0`, this is :math:`K C f = A f - \lambda f`, equation (5-7) of the
    detection filter with :math:`v = f`. Chains for which ``poles`` has none get the eigenvalue ``first``.

    Raises
    ------
    DesignError
        If a pole is fixed that is not stable, or slower than the margin.
    """
    pair, rate, dt = parts.pair, parts.pair.model.units.rate, float(parts.pair.model.plant.is_discrete)
    pairs = split_blocks(pair.A, pair.C, [event.space for event in events]).pairs
    fixed = np.concatenate([hidden_modes(*one) for one in pairs])
    slow = fixed[~is_stable_mode(fixed, dt, margin or 0.0)]
    if len(slow):
        raise DesignError(
            f"the invariant zero {describe_modes(rate * slow)} of the columns of {parts.text} is a fixed pole once "
            f"they are eigenvectors, and not {_stable(parts, margin)}; allow combine=True, or use decoupled_residual, "
            "whose poles are all free"
        )
    named = set(poles or {}) if poles is None or isinstance(poles, Mapping) else None
    chains = [event for event in events if event.faults[-1] != "ignored"]
    if named is not None:
        defaults = {e.faults[0]: [first] * e.space.dimension for e in chains if not set(e.faults) & named}
        poles = {**(poles or {}), **defaults}
    return block_gain(pair, events, None, poles, margin)


def _left_design(
    parts: _IgnoredColumns, poles: Any, margin: float | None, first: float, approximate: bool
) -> tuple[Matrix, Matrix | None, ObserverGain, str, dict[str, RankDecision]]:
    r"""Return residual rows, the states they see if they are exact, their gain, a note, and ranks.

    All rows ``s`` with :math:`s C F_Z = 0` for which ``s C A`` is a row of ``C``, or the nearest one. Both conditions
    are linear in ``s``: :math:`s\,[C F_Z,\ C A N] = 0` with ``N`` a basis of the null space of ``C``. As ``h = s C``
    is a row of ``C`` itself, the eigenvalue does not matter. Rows with ``s C = 0``, measurements that repeat one
    another, need no observer.

    :math:`H (A - K C) = \Lambda H` fixes ``H K``, :math:`H K C = H A - \Lambda H`; what is left of the gain acts
    inside the null space ``N`` of ``H``, where :math:`(C N, N^T A N)` is observable if the plant is:
    :math:`N^T H^T = 0`, so that what ``H K`` fixes does not reach it.
    """
    pair, A, C = parts.pair, parts.pair.A, parts.pair.C
    blind, _ = _left_null(C @ parts.stacked)
    if not len(blind):
        raise DesignError(
            f"no residual row is blind to {parts.text}: C F has rank {len(C)}, as many as measurements are left; "
            "add a sensor or ignore less"
        )
    U, sizes, Vh = np.linalg.svd(blind @ C)
    k = int(np.count_nonzero(sizes > BALANCED_RANK))
    still, H = without_rounding(U[:, k:].T @ blind), Vh[:k]  # every h of length one is a combination of the rows of H
    N = _left_null(C.T)[0].T
    rows, decision = _left_null(H @ A @ N)
    exact = bool(len(rows)) or not k
    if not exact:
        rows = np.linalg.svd(H @ A @ N)[0][:, [min(N.shape[1], k) - 1]].T  # the smallest singular value
    h = rows @ H
    ranks = {
        name: decide_rank(M, rtol=BALANCED_RANK, scale=1.0)
        for name, M in {"rank C": C, "rank [C; h A]": np.vstack([C, h @ A])}.items()
    }
    if exact:
        ranks["h A off the rows of C"] = decision
    elif not approximate:
        distance = float(np.linalg.norm(h @ A @ N) / max(np.linalg.norm(h @ A), TINY))
        plain = (h @ pair.inverse / pair.model.units.states).ravel()
        plain = plain / plain[np.argmax(np.abs(plain) > 1e-9 * np.abs(plain).max())]
        raise DesignError(
            f"no left eigenvectors: no row h = s C with h F = 0 for {parts.text} has h A among the rows of C, whatever "
            f"the eigenvalue: rank [C; h A] = {ranks['rank [C; h A]'].rank} > rank C = {ranks['rank C'].rank} for the "
            f"nearest, h = [{', '.join(f'{x:.4g}' for x in plain)}], {distance:.3g} of whose h A lies outside; use "
            "side='right' or decoupled_residual, or approximate=True"
            + ("; what measurements that repeat one another show needs no observer" if len(still) else "")
        )
    _require_detectable(parts)
    S = without_rounding(rows @ (U[:, :k].T / sizes[:k, None]) @ blind)
    H = S @ C
    k, N = len(H), complement(H.T)
    A2, C2 = without_rounding(N.T @ A @ N), without_rounding(C @ N)
    split, fixed = observable_split(A2, C2), hidden_modes(A2, C2)
    shares = share_poles(poles, [("left",)], [k, split.seen.shape[1]], fixed, pair.model.units.rate)
    share = np.full(k, first, dtype=complex) if shares[0] is None else shares[0]
    target = share[0].real * np.eye(k) if len(set(share.tolist())) == 1 else real_block_diagonal(share)
    K = H.T @ (H @ A - target @ H) @ np.linalg.pinv(C, rcond=BALANCED_RANK)
    rest = pair_gain(pair.model, A2, C2, (np.eye(len(A2)), np.eye(len(C))), shares[1], margin, split=split)
    K, requested = pair.on_outputs(K + N @ rest.K), np.concatenate([share, rest.requested])
    gain = replace(rest, K=K, requested=requested, fixed=fixed)
    note = "" if exact else "approximate: h A is no row of C, what is ignored leaks"
    return np.vstack([S, still]), H.T if exact else None, gain, note, ranks


def _left_null(M: Matrix) -> tuple[Matrix, RankDecision]:
    """Return rows that annihilate a balanced matrix."""
    decision = decide_rank(M, rtol=BALANCED_RANK, scale=1.0)
    return without_rounding(np.linalg.svd(M)[0][:, decision.rank :].T), decision


def _generator(
    parts: _IgnoredColumns,
    side: str,
    S: NDArray,
    seen: NDArray | None,
    gain: ObserverGain,
    note: str,
    ranks: dict[str, RankDecision],
) -> ResidualGenerator:
    """Return the generator of a gain, with its promises checked.

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
    generator = make_generator(system, plant, method, evidence, decouples=decouples, state_map=T, observer=observer)
    leaks = generator.evidence.decoupling
    decoupling = {name: gain for name, gain in leaks.items() if name != IGNORED}
    observer = replace(observer, evidence=evidence.extended(decoupling=decoupling))
    more = {IGNORED: leaks["disturbance"]} if exact and not faults and "disturbance" in leaks else {}
    if not exact:  # the peak gain of each ignored input over frequency, beside the largest of a fault that is seen
        form = generator.internal_form()
        peaks = {
            name: hinf_norm(form.A, form.B[:, [i]], form.C, form.D[:, [i]], form.dt).value
            for i, name in enumerate((*plant.faults, *plant.disturbances))
        }
        largest = max((peaks[name] for name in plant.faults if name not in parts.names), default=0.0)
        more = {f"{name}, leaking": float(peaks[name] / largest) if largest else np.inf for name in parts.names}
    return replace(generator, observer=observer, evidence=generator.evidence.extended(decoupling=more))
