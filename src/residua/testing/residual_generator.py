"""Checks that every residual generator must pass, for your own designs."""

from __future__ import annotations

import numpy as np

from residua.design import ResidualGenerator
from residua.design.core.balanced_filter import BalancedFilter
from residua.design.core.decoupling import reached
from residua.design.core.signatures import outside_subspaces, responses_of_filter
from residua.errors import AccuracyError
from residua.linear import simulate_descriptor
from residua.linear.systems.recursion import run_filter


def check_residual_generator(
    generator: ResidualGenerator,
    *,
    decoupled: bool | None = None,
    samples: int = 200,
    seed: int = 0,
    tolerance: float = 1e-7,
) -> None:
    """Check the guarantees of a residual generator, or raise with the first violation.

    Checked: it is stable; it takes the signals of its plant; it does not answer to control inputs (nor to
    disturbances, where they are decoupled), in the frequency domain and, when it is sampled, by running
    it on simulated data; every fault keeps to the subspace that is claimed for it; running in pieces, and
    with another plant beside it, gives the same bits as running at once. For a sampled continuous design the
    leakage that its evidence states is allowed for.

    Parameters
    ----------
    generator : ResidualGenerator
    decoupled : bool, optional
        Whether disturbances are claimed to be decoupled; by default as its observer states, else ``False``.
    samples : int
        Length of the simulated data.
    seed : int
    tolerance : float
        Of leaks: relative to the terms that have to cancel. Of the part of a fault's response outside its subspace:
        a fraction of the response at the same frequency, beyond twice the stated omission in the evidence.

    Raises
    ------
    AccuracyError
        Names the first violation, with the number.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.testing import check_residual_generator
    >>> check_residual_generator(rs.design.detection_filter(rs.library.gertler()))
    """
    if not generator.system.is_stable():
        raise AccuracyError(f"not stable: poles {generator.system.poles()}")
    plant = generator.plant
    width = len(plant.inputs) + plant.n_outputs
    if generator.system.n_inputs != width:
        raise AccuracyError(f"takes {generator.system.n_inputs} signals, the plant has {width}")
    if decoupled is None:
        decoupled = "disturbance" in generator.evidence.decoupling
    allowed = {"control": 0.0, "disturbance": 0.0} | generator.evidence.cost_of_sampling
    for name, gain in reached(generator.system, plant, generator.state_map, generator.static_map).items():
        if (name == "control" or decoupled) and gain > tolerance + 1.01 * allowed[name]:
            raise AccuracyError(f"answers to the {name} inputs: relative gain {gain:.2g}")
    if generator.state_map is not None:
        _check_subspaces(generator, tolerance)
    if generator.system.is_discrete:
        _check_runs(generator, decoupled, samples, np.random.default_rng(seed), tolerance + 2 * max(allowed.values()))


def _check_subspaces(generator: ResidualGenerator, tolerance: float) -> None:
    assert generator.state_map is not None
    f = BalancedFilter.of(generator.system, generator.plant, generator.state_map, generator.static_map)
    points = f.points[1:] * np.sqrt(f.points[:-1] / f.points[1:])  # between those of the design
    found = responses_of_filter(f, points)
    allowed = tolerance + 2 * generator.evidence.conditions.get("response off the signatures", 0.0)
    for name, outside in outside_subspaces(found, dict(generator.subspaces), generator.faults).items():
        if outside > allowed:
            raise AccuracyError(f"fault {name!r} leaves its subspace by {outside:.2g} > {allowed:.2g} of its response")


def _check_runs(
    generator: ResidualGenerator, decoupled: bool, samples: int, rng: np.random.Generator, tolerance: float
) -> None:
    plant = generator.plant
    roles = ("control", "disturbance") if decoupled else ("control",)
    system = plant.system(roles)
    v = rng.standard_normal((samples, system.n_inputs))
    with np.errstate(over="ignore", invalid="ignore"):
        if system.E is None:
            y = system.simulate(v)
        else:
            v[: system.n_states] = 0.0  # the algebraic part looks ahead, and the filter starts from rest
            y = simulate_descriptor(system, v).outputs
            samples = len(y)
    kept = int(np.argmax(np.abs(y).max(axis=1) > 1e6)) or samples  # an unstable plant leaves the range of the check
    u, y = v[:kept, : len(plant.inputs)], y[:kept]
    r = generator.run(u, y)
    g, whole = generator.system, np.hstack([u, y])
    apart = whole * np.eye(g.n_inputs)[:, None, :]  # each signal alone: the terms that cancel in the residual
    _, terms = run_filter(g.A, g.B, g.C, g.D, np.zeros((g.n_inputs, g.n_states)), apart)
    size = np.abs(terms).sum(axis=0).max(axis=0, initial=0.0)
    left = np.abs(r).max(axis=0, initial=0.0)
    if np.any(left > tolerance * size):
        worst = int(np.argmax(left / np.where(size > 0, size, 1.0)))
        raise AccuracyError(
            f"residual {generator.residuals[worst]!r} is {left[worst]:.2g} on fault-free data, where terms of "
            f"{size[worst]:.2g} should cancel"
        )
    together = generator.run(np.stack([u, u[::-1]]), np.stack([y, y[::-1]]))
    if not np.array_equal(together[0], r):
        raise AccuracyError("two plants run together do not give what each gives alone")
    data = whole[None]
    x, cut = np.zeros((1, g.n_states)), kept // 3
    x, first = run_filter(g.A, g.B, g.C, g.D, x, data[:, :cut])
    _, second = run_filter(g.A, g.B, g.C, g.D, x, data[:, cut:])
    if not np.array_equal(np.concatenate([first, second], axis=1)[0], r):
        raise AccuracyError("running in pieces does not give the same bits as running at once")
