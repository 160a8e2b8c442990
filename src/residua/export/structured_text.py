"""A monitor as a function block in Structured Text (IEC 61131-3)."""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from textwrap import wrap

import numpy as np

from residua.export.identifiers import comment_text
from residua.export.monitor_program import MonitorProgram
from residua.export.program import Variable
from residua.export.writer import Writer, indented

_WIDTH = 100


class STWriter(Writer):
    """Statements in Structured Text: declarations, assignments, IF, FOR, ABS and SQRT alone.

    Parameters
    ----------
    made : MonitorProgram
    """

    SIGNS = {
        ast.Constant: "FALSE TRUE", ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.USub: "-",
        ast.Not: "NOT ", ast.And: "AND", ast.Or: "OR", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
        ast.Eq: "=", ast.NotEq: "<>",
    }  # fmt: skip

    def __init__(self, made: MonitorProgram) -> None:
        super().__init__(made.program)
        self._single = made.precision.name == "float"
        self._types = {"real": "REAL" if self._single else "LREAL", "count": "DINT", "flag": "BOOL"}

    def number(self, value: float, kind: str) -> str:
        """Return a number, exactly; a literal of the standard has digits on both sides of its point."""
        if kind != "real":
            return str(int(value))
        text = str(np.float32(value)) if self._single else repr(float(value))
        mantissa, _, power = text.lower().partition("e")
        mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
        return f"{mantissa}E{int(power)}" if power else mantissa

    def place(self, variable: Variable | None, name: str, index: str | None) -> str:
        """Return a variable by its name."""
        return name if index is None else f"{name}[{index}]"

    def assignment(self, target: str, value: str) -> str:
        """Return an assignment."""
        return f"{target} := {value};"

    def condition(self, test: str, body: list[str], other: list[str]) -> list[str]:
        """Return a condition."""
        return [f"IF {test} THEN", *indented(body), *(["ELSE", *indented(other)] if other else []), "END_IF;"]

    def loop(self, name: str, count: int, body: list[str]) -> list[str]:
        """Return a loop."""
        return [f"FOR {name} := 0 TO {count - 1} DO", *indented(body), "END_FOR;"]

    def call(self, name: str, argument: str) -> str:
        """Return a standard function."""
        return f"{name.upper()}({argument})"

    def declared(self, one: Variable) -> list[str]:
        """Return the declaration of a variable, with its description."""
        kind = self._types[one.kind]
        if one.size == 0:
            return []
        kind = kind if one.size is None else f"ARRAY[0..{one.size - 1}] OF {kind}"
        words = f" (* {comment_text(one.words)} *)" if one.words else ""
        if one.role != "constant":
            return [f"{one.name} : {kind};{words}"]
        values = [self.number(value, one.kind) for value in one.values]
        if one.size is None:
            return [f"{one.name} : {kind} := {values[0]};"]
        return [f"{one.name} : {kind} := [", *indented(wrap(", ".join(values), _WIDTH)), "];"]

    def section(self, title: str, variables: Sequence[Variable], more: Sequence[str] = ()) -> list[str]:
        """Return a section of declarations."""
        lines = [line for one in variables for line in self.declared(one)]
        return [title, *indented([*lines, *more]), "END_VAR"] if lines or more else []


def function_block(made: MonitorProgram, name: str) -> str:
    """Return a monitor as a function block."""
    st, program = STWriter(made), made.program
    lines = [
        *_about(made),
        f"FUNCTION_BLOCK {name}",
        *st.section("VAR_INPUT", program.of_role("input")),
        *st.section("VAR_OUTPUT", program.of_role("output")),
        *st.section("VAR", program.of_role("state")),
        *st.section("VAR CONSTANT", program.of_role("constant")),
        *st.section("VAR_TEMP", program.of_role("local"), [f"{name} : DINT;" for name in program.counters]),
    ]
    for part in program.sections:
        lines += ["", f"(* {part.title} *)", *st.block(part.loops)]
    return "\n".join([*lines, "END_FUNCTION_BLOCK"]) + "\n"


def _about(made: MonitorProgram) -> list[str]:
    """Describe the block, as a comment."""
    named = [re.sub(r"\s+", " ", comment_text(name)) for name in (*made.inputs, *made.outputs)]
    units = [f" [{comment_text(unit)}]" if unit else "" for unit in made.units]
    cut = len(made.inputs)
    lines = [
        f"A monitor of {comment_text(made.name) or 'a plant'}, exported by residua: {comment_text(made.test)}.",
        f"Call it once for each sample, every {made.dt:g} s. A value that is missing is to be set outside of its "
        "plausible range (lowest, highest, as deviations from offset), or is NaN where the controller compares it as "
        "IEEE 754 says.",
        *map(comment_text, made.notes),
        *(f"u[{k}]  {name}{unit}" for k, (name, unit) in enumerate(zip(named[:cut], units[:cut], strict=True))),
        *(f"y[{k}]  {name}{unit}" for k, (name, unit) in enumerate(zip(named[cut:], units[cut:], strict=True))),
        *(f"score[{g}]  {comment_text(' or '.join(group))}" for g, group in enumerate(made.groups)),
        *(f"fired[{m}]  {comment_text(name)}" for m, name in enumerate(made.parts)),
    ]
    return ["(*", *(f"   {part}" for line in lines for part in wrap(line, 110)), "*)"]


__all__ = ["STWriter", "function_block"]
