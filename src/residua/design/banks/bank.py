"""Banks: residual generators with a structure, running as one stacked filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.analysis.codes import code_table, equal_codes, strongly_isolating
from residua.analysis.coding_sets import Structure, structure_rows
from residua.design.core.decoupling import IGNORED, Approximate
from residua.design.core.evidence import Evidence
from residua.design.core.generator import Member, ResidualGenerator, make_generator
from residua.design.observers.observer import Observer
from residua.errors import AccuracyError, DesignError
from residua.linear.systems.state_space import stack_systems
from residua.plant import Plant
from residua.shown import Shown
from residua.words import counted

#: Designs one member: takes its name, and the plant in which what the member ignores are disturbances; returns it for
#: that plant, or for the whole one.
MemberDesign = Callable[[str, Plant], ResidualGenerator]
#: States of all members together beyond which a design takes minutes, and the stacked filter runs slowly.
MOST_STATES = 4000


@dataclass(frozen=True, eq=False, repr=False)
class Bank(Shown):
    """Residual generators that each ignore some faults: the pattern of those that fire names the fault.

    Attributes
    ----------
    generator : ResidualGenerator
        All members, stacked: runs as one filter, and goes into a :class:`residua.Monitor`.
    structure : ndarray of bool, shape (members, faults)
        Which members answer to which fault: the columns are the codes of the faults.
    observers : mapping of str to Observer
        By member, if it is made of one: each estimates the state without what it ignores.
    failures : mapping of str to str
        Members that could not be designed, and why.

    References
    ----------
    Chen and Patton (1999), chapter 3; Gertler (1991), section 4.
    """

    generator: ResidualGenerator
    structure: NDArray[np.bool_]
    observers: Mapping[str, Observer] = field(repr=False)
    failures: Mapping[str, str]

    @property
    def plant(self) -> Plant:
        """The plant that the bank watches."""
        return self.generator.plant

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the plant's faults: the columns of the structure."""
        return self.generator.faults

    @property
    def members(self) -> tuple[str, ...]:
        """Names of the members: the rows of the structure."""
        return tuple(member.name for member in self.generator.members)

    @property
    def evidence(self) -> Evidence:
        """The checks that all members have passed."""
        return self.generator.evidence

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The faults with the same code, which this bank cannot tell apart; faults that no member sees are left out."""
        return tuple(tuple(self.faults[j] for j in group) for group in equal_codes(self.structure))

    @property
    def strongly_isolating(self) -> bool:
        """True if no code becomes another when some of its members stay silent: columns form an antichain."""
        return strongly_isolating(self.structure)

    def residual_generator(self) -> ResidualGenerator:
        """Return the stacked generator."""
        return self.generator

    def __repr__(self) -> str:
        members, faults = counted(len(self.members), "member"), counted(len(self.faults), "fault")
        return f"Bank({self.generator.method}: {members}, {faults})"

    def __str__(self) -> str:
        lines = [f"{self.generator.method}, {counted(len(self.members), 'member')}"]
        lines += code_table(self.members, self.structure, self.faults)
        lines += [f"no member '{name}': {reason}" for name, reason in self.failures.items()]
        lines += [f"same code: {', '.join(group)}" for group in self.groups if len(group) > 1]
        unseen = [name for name, code in zip(self.faults, self.structure.T, strict=True) if not code.any()]
        lines += [f"seen by no member: {', '.join(unseen)}"] if unseen else []
        return "\n".join(lines)


@dataclass(frozen=True)
class Wanted:
    """Specification of one member: the faults to ignore and those to answer to."""

    name: str
    ignored: tuple[str, ...]
    seen: tuple[str, ...]


def wanted_by_scheme(scheme: str, components: Mapping[str, str], without: str) -> list[Wanted]:
    """Return the members of a scheme over some faults, named after the component that each fault is in.

    Parameters
    ----------
    scheme : {"generalized", "dedicated"}
        Each member ignores one fault and sees all others, or sees one and ignores all others.
    components : mapping of str to str
        The component of each fault.
    without : str
        What the name of a member that ignores a component begins with.
    """
    if scheme not in ("generalized", "dedicated"):
        raise DesignError(f"scheme must be 'generalized' or 'dedicated', got {scheme!r}")
    wanted = []
    for fault, component in components.items():
        others = tuple(other for other in components if other != fault)
        if scheme == "generalized":
            wanted.append(Wanted(f"{without} {component}", (fault,), others))
        else:
            wanted.append(Wanted(f"only {component}", others, (fault,)))
    return wanted


def wanted_rows(structure: Structure, faults: tuple[str, ...]) -> list[Wanted]:
    """Return the members of a structure, one per row."""
    return [
        Wanted(
            name,
            tuple(fault for fault, one in zip(faults, row, strict=True) if not one),
            tuple(fault for fault, one in zip(faults, row, strict=True) if one),
        )
        for name, row in structure_rows(structure, faults).items()
    ]


def build_bank(
    plant: Plant,
    wanted: list[Wanted],
    design: MemberDesign,
    method: str,
    *,
    allow_missing: bool,
    reference: str,
    advice: str = "",
) -> Bank:
    """Design all members, stack them, and check that the structure is the one that was promised."""
    if len(wanted) * plant.n_states > MOST_STATES:
        raise DesignError(
            f"{len(wanted)} members for {plant.n_states} states are too much for one bank: up to "
            f"{len(wanted) * plant.n_states} states together, the most is {MOST_STATES}; reduce the order of the "
            "model, watch fewer faults at a time, or design the members one by one with unknown_input_observer"
        )
    parts: dict[str, ResidualGenerator] = {}
    observers: dict[str, Observer] = {}
    failures: dict[str, str] = {}
    kinds: set[type[DesignError] | type[AccuracyError]] = set()
    for one in wanted:
        try:
            part = design(one.name, plant.faults_as_disturbances(one.ignored))
            check_promise(part, one)
        except (DesignError, AccuracyError) as error:
            failures[one.name] = str(error)
            kinds.add(type(error))
            continue
        parts[one.name] = part
        if part.observer is not None:
            observers[one.name] = part.observer
    if failures and (not allow_missing or not parts):
        reasons = "; ".join(f"'{name}': {reason}" for name, reason in list(failures.items())[:3])
        reasons += f"; and {len(failures) - 3} more" if len(failures) > 3 else ""
        hint = "" if not parts else "; allow_missing=True builds the bank without them"
        missing = "do not exist" if DesignError in kinds else "missed their tolerance"
        kind = DesignError if DesignError in kinds else AccuracyError
        raise kind(f"{len(failures)} of {len(wanted)} members of the bank {missing}: {reasons}{hint}{advice}")
    generator = stacked_members(parts, plant, method, reference)
    assert generator.codes is not None  # stacked_members gives them
    return Bank(generator, generator.codes, observers, failures)


def check_promise(generator: ResidualGenerator, one: Wanted) -> None:
    """Raise for a member that answers to a fault to ignore, or is blind to one that it should see."""
    seen = _seen(generator)
    leaking = [name for name in one.ignored if name in seen]
    if leaking:
        raise AccuracyError(
            f"the residual answers to {', '.join(leaking)}, which it should ignore: the plant is too badly "
            "conditioned; ask for another margin, or for fewer faults to be ignored"
        )
    blind = [name for name in one.seen if name not in seen]
    if blind:
        raise DesignError(
            f"a residual that ignores {', '.join(one.ignored) or 'the disturbances'} cannot see {', '.join(blind)}"
        )


def stacked_members(
    parts: Mapping[str, ResidualGenerator], plant: Plant, method: str, reference: str
) -> ResidualGenerator:
    """Return the members as one generator of a plant with all its faults, which are disturbances of theirs or not."""
    generators = list(parts.values())
    if plant.E is not None and generators[0].plant.E is None:
        plant = plant.explicit()
    system = stack_systems([g.system for g in generators])
    # outputs are named after residual and member, or the member that has but one
    names = [name if g.n_residuals == 1 else f"{r}, {name}" for name, g in parts.items() for r in g.residuals]
    system = system.replaced(outputs=names)
    members, start = [], 0
    for name, g in parts.items():
        seen = _seen(g)
        rows = tuple(range(start, start + g.n_residuals))
        members.append(Member(name, rows, tuple(fault for fault in plant.faults if fault in seen)))
        start += g.n_residuals
    conditions: dict[str, float] = {}
    for g in generators:
        conditions |= {name: max(x, conditions.get(name, 0.0)) for name, x in g.evidence.conditions.items()}
    leaks = largest_leaks(generators, plant)
    evidence = Evidence(
        method=method,
        poles=system.poles(),
        requested_poles=np.concatenate([g.evidence.requested_poles for g in generators]),
        fixed_poles=np.concatenate([g.evidence.fixed_poles for g in generators]),
        decoupling=leaks,
        conditions=conditions,
        notes=tuple(f"{name}: {note}" for name, g in parts.items() for note in g.evidence.notes),
        references=(reference,),
    )
    relations = [g.relations for g in generators if g.relations is not None]
    return make_generator(
        system,
        plant,
        method,
        evidence,
        decouples=Approximate(next(iter(leaks), "")),
        **maps_of(generators, names),
        members=tuple(members),
        codes=np.array([[fault in member.faults for fault in plant.faults] for member in members], dtype=bool),
        relations=relations[0].stacked_with(relations[1:], tuple(parts)) if len(relations) == len(parts) else None,
    )


def maps_of(parts: Sequence[ResidualGenerator], names: Sequence[str]) -> dict[str, Any]:
    """Return the maps of filters side by side, or their internal form where one was sampled."""
    maps = [part.state_map for part in parts if part.state_map is not None]
    if len(maps) < len(parts):
        return {"known_form": stack_systems([part.internal_form() for part in parts]).replaced(outputs=names)}
    statics = [part.static_map for part in parts]
    if all(static is None for static in statics):
        return {"state_map": np.vstack(maps)}
    none = [np.zeros((part.n_residuals, part.plant.n_states)) for part in parts]
    static = [zero if known is None else known for zero, known in zip(none, statics, strict=True)]
    return {"state_map": np.vstack(maps), "static_map": np.vstack(static)}


def largest_leaks(members: Sequence[ResidualGenerator], plant: Plant) -> dict[str, float]:
    """Return the largest leaks of filters that have passed, into all of them side by side."""
    gains: dict[str, float] = {}
    for member in members:
        for name, gain in member.evidence.decoupling.items():
            name = "disturbance" if name == IGNORED else name
            if name == "control" or (name == "disturbance" and plant.disturbances):
                gains[name] = max(gains.get(name, 0.0), gain)
    return gains


def _seen(generator: ResidualGenerator) -> set[str]:
    """Return the faults that any of the residuals answers to."""
    return {name for name, column in zip(generator.faults, generator.structure.T, strict=True) if column.any()}
