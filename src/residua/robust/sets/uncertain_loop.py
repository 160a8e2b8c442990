"""Uncertain plants under feedback, and what an estimator makes of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import frozen
from residua.errors import DesignError, ModelError
from residua.linear import StateSpace
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.plant.plant import Plant
from residua.robust.sets.uncertain_plant import UncertainPlant, make_uncertain_plant, visited_values
from residua.robust.sets.uncertain_system import UncertainSystem, check_modes, parameter_values
from residua.tolerances import RESPONSE_ROUNDING

Matrix = NDArray[np.float64]


def close_loop(plant: UncertainPlant, controller: StateSpace) -> UncertainPlant:
    r"""Return the uncertain plant under the feedback of a controller.

    .. math::

       x_{c,k+1} = A_c x_{c,k} + B_c y_k, \qquad u_k = C_c x_{c,k}

    The loop has the states :math:`[x; x_c]`, no inputs, and uncertainty in ``A`` and ``C``:

    .. math::

       A = \begin{bmatrix} A_p & B_p C_c \\ B_c C_p & A_c \end{bmatrix}, \quad
       \Delta A = \begin{bmatrix} \Delta A_p & \Delta B_p C_c \\ B_c \Delta C_p & 0 \end{bmatrix}, \quad
       C = [C_p \; 0], \quad \Delta C = [\Delta C_p \; 0]

    A sensor fault, and a disturbance of an output, also drives the controller: a direction :math:`[D_1; D_2]` becomes
    :math:`[D_1; B_c D_2; D_2]`, and what is uncertain in it is too. Each parameter keeps its channels: one
    that stands in ``C`` enters the loop's ``A`` and ``C`` by the same channel, once, where the literature has two
    copies. A direct term of the plant is allowed, and adds its parts.

    Parameters
    ----------
    plant : UncertainPlant
    controller : StateSpace
        From the outputs of the plant to its inputs, in order, or by name where the names are those of the plant. The
        sign of the feedback is the controller's own. Without a direct term.

    Returns
    -------
    UncertainPlant
        Outputs, faults, disturbances and noise of the plant; no control inputs.

    Raises
    ------
    ModelError
        If the controller does not fit: size, sample step, a direct term.
    DesignError
        If the nominal loop is not stable.

    References
    ----------
    Robust l1 fault detection, eqs. (9)-(19).

    Examples
    --------
    >>> import residua as rs
    >>> from residua.plant import Perturbation, UncertainPlant
    >>> tank = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1.0)
    >>> unc = UncertainPlant(tank, deltas=[Perturbation("C", [[-1.0]], [[1.0]], -0.02, 0.01, ["gain"])])
    >>> loop = unc.in_closed_loop(rs.StateSpace([[0.5]], [[-0.5]], [[1.0]], dt=1.0))
    >>> loop.member({"gain": 0.01}).A
    array([[ 0.9  ,  0.1  ],
           [-0.505,  0.5  ]])
    """
    p = plant.nominal
    if p.E is not None:
        raise ModelError("the plant has a matrix E: plant.explicit() first, and perturbations of that plant")
    controller = fitting_controller(p, controller)
    Ac, Bc, Cc = controller.A, controller.B, controller.C
    A = np.block([[p.A, p.B @ Cc], [Bc @ p.C, Ac + Bc @ p.D @ Cc]])
    poles = np.linalg.eigvals(A).astype(complex)
    unstable = poles[~is_stable_mode(poles, p.dt)]
    if unstable.size:
        raise DesignError(
            f"the nominal loop is not stable: pole {describe_modes(unstable[:1])}; the controller gives u = +Cc xc, so "
            "that its sign must be in Cc or Bc"
        )
    labels = tuple(f"controller {name}" if name in p.states else name for name in controller.states)
    if len({*p.states, *labels}) < len(A):
        labels = tuple(f"controller state {i + 1}" for i in range(len(labels)))
    loop = Plant(
        A,
        np.zeros((len(A), 0)),
        np.hstack([p.C, p.D @ Cc]),
        dt=p.dt,
        outputs=p.outputs,
        states=p.states + labels,
        name=f"{p.name} in closed loop",
        units={k: v for k, v in p.units.items() if k in (*p.outputs, *p.states)},
        description=p.description,
    ).with_operating_point(outputs=p.operating_point.outputs)
    parts = {}
    for letter in "dfw":
        B, D = getattr(p, "B" + letter), getattr(p, "D" + letter)
        parts |= {"B" + letter: frozen(np.vstack([B, Bc @ D])), "D" + letter: D}
    loop = loop._with(**parts, disturbances=p.disturbances, fault_list=p.fault_list)
    H, G = np.vstack([plant.Hx, Bc @ plant.Hy, plant.Hy]), np.hstack([plant.Gx, plant.Gu @ Cc, plant.Gd, plant.Gf])
    return make_uncertain_plant(loop, plant.parameters, plant.channels, H, G, linearisation=plant.linearisation)


def fitting_controller(p: Plant, controller: StateSpace) -> StateSpace:
    """Return a controller with its channels in the order of a plant, or raise where it does not go with it."""
    if not isinstance(controller, StateSpace):
        raise ModelError(f"the controller must be a StateSpace from y to u, got {type(controller).__name__}")
    controller = controller.explicit()
    if controller.dt != p.dt:
        raise ModelError(f"the controller has dt={controller.dt:g} and the plant dt={p.dt:g}")
    if (controller.n_inputs, controller.n_outputs) != (p.n_outputs, len(p.inputs)):
        raise ModelError(
            f"the controller has {controller.n_inputs} inputs and {controller.n_outputs} outputs for a plant with "
            f"{p.n_outputs} outputs and {len(p.inputs)} inputs: it runs from y to u"
        )
    if np.any(controller.D):
        raise ModelError(
            "the controller has a direct term: uncertain B and C would multiply each other; compute u from the "
            "measurements of the sample before (one state more for each input of the controller)"
        )
    named_in = _by_name(controller.inputs, p.outputs, "inputs", "outputs")
    named_out = _by_name(controller.outputs, p.inputs, "outputs", "inputs")
    return controller.select(outputs=p.inputs if named_out else None, inputs=p.outputs if named_in else None)


def _by_name(channels: tuple[str, ...], of_plant: tuple[str, ...], what: str, theirs: str) -> bool:
    """Tell whether channels are wired by name; in order where no name is shared, and an error in between."""
    odd = [name for name in channels if name not in of_plant]
    if not odd or len(odd) == len(channels):
        return not odd
    missing = [name for name in of_plant if name not in channels]
    raise ModelError(
        f"the controller's {what} {', '.join(map(repr, odd))} are no {theirs} of the plant, while the others are (not "
        f"named: {', '.join(map(repr, missing))}): name them all as the plant does, or none, to wire them in order"
    )


def residual_over_set(
    loop: UncertainPlant,
    residual_filter: StateSpace,
    state_map: ArrayLike | None = None,
    *,
    signals: Iterable[str] | None = None,
    sizes: Mapping[str, float] | None = None,
) -> UncertainSystem:
    r"""Return the effect of disturbances and faults of an uncertain loop on the residual of any filter.

    The filter :math:`\xi_{k+1} = F \xi_k + K y_k,\; r_k = H \xi_k + J y_k` and a map ``T`` with :math:`\xi = T x`
    while nothing happens to the nominal loop. With :math:`e = T x - \xi` and the states :math:`[x; e]`,

    .. math::

       \tilde A = \begin{bmatrix} A & 0 \\ T A - F T - K C & F \end{bmatrix}, \quad
       B_p = -\begin{bmatrix} H_x \\ T H_x - K H_y \end{bmatrix}, \quad C_q = [G_x \; 0], \quad
       B_w = \begin{bmatrix} D_1 \\ T D_1 - K D_2 \end{bmatrix}, \\
       C_z = [H T + J C, \; -H], \quad D_{zp} = -J H_y, \quad D_{zw} = J D_2

    True for any ``T``; that of the filter makes the corner of :math:`\tilde A` zero; rounding in it is cleared.

    Where the directions :math:`D_1, D_2` of a signal that was asked for depend on the parameters, by :math:`G_w`, all
    signals come one sample later, by a state each, :math:`v_{k+1} = w_k`, and everything uncertain stands in ``A`` and
    ``C`` again: with :math:`[x; e; v]`

    .. math::

       \begin{bmatrix} \tilde A & B_w \\ 0 & 0 \end{bmatrix}, \quad \begin{bmatrix} 0 \\ I \end{bmatrix}, \quad
       [C_q \; G_w], \quad [C_z \; D_{zw}], \quad D_{zp}

    take the places of :math:`\tilde A, B_w, C_q, C_z, D_{zp}`, and ``Bp`` gets zeros. A delay of all signals together
    changes neither peak norms, which hold at any sample, nor gains; one of some of them would, for their sizes are
    bounded together at each sample.

    Parameters
    ----------
    loop : UncertainPlant
        Without control inputs: see :func:`close_loop`.
    residual_filter : StateSpace
        From the outputs of the loop.
    state_map : array_like, shape (states of the filter, n), optional
        Zero when omitted.
    signals : sequence of str, optional
        Disturbances and faults that are the inputs, in this order; all disturbances when omitted. White noise, which
        has no bound, is none.
    sizes : mapping of str to float, optional
        What the signals are multiplied by; one when omitted.

    Returns
    -------
    UncertainSystem
        Its parameters have the names of those of the loop, and are deviations from their nominal values: ``F`` itself.
        ``residua.plant.loop_parameters`` leads back to what ``loop.member`` takes.

    Raises
    ------
    ModelError
        If the loop has control inputs, or a shape does not fit; if directions depend on parameters in continuous time,
        where nothing can come a sample later.
    """
    p = loop.nominal
    if p.inputs or p.E is not None:
        raise ModelError(
            "an uncertain plant with control inputs has unbounded states: in_closed_loop(controller) first"
        )
    flt = residual_filter.explicit()
    if flt.n_inputs != p.n_outputs or flt.dt != p.dt:
        raise ModelError(
            f"the filter must read the {p.n_outputs} outputs of the loop with dt={p.dt:g}, "
            f"got {flt.n_inputs} inputs and dt={flt.dt:g}"
        )
    n = p.n_states
    T = np.zeros((flt.n_states, n)) if state_map is None else arrays.matrix(state_map, "state_map", (flt.n_states, n))
    known = (*p.disturbances, *p.faults)
    chosen = arrays.positions(p.disturbances if signals is None else signals, known, "disturbance or fault")
    scale = np.array([float((sizes or {}).get(known[i], 1.0)) for i in chosen])
    D1 = np.hstack([p.Bd, p.Bf])[:, chosen] * scale
    D2 = np.hstack([p.Dd, p.Df])[:, chosen] * scale
    Gw = np.hstack([loop.Gd, loop.Gf])[:, chosen] * scale
    F, K, H, J = flt.A, flt.B, flt.C, flt.D
    corner = T @ p.A - F @ T - K @ p.C
    rounding = RESPONSE_ROUNDING * (np.abs(T) @ np.abs(p.A) + np.abs(F) @ np.abs(T) + np.abs(K) @ np.abs(p.C))
    A = np.block([[p.A, np.zeros((n, len(F)))], [np.where(np.abs(corner) > rounding, corner, 0.0), F]])
    Bp, Bw = -np.vstack([loop.Hx, T @ loop.Hx - K @ loop.Hy]), np.vstack([D1, T @ D1 - K @ D2])
    Cq, Cz, Dzw = np.hstack([loop.Gx, np.zeros((len(loop.Gx), len(F)))]), np.hstack([H @ T + J @ p.C, -H]), J @ D2
    if np.any(Gw):
        if not p.is_discrete:
            moving = (repr(known[i]) for i, moves in zip(chosen, np.any(Gw, axis=0), strict=True) if moves)
            raise ModelError(
                f"the directions of {', '.join(moving)} depend on parameters, which is allowed for in sampled time "
                "only: discretize(dt) the uncertain plant first"
            )
        n, m = Bw.shape
        A, Bp = np.block([[A, Bw], [np.zeros((m, n + m))]]), np.vstack([Bp, np.zeros((m, Bp.shape[1]))])
        Cq, Cz = np.hstack([Cq, Gw]), np.hstack([Cz, Dzw])
        Bw, Dzw = np.eye(n + m, m, -n), np.zeros_like(Dzw)
    return UncertainSystem(
        A,
        Bp,
        Bw,
        Cq,
        Cz,
        -J @ loop.Hy,
        Dzw,
        low=loop.low - loop.nominal_values,
        high=loop.high - loop.nominal_values,
        channels=loop.channels,
        parameters=loop.names,
        dt=p.dt,
    )


def loop_parameters(loop: UncertainPlant, deviations: Mapping[str, float] | ArrayLike) -> dict[str, float]:
    """Return the parameters with these deviations from the nominal values of an uncertain plant.

    Norms of :func:`residual_over_set` and :meth:`UncertainPlant.estimator_residual` name their members by deviations.

    Parameters
    ----------
    loop : UncertainPlant
    deviations : mapping of str to float, or array_like, shape (parameters,)
        A mapping may leave out parameters: these are nominal.

    Returns
    -------
    dict of str to float
        What ``loop.member`` takes.

    Raises
    ------
    ModelError
        If a parameter is unknown or outside of its bounds.
    """
    nominal = loop.nominal_values
    v = parameter_values(deviations, loop.names, loop.low - nominal, loop.high - nominal, np.zeros(len(nominal)))
    # the sum may round to just outside of the bounds
    return dict(zip(loop.names, np.clip(nominal + v, loop.low, loop.high).tolist(), strict=True))


def check_members_stable(loop: UncertainPlant) -> None:
    """Raise a DesignError that names the least stable member, by its pole and parameters, unless all are stable.

    Visited are the nominal plant, the corners of the set (up to 10 parameters; beyond, as many at random) and points
    inside.
    """
    points = visited_values(loop, inside=256, seed=0)
    F = (points - loop.nominal_values)[:, list(loop.channels)]
    poles = np.linalg.eigvals(loop.nominal.A - (loop.Hx * F[:, None, :]) @ loop.Gx)
    consequence = "nothing is bounded in it: narrow the set, or change the controller"
    check_modes(poles, points, loop.names, loop.nominal.dt, consequence)
