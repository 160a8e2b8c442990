"""Exported C has the bits of the monitor: every test and isolation, with missing values, starts and overflows."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from compiled_exports import CompiledExport
from effort import cases
from export_examples import expected, exported
from fused_examples import ISOLATIONS, MARKS, ORDERS, TESTS, recording, specification
from residua.monitor.fused import run_block
from residua.monitor.running import initial_state, run_reference

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")


@needs_compiler
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    test=st.sampled_from(list(TESTS)),
    isolation=st.sampled_from(list(ISOLATIONS)),
    order=st.sampled_from(ORDERS),
    outputs=st.sampled_from((1, 2, 3, 5)),
    method=st.sampled_from(("kalman", "observer")),
    marks=st.lists(st.sampled_from(MARKS), max_size=8),
    overflow=st.booleans(),
    fast=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_it_has_the_bits_of_the_monitor(
    test: str, isolation: str, order: int, outputs: int, method: str, marks: list[float], overflow: bool, fast: bool,
    seed: int, tmp_path_factory: pytest.TempPathFactory,
) -> None:  # fmt: skip
    assume(order > 0 or test != "glr along faults")
    spec = replace(specification(test, isolation, order, outputs, method), partial=None)
    rng = np.random.default_rng(seed)
    if overflow:
        spec = replace(spec, plausible=np.tile([-1e308, 1e308], (spec.B.shape[1], 1)), max_hold=int(rng.integers(12)))
    inputs = int(rng.integers(0, spec.B.shape[1] + 1))
    data = recording(spec, rng, 700, marks)
    folder: Path = tmp_path_factory.mktemp("c")
    code = CompiledExport(exported(spec, inputs), folder, "-O3" if fast else "-O0")
    for one in data:
        with np.errstate(all="ignore"):
            _, decisions = run_reference(spec, initial_state(spec, 1), one[None])
        assert np.array_equal(code.run(one[:, :inputs], one[:, inputs:]), expected(spec, decisions))


@needs_compiler
@pytest.mark.parametrize("seed", cases(range(200), 4))
def test_long_recordings(seed: int, tmp_path: Path) -> None:
    """Of 10,000 samples, without optimisation and with all of it."""
    rng = np.random.default_rng(seed)
    order = int(rng.choice([*ORDERS, 40]))
    test = list(TESTS)[seed % len(TESTS) if order or seed % len(TESTS) != len(TESTS) - 1 else 0]
    isolation, method = str(rng.choice(list(ISOLATIONS))), ("kalman", "observer")[seed // len(TESTS) % 2]
    spec = replace(specification(test, isolation, order, int(rng.choice([1, 2, 3, 5])), method), partial=None)
    data = recording(spec, rng, 10_000, [*MARKS])[1]
    _, decisions = run_block(spec, initial_state(spec, 1), data[None])
    inputs = spec.B.shape[1] // 2
    for flag in ("-O0", "-O3"):
        (folder := tmp_path / flag).mkdir()
        code = CompiledExport(exported(spec, inputs), folder, flag)
        assert np.array_equal(code.run(data[:, :inputs], data[:, inputs:]), expected(spec, decisions))
