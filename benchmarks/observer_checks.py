"""Checks of finished observers, generators, banks and estimators against the plant, none of them the library's own.

Everything is computed anew from the matrices: identities, spectra, and transfer functions at random complex points,
where what must vanish is compared with the terms that cancel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components

import residua as rs
from residua.errors import AccuracyError, DesignError

#: Largest error of an identity, of a pole, and of a response that must vanish; relative.
TOLERANCE = 1e-6
#: A response that a structure promises is at least this large, relative to the terms that it is made of.
PRESENT = 1e-9
LARGE_FILTER = 300
POINTS = 6


class CheckError(AssertionError):
    """What was returned is not what was promised."""


@dataclass(frozen=True)
class Asked:
    """What was asked of the poles: nothing, a margin, or a list for each observer."""

    margin: float | None = None
    poles: tuple[float, ...] = ()


@dataclass(frozen=True)
class Measured:
    """The worst identity, relative to the terms that cancel, and the worst pole, relative to its size."""

    identity: float
    pole: float


def check(made: Any, plant: rs.Plant, asked: Asked) -> Measured:
    """Check whatever a design returned, or raise with the first thing that does not hold."""
    if isinstance(made, rs.design.Observer):
        return _observer(made, plant, asked)
    if isinstance(made, rs.design.Bank):
        return _bank(made, asked)
    if isinstance(made, rs.design.ResidualGenerator):
        return _generator(made, plant, asked, copies=_filters(made))
    if isinstance(made, rs.design.FaultEstimator):
        return _estimator(made, plant, asked)
    if isinstance(made, rs.design.PerfectObserver):
        return _perfect(made, plant)
    raise CheckError(f"no check is written for {type(made).__name__}")


# ------------------------------------------------------------------ by what was made


def _observer(made: rs.design.Observer, plant: rs.Plant, asked: Asked) -> Measured:
    own = made.plant
    E = np.eye(own.n_states) if own.E is None else own.E
    F, T, K, M, H = made.F, made.T, made.K, made.M, made.H
    x = _units(own.A, own.C)
    z = x if len(F) == own.n_states else None
    whole = np.abs(T) + np.eye(*T.shape) if z is not None else T  # T = I - H C may cancel
    worst = [
        _missed([T @ own.A, -K @ own.C, -F @ T @ E], _sizes((whole, own.A), (K, own.C), (F, T, E)), z, x),
        _missed([M @ T @ E, H @ own.C, -np.eye(own.n_states)], _sizes((M, T, E), (H, own.C)), x, x),
        _estimates(made.system, plant, ("control", "disturbance") if made.decouples else ("control",)),
    ]
    if made.decouples and own.disturbances and made.order:
        sizes = _sizes((whole, own.Bd), (K, own.Dd))
        worst.append(_missed([T @ own.Bd, -K @ own.Dd], sizes, z, 1 / np.maximum(sizes.max(axis=0), 1e-300)))
    worst.append(_own_residual(made, plant))
    _accepted("identities", worst)
    fixed = np.asarray(made.evidence.fixed_poles)
    _fixed_are_zeros(own if made.decouples else own.without_disturbances(), made, fixed)
    return Measured(max(worst), _spectrum([F], asked, fixed, own.dt))


def _generator(made: rs.design.ResidualGenerator, plant: rs.Plant, asked: Asked, *, copies: int = 1) -> Measured:
    silent = ["control"] + (["disturbance"] if "disturbance" in made.evidence.decoupling else [])
    leak = float(np.max(_residual_gain(made, plant, silent), initial=0.0))
    _accepted("gain from what must not be seen", [leak])
    blocks = _blocks(made.system.A)
    return Measured(leak, _spectrum(blocks, asked, made.evidence.fixed_poles, plant.dt, copies))


def _bank(made: rs.design.Bank, asked: Asked) -> Measured:
    plant, generator = made.plant, made.generator
    if made.failures:
        raise CheckError(f"members are missing though none may: {', '.join(made.failures)}")
    measured = _generator(generator, plant, asked, copies=len(made.members))
    gain = _residual_gain(generator, plant, ["fault"])
    present = _residual_gain(generator, plant, ["fault"], at_best_point=True)
    leaks = [measured.identity]
    for member, row in zip(generator.members, made.structure, strict=True):
        of_member = gain[list(member.residuals)].max(axis=0)
        leaks += list(of_member[~row])
        seen = present[list(member.residuals)].max(axis=0)[row]
        if (seen < PRESENT).any():
            raise CheckError(f"member {member.name!r} does not answer to a fault of its code: {seen.min():.2g}")
    _accepted("zeros of the structure", leaks)
    for name, observer in made.observers.items():
        try:
            leaks.append(_observer(observer, observer.plant, Asked()).identity)
        except CheckError as error:
            raise CheckError(f"member {name!r}: {error}") from error
    return Measured(max(leaks), measured.pole)


def _estimator(made: rs.design.FaultEstimator, plant: rs.Plant, asked: Asked) -> Measured:
    """Check that every estimate is its fault behind its lag, and one of no other, and the state estimate."""
    state = _observer(made.observer, made.observer.plant, asked)
    generator = made.residual_generator()
    silent = ["control", "disturbance"]
    worst = [state.identity, float(np.max(_residual_gain(generator, plant, silent), initial=0.0))]
    columns = [plant.faults.index(name) for name in made.faults]
    lags = np.array([made.lag[name] for name in made.faults])
    system, faulty = plant.system(("fault",)), len(plant.inputs)
    off: Any = 0.0
    terms: Any = 0.0
    for s in _points(plant):
        Q = _at(generator.system, s)[:, faulty:]
        P = _at(system, s)[:, columns]
        shift = s ** -np.round(lags / plant.dt) if plant.dt else 1 / (lags * s + 1)
        terms = np.maximum(terms, np.abs(Q) @ np.abs(P) + np.eye(len(columns)))
        off = np.maximum(off, np.abs(Q @ P - np.diag(shift)))
    worst.append(float(np.max(off / _floored(terms))))
    gain = generator.internal_form().dc_gain()[:, columns]
    units = 1 / np.maximum(np.linalg.norm(np.vstack([plant.Bf, plant.Df])[:, columns], axis=0), 1e-300)
    worst.append(float(np.abs((gain - np.eye(len(columns))) / units[:, None] * units).max()))
    _accepted("unit gain of the estimates", worst)
    if not generator.system.is_stable():
        raise CheckError("the estimator is not stable")
    return Measured(max(worst), state.pole)


def _perfect(made: rs.design.PerfectObserver, plant: rs.Plant) -> Measured:
    """Check that the error has no dynamics, and that the estimate is the state behind its filter or delay."""
    own, N = made.plant, made.N
    n, q = own.n_states, len(own.disturbances)
    rows = [own.outputs.index(name) for name in made.outputs]
    E = np.hstack([np.eye(n) if own.E is None else own.E, np.zeros((n, q))])
    top, bottom = np.hstack([own.A, own.Bd]), np.hstack([own.C, own.Dd])[rows]
    worst = [
        _relative(made.T @ top + made.L @ bottom - np.eye(n + q), _sizes((made.T, top), (made.L, bottom))),
        _relative(made.T @ E - N, _sizes((made.T, E))),
        max(abs(np.linalg.det(np.eye(n + q) - s * N) - 1) for s in _points(plant)),
    ]
    m = made.derivatives
    filtered = (lambda s: s**-m) if own.dt else (lambda s: 1 / (s / made.bandwidth + 1) ** m)
    worst.append(_estimates(made.system, plant, ("control", "disturbance"), filtered))
    worst.append(_own_residual(made, plant))
    _accepted("identities of the perfect observer", worst)
    return Measured(max(worst), 0.0)


def _own_residual(made: Any, plant: rs.Plant) -> float:
    """Return the gain to an observer's residual from what must not be seen; zero where it says it has none.

    Not examined for filters of more than 300 states, which take minutes.
    """
    if made.system.n_states > LARGE_FILTER:
        return 0.0
    try:
        generator = made.residual_generator()
    except (DesignError, AccuracyError):
        return 0.0
    return _generator(generator, plant, Asked()).identity


# ------------------------------------------------------------------------- algebra


def _sizes(*products: tuple[NDArray, ...]) -> NDArray:
    """Return the size of the terms in a sum of matrix products, entry by entry."""
    total: Any = 0.0
    for factors in products:
        part = np.abs(factors[0])
        for factor in factors[1:]:
            part = part @ np.abs(factor)
        total = total + part
    return total


def _missed(terms: list[NDArray], sizes: NDArray, rows: NDArray | None, columns: NDArray) -> float:
    """Return how far a sum is from zero, relative to its terms: by row, or over all where rows have units."""
    total = np.abs(sum(terms[1:], terms[0])) * columns
    sizes = sizes * columns
    if not total.size:
        return 0.0
    if rows is None:
        return float((total.max(axis=1) / np.maximum(sizes.max(axis=1), 1e-300)).max())
    return float((total / rows[:, None]).max() / max((sizes / rows[:, None]).max(), 1e-300))


def _relative(missed: NDArray, sizes: NDArray) -> float:
    return float(np.max(np.abs(missed) / np.maximum(sizes, np.eye(len(missed), missed.shape[1])).max(initial=1e-300)))


def _units(A: NDArray, C: NDArray) -> NDArray:
    """Return units of the states from SciPy's balancing, with the outputs as further rows."""
    n, p = A.shape[0], C.shape[0]
    whole = np.zeros((n + p, n + p))
    whole[:n, :n], whole[n:, :n] = A, C / np.maximum(np.abs(C).max(axis=1, keepdims=True), 1e-300)
    return scipy.linalg.matrix_balance(whole, permute=False, separate=True)[1][0][:n]


