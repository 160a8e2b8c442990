"""N4SID: the states as the oblique projection of the outputs to come, without weights."""

from __future__ import annotations

from dataclasses import replace

from residua.identify.hankel_factor import HankelFactor
from residua.identify.state_map import StateMap, future_by_past, states_of


def n4sid(factor: HankelFactor, past: int) -> StateMap:
    r"""Return the states of N4SID.

    The outputs to come are projected on the past along the inputs to come, :math:`O = \Theta_z Z_p`, and the states
    are :math:`X = U_1^T O` with the leading left singular vectors :math:`U_1` of :math:`O`.

    Consistent where the inputs do not depend on past outputs.

    References
    ----------
    Van Overschee and De Moor (1994), N4SID, Automatica 30(1); Van Overschee and De Moor (1995), A unifying theorem
    for three subspace system identification algorithms, Automatica 31(12), with both weights one.
    """
    joint = future_by_past(factor, past)
    states, _ = states_of(joint.by_past, joint.past, factor.windows, past)
    return replace(states, observability=None)
