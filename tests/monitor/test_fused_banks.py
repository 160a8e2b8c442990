"""Banks, groups and codes in the fused loop have the bits of NumPy, whatever the data, and however they are cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fused_examples import MARKS, Bank, bank_specification, recording, same, same_in_pieces, same_of_few_outputs
from residua.decide.directional import DirectionTest
from residua.decide.structured import CodeState, CodeTest, alarms_since
from residua.decide.whitened_norm import NormTest
from residua.decide.window import empty_window
from residua.errors import FileFormatError
from residua.monitor import fused
from residua.monitor.fused import FusedRun, LastSample, plan_of, run_block
from residua.monitor.plant_records import copied, rows_of, written_rows
from residua.monitor.running import initial_state, joined_decisions, run_reference

needs_kernel = pytest.mark.skipif(fused._kernel is None, reason="there is no compiled kernel")

banks = st.builds(
    Bank,
    kind=st.sampled_from(("norm", "norm", "peak", "groups", "directed", "alone")),
    members=st.lists(st.tuples(st.integers(0, 6), st.integers(1, 4)), min_size=1, max_size=40).map(tuple),
    channels=st.integers(1, 5),
    window=st.sampled_from((1, 1, 5)),
    persistence=st.integers(1, 3),
    release=st.integers(1, 4),
    code_window=st.sampled_from((1, 4, 30)),
    dedicated=st.booleans(),
    starts=st.booleans(),
)
seeds, marked = st.integers(0, 2**32 - 1), st.lists(st.sampled_from((*MARKS, 1e149)), max_size=6)
TOLD = ("missing", "usable", "statistic", "alarm", "residuals", "up", "member_statistics", "fired", "code", "scores")


def compare_blocks(bank: Bank, marks: list[float], overflow: bool, path: int, seed: int) -> int:
    """Assert that blocks have the bits of NumPy, in any cut; return how many samples were in alarm."""
    spec, rng = bank_specification(bank, seed), np.random.default_rng(seed + 1)
    if overflow:
        spec = replace(spec, plausible=np.tile([-1e308, 1e308], (spec.B.shape[1], 1)))
    plan = plan_of(spec)
    assert plan is not None
    assert plan.names
    data = recording(spec, rng, int(rng.integers(2, 600)), marks)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fused, "best_path", lambda: path)
        state, expected = same_in_pieces(spec, data, rng)
    same_of_few_outputs(spec, data, state, expected, seed)
    return int(expected.alarm.sum())


def compare_ticks(bank: Bank, marks: list[float], path: int, plants: int, few: bool, seed: int) -> None:
    """Assert that single samples of some plants, in any order, have the bits of NumPy, the last decisions too."""
    spec, rng = bank_specification(bank, seed), np.random.default_rng(seed + 1)
    plan, state = plan_of(spec), initial_state(spec, plants)
    assert plan is not None
    data = np.concatenate([recording(spec, rng, 30, marks) for _ in range(-(-plants // 3))])[:plants]
    keep = TOLD[:4] if few else fused.OUTPUTS
    coded = 0 if spec.isolation.coding is None else len(spec.members)
    last = LastSample.blank(plants, len(spec.C), len(spec.isolation.groups), coded)
    inputs = int(rng.integers(0, data.shape[2] + 1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fused, "best_path", lambda: path)
        run = FusedRun(spec, plan, copied(state), inputs, last)
    for k in range(data.shape[1]):
        rows = rng.permutation(plants)[: int(rng.integers(1, plants + 1))]
        outs, sample = run.outputs(len(rows), 1, keep), data[rows, k : k + 1]
        run.run(sample[..., :inputs], sample[..., inputs:], outs, rows)
        with np.errstate(all="ignore"):
            after, expected = run_reference(spec, rows_of(state, rows), sample)
        state = written_rows(copied(state), rows, after)
        for name in TOLD:
            values = outs[name]
            if values is not None:
                assert np.array_equal(values, getattr(expected, name), equal_nan=values.dtype == float), name
        if last.code is not None:
            assert np.array_equal(last.code[rows], expected.code[:, -1])
            loud = expected.alarm[:, -1]
            assert np.array_equal(last.scores[rows][loud], expected.scores[:, -1][loud], equal_nan=True)
    same(run.state, state, "state")


@needs_kernel
@settings(max_examples=60, deadline=None)
@given(bank=banks, marks=marked, overflow=st.booleans(), path=st.sampled_from((0, 1, 2)), seed=seeds)
def test_a_bank_has_the_bits_of_numpy(bank: Bank, marks: list[float], overflow: bool, path: int, seed: int) -> None:
    compare_blocks(bank, marks, overflow, min(path, fused.best_path()), seed)


@needs_kernel
@settings(max_examples=30, deadline=None)
@given(
    bank=banks,
    marks=marked,
    path=st.sampled_from((0, 1, 2)),
    plants=st.sampled_from((1, 2, 33, 70)),
    few=st.booleans(),
    seed=seeds,
)
def test_single_samples_of_many_banks_have_the_bits_of_numpy(
    bank: Bank, marks: list[float], path: int, plants: int, few: bool, seed: int
) -> None:
    compare_ticks(bank, marks, min(path, fused.best_path()), plants, few, seed)


@needs_kernel
@pytest.mark.parametrize("lies", ["side by side", "in two arrays", "with others between", "backwards"])
@pytest.mark.parametrize("marks", [0, 12])
def test_limits_are_those_of_deviations_wherever_values_lie(lies: str, marks: int) -> None:
    """Limits so far out that a sum of sizes is looked at first, with an operating point nearly as far."""
    bank = Bank("norm", ((4, 2), (3, 1), (2, 2)), 5, 1, 1, 2, 4, False, False)
    rng = np.random.default_rng(marks)
    offset = 1.5e15 * rng.choice([-1.0, 1.0], 5)
    spec = replace(bank_specification(bank, 1), plausible=np.tile([-2e15, 2e15], (5, 1)), offset=offset)
    data = offset + rng.standard_normal((3, 1500, 5))
    for _ in range(marks):
        where = tuple(int(rng.integers(size)) for size in data.shape)
        data[where] = offset[where[2]] - np.sign(offset[where[2]]) * rng.choice([1.99e15, 2.01e15])
    state, expected = run_reference(spec, initial_state(spec, 3), data)
    assert expected.missing.any() == (marks > 0)
    plan = plan_of(spec)
    assert plan is not None
    run = FusedRun(spec, plan, copied(initial_state(spec, 3)), 2)
    out, u, y = run.outputs(3, 1500), data[..., :2], data[..., 2:]
    if lies == "in two arrays":
        u, y = u.copy(), y.copy()
    if lies == "with others between":
        u = np.concatenate([u, u], axis=2)[..., :2]
        y = np.concatenate([y, y], axis=2)[..., :3]
    if lies == "backwards":
        u, y = (np.ascontiguousarray(one[..., ::-1])[..., ::-1] for one in (u, y))
    run.run(u, y, out)
    same(run.state, state, "state")
    for name in ("residuals", "missing", "aside", "statistic", "alarm", "code"):
        same(out[name], getattr(expected, name), name)


@needs_kernel
@pytest.mark.parametrize("small", [1.5e-162, 1e-160, 1e-170])
def test_scores_of_sums_whose_squares_underflow_are_those_of_numpy_in_any_cut(small: float) -> None:
    """The size of a sum may round to zero while its part along a signature does not: nothing is named then."""
    spec = replace(
        bank_specification(Bank("groups", ((0, 1), (0, 1)), 2, 1, 1, 50, 1, False, False), 0),
        D=np.eye(2),
        offset=np.zeros(2),
        settle=0,
        test=NormTest(np.zeros(2), np.eye(2), 1.0, 1, 50, 1, "made up"),
        isolation=DirectionTest(1, (("f",),), (np.full((2, 1), 0.5**0.5),), ()),
    )
    data = np.full((1, 40, 2), small)
    data[:, 3] = 5.0
    state, expected = run_reference(spec, initial_state(spec, 1), data)
    assert expected.alarm[0, 3:].all()
    for cuts in ([], [10], list(range(1, 40))):
        now, parts = initial_state(spec, 1), []
        for part in np.split(data, cuts, axis=1):
            now, decisions = run_block(spec, now, part)
            parts.append(decisions)
        same(joined_decisions(parts), expected, "decisions")
        same(now, state, "state")


@needs_kernel
def test_a_bank_without_channels_ends() -> None:
    spec = bank_specification(Bank("norm", ((1, 1), (1, 1), (1, 1)), 2, 1, 1, 2, 4, False, False), 3)
    none = np.zeros((3, 0))
    spec = replace(spec, B=none, D=none, start=none, offset=np.zeros(0), plausible=np.zeros((0, 2)))
    data = np.zeros((2, 30, 0))
    state, expected = run_reference(spec, initial_state(spec, 2), data)
    now, decisions = run_block(spec, initial_state(spec, 2), data)
    same(now, state, "state")
    same(decisions, expected, "decisions")


def test_a_member_that_fires_since_before_the_first_sample_is_refused() -> None:
    spec = bank_specification(Bank("norm", ((1, 1), (1, 1)), 2, 1, 1, 2, 4, False, False), 3)
    state = initial_state(spec, 1).isolation
    assert isinstance(spec.isolation, CodeTest)
    assert isinstance(state, CodeState)
    for since in (-5, 31):
        with pytest.raises(FileFormatError, match="between 0 and"):
            spec.isolation.check_state(replace(state, since=np.full_like(state.since, since)), 30)


def test_members_of_which_it_is_not_known_since_when_stay_so_in_any_cut() -> None:
    """States of an earlier version: a member fires, and since when is 0; known again once it has been silent."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        fired = rng.random((2, 7, 3)) < 0.8
        state = CodeState(empty_window(2, 1, 3), np.zeros((2, 3), dtype=np.int64), rng.random((2, 3)) < 0.6)
        expected, now = alarms_since(fired, state, 10), state
        for k in range(7):
            since = alarms_since(fired[:, k : k + 1], now, 10 + k)
            now = CodeState(now.window, since, fired[:, k])
        assert np.array_equal(now.since, expected)


@needs_kernel
@pytest.mark.campaign
@pytest.mark.parametrize("part", range(10))
@settings(max_examples=1_000, deadline=None)
@given(bank=banks, marks=marked, overflow=st.booleans(), path=st.sampled_from((0, 1, 2)), seed=seeds)
def test_ten_thousand_banks_have_the_bits_of_numpy(
    part: int, bank: Bank, marks: list[float], overflow: bool, path: int, seed: int
) -> None:
    """In ten parts, each of which ends before it would be taken to hang."""
    compare_blocks(bank, marks, overflow, min(path, fused.best_path()), seed)
    compare_ticks(bank, marks, min(path, fused.best_path()), 1 + seed % 40, bool(part % 2), seed)
