"""A residual generator seen from faults, disturbances and noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear import StateSpace
from residua.linear.subspaces.reachability import without_unobservable
from residua.plant import Plant
from residua.tolerances import above_rounding

#: Frequencies of a grid.
_POINTS = 60
#: Of the largest pole, the part below which a pole is at zero.
_SMALL = 1e-12


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
