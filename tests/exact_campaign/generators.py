"""What a returned generator or observer claims, against its own floats evaluated with 200 bits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from exact.responses import Paths, frequencies, paths
from exact_campaign.answers import Record, Subject, plain
from exact_campaign.cases import scales_of

#: A response above this, relative to the terms that cancel there, is a leak.
_LEAK = 1e-6
#: A leak above this multiple of the evidence contradicts it.
_BEYOND_EVIDENCE = 100.0
#: A response below this, relative to what the residual is made of, is silence; below the second, nearly.
_SILENT, _NEARLY_SILENT = 1e-11, 1e-9
#: The same where nothing connects the input with some of the outputs.
_SILENT_ROW = 1e-14
#: A response above this, relative to its terms, is an answer; above the second, nearly.
_ANSWER, _NEARLY_ANSWER = 1e-5, 1e-6
#: A response off the claimed subspace by more than the second fraction, and by more than the evidence says, contradicts
#: it; between the two it is close: what is below a millionth, in the units of the design, is no direction.
_NEAR, _OFF = 1e-5, 1e-3
#: A gain of a plant of small fractions above this comes of rounding that was taken for a coupling.
_GAIN = 1e9
#: Frequencies this far beyond the poles of plant and filter are asked about no more.
_BEYOND_POLES = 100.0
#: A residual that is made of less than this, against the others in base units, is rounding as a whole.
_NOTHING = 1e-9


def examine_generator(subject: Subject, record: Record, made: Any, plant: Any, prefix: str = "") -> Paths:
    """Check leak, structure and subspaces of a generator, and keep its facts."""
    y = _output_units(subject, plant)
    w = _frequencies(subject, plant, made.system.A)
    found = paths(made.system, plant, y, w, scales_of(plant, subject.by))
    decoupled = any(name in made.evidence.decoupling for name in ("disturbance", "everything ignored"))
    structure = np.asarray(made.structure)
    live = _live(found, structure)
    _leak(record, found, made, decoupled, live, _growth(made, w, subject.integrators))
    _structure(record, found, structure, plant.faults, live)
    _subspaces(record, found, made, plant.faults, live)
    if not made.system.is_stable():
        record.problem("wrong", "stability", f"not stable: {made.system.poles()}")
    sizes = {
        name: value / subject.by.t for name, value in made.evidence.conditions.items() if name.startswith("size of")
    }
    gain = max(sizes.values(), default=0.0)
    if subject.by.name == "base" and gain > _GAIN * max(1.0, subject.rates):
        record.problem("wrong", "gain", f"{record.function}: a gain of size {gain:.1e} for a plant of small fractions")
    record.facts |= {
        f"{prefix}residuals": made.n_residuals,
        f"{prefix}order": made.system.n_states,
        f"{prefix}structure": plain(structure),
        f"{prefix}dimensions": {name: basis.shape[1] for name, basis in made.subspaces.items()},
        f"{prefix}fixed poles": len(made.evidence.fixed_poles),
    }
    slowest = {"leaks measured from": (made.evidence.leaks_measured_from(made.dt) or 0.0) / subject.by.t}
    record.evidence |= {
        f"{prefix}{name}": value for name, value in (made.evidence.decoupling | sizes | slowest).items()
    }
    return found


def _output_units(subject: Subject, plant: Any) -> NDArray[np.float64]:
    y = subject.by.y
    return y if len(y) == plant.n_outputs else np.ones(plant.n_outputs)


def _frequencies(subject: Subject, plant: Any, F: NDArray[np.float64]) -> list[float]:
    own = frequencies(plant.dt)
    if plant.dt:
        return own
    if subject.rates < 50:
        return [x * subject.by.t for x in own]
    # far beyond all poles responses are powers of 1/s, and what rounding left of a filter is one of fewer.
    poles = np.abs(np.concatenate([scipy.linalg.eigvals(plant.A, plant.E), scipy.linalg.eigvals(F)])) / subject.by.t
    fastest = float(poles.max(where=np.isfinite(poles), initial=0.0))
    fast = [x * subject.rates for x in (0.0371, 1.311) if x * subject.rates < _BEYOND_POLES * fastest]
    return [x * subject.by.t for x in (*own, *fast)]


def _live(found: Paths, structure: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which residuals are more than rounding: marked for some fault, or not small against all others.

    Nor against their own terms in the filter: residuals have units of their own.
    """
    heights = found.reach.max(axis=(0, 2), initial=0.0)
    more = (heights > _NOTHING * heights.max(initial=0.0)) & (found.own > _NOTHING)
    return structure.any(axis=1) | more


def _growth(made: Any, w: Sequence[float], integrators: int) -> NDArray[np.float64]:
    """Return by how much a leak at each frequency may be larger than where the evidence begins to measure it.

    The terms of a plant that integrates ``k`` times, all chains together, may fall by powers of the frequency up to
    the ``k``-th, against what rounding leaves of its filter.
    """
    slowest = made.evidence.leaks_measured_from(made.dt)
    return np.maximum(1.0, (slowest or 0.0) / np.array(w)) ** integrators


