"""A monitor in C99: a header, its code, and a program that compares it with the answers of the monitor itself."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from textwrap import wrap

import numpy as np

from residua.export.identifiers import comment_text
from residua.export.monitor_program import MonitorProgram
from residua.export.program import Variable
from residua.export.writer import Writer, indented

_TYPES = {"count": "int32_t", "flag": "bool"}
#: Numbers to a line of an array.
_WIDTH = 100


class CWriter(Writer):
    """Statements in C.

    Parameters
    ----------
    made : MonitorProgram
    """

    SIGNS = {
        ast.Constant: "false true", ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.USub: "-",
        ast.Not: "!", ast.And: "&&", ast.Or: "||", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
        ast.Eq: "==", ast.NotEq: "!=",
    }  # fmt: skip

    def __init__(self, made: MonitorProgram) -> None:
        super().__init__(made.program)
        self._single = made.precision.name == "float"
        self.real = made.precision.name

    def number(self, value: float, kind: str) -> str:
        """Return a number, exactly."""
        if kind != "real":
            return str(int(value))
        if not self._single:
            return repr(float(value))
        return f"{np.format_float_scientific(np.float32(value), unique=True)}f"

    def place(self, variable: Variable | None, name: str, index: str | None) -> str:
        """Return a variable: of the state, of the decision, or by its name."""
        at = "" if index is None else f"[{index}]"
        owner = {"state": "state->", "output": "decision->"}.get(variable.role if variable else "", "")
        return f"{owner}{name}{at}"

    def assignment(self, target: str, value: str) -> str:
        """Return an assignment."""
        return f"{target} = {value};"

    def condition(self, test: str, body: list[str], other: list[str]) -> list[str]:
        """Return a condition."""
        end = ["}"] if not other else ["} else {", *indented(other), "}"]
        return [f"if ({test}) {{", *indented(body), *end]

    def loop(self, name: str, count: int, body: list[str]) -> list[str]:
        """Return a loop."""
        return [f"for ({name} = 0; {name} < {count}; {name}++) {{", *indented(body), "}"]

    def call(self, name: str, argument: str) -> str:
        """Return a function of the mathematical library."""
        return f"{ {'sqrt': 'sqrt', 'abs': 'fabs'}[name] }{'f' if self._single else ''}({argument})"

    def declared(self, one: Variable) -> str:
        """Return the declaration of a variable."""
        kind = _TYPES.get(one.kind, self.real)
        return f"{kind} {one.name}{'' if one.size is None else f'[{one.size}]'};"

    def constant(self, one: Variable) -> list[str]:
        """Return the definition of a constant."""
        kind = _TYPES.get(one.kind, self.real)
        values = [self.number(value, one.kind) for value in one.values]
        if one.size is None:
            return [f"static const {kind} {one.name} = {values[0]};"]
        lines = indented(wrap(", ".join(values), _WIDTH))
        return [f"static const {kind} {one.name}[{one.size}] = {{", *lines, "};"]


def header(made: MonitorProgram, prefix: str) -> str:
    """Return the header."""
    c = CWriter(made)
    upper = prefix.upper()
    lines = [
        *_about(made),
        f"#ifndef {upper}_H",
        f"#define {upper}_H",
        "",
        "#include <stdbool.h>",
        "#include <stdint.h>",
        "",
        f"#define {upper}_INPUTS {len(made.inputs)}",
        f"#define {upper}_OUTPUTS {len(made.outputs)}",
        f"#define {upper}_GROUPS {len(made.groups)}",
        "",
        "/* The state of one plant. */",
        "typedef struct {",
        *indented(_members(c, made.program.of_role("state"))),
        f"}} {prefix}_state;",
        "",
        "/* The decision on one sample. */",
        "typedef struct {",
        *indented(_members(c, made.program.of_role("output"))),
        f"}} {prefix}_decision;",
        "",
        "/* Before the first sample. */",
        f"void {prefix}_init({prefix}_state *state);",
        "",
        *_signals(made),
        f"void {prefix}_step({prefix}_state *state, const {c.real} u[], const {c.real} y[], "
        f"{prefix}_decision *decision);",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _about(made: MonitorProgram) -> list[str]:
    """Describe the files, as a comment."""
    lines = [
        f"A monitor of {comment_text(made.name) or 'a plant'}, exported by residua: {comment_text(made.test)}.",
        f"One call for each sample, {made.dt:g} s apart. No library but sqrt and fabs, no memory of its own, no "
        "recursion, bounded loops.",
        "In double precision, without contraction of products and sums (-std=c99, or -ffp-contract=off), it gives the "
        "bits of the monitor that it was made from.",
        *map(comment_text, made.notes),
    ]
    return ["/*", *(f" * {part}" for line in lines for part in wrap(line, 110)), " */"]


def _members(c: CWriter, variables: Sequence[Variable]) -> list[str]:
    return [f"{c.declared(one)}{f' /* {one.words} */' if one.words else ''}" for one in variables]


def _signals(made: MonitorProgram) -> list[str]:
    """Describe the channels and groups, as a comment."""
    named = (*made.inputs, *made.outputs)
    units = [f" [{comment_text(unit)}]" if unit else "" for unit in made.units]
    rows = [comment_text(name) + unit for name, unit in zip(named, units, strict=True)]
    cut = len(made.inputs)
    lines = [
        "One sample. A value that is missing is NaN, or outside of its plausible range.",
        *(f"u[{k}]  {row}" for k, row in enumerate(rows[:cut])),
        *(f"y[{k}]  {row}" for k, row in enumerate(rows[cut:])),
        *(f"score[{g}]  {comment_text(' or '.join(group))}" for g, group in enumerate(made.groups)),
        *(f"fired[{m}]  {comment_text(name)}" for m, name in enumerate(made.parts)),
    ]
    return ["/*", *(f" * {line}" for line in lines), " */"]


def code(made: MonitorProgram, prefix: str) -> str:
    """Return the code."""
    c = CWriter(made)
    counters = [f"int32_t {name};" for name in made.program.counters]
    lines = [
        *_about(made),
        f'#include "{prefix}.h"',
        "#include <math.h>",
        "",
        *(line for one in made.program.of_role("constant") for line in c.constant(one)),
        "",
        f"void {prefix}_init({prefix}_state *state)",
        "{",
        f"    static const {prefix}_state rest = {{0}};",
        "    *state = rest;",
        "}",
        "",
        f"void {prefix}_step({prefix}_state *state, const {c.real} u[], const {c.real} y[], "
        f"{prefix}_decision *decision)",
        "{",
        *indented([*counters, *(c.declared(one) for one in made.program.of_role("local"))]),
        *([] if made.inputs else ["    (void)u;"]),
        *([] if made.outputs else ["    (void)y;"]),
    ]
    for part in made.program.sections:
        lines += ["", f"    /* {part.title} */", *indented(c.block(part.loops))]
    return "\n".join([*lines, "}"]) + "\n"


__all__ = ["CWriter", "code", "header"]
