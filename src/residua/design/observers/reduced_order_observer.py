"""Observers of order n - p for ordinary plants."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from numpy.typing import ArrayLike

from residua.design.core.method import method
from residua.design.observers.observer import Observer
from residua.design.observers.reduced_order import reduced_observer
from residua.errors import DesignError
from residua.plant import Plant
from residua.plant.balanced import is_singular


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
    r"""Design an observer of order n - p: what the measurements say is not estimated again.

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
    return reduced_observer(
        plant.explicit(),
        "reduced-order observer",
        "Twardy and Kaczorek, part I, eqs. (18) to (29)",
        poles=poles,
        margin=margin,
        outputs=outputs,
    )
