"""The evidence of a design: the checks that it has passed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.rank import RankDecision
from residua.shown import Shown

#: How the decoupling of a sampled design calls what sampling costs, after the name of the group of inputs.
_SAMPLED = ", sampled"


def of_sampling(gains: Mapping[str, float]) -> dict[str, float]:
    """Return gains to the residual as entries of a decoupling that are the cost of sampling."""
    return {f"{name}{_SAMPLED}": gain for name, gain in gains.items()}


#: The beginning of a note on a set that was linearised.
AFFINE_FORM = "certified for the affine form of the set"

#: How the conditions of an evidence call the frequency from which leaks were measured, before its unit.
_MEASURED_FROM = {False: "leaks measured from, in rad/s", True: "leaks measured from, in rad per sample"}


def measured_from(slowest: float, dt: float) -> dict[str, float]:
    """Return the lowest of the frequencies, in rad/s, at which leaks were measured, as an entry of the conditions."""
    return {_MEASURED_FROM[dt > 0]: slowest * (dt or 1.0)}


_NONE = np.zeros(0, dtype=np.complex128)


@dataclass(frozen=True, eq=False, repr=False)
class Evidence(Shown):
    """The checks that a design has passed, with their numbers.

    Attributes
    ----------
    method : str
        The name of the design, in words.
    poles : ndarray
        The poles that the residual generator has.
    requested_poles : ndarray
        The poles that were asked for; empty when the design chose them.
    fixed_poles : ndarray
        Poles that no gain can move: unobservable modes, which are invariant zeros of the plant.
    decoupling : mapping of str to float
        How far each group of inputs that must not be seen (``"control"``, ``"disturbance"``) reaches the residual: the
        peak over frequency of the response, over the peak of the sum of the sizes of the terms that have to cancel.
        1e-16 is exact, 1 no decoupling; no unit is in it. The response is that to the defects, what the identities of
        the filter miss in extended precision, from a thirtieth of the slowest rate of plant and filter on. For sampled
        designs (``"control, sampled"``) it is the response itself.
    ranks : mapping of str to RankDecision
        Every rank decision with the singular values on both sides of its gap. It is made, and they are, in the
        balanced units of the plant.
    conditions : mapping of str to float
        Named condition numbers and residuals of the identities that define the design.
    notes : tuple of str
        What a reader should know, such as a redundancy or the cost of sampling.
    references : tuple of str
        Where the method is from, with equation numbers.
    """

    method: str
    poles: NDArray[np.complex128] = field(default_factory=_NONE.copy)
    requested_poles: NDArray[np.complex128] = field(default_factory=_NONE.copy)
    fixed_poles: NDArray[np.complex128] = field(default_factory=_NONE.copy)
    decoupling: Mapping[str, float] = field(default_factory=dict)
    ranks: Mapping[str, RankDecision] = field(default_factory=dict)
    conditions: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    references: tuple[str, ...] = ()

    @property
    def cost_of_sampling(self) -> dict[str, float]:
        """The entries of ``decoupling`` that sampling a continuous design cost, by group of inputs."""
        gains = self.decoupling.items()
        return {name.removesuffix(_SAMPLED): gain for name, gain in gains if name.endswith(_SAMPLED)}

    def leaks_measured_from(self, dt: float) -> float | None:
        """Return the frequency in rad/s from which leaks were measured, of the design or, with a step, as it runs.

        Nothing of a design without controls and disturbances, or one that measured none.

        Parameters
        ----------
        dt : float
            0 for continuous time, otherwise the sample step in seconds.

        Returns
        -------
        float or None
        """
        found = self.conditions.get(_MEASURED_FROM[dt > 0])
        return None if found is None else found / (dt or 1.0)

    def extended(
        self,
        *,
        decoupling: Mapping[str, float] | None = None,
        conditions: Mapping[str, float] | None = None,
        notes: tuple[str, ...] = (),
        **changes: object,
    ) -> Evidence:
        """Return a copy with entries added to the mappings and notes, and other fields replaced."""
        return replace(
            self,
            decoupling={**self.decoupling, **(decoupling or {})},
            conditions={**self.conditions, **(conditions or {})},
            notes=self.notes + notes,
            **changes,  # pyright: ignore[reportArgumentType]
        )

    def __str__(self) -> str:
        lines = [self.method]
        for label, poles in (
            ("poles", self.poles),
            ("asked for", self.requested_poles),
            ("fixed", self.fixed_poles),
        ):
            if len(poles):
                lines.append(f"  {label}: {', '.join(format_pole(p) for p in poles)}")
        lines += [f"  gain from {name}: {gain:.1e} (relative)" for name, gain in self.decoupling.items()]
        lines += [f"  {name}: {decision}" for name, decision in self.ranks.items()]
        lines += [f"  {name}: {value:.3g}" for name, value in self.conditions.items()]
        lines += [f"  note: {note}" for note in self.notes]
        lines += [f"  reference: {reference}" for reference in self.references]
        return "\n".join(lines)


def format_pole(pole: complex) -> str:
    """Return a pole as short text, in whatever unit of time: only a pole at zero is a zero."""
    pole = complex(pole)
    if pole == 0:
        return "0"
    if abs(pole.imag) <= 1e-9 * abs(pole):
        return f"{pole.real:.4g}"
    return f"{pole.real:.4g}{pole.imag:+.4g}i"