def _accepted(what: str, worst: list[float]) -> None:
    if not max(worst) <= TOLERANCE:
        raise CheckError(f"{what}: missed by {', '.join(f'{value:.2g}' for value in worst)}")


# ---------------------------------------------------------------------- responses


def _points(plant: rs.Plant) -> list[complex]:
    """Return fixed random complex points of the size of the plant's dynamics, in the unstable region."""
    rng = np.random.default_rng(20)
    angles = rng.uniform(0.2, 1.3, POINTS)
    if plant.dt:
        return list(rng.uniform(1.1, 2.0, POINTS) * np.exp(1j * angles))
    sizes = np.abs(_plant_poles(plant))
    sizes = sizes[sizes > 1e-9 * max(sizes.max(initial=0.0), 1e-300)]
    low, high = (sizes.min(), sizes.max()) if sizes.size else (1.0, 1.0)
    return list(1.37 * np.exp(np.linspace(np.log(low), np.log(high), POINTS) + 1j * angles))


def _plant_poles(plant: rs.Plant) -> NDArray:
    values = scipy.linalg.eigvals(plant.A, plant.E)
    return values[np.isfinite(values)]


def _at(system: rs.StateSpace, s: complex) -> NDArray:
    """Return the transfer matrix at a point; states in balanced units."""
    if not system.n_states:
        return system.D.astype(complex)
    if system.E is not None:
        return system.C @ np.linalg.solve(s * system.E - system.A, system.B.astype(complex)) + system.D
    A, (T, _) = scipy.linalg.matrix_balance(system.A, permute=False, separate=True)
    inner = np.linalg.solve(s * np.eye(len(A)) - A, (system.B / T[:, None]).astype(complex))
    return (system.C * T) @ inner + system.D


