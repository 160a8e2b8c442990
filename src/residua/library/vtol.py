"""The aircraft of Sueur: vertical takeoff and landing, motion in the vertical plane."""

from __future__ import annotations

import numpy as np

from residua.plant import Plant

A = (
    (-9.9477, -0.7476, 0.2632, 5.0337),
    (52.1659, 2.7452, 5.5532, -24.4221),
    (26.0922, 2.6361, -4.1975, -19.2774),
    (0.0, 0.0, 1.0, 0.0),
)
B = ((0.4422, 0.1761), (3.5446, -7.5922), (-5.52, 4.49), (0.0, 0.0))
C = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))

#: B(3, 1) as Sueur prints it; the literature that it cites has the other sign.
PRINTED_B31 = 5.52

STATES = ("v_horizontal", "v_vertical", "pitch_rate", "pitch")
INPUTS = ("collective", "cyclic")
OUTPUTS = ("v_horizontal", "v_vertical", "pitch")


def vtol(*, corrected: bool = True) -> Plant:
    r"""Return the linear model of an aircraft that takes off vertically, in the vertical plane.

    Four states (horizontal and vertical velocity, pitch rate and pitch angle), of which all but the pitch rate are
    measured; two inputs (collective pitch, longitudinal cyclic pitch). The faults are both actuators and all three
    sensors.

    Parameters
    ----------
    corrected : bool
        With ``B(3,1) = -5.52``, as Narendra and Tripathi and all who took the model from them have it; with
        ``+5.52``, printed in the paper, when false. The sign matters: with the first two outputs alone the
        zeros from the inputs are a stable pair for ``+5.52`` and an unstable one for ``-5.52``, so that the
        third sensor is indispensable on the real aircraft only.

    Returns
    -------
    Plant
        Continuous.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, section 3; Narendra and Tripathi, Identification
    and optimization of aircraft dynamics, J. Aircraft 10 (1973) 193-199; Saif and Guan, IEEE Trans. Aerospace and
    Electronic Systems 29 (1993) 685-695.

    Examples
    --------
    >>> from residua.library import vtol
    >>> vtol().faults[:2]
    ('collective actuator', 'cyclic actuator')
    >>> vtol().system(()).poles().real.round(4)
    array([-6.8271, -1.0112, -1.0112, -2.5506])
    """
    inputs = np.array(B)
    if not corrected:
        inputs[2, 0] = PRINTED_B31
    aircraft = Plant(
        A,
        inputs,
        C,
        states=STATES,
        inputs=INPUTS,
        outputs=OUTPUTS,
        units={"v_horizontal": "kn", "v_vertical": "kn", "pitch_rate": "deg/s", "pitch": "deg"},
        name="VTOL aircraft",
        description="Vertical takeoff and landing aircraft of Sueur, section 3; deviations from steady flight.",
    )
    return aircraft.with_actuator_faults().with_sensor_faults()
