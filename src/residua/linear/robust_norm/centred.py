"""Every member is its centre and a difference: the norm of the one is exact, that of the other is small."""

from __future__ import annotations

import numpy as np

from residua.linear.uncertain_system import UncertainSystem


def difference_system(system: UncertainSystem) -> UncertainSystem:
    r"""Return what the output of a member exceeds that of the centre of the set by, for the same input.

    With the state :math:`x_c` of the centre and :math:`\delta = x - x_c`,

    .. math::

       x_{c+} = A_c x_c + B_w w, \quad \delta_+ = A_c \delta + B_p p, \quad
       q = C_q (x_c + \delta), \quad z - z_c = C_{z,c} \delta + D_{zp} p

    where ``p = (F - F_c) q``. The input reaches the difference by way of the uncertainty only.
    """
    centre = (system.low + system.high) / 2
    middle = system.member(centre)
    zero = np.zeros_like(system.A)
    return UncertainSystem(
        np.block([[middle.A, zero], [zero, middle.A]]),
        np.vstack([np.zeros_like(system.Bp), system.Bp]),
        np.vstack([system.Bw, np.zeros_like(system.Bw)]),
        np.hstack([system.Cq, system.Cq]),
        np.hstack([np.zeros_like(middle.C), middle.C]),
        system.Dzp,
        np.zeros_like(system.Dzw),
        low=system.low - centre,
        high=system.high - centre,
        channels=system.channels,
        parameters=system.parameters,
        dt=system.dt,
    )