def _residual_gain(
    made: rs.design.ResidualGenerator, plant: rs.Plant, roles: list[str], *, at_best_point: bool = False
) -> NDArray:
    """Return the largest gain from inputs to residuals, relative to the largest terms that cancel.

    Or the largest ratio of the two at one point.
    """
    n_u = len(plant.inputs)
    gain: Any = 0.0
    terms: Any = 0.0
    best: Any = 0.0
    reach: Any = 0.0
    paths: Any = 0.0
    for s in _points(plant):
        Q, P = _at(made.system, s), _at(plant.system(tuple(roles)), s)
        direct = np.zeros((len(Q), P.shape[1]), dtype=complex)
        if roles[0] == "control":
            direct[:, :n_u] = Q[:, :n_u]
        Qy = Q[:, n_u:]
        size, parts = np.abs(direct + Qy @ P), np.abs(direct) + np.abs(Qy) @ np.abs(P)
        best = np.maximum(best, size / np.where(parts > 0, parts, 1.0))
        gain, terms, reach = np.maximum(gain, size), np.maximum(terms, parts), np.maximum(reach, np.abs(P))
        paths = np.maximum(paths, np.abs(Qy).max(axis=1, keepdims=True, initial=0.0))
    rows = np.max(terms, axis=1, keepdims=True, initial=0.0)
    gain = np.where(rows > 1e-12 * rows.max(initial=0.0), gain, 0.0)  # the others are residuals that are zero, rounded
    floor = 1e-9 * paths * np.max(reach, axis=0, initial=0.0)
    return best if at_best_point else gain / np.maximum(_floored(terms, reach), floor)


