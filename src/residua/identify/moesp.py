"""MOESP: the dynamics from the shift of the extended observability matrix."""

from __future__ import annotations

from dataclasses import replace

from residua.identify.hankel_factor import HankelFactor, regress
from residua.identify.state_map import StateMap, future_by_past, states_of


def moesp(factor: HankelFactor, past: int) -> StateMap:
    r"""Return the states of MOESP with past inputs and outputs as instruments, and the observability matrix.

    What the past explains of the outputs to come is projected on the complement of the inputs to come,
    :math:`\Theta_z Z_p \Pi_{U_f}^\perp`; its left singular vectors :math:`U_1` are the extended observability
    matrix, whose shift gives :math:`A` and :math:`C`.

    Consistent where the inputs do not depend on past outputs.

    References
    ----------
    Verhaegen (1994), Identification of the deterministic part of MIMO state space models, Automatica 30(1); Van
    Overschee and De Moor (1995), Automatica 31(12), weights one and the projection.
    """
    joint = future_by_past(factor, past)
    rest = regress(joint.past, joint.given).residual
    states, size = states_of(joint.by_past, rest, factor.windows, past)
    assert states.observability is not None
    return replace(states, observability=states.observability * size)
