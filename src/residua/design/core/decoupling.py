"""What of the controls and disturbances of a plant must not reach a residual, and the check of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residua.design.core.balanced_filter import BalancedFilter
from residua.design.core.evidence import measured_from
from residua.design.core.leak import largest_defect, leak_of
from residua.errors import AccuracyError
from residua.tolerances import LEAK

#: The entry of the evidence for the disturbances and the faults that are ignored, together.
IGNORED = "everything ignored"


#: Leaks by the entry of the evidence, and the conditions that say how they were measured, if they were.
Leaks = tuple[dict[str, float], dict[str, float]]


@dataclass(frozen=True)
class Decoupled:
    """An exact design: no control reaches its residual, nor the disturbances, nor the faults that it ignores.

    Attributes
    ----------
    disturbances : bool
        Whether the disturbances are decoupled too. A design that only attenuates them says ``False``.
    faults : tuple of str
        The faults that are decoupled as if they were disturbances.
    apart : bool
        Whether the evidence has the disturbances by themselves too where faults are ignored with them.
    """

    disturbances: bool = True
    faults: tuple[str, ...] = ()
    apart: bool = False

    def leaks(self, f: BalancedFilter | None) -> Leaks:
        """Return the leaks of a filter with a state map, and how far its identities are missed; or raise."""
        assert f is not None
        plant = f.plant
        ignored = [plant.faults.index(name) for name in self.faults]
        Bd, Dd = (plant.Bd, plant.Dd) if self.disturbances else (plant.Bd[:, :0], plant.Dd[:, :0])
        found = leak_of(f, np.hstack([Bd, plant.Bf[:, ignored]]), np.hstack([Dd, plant.Df[:, ignored]]))
        n_u = len(plant.inputs)
        gains = {"control": found.gains[:, :n_u]}
        if self.disturbances and (self.apart or not self.faults):
            gains |= {"disturbance": found.gains[:, n_u : n_u + len(plant.disturbances)]}
        if self.faults:
            gains |= {IGNORED: found.gains[:, n_u:]}
        leaks = self._accepted({name: float(part.max()) for name, part in gains.items() if part.size})
        _accept(found.defects)
        conditions = measured_from(found.slowest, plant.dt) if leaks else {}
        return leaks, {"identities": found.defects} | conditions

    def _accepted(self, leaks: dict[str, float]) -> dict[str, float]:
        for name, gain in leaks.items():
            if not gain <= LEAK:
                what = f"the {name} inputs" if name != IGNORED else f"{', '.join(self.faults)}, which it should ignore"
                raise AccuracyError(
                    f"the residual answers to {what} (by {gain:.2g} > {LEAK:.0e} of the terms that should "
                    "cancel): the plant is too badly conditioned for this design; ask for other poles, or use "
                    "decoupled_residual"
                )
        return leaks


@dataclass(frozen=True)
class Approximate:
    """A filter that controls and disturbances reach a little, as its evidence says: measured elsewhere, or approximate.

    Attributes
    ----------
    entry : str
        The entry of ``decoupling`` or ``conditions`` that holds this number; empty where no input can reach it.
    """

    entry: str

    def leaks(self, f: BalancedFilter | None) -> Leaks:
        """Return nothing but how far the identities of a filter with a state map are missed; or raise."""
        return {}, {} if f is None else {"identities": _accept(largest_defect(f))}


def _accept(defects: float) -> float:
    """Return how far the identities of a filter are missed, or raise where that is too far."""
    if not defects <= LEAK:
        raise AccuracyError(
            "the states of the filter are no function of those of the plant: its equations miss by "
            f"{defects:.2g} > {LEAK:.0e}; check its state_map, or ask for slower poles"
        )
    return defects


#: What a design says of the controls and disturbances of its plant.
Promise = Decoupled | Approximate
