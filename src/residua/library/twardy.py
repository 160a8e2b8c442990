"""The example of Twardy and Kaczorek: an observer for a plant with one unknown input."""

from __future__ import annotations

from residua.plant import Plant


def twardy() -> Plant:
    """Return the example plant of Twardy and Kaczorek, part I.

    Three states, two measurements, no control input, one unknown input that enters the first state. Its
    unknown input observer exists and all of its poles can be placed; the printed ``K1`` gives
    ``-1, -2 + i, -2 - i`` instead of the announced ``-2, -2 + i, -2 - i``.

    Returns
    -------
    Plant
        Continuous.

    References
    ----------
    Twardy and Kaczorek, Observer-based fault detection in dynamical systems, part I, example.

    Examples
    --------
    >>> from residua.library import twardy
    >>> twardy().disturbances
    ('d1',)
    """
    plant = Plant(
        [[-1, 1, 0], [-1, 0, 0], [0, -1, -1]],
        [[], [], []],
        [[1, 0, 0], [0, 0, 1]],
        name="Twardy and Kaczorek, example",
        description="Example of Twardy and Kaczorek, part I.",
    )
    return plant.with_disturbances([[-1], [0], [0]]).with_sensor_faults()
