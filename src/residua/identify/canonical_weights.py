"""CVA: the states as the canonical variates of the past that are most correlated with the outputs to come."""

from __future__ import annotations

from dataclasses import replace

from residua.identify.hankel_factor import HankelFactor, regress
from residua.identify.state_map import StateMap, future_by_past, states_of
from residua.linear.subspaces.rank import range_basis


def canonical_weights(factor: HankelFactor, past: int) -> StateMap:
    r"""Return the states of canonical variate analysis.

    With the inputs to come projected out of both, :math:`W = (Y_f \Pi Y_f^T)^{-1/2}` weights the outputs to come; the
    singular values of :math:`W \Theta_z Z_p \Pi` are the canonical correlations of past and future, and no unit of
    an output changes them.

    Consistent where the inputs do not depend on past outputs.

    References
    ----------
    Larimore (1990), Canonical variate analysis in identification, filtering and adaptive control, 29th CDC; Van
    Overschee and De Moor (1995), Automatica 31(12), third row of the table.
    """
    joint = future_by_past(factor, past)
    future = regress(joint.future, joint.given).residual
    past_left = regress(joint.past, joint.given).residual
    V, decision = range_basis(future.T)  # outputs to come without noise depend on one another
    weight = V.T / decision.singular_values[: decision.rank, None]
    states, _ = states_of(weight @ joint.by_past, past_left, factor.windows, past)
    return replace(states, observability=None)
