"""Variables of a Functional Mock-up Unit: their names, descriptions and references."""

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
        Description.
    unit : str
        Empty where it is not known.
    start : float or None
        Start value, if it is not computed.
    original : str
        Name of a signal in the plant.
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
    own = [*_numbers(made), *_flags(made), *_counts(made)]
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


def _numbers(made: MonitorProgram) -> list[FMUVariable]:
    """Return the numeric variables."""

    def output(name: str, words: str) -> FMUVariable:
        return FMUVariable(name, "real", "output", _printable(words))

    groups = made.groups if "score" in made.program.names else ()
    size = made.program.names["residual"].size or 0
    residuals = [made.residuals[k] if k < len(made.residuals) else "" for k in range(size)]
    threshold = float(made.judging.test.threshold)
    return [
        output("statistic", "the value compared with the threshold; zero without a decision"),
        FMUVariable("threshold", "real", "local", "over which the statistic raises an alarm", start=threshold),
        *(output(f"residual_{k}", f"residual {one}; zero if unknown") for k, one in enumerate(residuals, 1)),
        *(output(f"score_{k}", f"how well {' or '.join(one)} fits") for k, one in enumerate(groups, 1)),
        *(output(f"part_statistic_{k}", f"statistic of {one}") for k, one in enumerate(made.parts, 1)),
    ]


def _flags(made: MonitorProgram) -> list[FMUVariable]:
    """Return the Boolean variables."""

    def output(name: str, words: str) -> FMUVariable:
        return FMUVariable(name, "flag", "output", _printable(words))

    hold = "take samples inside of a communication step with the inputs of its beginning, instead of refusing the step"
    names, parts = made.program.names, list(enumerate(made.parts, 1))
    return [
        output("known", "whether there is a residual: no value is missing"),
        output("decided", "false while the filter settles, or if the residual is unknown"),
        output("alarm", "whether an alarm stands"),
        FMUVariable("hold_inputs", "flag", "parameter", hold, start=0.0),
        *(output(f"fired_{k}", f"whether {one} is in alarm") for k, one in parts),
        *(output(f"code_{k}", f"whether {one} counts as fired") for k, one in parts if "code" in names),
        *([output("scored", "whether the scores are meaningful: only in an alarm")] if "score" in names else []),
    ]


def _counts(made: MonitorProgram) -> list[FMUVariable]:
    """Return the integer variables."""
    best = FMUVariable("best", "count", "output", "the score of the fault that is named, from 1 on; 0 for none")
    answer = FMUVariable(
        "answer", "count", "output",
        "the reading of the code: 0 none, 1 exact, 2 several, 3 degraded, 4 nearest, 5 unknown",
    )  # fmt: skip
    names = made.program.names
    return [*([best] if "score" in names else []), *([answer] if "answer" in names else [])]


def names_in_unit(names: Iterable[str], taken: set[str]) -> list[str]:
    """Return distinct names that are valid in a unit: without control characters, not empty, none that is taken."""
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
    """Return a name with underscores in place of characters that XML or a table of names cannot hold."""
    return "".join(one if one.isprintable() else "_" for one in name)


__all__ = ["FMUVariable", "fmu_variables", "names_in_unit"]
