"""A residual generator seen from faults, disturbances and noise."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError
from residua.linear import StateSpace
from residua.linear.poles.spectrum import spectral_radius
from residua.linear.subspaces.observability import staircase, without_unobservable
from residua.linear.systems.sampling import exponentials
from residua.plant import Plant
from residua.tolerances import IDENTITY, LEAKAGE, TINY, above_rounding

#: Frequencies of a grid.
_POINTS = 60
#: Of the largest pole, the part below which a pole is at zero.
_SMALL = 1e-12
#: Windows of more samples are summed by doubling: what they cost grows with the logarithm of their length.
_LONG = 4096
#: Doublings of a covariance at most: poles as near to the circle as rounding keeps apart have settled by then.
_DOUBLINGS = 60
#: The most that a plant may grow by from one sample to the next: rounding of that is then what may leak.
_MOST_GROWTH = LEAKAGE / float(np.finfo(float).eps)


def internal_form(
    generator: StateSpace,
    plant: Plant,
    state_map: NDArray | None = None,
    static_map: NDArray | None = None,
    *,
    with_controls: bool = False,
) -> StateSpace:
    r"""Return the system from faults, disturbances and noise (and controls) of ``plant`` to the residual.

    With a state map ``T``, the state that the fault-free plant gives the generator, :math:`\xi = T E x`, the error
    :math:`e = T E x - \xi` obeys :math:`\dot e = A_g e + (T B - G_y D) v`,
    :math:`r = -C_g e + (H_y D + V B) v`, where ``V``, with ``V E = 0``, reads the algebraic equations of a
    singular plant: exact, of the order of the generator, whatever the plant. Without a state map the
    generator is driven by the plant, and the states that the residual does not see are removed.

    Parameters
    ----------
    generator : StateSpace
        From control inputs and outputs of the plant to residuals.
    plant : Plant
    state_map : ndarray, shape (states of the generator, states of the plant), optional
    static_map : ndarray, shape (residuals, states of the plant), optional
        Zero when omitted.
    with_controls : bool
        Whether the control inputs are further columns, at the end.

    Returns
    -------
    StateSpace

    References
    ----------
    Gertler (1991), eqs. (4-15) to (4-20).
    """
    n_u = len(plant.inputs)
    if state_map is None:
        whole = _driven(generator, plant)
        order = list(range(n_u, whole.n_inputs)) + (list(range(n_u)) if with_controls else [])
        return without_unobservable(whole.select(inputs=order))
    p = plant.system(("fault", "disturbance", "noise", *(("control",) if with_controls else ())))
    Gy, Hy = generator.B[:, n_u:], generator.D[:, n_u:]
    B, D = state_map @ p.B - Gy @ p.D, Hy @ p.D
    B_terms = np.abs(state_map) @ np.abs(p.B) + np.abs(Gy) @ np.abs(p.D)
    D_terms = np.abs(Hy) @ np.abs(p.D)
    if static_map is not None:
        D, D_terms = D + static_map @ p.B, D_terms + np.abs(static_map) @ np.abs(p.B)
    if with_controls:
        first = p.n_inputs - n_u
        B[:, first:] -= generator.B[:, :n_u]
        D[:, first:] += generator.D[:, :n_u]
        B_terms[:, first:] += np.abs(generator.B[:, :n_u])
        D_terms[:, first:] += np.abs(generator.D[:, :n_u])
    # what rounding leaves of nothing would be a coupling, by which units are chosen
    B, D = above_rounding(B, B_terms), above_rounding(D, D_terms)
    return StateSpace(generator.A, B, -generator.C, D, dt=plant.dt, inputs=p.inputs, outputs=generator.outputs)


def with_silent_inputs(form: StateSpace, names: tuple[str, ...]) -> StateSpace:
    """Return an internal form with further inputs that do nothing."""
    if not names:
        return form
    clash = set(names) & set(form.inputs)
    return form.replaced(
        B=np.hstack([form.B, np.zeros((form.n_states, len(names)))]),
        D=np.hstack([form.D, np.zeros((form.n_outputs, len(names)))]),
        inputs=(*form.inputs, *(f"control {name}" if name in clash else name for name in names)),
    )


def _driven(generator: StateSpace, plant: Plant) -> StateSpace:
    """Return the generator driven by the plant, with all inputs of the plant: controls, f, d, w."""
    n_u, n_y = len(plant.inputs), plant.n_outputs
    if generator.n_inputs != n_u + n_y:
        raise ModelError(
            f"this generator takes {generator.n_inputs} signals, the plant has {n_u} inputs and {n_y} outputs"
        )
    if generator.dt != plant.dt:
        raise ModelError(
            f"the generator has dt={generator.dt:g}, the plant dt={plant.dt:g}: sample both with the same step"
        )
    p = plant.system(("control", "fault", "disturbance", "noise")).explicit()
    signals = p.replaced(
        C=np.vstack([np.zeros((n_u, p.n_states)), p.C]),
        D=np.vstack([np.eye(n_u, p.n_inputs), p.D]),
        outputs=generator.inputs,
    )
    return signals.series(generator)


def refuse_growth(plant: Plant) -> None:
    """Refuse a sampled plant whose growth in one step hides the residual in rounding."""
    growth, most = np.log(max(float(spectral_radius(plant.A)), 1.0)), np.log(_MOST_GROWTH)
    if growth > most:
        raise AccuracyError(
            f"sampled every {plant.dt:g} s the residual is lost in rounding: an unstable mode of the plant grows by "
            f"exp({growth:.0f}) from one sample to the next; take a step of at most {most / growth * plant.dt:.2g} s"
        )


def sampled_form(
    system: StateSpace, T: NDArray[np.float64], plant: Plant, sampled: StateSpace, sampled_plant: Plant, hold: str
) -> StateSpace:
    r"""Return the system from faults, disturbances and noise to the residual of a sampled continuous design.

    The continuous filter sees nothing of a plant that moves without faults: its state is :math:`\xi = T x`. The
    sampled one takes an output to run straight from sample to sample, and sees how far it does not:

    .. math::
       \varepsilon(s) = \delta(s) - \frac{s}{h} \delta(h), \qquad
       \delta(s) = \int_0^s \int_0^\sigma C A^2 e^{A \tau} d\tau\, d\sigma\; x_k

    Integrators whose outputs run straight are not in :math:`C A^2`, exactly. In the filter driven by the plant they
    would have to cancel: what rounding leaves of them, beside a difference of size :math:`h^2`, looks like one that
    noise moves.

    Parameters
    ----------
    system, plant : StateSpace, Plant
        Continuous, with as many states of the plant as the sampled one has.
    T : ndarray, shape (states of the filter, states of the plant)
        ``xi = T E x`` while nothing fails, and ``E`` invertible.
    sampled, sampled_plant : StateSpace, Plant
        The same, sampled.
    hold : {"linear", "zero"}
        What outputs are taken to do between the samples.

    Returns
    -------
    StateSpace
        States of the plant that the residual sees, and ``T x`` less the state of the filter.
    """
    n_u, dt = len(plant.inputs), sampled.dt
    TE = T if plant.E is None else T @ plant.E
    explicit = plant.system(()).explicit()
    G = system.B[:, n_u:]
    if hold == "linear":
        TE = TE - exponentials(system.A, G, dt)[2] @ explicit.C  # the state that the sampled filter keeps is shifted
    p = sampled_plant.system(("fault", "disturbance", "noise"))
    through, direct = sampled.B[:, n_u:], sampled.D[:, n_u:]
    B = above_rounding(TE @ p.B - through @ p.D, np.abs(TE) @ np.abs(p.B) + np.abs(through) @ np.abs(p.D))
    order = 2 if hold == "linear" else 1
    bend, terms = explicit.C, np.abs(explicit.C)  # the first derivative of the outputs that their hold misses
    for _ in range(order):
        bend, terms = bend @ explicit.A, terms @ np.abs(explicit.A)
    bend = above_rounding(bend, terms)
    seen = staircase(explicit.A, above_rounding(G @ bend, np.abs(G) @ terms))
    Q = seen.Q[:, : seen.n_observable]
    A = Q.T @ seen.A @ Q
    driven = _between(system.A, G, A, bend * seen.states @ Q, order, dt)
    k, m = len(A), system.n_states
    return StateSpace(
        np.block([[scipy.linalg.expm(A * dt), np.zeros((k, m))], [driven, sampled.A]]),
        np.vstack([Q.T @ (p.B / seen.states[:, None]), B]),
        np.hstack([np.zeros((sampled.n_outputs, k)), -sampled.C]),
        direct @ p.D,
        dt=dt,
        inputs=p.inputs,
        outputs=sampled.outputs,
    )


def _between(
    Ag: NDArray[np.float64],
    G: NDArray[np.float64],
    A: NDArray[np.float64],
    bend: NDArray[np.float64],
    order: int,
    dt: float,
) -> NDArray[np.float64]:
    """Return the effect of a state of the plant on the filter over a step, by the error of the hold of its outputs.

    ``bend`` is their derivative of that order. In time from sample to sample, and with derivatives of size one, one
    exponential has it to the last digits however short the step is.
    """
    n, m, p = len(A), len(Ag), len(bend)
    sizes = np.abs(bend).max(axis=1, initial=0.0)
    G = G * sizes
    size = float(np.abs(G).max(initial=0.0))
    if not size:
        return np.zeros((m, n))
    G, bend = G / size, bend / np.where(sizes > 0, sizes, 1.0)[:, None]
    last = slice(n + (order - 1) * p, n + order * p)  # of the integrals of the derivative, the signal itself
    M = np.zeros((n + order * p + m,) * 2)
    M[:n, :n], M[n : n + p, :n] = A * dt, bend
    M[n + p : n + order * p, n : n + (order - 1) * p] = np.eye((order - 1) * p)
    M[-m:, last], M[-m:, -m:] = G, Ag * dt
    X = scipy.linalg.expm(M)
    driven = X[-m:, :n]
    if order == 2:  # what it is at the next sample, the filter is told, on a straight line
        driven = driven - exponentials(Ag * dt, G, 1.0)[2] @ X[last, :n]
    return size * dt ** (order + 1) * driven


def frequency_grid(*systems: StateSpace) -> NDArray[np.float64]:
    """Return frequencies in rad/s that span the dynamics of the systems, from far below to far above."""
    dt = max(system.dt for system in systems)
    if dt:  # not at the ends of the circle, where models have poles
        return np.concatenate([np.pi / dt * np.logspace(-5, np.log10(0.97), _POINTS - 1), [0.37 * np.pi / dt]])
    sizes = np.abs(np.concatenate([np.zeros(0), *(system.poles() for system in systems)]))
    sizes = sizes[sizes > _SMALL * sizes.max(initial=0.0)]
    low, high = (sizes.min(), sizes.max()) if sizes.size else (1.0, 1.0)
    # the factor keeps round numbers, where models have their poles, off the grid
    return 1.0371 * np.geomspace(0.01 * low, 100 * high, _POINTS)


def state_covariance(A: NDArray, Q: NDArray) -> NDArray[np.float64]:
    r"""Return ``X = A X A' + Q`` of a stable system, or raise when the solution misses the equation.

    By doubling, :math:`X_{k+1} = X_k + A^{2^k} X_k (A^{2^k})^T`: a sum of what cannot cancel, in which predictors with
    all poles at zero and large gains keep their digits.
    """
    if not len(A):
        return np.zeros((0, 0))
    units = np.sqrt(np.where(np.diag(Q) > 0, np.diag(Q), 1.0))  # comparable states, whatever the units of the model
    A, Q = A / units[:, None] * units, Q / units[:, None] / units
    X, power, settled = Q, A, False
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_DOUBLINGS):
            added = power @ X @ power.T
            X, power = X + (added + added.T) / 2, power @ power
            settled = bool((np.diag(added) <= np.finfo(float).eps * np.diag(X)).all())  # each state by its own size
            if settled:
                break
    if not settled or not np.isfinite(X).all():
        raise AccuracyError(f"a residual has no covariance: noise moves a state that does not settle, {_slowest(A)}")
    missed = float(np.linalg.norm(X - A @ X @ A.T - Q) / max(np.linalg.norm(X), TINY))
    if not missed < IDENTITY:
        raise AccuracyError(
            f"the covariance of the residual misses its equation by {missed:.2g}: noise, and rounding with it, is "
            f"summed by a state that hardly settles, {_slowest(A)}"
        )
    return X * units[:, None] * units


def _slowest(A: NDArray) -> str:
    """Return the place of the pole that is nearest to the circle, with a remedy."""
    inside = 1 - float(np.abs(np.linalg.eigvals(A)).max())
    return (
        f"of a pole {abs(inside):.2g} {'inside' if inside > 0 else 'outside'} the unit circle: ask for faster poles or "
        "a longer step, or, where a continuous design was sampled, design for the sampled plant, plant.discretize(dt)"
    )


def covariance_of_sums(form: StateSpace, window: int) -> NDArray[np.float64]:
    """Return the covariance of outputs summed over ``window`` samples, divided by it, for white inputs of variance one.

    See :meth:`ResidualGenerator.covariance_of_sums`.
    """
    A, B, C, D = form.A, form.B, form.C, form.D
    X = state_covariance(A, B @ B.T)
    S = C @ X @ C.T + D @ D.T
    step = A @ X @ C.T + B @ D.T
    if window > _LONG:
        R = C @ _weighted_powers(A, window) @ step
        return (S + S.T) / 2 + R + R.T
    for k in range(1, window):
        if not step.any():  # nothing is left: a long window costs no more than the memory of the system
            break
        R = C @ step
        S = S + (1 - k / window) * (R + R.T)
        step = A @ step
    return (S + S.T) / 2


def _weighted_powers(A: NDArray, window: int) -> NDArray[np.float64]:
    """Return the sum of ``(1 - k / window) A^(k-1)`` for ``k`` from one below ``window``, by doubling."""
    n, count = len(A), window - 1
    power, plain, weighted = np.eye(n), np.zeros((n, n)), np.zeros((n, n))  # A^m, sum of A^j and of j A^j, for j < m
    m = 0
    for bit in bin(count)[2:]:
        plain, weighted = plain + power @ plain, weighted + power @ (weighted + m * plain)
        power, m = power @ power, 2 * m
        if bit == "1":
            plain, weighted = plain + power, weighted + m * power
            power, m = power @ A, m + 1
    return (1 - 1 / window) * plain - weighted / window
