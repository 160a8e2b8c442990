"""The calls that :func:`residua.suggest` considers for a plant."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from residua.analysis.coding import choose
from residua.analysis.diagnosability import Diagnosability
from residua.analysis.unknown_input import is_singular
from residua.plant import Plant

#: Seconds for the choice of a coding set; what was found by then is taken.
_CHOICE_TIME = 5.0


@dataclass(frozen=True)
class Candidate:
    """A call, and why it makes no sense here, where it makes none.

    Attributes
    ----------
    function : str
        In :mod:`residua.design`.
    arguments : str
        After the plant, as they are typed.
    options : tuple of (str, value)
        The same as values.
    many : bool
        Whether it designs many filters.
    pointless : str
        Why it makes no sense; empty where it does.
    chosen : callable, optional
        Makes the second argument from the plant.
    """

    function: str
    arguments: str = ""
    options: tuple[tuple[str, Any], ...] = ()
    many: bool = False
    pointless: str = ""
    chosen: Callable[[Plant], Any] | None = None

    @property
    def call(self) -> str:
        """The line of code."""
        return f"rs.design.{self.function}(plant{', ' + self.arguments if self.arguments else ''})"

    def run(self, plant: Plant) -> Any:
        """Make the call."""
        second = () if self.chosen is None else (self.chosen(plant),)
        return getattr(import_module("residua.design"), self.function)(plant, *second, **dict(self.options))


def candidates(plant: Plant, known: Diagnosability | None) -> Iterator[Candidate]:
    """Yield what could serve, the more usual first.

    Parameters
    ----------
    plant : Plant
    known : Diagnosability or None
        Of this plant; ``None`` where it was not examined.
    """
    kinds = set(plant.fault_kinds)
    noise = "" if plant.noises else "the plant has no noise: give it with plant.with_noise(...)"
    yield Candidate("kalman_filter", pointless=noise)
    for name in ("luenberger_observer", "unknown_input_observer", "reduced_order_observer", "descriptor_observer"):
        yield Candidate(name)
    if is_singular(plant) or plant.disturbances:
        yield Candidate("perfect_observer")
    else:
        yield Candidate("perfect_observer", "least_order=True", (("least_order", True),))
    if not plant.faults:
        return
    yield Candidate("detection_filter")
    decouples = "" if plant.disturbances else "the plant has no disturbances: detection_filter is the same"
    yield Candidate("robust_detection_filter", pointless=decouples)
    yield Candidate("decoupled_residual")
    for kind in ("sensor", "actuator"):
        for scheme in ("generalized", "dedicated"):
            missing = "" if kind in kinds else f"the plant has no {kind} faults"
            option = (("scheme", scheme),)
            yield Candidate(f"{kind}_fault_bank", f'scheme="{scheme}"', option, True, missing)
    if known is not None and len(known.groups) > 1:
        coding = "rs.coding.choose(plant)"
        yield Candidate("structured_bank", coding, many=True, chosen=lambda p: choose(p, time_limit=_CHOICE_TIME))
    continuous = "" if plant.is_discrete else "it counts samples: plant.discretize(dt) first"
    yield Candidate("matched_filters", pointless=noise or continuous)
    yield from _estimators(plant, known)


def _estimators(plant: Plant, known: Diagnosability | None) -> Iterator[Candidate]:
    """Yield the estimators of all faults, of all of one kind, and of each fault."""
    seen = plant.faults if known is None else tuple(np.asarray(plant.faults)[known.detectable].tolist())
    groups: list[tuple[str, ...]] = [plant.faults]
    for kind in ("actuator", "sensor", "component"):
        groups.append(tuple(fault.name for fault in plant.fault_list if fault.kind == kind))
    groups += [(name,) for name in seen]
    done = set()
    for group in groups:
        if not group or group in done:
            continue
        done.add(group)
        whole = group == plant.faults
        yield Candidate(
            "fault_estimator", "" if whole else f"faults={list(group)!r}", () if whole else (("faults", group),), True
        )
