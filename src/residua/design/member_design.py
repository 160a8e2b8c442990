"""What a bank's members can be: the observers, each turned into a residual that ignores the disturbances."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from residua.design.bank import MemberDesign
from residua.design.decoupled_residual import decoupled_residual
from residua.design.descriptor_observer import descriptor_observer
from residua.design.generator import ResidualGenerator
from residua.design.unknown_input_observer import unknown_input_observer
from residua.errors import DesignError
from residua.plant import Plant

KINDS = ("unknown-input", "reduced-order", "perfect", "minimal")


def member_design(
    kind: str, *, poles: Sequence[complex] | ArrayLike | None, margin: float | None, rtol: float
) -> MemberDesign:
    """Return how members of a kind are designed.

    Parameters
    ----------
    kind : {"unknown-input", "reduced-order", "perfect", "minimal"}
    poles : sequence of complex, optional
        The same for every member.
    margin : float, optional
    rtol : float

    Returns
    -------
    callable
        From the plant, in which what is to be ignored are disturbances, to the residual generator.
    """
    if kind == "unknown-input":
        return lambda p: unknown_input_observer(p, poles=poles, margin=margin, rtol=rtol).residual_generator()
    if kind == "reduced-order":
        return lambda p: _with_one_held_out(p, poles, margin, rtol)
    if kind == "minimal":
        return lambda p: decoupled_residual(p, poles=poles, margin=margin, rtol=rtol)
    if kind == "perfect":
        if poles is not None or margin is not None:
            raise DesignError("a perfect observer has no poles to place: leave out poles and margin")
        from residua.design.perfect_observer import perfect_observer

        return lambda p: perfect_observer(p, rtol=rtol).residual_generator()
    raise DesignError(f"unknown kind of observer {kind!r}; known: {', '.join(KINDS)}")


def _with_one_held_out(
    plant: Plant, poles: Sequence[complex] | ArrayLike | None, margin: float | None, rtol: float
) -> ResidualGenerator:
    """Return the reduced observer that uses all measurements but one, which is the one it is judged by.

    The held-out measurement is the first that leaves an observer that sees every remaining fault, or else the
    most of them.
    """
    best: tuple[int, ResidualGenerator] | None = None
    reasons = []
    for k, name in enumerate(plant.outputs):
        if plant.Dd[k].any():
            continue  # a disturbance enters it: its error would say nothing
        used = [i for i in range(plant.n_outputs) if i != k]
        try:
            found = descriptor_observer(plant, poles=poles, margin=margin, outputs=used, rtol=rtol)
            generator = found.residual_generator()
        except DesignError as error:
            reasons.append(f"without {name}: {error}")
            continue
        seen = int(generator.structure.any(axis=0).sum())
        if seen == len(plant.faults):
            return generator
        if best is None or seen > best[0]:
            best = (seen, generator)
    if best is None:
        raise DesignError("; ".join(reasons) or "every measurement carries a disturbance or an ignored fault")
    return best[1]
