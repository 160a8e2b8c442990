"""Members of a bank: observers, each turned into a residual that ignores the disturbances."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from residua.design.banks.bank import MemberDesign
from residua.design.banks.decoupled_residual import decoupled_residual
from residua.design.core.generator import ResidualGenerator
from residua.design.observers.observer_gain import asked
from residua.design.observers.perfect_observer import perfect_observer
from residua.design.observers.reduced_order_observer import descriptor_observer
from residua.design.observers.unknown_input_observer import unknown_input_observer
from residua.errors import DesignError
from residua.plant import Plant

KINDS = ("unknown-input", "reduced-order", "perfect", "minimal")


def member_design(
    kind: str, plant: Plant, *, poles: Sequence[complex] | ArrayLike | None, margin: float | None
) -> MemberDesign:
    """Return the design function for members of a kind.

    Parameters
    ----------
    kind : {"unknown-input", "reduced-order", "perfect", "minimal"}
    plant : Plant
        With all faults that the bank is about.
    poles : sequence of complex, optional
        The same for every member.
    margin : float, optional

    Returns
    -------
    callable
        From a name and the plant, in which what is to be ignored are disturbances, to the residual generator.

    Raises
    ------
    DesignError
        If the kind is not known, or does not have the poles asked for.
    """
    asked(plant, poles, margin)  # once, not for every member
    if kind == "unknown-input":
        return lambda _, p: unknown_input_observer(p, poles=poles, margin=margin, scaling="even").residual_generator()
    if kind == "reduced-order":
        return lambda _, p: _with_some_held_out(p, poles, margin)
    if kind == "minimal":
        return decoupled_member(plant, poles=poles, margin=margin)
    if kind == "perfect":
        if poles is not None or margin is not None:
            raise DesignError("a perfect observer has no poles to place: leave out poles and margin")
        return lambda _, p: perfect_observer(p).residual_generator()
    raise DesignError(f"unknown kind of observer {kind!r}; known: {', '.join(KINDS)}")


def decoupled_member(
    plant: Plant,
    *,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
) -> MemberDesign:
    """Return the design function for members that are decoupled residuals, each with all faults of a plant."""
    known = len(plant.disturbances)
    return lambda _, part: decoupled_residual(
        plant, insensitive_to=part.disturbances[known:], poles=poles, margin=margin
    )


def advice_for(kind: str) -> str:
    """Return the advice for members of a kind that do not exist."""
    return "" if kind == "minimal" else "; observer='minimal' exists whenever any residual does: try it"


def _with_some_held_out(
    plant: Plant, poles: Sequence[complex] | ArrayLike | None, margin: float | None
) -> ResidualGenerator:
    """Return a reduced observer that leaves some measurements out of the estimate and is judged by those.

    As few as make it see every remaining fault, or else the set with which it sees most of them: with all
    measurements but one in use, what is left of the dynamics may not react to an actuator.
    """
    usable = [k for k in range(plant.n_outputs) if not plant.Dd[k].any()]  # others would say nothing when held out
    best: tuple[int, ResidualGenerator] | None = None
    reason = "every measurement carries a disturbance or an ignored fault"
    for count in range(1, len(usable)):
        failed = 0
        for start in range(len(usable)):
            held = {usable[(start + k) % len(usable)] for k in range(count)}
            used = [i for i in range(plant.n_outputs) if i not in held]
            try:
                observer = descriptor_observer(plant, poles=poles, margin=margin, outputs=used)
                generator = observer.residual_generator()
            except DesignError as error:
                reason, failed = str(error), failed + 1
                continue
            seen = int(generator.structure.any(axis=0).sum())
            if seen == len(plant.faults):
                return generator
            if best is None or seen > best[0]:
                best = (seen, generator)
        if failed == len(usable):
            break  # fewer measurements determine less
    if best is None:
        raise DesignError(reason)
    return best[1]
