"""A residual generator seen from faults, disturbances and noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError
from residua.linear import StateSpace
from residua.linear.balancing import descriptor_units, state_units
from residua.linear.reachability import without_unobservable
from residua.plant import Plant


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
    if static_map is not None:
        D = D + static_map @ p.B
    if with_controls:
        first = p.n_inputs - n_u
        B[:, first:] -= generator.B[:, :n_u]
        D[:, first:] += generator.D[:, :n_u]
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


def check_state_map(
    generator: StateSpace, plant: Plant, T: NDArray, V: NDArray | None = None, *, limit: float = 1e-8
) -> float:
    r"""Return how far the identities of a generator are missed, or raise.

    :math:`T A - G_y C = A_g T E`, :math:`C_g T E + H_y C + V A = 0` and :math:`V E = 0`, in balanced units,
    relative to the terms that have to cancel.
    """
    n_u = len(plant.inputs)
    p = plant.system(("control", "disturbance", "fault"))
    units = state_units(p.A, p.B, p.C, p.D) if p.E is None else descriptor_units(p.A, p.E, p.B, p.C, p.D).states
    V = np.zeros((generator.n_outputs, plant.n_states)) if V is None else V
    TE, VE = (T, 0.0 * V) if p.E is None else (T @ p.E, V @ p.E)
    absolute_TE, absolute_VE = (
        (np.abs(T), 0.0 * V) if p.E is None else (np.abs(T) @ np.abs(p.E), np.abs(V) @ np.abs(p.E))
    )
    Gy, Hy = generator.B[:, n_u:], generator.D[:, n_u:]
    terms = np.abs(T) @ np.abs(p.A) + np.abs(Gy) @ np.abs(p.C) + np.abs(generator.A) @ absolute_TE
    if len(T) % max(p.n_states, 1) == 0:
        rows = np.resize(units, len(T))  # stacked observers repeat the states of the plant
    else:
        heights = (absolute_TE * units).max(axis=1, initial=0.0)
        others = (terms * units).max(axis=1, initial=0.0)  # of a row of T that is zero
        rows = np.where(heights > 1e-12 * heights.max(initial=0.0), heights, np.where(others > 0, others, 1.0))
    first = _largest(T @ p.A - Gy @ p.C - generator.A @ TE, units / rows[:, None])
    own = _largest(p.A, units / units[:, None]) if p.E is None else 0.0
    if generator.n_states:  # where decoupling left T = 0, all the terms are rounding of what the poles are made of
        own = max(own, 1e-3 * float(np.abs(generator.poles()).max()))
    first /= max(_largest(terms, units / rows[:, None]), own, 1e-300)
    terms = np.abs(generator.C) @ absolute_TE + np.abs(Hy) @ np.abs(p.C) + np.abs(V) @ np.abs(p.A)
    heights = np.abs(p.C) @ units
    scale = units / np.where(heights > 0, heights, 1.0)[:, None] if len(Hy) == len(p.C) else units[None, :]
    per_row = (
        np.abs(generator.C) * rows / (np.where(heights > 0, heights, 1.0)[:, None] if len(Hy) == len(p.C) else 1.0)
    )
    floor = max(1e-6 * float(per_row.max(initial=0.0)), 1e-300)
    second = _largest(generator.C @ TE + Hy @ p.C + V @ p.A, scale) / max(_largest(terms, scale), floor)
    third = 0.0
    if np.any(V) and p.E is not None:  # what V reads may stand where E is zero, and meet it by rounding only
        beside = np.abs(V).max(axis=1, initial=0.0)[:, None] * np.abs(p.E).max(axis=0, initial=0.0)
        third = _largest(VE, scale) / max(_largest(absolute_VE, scale), 1e-3 * _largest(beside, scale), 1e-300)
    return _accepted(max(first, second, third), limit)


def check_known_form(generator: StateSpace, plant: Plant, form: StateSpace, *, limit: float = 1e-7) -> float:
    """Return how far an internal form is from the generator driven by the plant, over frequency, or raise."""
    w = frequency_grid(generator, plant.system(()))
    n_u = len(plant.inputs)
    Q = generator.frequency_response(w)[..., n_u:]
    P = plant.system(("fault", "disturbance", "noise")).frequency_response(w)
    known = form.frequency_response(w)
    if known.shape != (len(w), Q.shape[1], P.shape[2]):
        raise ModelError(f"the internal form is {form.n_outputs} x {form.n_inputs}, not residuals x (f, d, w)")
    terms = (np.abs(Q) @ np.abs(P)).max(axis=0)
    # a path that is itself what rounding left of nothing cannot be missed
    terms = np.maximum(terms, 1e-8 * np.abs(Q).max(axis=(0, 2))[:, None] * np.abs(P).max(axis=(0, 1))[None, :])
    missed = np.abs(Q @ P - known).max(axis=0)
    return _accepted(float(np.max(missed / np.where(terms > 0, terms, 1.0), initial=0.0)), limit)


def _accepted(worst: float, limit: float) -> float:
    if not worst <= limit:
        raise AccuracyError(
            f"the identities of the residual generator are missed by {worst:.2g} > {limit:.0e}: the plant is too "
            "badly scaled or conditioned for this design; rescale its states and channels"
        )
    return worst


def _largest(M: NDArray, units: NDArray) -> float:
    """Return the largest entry of a matrix in given units."""
    return float(np.max(np.abs(M * units), initial=0.0))


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
    Gu, Gy = generator.B[:, :n_u], generator.B[:, n_u:]
    Hu, Hy = generator.D[:, :n_u], generator.D[:, n_u:]
    n_rest = p.n_inputs - n_u
    A = np.block(
        [[p.A, np.zeros((p.n_states, generator.n_states))], [Gy @ p.C, generator.A]],
    )
    B = np.vstack([p.B, Gy @ p.D + np.hstack([Gu, np.zeros((generator.n_states, n_rest))])])
    D = Hy @ p.D + np.hstack([Hu, np.zeros((generator.n_outputs, n_rest))])
    return StateSpace(
        A,
        B,
        np.hstack([Hy @ p.C, generator.C]),
        D,
        dt=plant.dt,
        inputs=p.inputs,
        outputs=generator.outputs,
    )


def frequency_grid(*systems: StateSpace, points: int = 60) -> NDArray[np.float64]:
    """Return frequencies in rad/s that span the dynamics of the systems, from far below to far above."""
    dt = max(system.dt for system in systems)
    if dt:  # not at the ends of the circle, where models have poles
        return np.concatenate([np.pi / dt * np.logspace(-5, np.log10(0.97), points - 1), [0.37 * np.pi / dt]])
    sizes = np.concatenate([np.zeros(0), *(_pole_sizes(system) for system in systems)])
    low, high = (sizes.min(), sizes.max()) if sizes.size else (1.0, 1.0)
    # the factor keeps round numbers, where models have their poles, off the grid
    return 1.0371 * np.logspace(np.log10(low) - 2, np.log10(high) + 2, points)


def _pole_sizes(system: StateSpace) -> NDArray[np.float64]:
    """Return the sizes of the poles that are not rounding."""
    size = float(np.linalg.norm(system.A)) if system.n_states else 0.0
    poles = np.abs(system.poles())
    return poles[poles > np.sqrt(np.finfo(float).eps) * size]


def leakage(generator: StateSpace, plant: Plant, w: NDArray | None = None) -> dict[str, float]:
    """Return the gain to the residual from controls and from disturbances, relative to the parts it is made of.

    For each input and each residual the largest response over frequency, divided by the largest sum of the
    magnitudes of the terms that have to cancel; of these the largest. 1e-16 is exact, 1 is no decoupling.
    """
    if w is None:
        w = frequency_grid(generator, plant.system(()))
    n_u = len(plant.inputs)
    Q = generator.frequency_response(w)
    driven = plant.system(("control", "disturbance"))
    P, made_of = driven.frequency_response(w), _terms(driven, w)
    Qu, Qy = Q[..., :n_u], Q[..., n_u:]
    out = {}
    for name, direct, through, sums in (
        ("control", Qu, P[..., :n_u], made_of[..., :n_u]),
        ("disturbance", 0.0, P[..., n_u:], made_of[..., n_u:]),
    ):
        if through.shape[-1] == 0:
            continue
        total = np.abs(direct + Qy @ through).max(axis=0)
        parts = (np.abs(direct) + np.abs(Qy) @ np.abs(through)).max(axis=0)
        # a path that is itself what rounding left of nothing cannot leak
        paths = np.abs(Qy).max(axis=(0, 2))[:, None] * np.abs(through).max(axis=(0, 1))[None, :]
        sums = (np.abs(Qy) @ sums).max(axis=0)
        parts = np.maximum(parts, 1e-6 * np.maximum(paths, sums))
        out[name] = float(np.max(total / np.where(parts > 0, parts, 1.0), initial=0.0))
    return out


def _terms(system: StateSpace, w: NDArray) -> NDArray[np.float64]:
    """Return what rounding in the responses of a system is relative to, over frequency.

    Terms of ``C x``, each as large as the largest state makes it, in balanced units: solving for the states brings
    rounding to those that an input does not reach.
    """
    n = system.n_states
    units = descriptor_units(system.A, system.E, system.B, system.C, system.D).states
    states = system.replaced(C=np.eye(n), D=np.zeros((n, system.n_inputs)), outputs=[f"x{i + 1}" for i in range(n)])
    largest = (np.abs(states.frequency_response(w)) / units[:, None]).max(axis=1, initial=0.0)
    return (np.abs(system.C) @ units)[:, None] * largest[:, None, :] + np.abs(system.D)


def check_decoupling(generator: StateSpace, plant: Plant, *, decoupled: bool, limit: float = 1e-7) -> dict[str, float]:
    """Return the leakage of a finished design, or raise when what was promised is not kept."""
    found = leakage(generator, plant)
    promised = {name: gain for name, gain in found.items() if name == "control" or decoupled}
    for name, gain in promised.items():
        if not gain <= limit:
            raise AccuracyError(
                f"the residual answers to the {name} inputs (relative gain {gain:.2g} > {limit:.0e}): "
                "the plant is too badly scaled or conditioned for this design; rescale its states and channels"
            )
    return promised


def signature_bases(
    generator: StateSpace,
    plant: Plant,
    form: StateSpace,
    state_map: NDArray | None = None,
    static_map: NDArray | None = None,
    *,
    rtol: float = 1e-6,
) -> tuple[dict[str, NDArray[np.float64]], float]:
    """Return for each fault an orthonormal basis of the subspace that its residual never leaves.

    The subspace is spanned by the response to the fault at all frequencies; it is found from the singular
    values of the responses at many, each scaled to unit length. (Krylov spaces of the same would amplify
    rounding in every step.) What is rounding against the terms that a response is made of is taken for zero. The
    vector of a one-dimensional subspace has the sign of the first response to a positive fault.

    Parameters
    ----------
    generator : StateSpace
    plant : Plant
    form : StateSpace
        Their internal form, faults first.
    state_map, static_map : ndarray, optional
        Those of the generator, where it has them.
    rtol : float
        Directions that carry less than this fraction of the response at every frequency are not there.

    Returns
    -------
    bases : dict of str to ndarray, shape (residuals, k)
    off : float
        The largest fraction of any response that was taken for rounding and left out.
    """
    w = frequency_grid(form, generator)
    responses = form.frequency_response(w)[:, :, : len(plant.faults)]
    terms = response_terms(generator, plant, form, state_map, static_map, w)
    ratio = np.abs(responses) / np.where(terms > 0, terms, 1.0)
    responses = np.where(ratio.max(axis=0, initial=0.0) > 1e-9, responses, 0.0)
    units = terms.max(axis=(0, 2), initial=0.0)  # of each residual: the size of what it is made of
    units = np.where(units > 0, units, 1.0)
    bases, off = {}, 0.0
    for i, name in enumerate(plant.faults):
        response = responses[:, :, i].T / units[:, None]
        size = np.linalg.norm(response, axis=0)
        keep = (size > 0) & (size > 1e-7 * size.max(initial=0.0))
        columns = response[:, keep] / size[keep]
        if columns.shape[1] == 0:
            bases[name] = np.zeros((form.n_outputs, 0))
            continue
        U, s, _ = np.linalg.svd(np.hstack([columns.real, columns.imag]), full_matrices=False)
        basis = np.linalg.qr(units[:, None] * U[:, s > rtol * s[0]])[0]
        off = max(off, float(s[basis.shape[1]] / s[0]) if basis.shape[1] < len(s) else 0.0)
        if basis.shape[1] == 1 and basis[:, 0] @ first_response(form, i) < 0:
            basis = -basis
        bases[name] = basis
    return bases, off


def response_terms(
    generator: StateSpace, plant: Plant, form: StateSpace, T: NDArray | None, V: NDArray | None, w: NDArray
) -> NDArray[np.float64]:
    """Return the size of the terms that the responses to faults are the sum of, in balanced units, over frequency.

    Of a product such as ``T Bf`` the largest entries of row and column count, wherever they stand: an entry that
    should be zero is rounding of those.
    """
    p = plant.system("fault")
    u = descriptor_units(p.A, p.E, p.B, p.C, p.D)
    Gy, Hy = (np.abs(M[:, len(plant.inputs) :]) / u.outputs for M in (generator.B, generator.D))
    Bf, Df = np.abs(p.B) * u.equations[:, None], np.abs(p.D) * u.outputs[:, None]
    n_f = len(plant.faults)

    def largest(rows: NDArray, columns: NDArray) -> NDArray:
        anywhere = rows.max(axis=1, initial=0.0)[:, None] * columns.max(axis=0, initial=0.0)
        return rows @ columns + 1e-4 * anywhere  # rounding of what stands elsewhere is eps, not what may cancel here

    driven = 0.0
    if T is None:
        B, D = np.abs(form.B[:, :n_f]), np.abs(form.D[:, :n_f])
        Q = np.abs(generator.frequency_response(w)[:, :, len(plant.inputs) :])
        D = D + largest(Q.max(axis=0, initial=0.0) / u.outputs, Df)
        driven = Q @ np.abs(p.frequency_response(w))  # its internal form may be rounding where that cancels
    else:
        B = largest(np.abs(T) / u.equations, Bf) + largest(Gy, Df)
        D = largest(Hy, Df) + (0.0 if V is None else largest(np.abs(V) / u.equations, Bf))
    points = np.exp(1j * w * form.dt) if form.is_discrete else 1j * w
    n = form.n_states
    if not n:
        return np.broadcast_to(D, (len(w), *D.shape)) + driven
    through = np.linalg.solve(np.swapaxes(points[:, None, None] * np.eye(n) - form.A, 1, 2), form.C.T[None] + 0j)
    return np.abs(np.swapaxes(through, 1, 2)) @ B + D + driven


def first_response(form: StateSpace, column: int) -> NDArray[np.float64]:
    """Return the first nonzero Markov parameter ``D, C B, C A B, ...`` of one input, up to a positive factor."""
    if np.any(form.D[:, column]):
        return form.D[:, column]
    A = form.A / max(float(np.linalg.norm(form.A)), 1e-300)  # only the direction matters: no power overflows
    x = form.B[:, column]
    scale = np.linalg.norm(form.C) * np.linalg.norm(x)
    for _ in range(form.n_states):
        y = form.C @ x
        if np.linalg.norm(y) > 1e-10 * scale:
            return y
        x = A @ x
    return np.zeros(form.n_outputs)