def _floored(terms: NDArray, reach: Any = 0.0) -> NDArray:
    """Return sizes that are no less than a millionth of what their row and column suggest.

    Where an input does not reach an output at all, the terms are rounding themselves, and nothing can be read from
    their cancelling. ``reach`` are the sizes of the plant's responses, for inputs that reach no residual.
    """
    if not np.size(terms):
        return np.ones_like(terms)
    whole = np.vstack([terms, np.broadcast_to(reach, (len(np.atleast_2d(reach)), terms.shape[1]))])
    rows = np.maximum(whole.max(axis=1, keepdims=True), 1e-300)
    columns = np.maximum((whole / rows).max(axis=0), 1e-300)
    rows = (terms / columns).max(axis=1, keepdims=True)
    return np.maximum(np.maximum(terms, 1e-6 * rows * columns), 1e-300)


def _estimates(
    system: rs.StateSpace, plant: rs.Plant, roles: tuple[str, ...], filtered: Callable[[complex], complex] | None = None
) -> float:
    """Return how far the transfer function to the state estimate is from that to the state, filtered alike."""
    n_u = len(plant.inputs)
    off: Any = 0.0
    terms: Any = 0.0
    from_inputs = plant.system(roles)
    states = rs.StateSpace(plant.A, from_inputs.B, np.eye(plant.n_states), E=plant.E, dt=plant.dt)
    for s in _points(plant):
        Q, X = _at(system, s), _at(states, s)
        P = plant.C @ X + from_inputs.D
        X = X * filtered(s) if filtered else X
        direct = np.zeros_like(X)
        direct[:, :n_u] = Q[:, :n_u]
        terms = np.maximum(terms, np.abs(direct) + np.abs(Q[:, n_u:]) @ np.abs(P) + np.abs(X))
        off = np.maximum(off, np.abs(direct + Q[:, n_u:] @ P - X))
    return float(np.max(off / _floored(terms), initial=0.0))


# ------------------------------------------------------------------------- spectra


def _filters(made: rs.design.ResidualGenerator) -> int:
    """Return how many filters a directional generator runs as one: a list of poles holds for each."""
    return len(made.members)


def _blocks(A: NDArray) -> list[NDArray]:
    """Return the uncoupled parts of a stacked filter."""
    count, label = connected_components(A != 0, directed=False) if len(A) else (0, np.zeros(0))
    return [A[np.ix_(label == k, label == k)] for k in range(count)]