def _leak(
    record: Record, found: Paths, made: Any, decoupled: bool, live: NDArray[np.bool_], growth: NDArray[np.float64]
) -> None:
    groups = [("control", found.to_controls)] + ([("disturbance", found.to_disturbances)] if decoupled else [])
    for name, columns in groups:
        ratio = found.leak(columns)[:, live] / growth[:, None, None]
        if not ratio.size:
            continue
        worst = float(ratio.max())
        said = made.evidence.decoupling.get(name, made.evidence.decoupling.get("everything ignored", 0.0))
        text = f"{record.function}: {name} leaks {worst:.1e} of the terms that cancel; evidence {said:.1e}"
        if worst > _LEAK:
            record.problem("wrong", "leak", text)
        elif worst > 1e-9 and worst > _BEYOND_EVIDENCE * said:
            record.problem("evidence", "leak beyond evidence", text)


def _structure(
    record: Record, found: Paths, structure: NDArray[np.bool_], faults: Sequence[str], live: NDArray[np.bool_]
) -> None:
    total, terms, reach = (np.abs(M[:, :, found.to_faults]) for M in (found.total, found.terms, found.reach))
    there = live[:, None]
    share = (total / np.where(reach > 0, reach, 1.0)).max(axis=0)
    # Parts of a plant that nothing connects have no unit in common but those of the signals, as written or in base
    # units. No sum is taken over both: what rounding leaves of one in the other is a digit of the row, not of terms.
    written = np.abs(found.terms).max(axis=2, keepdims=True, initial=0.0)
    apart = found.apart[found.to_faults]
    share = np.where(apart, np.maximum(share, (total / np.where(written > 0, written, 1.0)).max(axis=0)), share)
    silent, nearly = (np.where(apart, _SILENT_ROW, limit) for limit in (_SILENT, _NEARLY_SILENT))
    ratio = np.where(total > 1e-7 * reach, total / np.where(terms > 0, terms, 1.0), 0.0).max(axis=0)
    for i, j in np.argwhere(structure & there & (share < nearly)):
        told = f"residual {i + 1} is marked for {faults[j]!r}, which is {share[i, j]:.1e} of what it is made of"
        outcome = "wrong" if share[i, j] < silent[j] else "close"
        record.problem(outcome, "structure", f"{record.function}: {told}")
    for i, j in np.argwhere(~structure & there & (ratio > _NEARLY_ANSWER)):
        told = f"residual {i + 1} is not marked for {faults[j]!r}, which is {ratio[i, j]:.1e} of its terms"
        outcome = "wrong" if ratio[i, j] > _ANSWER and share[i, j] > 0.1 * _ANSWER else "close"
        record.problem(outcome, "structure", f"{record.function}: {told}")


def _subspaces(record: Record, found: Paths, made: Any, faults: Sequence[str], live: NDArray[np.bool_]) -> None:
    total = np.where(live[:, None], found.total[:, :, found.to_faults], 0.0)
    size = found.reach[:, :, found.to_faults].max(axis=(0, 2), initial=0.0)
    unit = np.where(size > 0, size, 1.0)
    for j, name in enumerate(faults):
        basis = np.asarray(made.subspaces[name])
        if not basis.shape[1] or basis.shape[1] == basis.shape[0]:
            continue
        scaled = np.linalg.qr(basis / unit[:, None])[0]
        r = (total[:, :, j] / unit).T
        height = np.linalg.norm(r, axis=0)
        off = np.linalg.norm(r - scaled @ (scaled.T @ r), axis=0)
        terms = np.linalg.norm(np.where(live[:, None], found.terms[:, :, found.to_faults], 0.0)[:, :, j] / unit, axis=1)
        off = np.where(off > _LEAK * terms, off, 0.0)  # against what cancels there, as any leak
        worst = float(np.max(np.where(height > 1e-7, off / np.where(height > 0, height, 1.0), 0.0)))
        if worst > _NEAR:
            text = f"{record.function}: {name!r} leaves its subspace of dimension {basis.shape[1]} by {worst:.1e}"
            told = made.evidence.conditions.get("response off the signatures", 0.0)
            record.problem("wrong" if worst > max(_OFF, 10 * told) else "close", "subspace", text)


def examine_estimate(subject: Subject, record: Record, system: Any, plant: Any, decoupled: bool) -> None:
    """Check that an estimate of the state is the state, whatever the controls (and the disturbances) do."""
    n = plant.n_states
    if not n:
        return
    zero = np.zeros
    seen = SimpleNamespace(
        A=plant.A,
        E=plant.E,
        C=np.vstack([plant.C, np.eye(n)]),
        dt=plant.dt,
        inputs=plant.inputs,
        disturbances=plant.disturbances,
        B=plant.B,
        Bd=plant.Bd,
        Bf=plant.Bf,
        D=np.vstack([plant.D, zero(plant.B.shape)]),
        Dd=np.vstack([plant.Dd, zero(plant.Bd.shape)]),
        Df=np.vstack([plant.Df, zero(plant.Bf.shape)]),
    )
    D = np.hstack([system.D, -np.eye(n)])
    B = np.hstack([system.B, zero((len(system.A), n))])
    error = SimpleNamespace(A=system.A, B=B, C=system.C, D=D)
    y = np.concatenate([_output_units(subject, plant), subject.by.x])
    scales = scales_of(plant, subject.by)
    scales = scales and replace(scales, outputs=y)
    found = paths(error, seen, y, _frequencies(subject, plant, system.A), scales)
    for name, columns in [("control", found.to_controls), ("disturbance", found.to_disturbances)]:
        if name == "disturbance" and not decoupled:
            continue
        worst = float(found.leak(columns).max(initial=0.0))
        if worst > _LEAK:
            text = f"{record.function}: the estimate is off by {worst:.1e} of its terms under {name}"
            record.problem("wrong", "estimate", text)
