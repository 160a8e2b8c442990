"""An evaluator of the part of Structured Text that exports are made of, written from IEC 61131-3."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

_TOKEN = re.compile(
    r"\(\*.*?\*\)|\d+\.\d+(?:E-?\d+)?|\d+|[A-Za-z_]\w*|:=|\.\.|<=|>=|<>|[-+*/()<>=;:,\[\]]|\s+", re.DOTALL
)
_KINDS = {"LREAL": float, "REAL": np.float32, "DINT": int, "BOOL": bool}
_SIGNS = {"=": "==", "<>": "!=", "AND": "&", "OR": "|", "NOT": "not_", "TRUE": "True", "FALSE": "False"}
_RESERVED = {"IF", "THEN", "ELSE", "END_IF", "FOR", "TO", "DO", "END_FOR", "ARRAY", "OF", "VAR", "END_VAR"}


def tokens(text: str) -> list[str]:
    """Return the words of a text without comments; anything else is an error."""
    out, at = [], 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        assert match, f"no token at {text[at : at + 40]!r}"
        at = match.end()
        if not match[0].isspace() and not match[0].startswith("(*"):
            out.append(match[0])
    return out


class FunctionBlock:
    """One instance of a function block: call :meth:`step` for each sample."""

    def __init__(self, text: str) -> None:
        self._words, self._at = tokens(text), 0
        self.kinds: dict[str, Any] = {}
        self.roles: dict[str, str] = {}
        self.values: dict[str, Any] = {}
        self._take("FUNCTION_BLOCK")
        self.name = self._next()
        while self._peek().startswith("VAR"):
            self._declarations()
        lines = list(self._statements("END_FUNCTION_BLOCK", 0))
        self.body = compile("\n".join(lines), self.name, "exec")
        names = [name.lower() for name in self.kinds]
        assert len(set(names)) == len(names), "names differ by case alone"
        assert not {name.upper() for name in names} & (_RESERVED | set(_KINDS)), "a reserved word"

    def step(self, u: np.ndarray, y: np.ndarray) -> dict[str, Any]:
        """Run the body on one sample, and return the outputs."""
        for name, values in (("u", u), ("y", y)):
            if name in self.kinds:
                self.values[name] = [self.kinds[name](value) for value in values]
        for name, role in self.roles.items():
            if role == "VAR_TEMP":  # not kept from one call to the next
                self.values[name] = _blank(self.values[name])
        functions = {"SQRT": np.sqrt, "ABS": abs, "not_": lambda flag: not flag}
        with np.errstate(all="ignore"):
            exec(self.body, functions, self.values)
        return {name: self.values[name] for name, role in self.roles.items() if role == "VAR_OUTPUT"}

    # ------------------------------------------------------------------------ reading

    def _peek(self) -> str:
        return self._words[self._at]

    def _next(self) -> str:
        self._at += 1
        return self._words[self._at - 1]

    def _take(self, *words: str) -> None:
        for word in words:
            assert self._next() == word, (word, self._words[self._at - 5 : self._at + 5])

    def _declarations(self) -> None:
        role = self._next()
        if self._peek() == "CONSTANT":
            role = f"{role} {self._next()}"
        while self._peek() != "END_VAR":
            name = self._next()
            self._take(":")
            count = None
            if self._peek() == "ARRAY":
                self._take("ARRAY", "[", "0", "..")
                count = int(self._next()) + 1
                self._take("]", "OF")
            kind = _KINDS[self._next()]
            values = [kind(0)] * (1 if count is None else count)
            if self._peek() == ":=":
                self._next()
                values = [kind(self._number()) for _ in range(1)] if count is None else self._array(kind)
            assert len(values) == (1 if count is None else count)
            self._take(";")
            self.kinds[name], self.roles[name] = kind, role
            self.values[name] = values[0] if count is None else values
        self._take("END_VAR")

    def _array(self, kind: Any) -> list[Any]:
        self._take("[")
        values = [kind(self._number())]
        while self._peek() == ",":
            self._next()
            values.append(kind(self._number()))
        self._take("]")
        return values

    def _number(self) -> float:
        sign = -1.0 if self._peek() == "-" else 1.0
        if sign < 0:
            self._next()
        return sign * float(self._next())

    def _statements(self, end: str, level: int) -> Iterator[str]:
        """Yield Python for statements up to a word."""
        pad = "    " * level
        while self._peek() not in (end, "ELSE"):
            word = self._next()
            if word == "IF":
                yield f"{pad}if {self._expression('THEN')}:"
                yield from self._statements("END_IF", level + 1)
                if self._peek() == "ELSE":
                    self._next()
                    yield f"{pad}else:"
                    yield from self._statements("END_IF", level + 1)
                self._take("END_IF", ";")
            elif word == "FOR":
                name = self._next()
                self._take(":=")
                first, last = self._expression("TO"), self._expression("DO")
                yield f"{pad}for {name} in range({first}, {last} + 1):"
                yield from self._statements("END_FOR", level + 1)
                self._take("END_FOR", ";")
            else:
                assert self.roles[word] not in ("VAR CONSTANT", "VAR_INPUT"), f"{word} is not to be changed"
                self._at -= 1
                target = self._expression(":=")
                kind = self.kinds[word]
                convert = {float: "", int: "", bool: "bool", np.float32: ""}[kind]
                yield f"{pad}{target} = {convert}({self._expression(';')})"

    def _expression(self, end: str) -> str:
        """Return Python for an expression up to a word; both sides of AND and OR are evaluated, as on a controller."""
        parts = []
        while (word := self._next()) != end:
            single = re.fullmatch(r"\d+\.\d+(E-?\d+)?", word) and np.float32 in self.kinds.values()
            parts.append(f"f32({word})" if single else _SIGNS.get(word, word))
        text = " ".join(parts)
        return re.sub(r"not_ (\((?:[^()]|\([^()]*\))*\)|\w+(?: \[[^\]]*\])?)", r"not_(\1)", text)


def _blank(values: Any) -> Any:
    return [type(one)(0) for one in values] if isinstance(values, list) else type(values)(0)
