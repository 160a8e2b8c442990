"""Sizes of estimated faults over a stretch of samples, with their units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Candidate, Size
from residua.design import ResidualGenerator
from residua.plant import Plant


def estimates_of(generator: ResidualGenerator, residuals: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the columns that estimate a fault; one estimated more than once also gets its residual's name."""
    names = generator.estimated
    labels = [f if names.count(f) == 1 else f"{f} ({r})" for f, r in zip(names, generator.residuals, strict=False)]
    return {label: residuals[..., i] for i, label in enumerate(labels) if names[i]}


def sizes_over(
    generator: ResidualGenerator, residuals: NDArray[np.float64], usable: NDArray[np.bool_], first: int, last: int
) -> tuple[Size, ...]:
    """Return mean and last value of every estimate over a stretch of samples, both ends included."""
    if not generator.estimated:
        return ()
    rows = residuals[first : last + 1][usable[first : last + 1]]
    return tuple(
        Size(
            fault,
            float(rows[:, i].mean()) if len(rows) else float("nan"),
            float(rows[-1, i]) if len(rows) else float("nan"),
            fault_unit(generator.plant, fault),
        )
        for i, fault in enumerate(generator.estimated)
        if fault
    )


def with_sizes(candidates: tuple[Candidate, ...], sizes: tuple[Size, ...]) -> tuple[Candidate, ...]:
    """Return the candidates, each with the sizes of its faults."""
    if not sizes:
        return candidates
    return tuple(replace(c, sizes=tuple(size for size in sizes if size.fault in c.faults)) for c in candidates)


def fault_unit(plant: Plant, fault: str) -> str:
    """Return the unit of a fault: its own, or that of its channel, if the plant has one."""
    if fault not in plant.faults:
        return ""
    i = plant.faults.index(fault)
    if plant.fault_list[i].unit:
        return plant.fault_list[i].unit
    if plant.fault_kinds[i] not in ("sensor", "actuator"):
        return ""  # the size of a process fault is in the units of its direction
    return str(plant.units.get(plant.fault_components[i], ""))
