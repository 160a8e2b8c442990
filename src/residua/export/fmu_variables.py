"""The variables of a Functional Mock-up Unit: what they are called, what they are, and how they are referred to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from residua.export.monitor_program import MonitorProgram

Kind = Literal["real", "flag", "count"]
Role = Literal["independent", "input", "output", "parameter", "local"]


@dataclass(frozen=True)
class FMUVariable:
    """A variable of a unit.

    Attributes
    ----------
    name : str
        In the unit.
    kind : {"real", "flag", "count"}
    role : {"independent", "input", "output", "parameter", "local"}
        ``local`` is a constant.
    words : str
        What it is.
    unit : str
        Empty where it is not known.
    start : float or None
        What it is before anything is computed, where it is not computed itself.
    original : str
        What a signal is called in the plant.
    """

    name: str
    kind: Kind
    role: Role
    words: str
    unit: str = ""
    start: float | None = None
    original: str = ""


def fmu_variables(made: MonitorProgram) -> list[FMUVariable]:
    """Return the variables, in the order of their references.

    Signals keep the names of the plant. A name that a unit cannot have is changed: one of the unit's own variables, one
    with control characters, an empty one.
    """
    named, cut = (*made.inputs, *made.outputs), len(made.inputs)
    size = made.program.names["residual"].size or 0
    groups = made.groups if "score" in made.program.names else ()
    flags = _flags(bool(groups))
    own = [
        FMUVariable(
            "statistic", "real", "output", "what is compared with the threshold; zero where nothing is decided"
        ),
        FMUVariable("threshold", "real", "local", "over which the statistic raises an alarm", start=_threshold(made)),
        *(_residual(k, made.residuals) for k in range(size)),
        *(
            FMUVariable(f"score_{g + 1}", "real", "output", f"how well {' or '.join(group)} explains the residual")
            for g, group in enumerate(groups)
        ),
        *flags,
    ]
    if groups:
        words = "the score that explains the residual best, from 1 on; 0 for none"
        own.append(FMUVariable("best", "count", "output", words))
    names = names_in_unit(named, {"time", *(one.name for one in own)})
    signals = [
        FMUVariable(
            names[k], "real", "input",
            f"{'input' if k < cut else 'output'} of the plant{'' if names[k] == name else f', there {name!r}'}",
            _printable(made.units[k]), float(made.specification.offset[k]), name,
        )
        for k, name in enumerate(named)
    ]  # fmt: skip
    return [FMUVariable("time", "real", "independent", "simulation time", "s"), *signals, *own]


def _flags(named: bool) -> list[FMUVariable]:
    hold = "take samples inside of a communication step with the inputs of its beginning, instead of refusing the step"
    made = [
        FMUVariable("known", "flag", "output", "whether there is a residual: no value is missing"),
        FMUVariable("decided", "flag", "output", "not while the filter settles, and where the residual is not known"),
        FMUVariable("alarm", "flag", "output", "whether an alarm stands"),
        FMUVariable("hold_inputs", "flag", "parameter", hold, start=0.0),
    ]
    if named:
        made.append(FMUVariable("scored", "flag", "output", "whether the scores say something: only in an alarm"))
    return made


def _residual(k: int, names: tuple[str, ...]) -> FMUVariable:
    words = f"residual {names[k]}" if k < len(names) else "residual"
    return FMUVariable(f"residual_{k + 1}", "real", "output", f"{words}; zero where it is not known")


def _threshold(made: MonitorProgram) -> float:
    test = made.specification.test.compiled
    assert test is not None  # what has no such form is no program
    return float(test.threshold)


def names_in_unit(names: Iterable[str], taken: set[str]) -> list[str]:
    """Return names that a unit can have, each once: without control characters, not empty, none that is taken."""
    made: list[str] = []
    for name in names:
        plain = _printable(name).strip() or "signal"
        one, count = plain, 0
        while one in taken:
            count += 1
            one = f"{plain}_{count}"
        taken = taken | {one}
        made.append(one)
    return made


def _printable(name: str) -> str:
    """Return a name with what XML or a table of names cannot hold as underscores."""
    return "".join(one if one.isprintable() else "_" for one in name)


__all__ = ["FMUVariable", "fmu_variables", "names_in_unit"]
