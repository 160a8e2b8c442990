"""Observers of order n - p for singular plants."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from numpy.typing import ArrayLike

from residua.design.core.method import method
from residua.design.observers.observer import Observer
from residua.design.observers.reduced_order import reduced_observer
from residua.plant import Plant


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
    return reduced_observer(
        plant,
        "descriptor observer",
        "Twardy and Kaczorek, part I, eqs. (18) to (29)",
        poles=poles,
        margin=margin,
        outputs=outputs,
    )
