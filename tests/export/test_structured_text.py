"""The function block has the bits of the monitor, by an evaluator of the standard's text."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from export_examples import expected, exported
from fused_examples import ISOLATIONS, TESTS, recording, specification
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
