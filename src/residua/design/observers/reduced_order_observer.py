"""Observers of order n - p, with unknown inputs, for plants with and without a singular E."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from residua import arrays
from residua.design.core.evidence import Evidence
from residua.design.core.method import method
from residua.design.observers.observer import Observer, plant_observer, with_checked_estimate
from residua.design.observers.observer_gain import asked, default_weights, pair_gain, with_gain
from residua.design.observers.unknown_input_observer import largest
from residua.errors import DesignError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.quotient import Quotient, quotient, without_rounding
from residua.linear.subspaces.rank import RankDecision
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant, is_inside, is_singular
from residua.tolerances import BALANCED_RANK, above_rounding

REFERENCE = "Twardy and Kaczorek, part I, eqs. (18) to (29)"


@method(
    exists_when="as unknown_input_observer",
    order="n - p",
    source="Twardy and Kaczorek, part I, eqs. (3), (18) to (29)",
    state="estimate, converges; measurements enter unfiltered",
    decouples=True,
    noise="unfiltered",
)
def reduced_order_observer(
    plant: Plant,
    *,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    outputs: Iterable[str | int] | str | None = None,
) -> Observer:
    r"""Design an observer of order n - p, which takes the measured part of the state from the measurements.

    .. math:: \dot z = F z + T B u + K y, \qquad \hat x = M z + H y, \qquad
              \begin{bmatrix} M & H \end{bmatrix} = \begin{bmatrix} T \\ C \end{bmatrix}^{-1}

    Guaranteed: :math:`C \hat x = y`, and :math:`\varepsilon = T x - z` obeys :math:`\dot\varepsilon = F \varepsilon`
    for any control input and any disturbance of the plant. Noise on the measurements reaches the estimate unfiltered.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, with invertible ``E``. Its disturbances are decoupled.
    poles : sequence of complex, optional
        n - p of them (``p`` independent measurements), or as many as are free; closed under conjugation.
    margin : float, optional
        Stability margin in 1/s, used without ``poles``.
    outputs : sequence of str, optional
        The measurements that are used, all when omitted. The errors of those that are left out are the residual:
        with all of them used there is none.

    Returns
    -------
    Observer

    Raises
    ------
    DesignError
        If no such observer exists; the message says which condition failed, with its numbers.
    AccuracyError
        If poles or identities missed their tolerance.

    See Also
    --------
    luenberger_observer : Filters all measurements.
    unknown_input_observer : Of full order, with a residual.
    descriptor_observer : The same for singular E.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant.

    References
    ----------
    Twardy and Kaczorek, part I, eqs. (3) and (18) to (29) with E = I.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0, 1], [-2, -3]], [[0], [1]], [[1, 0]])
    >>> observer = rs.design.reduced_order_observer(plant, poles=[-5])
    >>> observer.order, observer.poles.real.round(9)
    (1, array([-5.]))
    """
    if is_singular(plant):
        raise DesignError("E is singular: use descriptor_observer, which is the same for singular plants")
    return with_checked_estimate(_designed(plant.explicit(), "reduced-order observer", poles, margin, outputs))


@method(
    needs=["nothing more; made for singular E"],
    exists_when="as unknown_input_observer",
    order="n - p",
    source="Twardy and Kaczorek, part I, eqs. (18) to (29)",
    state="estimate, converges; measurements enter unfiltered",
    decouples=True,
    singular=True,
    noise="unfiltered",
)
def descriptor_observer(
    plant: Plant,
    *,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    outputs: Iterable[str | int] | str | None = None,
) -> Observer:
    r"""Design the standard observer of order n - p of a singular plant.

    .. math:: \dot z = F z + T B u + K y, \qquad \hat x = M z + H y, \qquad
              \begin{bmatrix} M & H \end{bmatrix} = \begin{bmatrix} T E \\ C \end{bmatrix}^{-1}, \qquad
              T A = F T E + K C

    Guaranteed: it is an ordinary system, and :math:`\varepsilon = T E x - z` obeys
    :math:`\dot\varepsilon = F \varepsilon` for any control input, any disturbance of the plant (:math:`T E_d = 0`)
    and any consistent initial value. The poles are placed, not drawn: see Notes.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled; ``E`` singular, or not. Its disturbances are decoupled.
    poles : sequence of complex, optional
        n - p of them (``p`` independent measurements), or as many as are free; closed under conjugation.
    margin : float, optional
        Stability margin in 1/s, used without ``poles``.
    outputs : sequence of str, optional
        The measurements that are used, all when omitted. The errors of those that are left out are the residual:
        with all of them used there is none.

    Returns
    -------
    Observer
        ``T`` is the paper's ``X``, ``H`` its ``N``.

    Raises
    ------
    DesignError
        If ``rank [E E_d; C 0] < n + rank E_d``, or a finite mode that the measurements do not see (an invariant zero
        of the disturbances) is not stable; with the numbers.
    AccuracyError
        If poles or identities missed their tolerance.

    See Also
    --------
    unknown_input_observer : Of full order, for singular E too.
    perfect_observer : No transient, from derivatives.
    reduced_order_observer : For state equations.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant. The pencil ``s E - A`` need not be regular.

    The paper draws ``K`` at random and solves ``x_i = k_i C (A - f_i E)^-1`` row by row, for distinct poles that are
    not poles of the plant. Here all ``T`` with ``T [E Q, E_d] = [I, 0]`` are parametrised, ``Q`` a basis of the null
    space of ``C``, and the poles of ``F = T A Q`` placed: any poles, multiple ones too, well conditioned.

    References
    ----------
    Twardy and Kaczorek, part I, eqs. (18) to (29).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[-1, 1, 0], [0, -1, 1], [0, 0, 1]], [[1], [0], [1]], [[1, 0, 0], [0, 0, 1]],
    ...                  E=[[1, 0, 0], [0, 1, 0], [0, 0, 0]])
    >>> observer = rs.design.descriptor_observer(plant, poles=[-4])
    >>> observer.order, observer.poles.real.round(9)
    (1, array([-4.]))
    """
    return with_checked_estimate(_designed(plant, "descriptor observer", poles, margin, outputs))


def _designed(
    plant: Plant,
    name: str,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    outputs: Iterable[str | int] | str | None,
) -> Observer:
    r"""Return the observer of order n - p.

    Of the plant without its unknown inputs, :math:`\dot z = F z + J y, \; H y = G z`, the measurements determine
    :math:`a = V_1^T z` by :math:`G`; only :math:`b = V_2^T z` is estimated, by an observer of
    :math:`\dot b = A_{22} b + A_{21} a + \dots` that reads :math:`\dot a = A_{12} b + \dots`: with
    :math:`w = b - L a` nothing is differentiated.
    """
    used = arrays.different_positions(outputs, plant.outputs, "output")
    model, p = plant.balanced, plant.n_outputs
    every = np.eye(p + len(model.algebra))
    rows = every[[*used, *range(p, len(every))]]
    q = _quotient_of(model, rows)
    F, G = q.pair
    U, s, Vh = np.linalg.svd(G) if G.size else (np.eye(len(G)), np.zeros(0), np.eye(len(F)))
    k = int(np.count_nonzero(s > BALANCED_RANK))
    U, Vh = without_rounding(U), without_rounding(Vh)
    V1, V2 = Vh[:k].T, Vh[k:].T
    reading = (U[:, :k] / s[:k]).T @ q.H  # a from the outputs
    A11, A12, A21, A22 = V1.T @ F @ V1, V1.T @ F @ V2, V2.T @ F @ V1, V2.T @ F @ V2
    process = q.N @ default_weights(model)[0] @ q.N.T
    gain = pair_gain(model, A22, A12, (V2.T @ process @ V2, V1.T @ process @ V1), *asked(model.plant, poles, margin))
    L = gain.K
    dynamics, down = A22 - L @ A12, V2.T - L @ V1.T
    K = without_rounding((dynamics @ L + A21 - L @ A11) @ reading + down @ q.J)
    known, whole = q.known[0], V1 + V2 @ L
    out = without_rounding(q.P - q.R @ known @ q.C)
    H = out @ whole @ reading + q.R @ known
    H = above_rounding(H, np.abs(out) @ np.abs(whole) @ np.abs(reading) + np.abs(q.R) @ np.abs(known))
    # the residual: combinations of outputs that are left out and that no disturbance enters; all when none is left out
    rest = [i for i in range(p) if i not in used] or list(range(p))
    U, d, _ = np.linalg.svd(model.disturbances[1][rest])
    left = U[:, int(np.count_nonzero(d > BALANCED_RANK)) :].T @ np.eye(p)[rest] * model.units.outputs
    evidence = Evidence(
        method=name,
        ranks={"independent measurements": RankDecision(k, s, BALANCED_RANK)},
        notes=(f"uses {', '.join(plant.outputs[i] for i in used)}",) if len(used) < p else (),
        references=(REFERENCE,),
    )
    evidence = with_gain(evidence, gain, model, "L")
    K, H, algebra = K @ rows, H @ rows, model.algebra
    return plant_observer(
        model,
        dynamics,
        without_rounding(down @ q.N @ model.derivative - K[:, p:] @ algebra),
        K[:, :p],
        left / largest(left),
        evidence,
        M=without_rounding(out @ V2),
        H=H[:, :p],
        J=H[:, p:] @ algebra if plant.E is not None else None,
    )


def _quotient_of(model: BalancedPlant, rows: np.ndarray) -> Quotient:
    """Return the quotient by the disturbances of a plant with some of its outputs, or raise where none will do."""
    plant, (B, D), n = model.plant, model.unknown(), len(model.A)
    R = np.pad(model.back[:, n:], ((0, 0), (0, len(plant.disturbances))))
    q = quotient(model.A, B, rows @ model.C, rows @ D, model.back[:, :n], R)
    if not q.proper:
        raise DesignError(
            "rank [E D; C 0] < n + rank D: the measurements do not determine what the equations leave open; "
            + (
                f"add a sensor or decouple fewer disturbances than {', '.join(plant.disturbances)}"
                if plant.disturbances
                else "add a sensor that sees the states without equations of their own"
            )
        )
    modes = q.hidden_modes
    unstable = model.units.rate * modes[~is_inside(modes, plant.is_discrete)]
    if unstable.size:
        raise DesignError(
            f"not detectable: the measurements that are used do not see the mode {describe_modes(unstable)}, or the "
            "disturbances hide it, and it is not stable; add a sensor, or decouple other disturbances"
        )
    return q
