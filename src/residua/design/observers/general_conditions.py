"""The conditions that the general form of a residual generator must fulfil, and the state map behind them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import DesignError
from residua.linear.subspaces.rank import left_null_basis
from residua.linear.systems.balancing import DescriptorUnits, descriptor_units
from residua.plant import Plant

#: The conditions in the order of (4-18), with feedthrough; those of (4-19) follow.
CONDITIONS = (
    "T A - M T E - N C = 0",
    "T B - N D - J = 0",
    "Ls T E + Ly C + V A = 0",
    "Lu + Ly D + V B = 0",
    "T Fd - N Dd = 0",
    "Ly Dd + V Fd = 0",
)
#: Largest error of a condition, relative to the terms that have to cancel.
FULFILLED = 1e-8
#: Most entries of a state map for which least squares is used.
_MOST = 2500


@dataclass(frozen=True, eq=False)
class GeneralMatrices:
    """The matrices of ``s' = M s + J u + N y``, ``r = Ls s + Lu u + Ly y``, with ``s = T E x`` and ``V E = 0``."""

    T: NDArray[np.float64]
    M: NDArray[np.float64]
    J: NDArray[np.float64]
    N: NDArray[np.float64]
    Ls: NDArray[np.float64]
    Lu: NDArray[np.float64]
    Ly: NDArray[np.float64]
    V: NDArray[np.float64]


def condition_errors(plant: Plant, m: GeneralMatrices) -> dict[str, float]:
    """Return how far each condition is missed: of each row the largest error, relative to the terms that cancel.

    In balanced units. What should be zero is rounding of the largest entries of a row and a column, wherever these
    stand, so that they count as terms too.
    """
    units = _units(plant)
    A, E, C = plant.A, np.eye(plant.n_states) if plant.E is None else plant.E, plant.C
    s, y, e = units.states, 1 / units.outputs, 1 / units.equations
    u = 1 / _sizes(plant.B, plant.D, units)
    d = 1 / _sizes(plant.Bd, plant.Dd, units)
    TE, TE_terms = m.T @ E, np.abs(m.T) @ np.abs(E)
    own = _row_sizes(TE_terms, s)
    third = [(m.Ls, TE, np.where(own > 0, own, 1.0)), (m.Ly, C, y), (m.V, A, e)]
    # a V that is nothing but rounding is small against what the residual is made of
    size_A = float((units.equations[:, None] * np.abs(A) * s).max(initial=0.0))
    floor = 1e-4 * _terms(third, s).max(axis=1, initial=0.0) / (size_A or 1.0) if np.any(m.V) else np.zeros(len(m.Ls))
    conditions = (
        (m.T @ A - m.M @ TE - m.N @ C, [(m.T, A, e), (m.M, TE, np.where(own > 0, own, 1.0)), (m.N, C, y)], s, None),
        (m.T @ plant.B - m.N @ plant.D - m.J, [(m.T, plant.B, e), (m.N, plant.D, y), (m.J, None, None)], u, None),
        (m.Ls @ TE + m.Ly @ C + m.V @ A, third, s, None),
        (
            m.Lu + m.Ly @ plant.D + m.V @ plant.B,
            [(m.Lu, None, None), (m.Ly, plant.D, y), (m.V, plant.B, e)],
            u,
            floor,
        ),
        (m.T @ plant.Bd - m.N @ plant.Dd, [(m.T, plant.Bd, e), (m.N, plant.Dd, y)], d, None),
        (m.Ly @ plant.Dd + m.V @ plant.Bd, [(m.Ly, plant.Dd, y), (m.V, plant.Bd, e)], d, floor),
    )
    errors = {name: _relative(*parts) for name, parts in zip(CONDITIONS, conditions, strict=True)}
    return errors if plant.disturbances else dict(list(errors.items())[:4])


Products = Sequence[tuple[NDArray, NDArray | None, NDArray | None]]


def _terms(products: Products, columns: NDArray) -> NDArray[np.float64]:
    """Return the size of the terms that products add up from, with what stands elsewhere in their rows and columns."""
    terms = 0.0
    for P, Q, unit in products:
        if Q is None or unit is None:
            terms = terms + np.abs(P) * columns
            continue
        P, Q = np.abs(P) * unit, np.abs(Q) / unit[:, None] * columns
        terms = terms + P @ Q + 1e-4 * P.max(axis=1, initial=0.0)[:, None] * Q.max(axis=0, initial=0.0)
    return np.asarray(terms, dtype=float)


def _relative(off: NDArray, products: Products, columns: NDArray, floor: NDArray | None) -> float:
    """Return the largest entry of each row of ``off`` relative to the largest of the products that it is made of."""
    if not off.size:
        return 0.0
    size = _terms(products, columns).max(axis=1) + (0.0 if floor is None else floor)
    return float(np.max(np.abs(off * columns).max(axis=1) / np.where(size > 0, size, 1.0)))


