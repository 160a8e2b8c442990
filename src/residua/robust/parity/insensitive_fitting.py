"""Units and thresholds of residuals that ignore parameters, from fault-free data."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.robust.parity.insensitive_running import ParameterRunning
from residua.robust.parity.noise_units import fitted_scale

if TYPE_CHECKING:
    from residua.decide.false_alarms import Promise
    from residua.decide.fault_free import FaultFree

#: What may be left of an expected change of a parameter, in units of the noise, is half of this.
REST = 0.1
#: Memories after which what came before is forgotten.
_FORGOTTEN = 5


def fitted_running(
    bare: ParameterRunning, data: NDArray[np.float64], rate: float
) -> tuple[ParameterRunning, list[Promise], int]:
    """Return what runs in units of the noise, the promise of each member, and the number of fault-free samples.

    The statistic of each stretch of time is that in units that the others give, so that the thresholds hold on data
    that the units were not fitted to.

    Parameters
    ----------
    bare : ParameterRunning
    data : ndarray, shape (plants, time, channels)
        Fault-free, of the nominal parameters.
    rate : float
        Fraction of samples over the threshold of each member.
    """
    from residua.decide.fault_free import FaultFree  # what decides stands on what is designed, elsewhere

    plants, time, _ = data.shape
    m = len(bare.scale)
    plain = replace(bare, scale=np.eye(m))
    e = plain.block(plain.initial_state(plants), data)[1].primary.reshape(-1, m)
    usable = np.tile(np.arange(time) >= bare.settle, plants)
    count, least = int(usable.sum()), max(10 * m, 30)
    if count < least:
        raise DataError(f"{count} settled samples are too few to fit {m} equations: give at least {least}")
    reach = min(_FORGOTTEN * bare.memory, max(1, (time - bare.settle) // 4))
    seen = FaultFree(e, usable, reach, tuple(range(time, plants * time, time)))
    gains = bare.largest_gains()
    scale, noise_free = fitted_scale(e[usable], gains, data, bare.scale)
    running = bare if noise_free else replace(bare, scale=scale, rest=REST)
    own = running.block(running.initial_state(plants), data)[1].statistic.reshape(plants * time, -1)
    statistic = own.copy()
    for held, kept, _ in () if noise_free else seen.held_out():
        turn = replace(running, scale=fitted_scale(e[kept], gains, data, bare.scale)[0])
        for p, part in enumerate(seen.parts):
            inside = np.flatnonzero(held[part])
            if len(inside):
                first, last = int(inside[0]), int(inside[-1]) + 1
                begin = max(0, first - bare.settle - reach)
                found = turn.block(turn.initial_state(1), data[p : p + 1, begin:last])[1].statistic[0]
                statistic[part][first:last] = found[first - begin :]
    own, statistic = np.nan_to_num(own), np.nan_to_num(statistic)
    promises = [_promise(statistic[:, j], own[:, j], seen, bare.memory, rate) for j in range(len(bare.ignored))]
    thresholds = np.array([one.threshold for one in promises])
    return replace(running, thresholds=thresholds), promises, count


def _promise(statistic: NDArray, own: NDArray, seen: FaultFree, memory: int, rate: float) -> Promise:
    from residua.decide.false_alarms import observed, promise_of

    found = observed(
        statistic, seen.full, seen.usable, seen.parts, np.inf, persistence=1, release=1, window=memory, own=own
    )
    return promise_of(found, rate)


__all__ = ["REST", "fitted_running"]
