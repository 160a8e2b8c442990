r"""Residual generators of recorded channels: a filter of their present and past, and the plant that it watches.

There is no model. The plant has no states and no control inputs: all channels are its outputs, inputs of the recording
first, and its operating point are their means. What it says is all that is known: a fault of a channel adds to that
channel.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import Member, ResidualGenerator, make_generator
from residua.identify.drift_treatment import Treated
from residua.linear import StateSpace
from residua.plant import Plant


def channel_plant(channels: Treated) -> Plant:
    """Return the plant of all channels of a recording: a fault for each of them that is not left out.

    The fault of an output is called ``"NAME sensor"`` and adds to it. That of an input is called ``"NAME actuator"``:
    what acts is more than what is recorded, so it takes away from the record.
    """
    gathered, watched = channels.whole, channels.gathered
    q = len(gathered.channels)
    nothing = np.zeros((0, 0))
    plant = Plant(
        nothing, nothing, np.zeros((q, 0)), dt=gathered.dt, outputs=gathered.channels, name="recorded channels"
    )
    for name in watched.inputs:
        column = np.zeros(q)
        column[gathered.inputs.index(name)] = -1.0
        plant = plant.with_faults({f"{name} actuator": (np.zeros(0), column)}, kind="actuator", component=name)
    return plant.with_sensor_faults(watched.outputs).with_operating_point(outputs=channels.mean)


def channel_generator(
    channels: Treated,
    weights: NDArray[np.float64],
    groups: dict[str, int],
    evidence: Evidence,
    *,
    denominator: Sequence[float] = (),
) -> ResidualGenerator:
    r"""Return the generator :math:`d(q^{-1})\, r_k = \sum_i W_i z_{k-i}` of channels in standard units.

    Parameters
    ----------
    weights : ndarray, shape (lags + 1, residuals, channels)
        ``W``, the present sample first; of the channels as they are treated.
    groups : dict of str to int
        Names of groups of residuals, in their order, and how many each has.
    denominator : sequence of float
        :math:`d_1, ..., d_{lags}` of :math:`d = 1 + \sum_i d_i q^{-i}`; all zero, a moving average, when omitted.
    """
    plant, gathered = channel_plant(channels), channels.gathered
    W = channels.weights(weights)
    lags, q = len(W) - 1, plant.n_outputs
    d = np.array([*denominator, *np.zeros(lags - len(denominator))])
    A = np.zeros((lags * q, lags * q))
    B = np.zeros((lags * q, q))
    if lags:
        A[:q] = np.kron(-d, np.eye(q))
        A[q:, :-q] = np.eye((lags - 1) * q)
        B[:q] = np.eye(q)
    C = np.hstack([W[i + 1] - d[i] * W[0] for i in range(lags)]) if lags else np.zeros((W.shape[1], 0))
    names = tuple(f"{group} {k + 1}" if size > 1 else group for group, size in groups.items() for k in range(size))
    system = StateSpace(A, B, C, W[0], dt=gathered.dt, inputs=plant.outputs, outputs=names)
    ends = np.cumsum([0, *groups.values()]).tolist()
    members = tuple(
        Member(group, tuple(range(a, b)), plant.faults) for group, a, b in zip(groups, ends[:-1], ends[1:], strict=True)
    )
    notes = (*gathered.notes, *channels.notes)
    # nothing is known of the plant, so that its state, of dimension zero, is mapped exactly, and nothing is decoupled
    return make_generator(
        system,
        plant,
        evidence.method,
        evidence.extended(poles=system.poles(), notes=notes),
        decouples=Decoupled(),
        state_map=np.zeros((lags * q, 0)),
        members=members,
    )


def names_of_groups(groups: dict[str, int], generator: ResidualGenerator) -> dict[str, tuple[str, ...]]:
    """Return the names of the residuals of each group."""
    return {
        one.name: tuple(generator.residuals[i] for i in one.residuals)
        for one in generator.members
        if one.name in groups
    }