def fault_columns(plant: Plant, m: GeneralMatrices) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``T F`` (less ``N D_f``) without what is rounding, and the fault columns themselves."""
    units = _units(plant)
    e, y = 1 / units.equations, 1 / units.outputs
    terms = np.abs(m.T) @ np.abs(plant.Bf) + np.abs(m.N) @ np.abs(plant.Df)
    for P, Q, unit in ((m.T, plant.Bf, e), (m.N, plant.Df, y)):
        rows = (np.abs(P) * unit).max(axis=1, initial=0.0)
        terms = terms + 1e-4 * rows[:, None] * (np.abs(Q) / unit[:, None]).max(axis=0, initial=0.0)
    TF = m.T @ plant.Bf - m.N @ plant.Df
    return np.where(np.abs(TF) > 1e-9 * terms, TF, 0.0), np.vstack([plant.Bf, plant.Df])


def _units(plant: Plant) -> DescriptorUnits:
    B, D = np.hstack([plant.B, plant.Bd, plant.Bf]), np.hstack([plant.D, plant.Dd, plant.Df])
    return descriptor_units(plant.A, plant.E, B, plant.C, D)


def _sizes(B: NDArray, D: NDArray, units: DescriptorUnits) -> NDArray[np.float64]:
    """Return the size of each input in balanced units; one for an input that does nothing."""
    both = np.vstack([units.equations[:, None] * B, units.outputs[:, None] * D])
    size = np.abs(both).max(axis=0, initial=0.0)
    return np.where(size > 0, size, 1.0)


def _row_sizes(M: NDArray, columns: NDArray) -> NDArray[np.float64]:
    return (M * columns).max(axis=1, initial=0.0)


def state_map(plant: Plant, m: GeneralMatrices, *, decouples: bool, control: bool) -> NDArray[np.float64]:
    """Return ``T`` from :math:`T A - M T E = N C`, a Sylvester equation.

    Where it leaves ``T`` open or nearly so, because ``M`` and the plant share a pole, or with an ``E``, the other
    conditions are fulfilled along with it, in the sense of least squares: that of the controls with ``control``, if
    there is a ``J``, and that of the disturbances with ``decouples``.
    """
    if not len(m.M):
        return np.zeros((0, plant.n_states))
    units = _units(plant)
    R, S, Y = units.equations[:, None], units.states, units.outputs
    A, C = R * plant.A * S, Y[:, None] * plant.C * S
    M, N = m.M, m.N / Y
    candidates = [_sylvester(M, A, N @ C)] if plant.E is None else []
    if len(M) * len(A) <= _MOST:
        E = np.eye(len(A)) if plant.E is None else R * plant.E * S
        rows = [(np.eye(len(M)), A, N @ C)]
        if control:
            rows.append((np.eye(len(M)), R * plant.B, m.J + m.N @ plant.D))
        if plant.E is None:  # otherwise the algebraic equations may help to fulfil it
            rows.append((m.Ls, E, -(m.Ly / Y) @ C))
        if decouples and plant.disturbances:
            rows.append((np.eye(len(M)), R * plant.Bd, m.N @ plant.Dd))
        candidates.append(_joint(M, E, rows))
    maps = [T * units.equations for T in candidates if T is not None]
    if not maps:
        raise DesignError(f"T cannot be found for {len(M)} x {len(A)} states with an E: give T")
    errors = [_error_with(plant, m, T, decouples=decouples, control=control) for T in maps]
    best = int(np.argmin(errors))
    # where none fits, that of the first condition alone shows best which of the others fails
    return maps[best if errors[best] <= FULFILLED else 0]


def _error_with(plant: Plant, m: GeneralMatrices, T: NDArray, *, decouples: bool, control: bool) -> float:
    """Return the largest error of a condition with a state map; ``Lu``, which has nothing to do with it, left out."""
    J = m.J if control else T @ plant.B - m.N @ plant.D
    errors = condition_errors(plant, static_map(plant, replace(m, T=T, J=J)))
    asked = [CONDITIONS[i] for i in ((0, 1, 2, 4) if decouples else (0, 1, 2))]
    return max(errors.get(name, 0.0) for name in asked)


def _sylvester(M: NDArray, A: NDArray, G: NDArray) -> NDArray[np.float64] | None:
    """Return ``T`` with ``T A - M T = G``, or None if the spectra meet."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # the outcome is checked
            T = scipy.linalg.solve_sylvester(-M, A, G)
            T = T + scipy.linalg.solve_sylvester(-M, A, G - (T @ A - M @ T))
    except (np.linalg.LinAlgError, ValueError):
        return None
    return T if np.all(np.isfinite(T)) else None


def _joint(M: NDArray, E: NDArray, rows: list[tuple[NDArray, NDArray, NDArray]]) -> NDArray[np.float64]:
    """Return ``T`` with ``P T Q = G`` for each row of the list, of the first less ``M T E``, by least squares."""
    q, n = len(M), len(E)
    units = np.ones(q * n)
    blocks, sizes = [np.kron(P, Q.T) for P, Q, _ in rows], [np.abs(np.kron(P, Q.T)) for P, Q, _ in rows]
    through = np.kron(M, E.T)
    blocks[0], sizes[0] = blocks[0] - through, sizes[0] + np.abs(through)  # what cancels leaves no equation
    K, W, g = np.vstack(blocks), np.vstack(sizes), np.concatenate([G.ravel() for _, _, G in rows])
    for _ in range(2):  # comparable equations, and the rows of T in comparable units
        height = np.linalg.norm(W, axis=1)
        height = np.where(height > 0, height, 1.0)
        width = np.linalg.norm(W / height[:, None], axis=0)
        width = np.where(width > 0, width, 1.0)
        K, W, g = K / height[:, None] / width, W / height[:, None] / width, g / height
        units = units / width
    t = np.linalg.lstsq(K, g, rcond=1e-13)[0]
    t = (t + np.linalg.lstsq(K, g - K @ t, rcond=1e-13)[0]) * units
    return t.reshape(q, n)


def static_map(plant: Plant, m: GeneralMatrices) -> GeneralMatrices:
    """Return the matrices with what the residual must read of the algebraic equations of a singular plant."""
    if plant.E is None:
        return m
    algebra = left_null_basis(plant.E)[0].T
    missing = -(m.Ls @ m.T @ plant.E + m.Ly @ plant.C)
    if not len(algebra) or not np.any(missing):
        return m
    units = _units(plant)
    Z = np.linalg.lstsq((algebra @ plant.A * units.states).T, (missing * units.states).T, rcond=None)[0].T
    return replace(m, V=Z @ algebra)
