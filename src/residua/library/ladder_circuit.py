"""An electrical circuit with its node voltages kept: a singular plant of index 1."""

from __future__ import annotations

import numpy as np

from residua.plant import Plant

INDUCTANCE = 0.05  #: H.
CAPACITANCE = 2e-3  #: F.
R_SOURCE = 0.5  #: Resistance of the source and the coil, ohm.
R_SHUNT, R_LINK, R_LOAD, R_CAPACITOR = 40.0, 2.0, 20.0, 1.0  #: ohm.


def ladder_circuit(dt: float = 0) -> Plant:
    r"""Return a ladder of coil, resistors and capacitor, as Kirchhoff's laws give it.

    .. math::

       \begin{aligned}
       L\, \dot i &= u + d - R_s\, i - v_a, &
       0 &= i - \frac{v_a}{R_1} - \frac{v_a - v_b}{R_2}, \\
       C\, \dot v_c &= \frac{v_b - v_c}{R_4}, &
       0 &= \frac{v_a - v_b}{R_2} - \frac{v_b}{R_3} - \frac{v_b - v_c}{R_4}.
       \end{aligned}

    A source ``u`` drives the coil current ``i`` into node a; a shunt hangs on a, a link leads on to node b, where
    load and capacitor are. The currents into a and b add up to zero at every instant, so the equations of the
    node voltages ``va`` and ``vb`` have no derivative: ``E = diag(L, C, 0, 0)``. Measured are ``va``, ``vb`` and the
    coil current, not the voltage of the capacitor. The faults, with their units:

    - ``i sensor``, ``va sensor``, ``vb sensor``: offset of the reading, A and V;
    - ``leak a``, ``leak b``: current that leaves the node to ground, A.

    The voltage of the source is uncertain: the disturbance ``ripple``, V, adds to its set value.

    Parameters
    ----------
    dt : float
        Step in seconds; 0 for the continuous plant. Sampling eliminates the node voltages.

    Returns
    -------
    Plant
        Of index 1, with two finite poles; without noise.

    References
    ----------
    An example of ours; the values are made up.

    Examples
    --------
    >>> from residua.library import ladder_circuit
    >>> plant = ladder_circuit()
    >>> plant.states, plant.system().poles().size
    (('i', 'vc', 'va', 'vb'), 2)
    >>> ladder_circuit(dt=1e-3).states
    ('i', 'vc')
    """
    g1, g2, g3, g4 = 1 / R_SHUNT, 1 / R_LINK, 1 / R_LOAD, 1 / R_CAPACITOR
    plant = Plant(
        [
            [-R_SOURCE, 0, -1, 0],
            [0, -g4, 0, g4],
            [1, 0, -g1 - g2, g2],
            [0, g4, g2, -g2 - g3 - g4],
        ],
        [[1], [0], [0], [0]],
        [[1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        E=np.diag([INDUCTANCE, CAPACITANCE, 0, 0]),
        inputs=["source"],
        outputs=["i", "va", "vb"],
        states=["i", "vc", "va", "vb"],
        units={"source": "V", "i": "A", "va": "V", "vb": "V", "vc": "V"},
        name="ladder circuit",
        description="Coil, resistors and capacitor; the node voltages obey algebraic equations.",
    )
    plant = plant.with_disturbances({"ripple": {"i": 1.0}}).with_sensor_faults()
    plant = plant.with_faults({"leak a": {"va": -1.0}, "leak b": {"vb": -1.0}})
    return plant.discretize(dt) if dt else plant
