"""Faults that residuals can see, those that they can see while ignoring others, and lasting traces of faults."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.errors import DesignError
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant
from residua.tolerances import BALANCED_ANSWER

#: Of faults that are seen to this part of the best one, the first of the plant is taken.
_ALIKE = 0.1


@dataclass(frozen=True, eq=False)
class FaultSpace:
    """The faults of a plant as residuals see them, for any set of faults that they ignore with the disturbances.

    A residual that ignores some faults ignores all in their *closure*. The closed sets are the flats of a matroid: of
    independent residuals, each ignores one independent fault more.

    Attributes
    ----------
    model : BalancedPlant
    """

    model: BalancedPlant

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults."""
        return self.model.plant.faults

    @property
    def dimension(self) -> int:
        """Number of independent residuals that ignore the disturbances."""
        return len(self.model.quotient().H)

    @cached_property
    def visible(self) -> NDArray[np.bool_]:
        """Faults seen by some residual that ignores the disturbances."""
        return self.drive(()) > BALANCED_ANSWER

    def drive(self, ignored: Sequence[int]) -> NDArray[np.float64]:
        """Return the strength of each fault in the residuals that ignore the disturbances and some faults."""
        return np.linalg.norm(self.model.quotient(ignored).drive(*self.model.faults), axis=0)

    def closure(self, ignored: Sequence[int]) -> NDArray[np.bool_]:
        """Return the faults that every residual ignores that ignores these."""
        closed = self.drive(ignored) <= BALANCED_ANSWER
        closed[list(ignored)] = True
        return closed

    def basis(self, chosen: Iterable[int]) -> list[int]:
        """Return a largest independent subset of some faults; the one that is seen best beside those taken is next."""
        left, taken = [j for j in chosen if self.visible[j]], []
        while left:
            drive = np.where(self.closure(taken), 0.0, self.drive(taken))[left]
            if not drive.any():
                break
            best = int(np.argmax(drive > _ALIKE * drive.max()))
            taken.append(left.pop(best))
        return taken

    def lasting(self, ignored: Sequence[int]) -> NDArray[np.bool_]:
        """Return the constant faults with a lasting trace in some residual that ignores others."""
        return ~self.closure(ignored) & (np.linalg.norm(self.limit(ignored), axis=0) > BALANCED_ANSWER)

    def limit(self, ignored: Sequence[int]) -> NDArray[np.float64]:
        r"""Return the limits, for constant faults, of all residuals that ignore some faults: one column for each fault.

        The rows that annihilate :math:`[F - s_0 I; G]` of the part that is seen, at :math:`s_0 = 0` (:math:`z = 1`).
        """
        q = self.model.quotient(ignored)
        O = q.split.seen  # noqa: E741
        F, G = q.pair
        M = np.vstack([O.T @ F @ O - self.model.boundary * np.eye(O.shape[1]), G @ O])
        left = np.linalg.svd(M)[0][:, M.shape[1] :] if M.size else np.eye(len(M))
        return left.T @ q.drive(*self.model.faults)

    def hiders(self, fault: int, basis: Sequence[int]) -> list[int]:
        """Return a smallest part of some faults that hides one of their closure; empty for one that is not visible."""
        alone = next((i for i in basis if self.closure([i])[fault]), None)
        if alone is not None:
            return [alone] if self.visible[fault] else []
        needed = list(basis)
        for j in reversed(basis):
            fewer = [i for i in needed if i != j]
            if self.closure(fewer)[fault]:
                needed = fewer
        return needed

    def why_unseen(self, fault: int) -> str:
        """Return why no residual that ignores the disturbances sees a fault."""
        plant = self.model.plant
        if not plant.disturbances or not fault_space(plant.without_disturbances()).visible[fault]:
            return "no output sees it"
        return f"hidden by the disturbances {', '.join(plant.disturbances)}, which can imitate it"

    def flats(self, most: int) -> list[tuple[NDArray[np.bool_], list[int]]]:
        """Return every closed set but the whole, with a basis, those of fewest dimensions first.

        Raises DesignError when there are more than ``most``.
        """
        visible = np.flatnonzero(self.visible)
        whole = len(self.basis(visible))
        if not whole:
            return []
        known = [(~self.visible, [])]
        level: list[tuple[NDArray[np.bool_], list[int]]] = list(known)
        for _ in range(whole - 1):
            above: dict[bytes, tuple[NDArray[np.bool_], list[int]]] = {}
            for flat, basis in level:
                covered = flat.copy()
                for j in visible:
                    if covered[j]:
                        continue
                    larger = [*basis, int(j)]
                    closed = self.closure(larger) | flat
                    covered |= closed
                    if not closed.all():
                        above.setdefault(closed.tobytes(), (closed, larger))
                if len(known) + len(above) > most:
                    raise DesignError(
                        f"more than {most} rows are attainable with {len(visible)} faults and {whole} independent "
                        "residuals: ask about the rows you mean (structure=...), watch fewer faults at a time "
                        "(plant.without_faults), or allow more with most="
                    )
            level = list(above.values())
            known += level
        return known


def fault_space(plant: Plant) -> FaultSpace:
    """Return the faults of a plant as residuals see them."""
    if not plant.faults:
        raise DesignError("the plant has no faults: add some with with_sensor_faults or with_faults")
    return FaultSpace(plant.balanced)
