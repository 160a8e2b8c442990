"""The second-order examples of Gertler's survey: one sampled plant with two state faults."""

from __future__ import annotations

from residua.plant import Plant


def gertler(*, sensor_faults: bool = False) -> Plant:
    r"""Return the sampled plant of Examples 2 and 3 of Gertler's survey.

    .. math::

       x_{k+1} = \mathrm{diag}(0.4, 0.5, 0.9)\, x_k + (0.5, 1, 0.1)^T u_k + F p_k, \qquad
       y = \begin{bmatrix} 1 & 1 & 0 \\ 0 & 1 & 1 \end{bmatrix} x

    with the columns (1, 1, 0) and (0, 1, 1) of ``F`` for the faults ``p1`` and ``p2``.

    Parameters
    ----------
    sensor_faults : bool
        Whether both sensors may fail too.

    Returns
    -------
    Plant
        Sampled with a step of 1.

    References
    ----------
    Gertler (1991), Examples 2 and 3.

    Examples
    --------
    >>> from residua.library import gertler
    >>> gertler().faults
    ('p1', 'p2')
    """
    plant = Plant(
        [[0.4, 0, 0], [0, 0.5, 0], [0, 0, 0.9]],
        [[0.5], [1.0], [0.1]],
        [[1, 1, 0], [0, 1, 1]],
        dt=1.0,
        name="Gertler, example 2",
        description="Examples 2 and 3 of Gertler (1991); the step is a unit step.",
    ).with_faults({"p1": [1, 1, 0], "p2": [0, 1, 1]})
    return plant.with_sensor_faults() if sensor_faults else plant
