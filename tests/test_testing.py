"""The shipped checks accept what is right and refuse what is not."""

from __future__ import annotations

from dataclasses import replace

import pytest

import residua as rs
from guards import changed, trips
from residua.errors import AccuracyError
from residua.testing import check_residual_generator


@pytest.mark.parametrize("dt", [0.0, 0.05])
def test_our_own_designs_pass(dt: float) -> None:
    engine = rs.library.jet_engine()
    engine = engine.discretize(dt) if dt else engine
    check_residual_generator(rs.design.robust_detection_filter(engine))
    check_residual_generator(rs.design.detection_filter(engine))
    check_residual_generator(rs.design.kalman_filter(engine.with_noise(process=1e-4, measurement=1e-3)))
    check_residual_generator(rs.design.unknown_input_observer(engine).residual_generator())


def test_sampled_continuous_designs_pass_with_what_sampling_costs() -> None:
    engine = rs.library.jet_engine()
    for dt in (0.001, 0.01, 0.1):
        check_residual_generator(rs.design.robust_detection_filter(engine).discretize(dt))


@trips(
    "testing.residual_generator:check_residual_generator:1",
    "testing.residual_generator:check_residual_generator:3",
    "testing.residual_generator:_check_subspaces",
)
def test_wrong_ones_are_refused() -> None:
    good = rs.design.detection_filter(rs.library.gertler())
    for change, words in (
        ({"A": good.system.A * 3}, "not stable"),
        ({"B": good.system.B * 1.01}, "control inputs"),
    ):
        with pytest.raises(AccuracyError, match=words):
            check_residual_generator(replace(good, system=good.system.replaced(**change)))
    swapped = {"p1": good.subspaces["p2"], "p2": good.subspaces["p1"]}
    with pytest.raises(AccuracyError, match="leaves its subspace"):
        check_residual_generator(replace(good, subspaces=swapped))
    robust = rs.design.detection_filter(rs.library.jet_engine())
    with pytest.raises(AccuracyError, match="disturbance"):
        check_residual_generator(robust, decoupled=True)


@trips("testing.residual_generator:check_residual_generator:2")
def test_a_filter_of_other_signals_is_refused() -> None:
    good = rs.design.detection_filter(rs.library.gertler())
    fewer = good.system.select(inputs=range(good.system.n_inputs - 1))
    with pytest.raises(AccuracyError, match="takes 2 signals, the plant has 3"):
        check_residual_generator(replace(good, system=fewer))


@trips("testing.residual_generator:_check_runs:1")
def test_a_residual_that_is_not_zero_on_data_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    good = rs.design.detection_filter(rs.library.gertler())
    changed(monkeypatch, "design.core.generator:ResidualGenerator.run", lambda r: r + 1e-3)
    with pytest.raises(AccuracyError, match="on fault-free data"):
        check_residual_generator(good)


@trips("testing.residual_generator:_check_runs:2")
def test_plants_that_are_not_apart_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    good = rs.design.detection_filter(rs.library.gertler())
    changed(monkeypatch, "design.core.generator:ResidualGenerator.run", lambda r: r[::-1] if r.ndim == 3 else r)
    with pytest.raises(AccuracyError, match="two plants run together"):
        check_residual_generator(good)


@trips("testing.residual_generator:_check_runs:3")
def test_pieces_with_other_bits_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    good = rs.design.detection_filter(rs.library.gertler())
    changed(monkeypatch, "testing.residual_generator:run_filter", lambda found: (found[0] + 1e-15, found[1]))
    with pytest.raises(AccuracyError, match="running in pieces"):
        check_residual_generator(good)
