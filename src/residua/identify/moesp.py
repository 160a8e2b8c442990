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

    The shift needs two rows of the future, and tells apart ``(past - 1) outputs`` states at most.

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
    # the shift drops a row: a state beyond the rows that are left would get poles that no data say
    most = min(len(size), (past - 1) * factor.n_outputs)
    return replace(
        states,
        T=states.T[:most],
        singular_values=states.singular_values[:most],
        observability=states.observability[:, :most] * size[:most],
    )