def _spectrum(blocks: list[NDArray], asked: Asked, fixed: NDArray, dt: float, copies: int = 1) -> float:
    """Return the worst error of the poles that were asked for, or raise where a filter is not stable or off."""
    found = np.concatenate([scipy.linalg.eigvals(block) for block in blocks if len(block)] or [np.zeros(0, complex)])
    stable = np.abs(found) < 1 if dt else found.real < 0
    if not stable.all():
        raise CheckError(f"not stable: {found[~stable][0]:.6g}")
    fixed = np.asarray(fixed, dtype=complex)
    if asked.margin is not None:
        return _beyond(found, asked.margin, fixed, dt)
    if not asked.poles or not found.size:
        return 0.0
    wanted = np.concatenate([np.tile(np.asarray(asked.poles, dtype=complex), copies), fixed])
    if len(wanted) > len(found):
        raise CheckError(f"{len(wanted)} poles asked for or fixed, the filter has {len(found)}")
    distance = np.abs(wanted[:, None] - found)
    size = np.maximum(np.abs(wanted), 1e-3 * np.abs(wanted).max())
    order = linear_sum_assignment(distance / size[:, None])[1]
    return _worst_pole(blocks, wanted, found[order], len(asked.poles) * copies, dt)


def _worst_pole(blocks: list[NDArray], wanted: NDArray, found: NDArray, count: int, dt: float) -> float:
    """Return the worst error; the mean of a multiple pole counts, whose members scatter as theory says."""
    worst = 0.0
    for pole in np.unique(wanted[:count]):
        members = np.flatnonzero(np.abs(wanted - pole) <= 1e-9 * abs(pole))
        unit = 1.0 if dt else float(abs(pole))
        error = abs(complex(np.mean(found[members])) - pole) / unit
        if len(members) > 1:
            scatter = float(np.abs(found[members] - pole).max()) / unit
            backward = min(_distance_to_pole(block, pole) for block in blocks if len(block))
            # a coupling of 2e-6, as in BD01_2_02, costs six digits of the gain
            if scatter > 1e-3 or (scatter > TOLERANCE and backward > 1e-10):
                raise CheckError(f"the pole {pole:.4g} is {len(members)}-fold: scatter {scatter:.2g}, {backward:.2g}")
        worst = max(worst, error)
    return worst


def _distance_to_pole(block: NDArray, pole: complex) -> float:
    """Return the smallest relative change of a matrix that makes a number an eigenvalue."""
    A = scipy.linalg.matrix_balance(block)[0]
    values = np.linalg.svd(A - pole * np.eye(len(A)), compute_uv=False)
    return float(values[-1] / max(float(np.linalg.norm(A, 2)), 1e-300))


def _beyond(found: NDArray, margin: float, fixed: NDArray, dt: float) -> float:
    """Return by how much the slowest pole misses a margin; fixed poles need not reach it."""
    rest = found
    for pole in fixed:
        rest = np.delete(rest, int(np.argmin(np.abs(rest - pole)))) if rest.size else rest
    if not rest.size:
        return 0.0
    if dt:
        return max(0.0, float(np.abs(rest).max()) - float(np.exp(-margin * dt)))
    return max(0.0, 1 + float(rest.real.max()) / margin)


def _fixed_are_zeros(plant: rs.Plant, made: rs.design.Observer, fixed: NDArray) -> None:
    """Raise for a fixed pole where the pencil of plant and disturbances has full rank: a gain could have moved it."""
    n, q = plant.n_states, len(plant.disturbances)
    E = np.eye(n) if plant.E is None else plant.E
    x = _units(plant.A, plant.C)[:, None]
    for pole in fixed:
        B = plant.Bd / np.maximum(np.linalg.norm(plant.Bd, axis=0), 1e-300)
        pencil = np.vstack([np.hstack([(pole * E - plant.A) / x * x.T, B / x]), np.hstack([plant.C * x.T, plant.Dd])])
        size = np.vstack([np.hstack([(abs(pole) * abs(E) + abs(plant.A)) / x * x.T, abs(B) / x]), abs(pencil[n:])])
        row = np.maximum(np.linalg.norm(size, axis=1), 1e-300)[:, None]
        column = np.maximum(np.linalg.norm(size / row, axis=0), 1e-300)
        values = np.linalg.svd(pencil / row / column, compute_uv=False)
        if values[n + q - 1] > TOLERANCE * values[0]:
            raise CheckError(f"the pole {pole:.4g} is called fixed, but the pencil has full rank there: {values[-1]}")
