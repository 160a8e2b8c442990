"""The function block has the bits of the monitor, by an evaluator of the standard's text."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from effort import cases
from export_banks import bank_monitor
from export_examples import expected, exported
from fused_examples import ISOLATIONS, MARKS, ORDERS, TESTS, recording, specification
from residua.export.monitor_program import FLOAT, monitor_program
from residua.export.structured_text import function_block
from residua.monitor.running import initial_state, run_reference
from structured_text import FunctionBlock


@pytest.mark.parametrize("test", list(TESTS))
def test_it_has_the_bits_of_the_monitor(test: str) -> None:
    number = list(TESTS).index(test)
    isolation = list(ISOLATIONS)[number % len(ISOLATIONS)]
    spec = replace(specification(test, isolation, 3, 2, ("kalman", "observer")[number % 2]), partial=None)
    data = recording(spec, np.random.default_rng(number), 250, [np.nan, 1e300, np.inf])
    _, decisions = run_reference(spec, initial_state(spec, 1), data[2:3])
    made = exported(spec, 2)
    block = FunctionBlock(function_block(made, "watch"))
    rows = []
    for sample in data[2]:
        out = block.step(sample[:2], sample[2:])
        named = [out["best"], *out["score"]] if "score" in out else []
        rows.append([*out["residual"], out["statistic"], out["known"], out["decided"], out["alarm"], *named])
    assert np.array_equal(np.array(rows, dtype=float), expected(spec, decisions))


@pytest.mark.parametrize("seed", cases(range(200), 1))
def test_generated_monitors(seed: int) -> None:
    """Of every kind and of orders up to 40."""
    rng = np.random.default_rng(seed)
    order = int(rng.choice([*ORDERS, 40]))
    test = list(TESTS)[seed % len(TESTS) if order or seed % len(TESTS) != len(TESTS) - 1 else 0]
    isolation, method = str(rng.choice(list(ISOLATIONS))), ("kalman", "observer")[seed // len(TESTS) % 2]
    spec = replace(specification(test, isolation, order, int(rng.choice([1, 2, 3, 5])), method), partial=None)
    data, inputs = recording(spec, rng, 150, [*MARKS])[1], spec.B.shape[1] // 2
    _, decisions = run_reference(spec, initial_state(spec, 1), data[None])
    block = FunctionBlock(function_block(exported(spec, inputs), "watch"))
    for sample, right in zip(data, expected(spec, decisions), strict=True):
        out = block.step(sample[:inputs], sample[inputs:])
        named = [out["best"], *out["score"]] if "score" in out else []
        row = [*out["residual"], out["statistic"], out["known"], out["decided"], out["alarm"], *named]
        assert np.array_equal(np.array(row, dtype=float), right)


def parsed(text: str) -> str:
    """Return what a parser of the standard's third edition says against a text; nothing if it parses."""
    blark = pytest.importorskip("blark.parse", reason="there is no blark")
    result = blark.parse_source_code(text)
    if result.exception is None:
        result.transform()
    return "" if result.exception is None else str(result.exception)


@pytest.mark.parametrize(
    "kind", cases(["small", *TESTS, *(f"bank: {kind}" for kind in ("bank", "dedicated", "groups, by direction"))], 1)
)
def test_another_parser_takes_it(kind: str) -> None:
    if kind == "small":
        made = exported(specification("norm", "none", 0, 1, "kalman"), 0)
    elif kind.startswith("bank"):
        made = monitor_program(bank_monitor(kind.removeprefix("bank: "), 3, 5, 1), missing="hold")
    else:
        made = exported(replace(specification(kind, "short", 2, 2, "kalman"), partial=None), 2, FLOAT)
    assert parsed(function_block(made, "watch")) == ""


def test_the_other_parser_notices_what_is_wrong() -> None:
    text = "FUNCTION_BLOCK x\nVAR\n    a : LREAL;\nEND_VAR\na := := 3;\nEND_FUNCTION_BLOCK\n"
    assert parsed(text.replace(":= :=", ":=")) == ""
    assert "No terminal matches" in parsed(text)
